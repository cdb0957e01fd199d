"""The gradient of a window's cost with respect to its switching instants, computed in three independent ways.

All three take the controls as given and leave end conditions and limits aside: the cost is that of rolling the
dynamics out. The discrete adjoint and algorithmic differentiation hold U fixed on the mesh, which stretches with the
instants; the paper's costate formula holds u(t) fixed in physical time: it agrees where the control is stationary.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np

from psmpc_cli.ocp.objective import StageShape, stage_functions
from psmpc_cli.ocp.window import Window, desired_paths
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
        window: The window.
        instants: Guessed instants (S,) [s], about which trajectories are linear.
    """

    def __init__(self, model: RobotModel, window: Window, instants: np.ndarray) -> None:
        self.window, self.nodes = window, window.nodes
        self.paths = desired_paths(window, instants)
        self.stages = [_rolled(model, window, s) for s in range(len(window.nodes))]

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
            stage, N, r = self.stages[s], self.nodes[s], self._wanted(s, tau[s])
            for i in reversed(range(N)):
                k -= 1
                u, dt = U[s][i], tau[s] / N
                F_x, F_dt = (np.asarray(block) for block in stage.step_jacobians(X[k], u, dt))
                by_x, by_r = (np.asarray(block).ravel() for block in stage.cost_gradients(X[k], u, r[i]))
                by_duration[s] += (F_dt.ravel() @ costate + float(stage.cost(X[k], u, r[i]))) / N
                by_duration[s] += dt * by_r @ self.paths[s].slopes[i]
                costate = F_x.T @ costate + by_x * dt
        return self._by_instants(by_duration)

    def by_differentiation(self, tau: np.ndarray, U: list[np.ndarray]) -> np.ndarray:
        """Return dJ/dt_s (S,) by algorithmic differentiation of the rollout."""
        symbol = ca.MX.sym("tau", len(tau))
        J, x = ca.MX(0), ca.MX(self.window.x0)
        for s, (stage, N) in enumerate(zip(self.stages, self.nodes, strict=True)):
            for i, u in enumerate(U[s]):
                J += stage.cost(x, u, self.paths[s].values[i] + symbol[s] * self.paths[s].slopes[i]) * symbol[s] / N
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
            stage, dt, r = self.stages[s], tau[s] / self.nodes[s], self._wanted(s, tau[s])
            if s < self.switches:
                gradient[s] += self._jump(s, X[k], tau, (U[s][-1], U[s + 1][0]), costate)
            for i in reversed(range(self.nodes[s])):
                k -= 1
                by_x, by_r = (np.asarray(block).ravel() for block in stage.cost_gradients(X[k], U[s][i], r[i]))
                costate = costate + dt * (np.asarray(stage.flow_jacobian(X[k], U[s][i])).T @ costate + by_x)
                gradient[s - 1 : s] -= by_r @ (r[i + 1] - r[i])  # a trajectory begins with its stage, and later with it
        return np.asarray(gradient + self._pending())

    def cost(self, tau: np.ndarray, U: list[np.ndarray]) -> float:
        """Return J over the window's largest priority, end conditions and limits aside."""
        X, k, J = self.states(tau, U), 0, float(self._pending() @ np.cumsum(tau)[:-1])
        for s, N in enumerate(self.nodes):
            L = np.asarray(self.stages[s].cost(X[k : k + N].T, U[s].T, self._wanted(s, tau[s])[:-1].T))
            J += float(L.sum() * tau[s] / N)
            k += N
        return J

    def _wanted(self, s: int, tau: float) -> np.ndarray:
        """Return what the cost of a stage that lasts tau [s] follows at its nodes, (N_s + 1, rows)."""
        return self.paths[s].values + tau * self.paths[s].slopes

    def _jump(
        self, s: int, x: np.ndarray, tau: np.ndarray, u: tuple[np.ndarray, np.ndarray], costate: np.ndarray
    ) -> float:
        """Return the jump of the Hamiltonian at the switch after stage s, each side with its own control.

        Eq. (25) assumes a continuous control; at an optimum it jumps, because the weight on it does.
        """
        before, after = self.stages[s], self.stages[s + 1]
        flow = np.asarray(before.flow(x, u[0]) - after.flow(x, u[1])).ravel()
        ends, begins = self._wanted(s, tau[s])[-1], self._wanted(s + 1, tau[s + 1])[0]
        return float(costate @ flow) + float(before.cost(x, u[0], ends) - after.cost(x, u[1], begins))

    def _by_instants(self, by_duration: np.ndarray) -> np.ndarray:
        """Return dJ/dt_s from dJ/dtau_s: an instant lengthens one stage and shortens the next."""
        return np.asarray(by_duration[:-1] - by_duration[1:] + self._pending())

    def _pending(self) -> np.ndarray:
        return np.full(self.switches, self.window.pending_cost)


def _rolled(model: RobotModel, window: Window, s: int) -> RolledStage:
    """Bind a stage's numbers into its functions."""
    stage = window.stages[s]
    functions = stage_functions(model, StageShape(stage.space, stage.input))
    x, dt, r = ca.SX.sym("x", 2 * model.n), ca.SX.sym("dt"), ca.SX.sym("r", len(stage.target))
    u = ca.SX.sym("u", functions.inputs)
    Lbar = functions.cost(x, u, r, stage.weights, stage.control_weights)
    cost = window.omega[s] / np.max(window.omega) * (Lbar - window.offset[s]) / window.scale[s]
    after = functions.step(window.discretization)(x, u, dt)
    flow = (model.f_1 if stage.input == "joint" else model.f_2)(x, u)
    return RolledStage(
        step=ca.Function("F", [x, u, dt], [after]),
        cost=ca.Function("L", [x, u, r], [cost]),
        flow=ca.Function("f", [x, u], [flow]),
        step_jacobians=ca.Function("dF", [x, u, dt], [ca.jacobian(after, x), ca.jacobian(after, dt)]),
        cost_gradients=ca.Function("dL", [x, u, r], [ca.gradient(cost, x), ca.gradient(cost, r)]),
        flow_jacobian=ca.Function("df", [x, u], [ca.jacobian(flow, x)]),
    )
