"""The gradient of a window's cost with respect to its switching instants, computed in three independent ways.

All three take the controls as given and leave end conditions and limits aside: the cost is that of rolling the
dynamics out. The discrete adjoint and algorithmic differentiation hold U fixed on the mesh, which stretches with the
instants; the paper's costate formula holds u(t) fixed in physical time: it agrees where the control is stationary. What
a desired trajectory wants at the nodes is fixed on the mesh too, as in the NLP.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np

from psmpc_cli.ocp.layout import WindowShape
from psmpc_cli.ocp.transcription import stage_functions
from psmpc_cli.ocp.window import Window, references
from psmpc_cli.robot.model import RobotModel


@dataclass(frozen=True, eq=False)
class RolledStage:
    """A stage of a rollout, its numbers bound in.

    Attributes:
        step: x, u, dt -> x_next.
        cost: x, u, r -> omega L, the weighted and normalized running cost against the reference r.
        flow: x, u -> xdot.
        step_jacobians: x, u, dt -> dF/dx, dF/ddt.
        cost_gradients: x, u, r -> d(omega L)/dx, d(omega L)/dr.
        flow_jacobian: x, u -> df/dx.
    """

    step: ca.Function
    cost: ca.Function
    flow: ca.Function
    step_jacobians: ca.Function
    cost_gradients: ca.Function
    flow_jacobian: ca.Function


class Rollout:
    """The cost of a window as a function of its instants, over given controls.

    Args:
        model: The robot.
        shape: The window's shape.
        window: The window.
        instants: Guessed instants (S,) [s], which say what trajectories want at the nodes.
    """

    def __init__(self, model: RobotModel, shape: WindowShape, window: Window, instants: np.ndarray) -> None:
        self.window, self.nodes = window, shape.nodes
        self.references = references(shape.nodes, window, instants)
        self.stages = [_rolled(model, shape, window, s) for s in range(len(shape.nodes))]

    @property
    def switches(self) -> int:
        """Number of switching instants, S."""
        return len(self.nodes) - 1

    def states(self, tau: np.ndarray, U: list[np.ndarray]) -> np.ndarray:
        """Return the states (K + 1, 2n) that durations tau (S + 1,) and inputs U, (N_s, inputs) by stage, lead to."""
        X = [self.window.x0]
        for stage, duration, N, inputs in zip(self.stages, tau, self.nodes, U, strict=True):
            for u in inputs:
                X.append(np.asarray(stage.step(X[-1], u, duration / N)).ravel())
        return np.array(X)

    def by_adjoint(self, tau: np.ndarray, U: list[np.ndarray]) -> np.ndarray:
        """Return dJ/dt_s (S,) by the discrete adjoint of the rollout."""
        X, k = self.states(tau, U), sum(self.nodes)
        costate, by_duration = np.zeros(len(self.window.x0)), np.zeros(len(tau))
        for s in reversed(range(len(tau))):
            stage, N, reference = self.stages[s], self.nodes[s], self.references[s].T
            for u, r in zip(U[s][::-1], reference[-2::-1], strict=True):
                k -= 1
                F_x, F_dt = (np.asarray(block) for block in stage.step_jacobians(X[k], u, tau[s] / N))
                by_duration[s] += (F_dt.ravel() @ costate + float(stage.cost(X[k], u, r))) / N
                costate = F_x.T @ costate + np.asarray(stage.cost_gradients(X[k], u, r)[0]).ravel() * tau[s] / N
        return self._by_instants(by_duration)

    def by_differentiation(self, tau: np.ndarray, U: list[np.ndarray]) -> np.ndarray:
        """Return dJ/dt_s (S,) by algorithmic differentiation of the rollout."""
        symbol = ca.MX.sym("tau", len(tau))
        J, x = ca.MX(0), ca.MX(self.window.x0)
        for s, (stage, N) in enumerate(zip(self.stages, self.nodes, strict=True)):
            for u, r in zip(U[s], self.references[s].T[:-1], strict=True):
                J += stage.cost(x, u, r) * symbol[s] / N
                x = stage.step(x, u, symbol[s] / N)
        gradient = ca.Function("gradient", [symbol], [ca.gradient(J, symbol)])
        return self._by_instants(np.asarray(gradient(tau)).ravel())

    def by_differences(self, tau: np.ndarray, U: list[np.ndarray], h: float = 1e-4) -> np.ndarray:
        """Return dJ/dt_s (S,) by central differences with step h [s]."""
        gradient = np.zeros(self.switches)
        for s in range(self.switches):
            for sign in (1, -1):
                moved = tau.copy()
                moved[s], moved[s + 1] = tau[s] + sign * h, tau[s + 1] - sign * h
                gradient[s] += sign * self.cost(moved, U) / (2 * h)
        return gradient

    def by_costate(self, tau: np.ndarray, U: list[np.ndarray]) -> np.ndarray:
        """Return dJ/dt_s (S,) by the costate formula. Paper eqs. (26), (27), each stage with its own weight."""
        X, k = self.states(tau, U), sum(self.nodes)
        costate, gradient = np.zeros(len(self.window.x0)), np.zeros(self.switches)
        for s in reversed(range(len(tau))):
            stage, N, dt, reference = self.stages[s], self.nodes[s], tau[s] / self.nodes[s], self.references[s].T
            if s < self.switches:
                gradient[s] += self._jump(s, X[k], (U[s][-1], U[s + 1][0]), costate)
            for i in reversed(range(N)):
                k -= 1
                by_x, by_r = (np.asarray(g).ravel() for g in stage.cost_gradients(X[k], U[s][i], reference[i]))
                costate = costate + dt * (np.asarray(stage.flow_jacobian(X[k], U[s][i])).T @ costate + by_x)
                drag = float(by_r @ (reference[i + 1] - reference[i]))  # the mesh takes the trajectory along
                gradient[s : s + 1] -= drag * i / N
                gradient[s - 1 : s] -= drag * (1 - i / N)
        return np.asarray(gradient + self._pending())

    def cost(self, tau: np.ndarray, U: list[np.ndarray]) -> float:
        """Return J over the window's largest priority, end conditions and limits aside."""
        X, k, J = self.states(tau, U), 0, float(self._pending() @ np.cumsum(tau)[:-1])
        for s, N in enumerate(self.nodes):
            L = np.asarray(self.stages[s].cost(X[k : k + N].T, U[s].T, self.references[s][:, :-1]))
            J += float(L.sum() * tau[s] / N)
            k += N
        return J

    def _jump(self, s: int, x: np.ndarray, u: tuple[np.ndarray, np.ndarray], costate: np.ndarray) -> float:
        """Return the jump of the Hamiltonian at the switch after stage s, each side with its own control.

        Eq. (25) assumes a continuous control; at an optimum it jumps, because the weight on it does.
        """
        before, after = self.stages[s], self.stages[s + 1]
        flow = np.asarray(before.flow(x, u[0]) - after.flow(x, u[1])).ravel()
        ends, begins = self.references[s][:, -1], self.references[s + 1][:, 0]
        return float(costate @ flow) + float(before.cost(x, u[0], ends) - after.cost(x, u[1], begins))

    def _by_instants(self, by_duration: np.ndarray) -> np.ndarray:
        """Return dJ/dt_s from dJ/dtau_s: an instant lengthens one stage and shortens the next."""
        return np.asarray(by_duration[:-1] - by_duration[1:] + self._pending())

    def _pending(self) -> np.ndarray:
        return np.full(self.switches, self.window.pending_cost)


def _rolled(model: RobotModel, shape: WindowShape, window: Window, s: int) -> RolledStage:
    """Bind a stage's numbers into its functions."""
    stage, functions = window.stages[s], stage_functions(model, shape.stages[s], shape.discretization)
    x, dt, r = ca.SX.sym("x", 2 * model.n), ca.SX.sym("dt"), ca.SX.sym("r", len(stage.target))
    u = ca.SX.sym("u", model.n if stage.input == "joint" else model.m)
    Lbar = functions.cost(x, u, r, stage.weights, stage.control_weights)
    cost = window.omega[s] / np.max(window.omega) * (Lbar - window.offset[s]) / window.scale[s]
    after = functions.step(x, u, dt)
    flow = (model.f_1 if stage.input == "joint" else model.f_2)(x, u)
    return RolledStage(
        step=ca.Function("F", [x, u, dt], [after]),
        cost=ca.Function("L", [x, u, r], [cost]),
        flow=ca.Function("f", [x, u], [flow]),
        step_jacobians=ca.Function("dF", [x, u, dt], [ca.jacobian(after, x), ca.jacobian(after, dt)]),
        cost_gradients=ca.Function("dL", [x, u, r], [ca.gradient(cost, x), ca.gradient(cost, r)]),
        flow_jacobian=ca.Function("df", [x, u], [ca.jacobian(flow, x)]),
    )
