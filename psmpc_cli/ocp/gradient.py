"""The gradient of a window's cost with respect to its switching instants, computed in independent ways.

All take the controls as given and leave end conditions and limits aside: the cost is that of rolling the dynamics out.
The discrete adjoint, algorithmic differentiation and differences hold U fixed on the mesh, which stretches with the
instants; the paper's costate formula holds u(t) fixed in physical time: it agrees where the control is stationary.
"""

from dataclasses import replace

import casadi as ca
import numpy as np

from psmpc_cli.ocp.objective import stage_functions
from psmpc_cli.ocp.stage import stage_shape, without_end
from psmpc_cli.ocp.window import Window, reference, window_numbers
from psmpc_cli.robot.model import RobotModel


class Rollout:
    """The cost of a window as a function of its instants, over given controls.

    Args:
        model: The robot.
        window: The window.
        instants: Guessed instants (S,) [s], about which trajectories are linear.
    """

    def __init__(self, model: RobotModel, window: Window, instants: np.ndarray) -> None:
        self.window = window
        self.nodes = window.nodes
        self._p = window_numbers(window, instants)
        self._stages = [_stage_terms(model, window, s) for s in range(len(window.nodes))]

    def states(self, tau: np.ndarray, U: list[np.ndarray]) -> np.ndarray:
        """Return the states (K + 1, 2n) that durations tau (S + 1,) and inputs U, (N_s, inputs) by stage, lead to."""
        X = [self.window.x0]
        for s, N in enumerate(self.nodes):
            r, _ = self._reference(s, tau[s])
            for u in U[s]:
                X.append(self._terms(s, X[-1], u, tau[s] / N, r[0])["after"].ravel())
        return np.array(X)

    def by_adjoint(self, tau: np.ndarray, U: list[np.ndarray]) -> np.ndarray:
        """Return dJ/dt_s (S,) by the discrete adjoint of the rollout."""
        X = self.states(tau, U)
        k = sum(self.nodes)
        costate = np.zeros(len(self.window.x0))
        by_duration = np.zeros(len(tau))
        for s in reversed(range(len(tau))):
            N = self.nodes[s]
            dt = tau[s] / self.nodes[s]
            r, slopes = self._reference(s, tau[s])
            for i in reversed(range(N)):
                k -= 1
                at = self._terms(s, X[k], U[s][i], dt, r[i])
                by_duration[s] += (at["after_dt"].ravel() @ costate + at["L"].item()) / N
                by_duration[s] += dt * at["L_r"].ravel() @ slopes[i]
                costate = at["after_x"].T @ costate + at["L_x"].ravel() * dt
        return self._by_instants(by_duration) + self.window.pending_cost

    def by_differentiation(self, tau: np.ndarray, U: list[np.ndarray]) -> np.ndarray:
        """Return dJ/dt_s (S,) by algorithmic differentiation of the rollout."""
        symbol = ca.MX.sym("tau", len(tau))
        gradient = ca.Function("gradient", [symbol], [ca.gradient(self._objective(symbol, U), symbol)])
        return self._by_instants(np.asarray(gradient(tau)).ravel())

    def by_differences(self, tau: np.ndarray, U: list[np.ndarray], h: float = 1e-4) -> np.ndarray:
        """Return dJ/dt_s (S,) by central differences with step h [s]."""
        symbol = ca.MX.sym("tau", len(tau))
        J = ca.Function("J", [symbol], [self._objective(symbol, U)])
        by_duration = [float(J(tau + h * e) - J(tau - h * e)) / (2 * h) for e in np.eye(len(tau))]
        return self._by_instants(np.array(by_duration))

    def by_costate(self, tau: np.ndarray, U: list[np.ndarray]) -> np.ndarray:
        """Return dJ/dt_s (S,) by the costate formula. Paper eqs. (26), (27), each stage with its own weight."""
        X = self.states(tau, U)
        k = sum(self.nodes)
        S = len(tau) - 1
        costate = np.zeros(len(self.window.x0))
        gradient = np.full(S, self.window.pending_cost)
        for s in reversed(range(len(tau))):
            dt = tau[s] / self.nodes[s]
            r, _ = self._reference(s, tau[s])
            if s < S:  # eq. (25) assumes a continuous control; at an optimum it jumps, because the weight on it does
                before = self._terms(s, X[k], U[s][-1], dt, r[-1])
                after = self._terms(s + 1, X[k], U[s + 1][0], dt, self._reference(s + 1, tau[s + 1])[0][0])
                gradient[s] += costate @ (before["f"] - after["f"]).ravel() + (before["L"] - after["L"]).item()
            for i in reversed(range(self.nodes[s])):
                k -= 1
                at = self._terms(s, X[k], U[s][i], dt, r[i])
                costate = costate + dt * (at["f_x"].T @ costate + at["L_x"].ravel())
                gradient[s - 1 : s] -= at["L_r"].ravel() @ (r[i + 1] - r[i])  # a trajectory begins with its stage
        return gradient

    def _objective(self, tau: ca.MX, U: list[np.ndarray]) -> ca.MX:
        """Return J over the window's largest priority, end conditions and limits aside."""
        J = self.window.pending_cost * ca.sum1(ca.cumsum(tau)[:-1])
        x = ca.MX(self.window.x0)
        for s, N in enumerate(self.nodes):
            values, slopes = self._reference(s, 0.0)
            for i, u in enumerate(U[s]):
                at = self._stages[s](x=x, u=u, dt=tau[s] / N, r=values[i] + tau[s] * slopes[i])
                J = J + at["L"] * tau[s] / N
                x = at["after"]
        return J

    def _terms(self, s: int, x: np.ndarray, u: np.ndarray, dt: float, r: np.ndarray) -> dict[str, np.ndarray]:
        return {name: np.asarray(value) for name, value in self._stages[s](x=x, u=u, dt=dt, r=r).items()}

    def _reference(self, s: int, tau: float) -> tuple[np.ndarray, np.ndarray]:
        """Return what the cost of a stage follows at its nodes, and its slope by tau [s], (N_s + 1, rows) each."""
        found, slopes = reference(self._p, s, tau)
        shape = (self.nodes[s] + 1, found.shape[1])
        return np.broadcast_to(found, shape), np.broadcast_to(slopes, shape)

    def _by_instants(self, by_duration: np.ndarray) -> np.ndarray:
        """Return dJ/dt_s from dJ/dtau_s: an instant lengthens one stage and shortens the next."""
        return np.asarray(by_duration[:-1] - by_duration[1:])


def _stage_terms(model: RobotModel, window: Window, s: int) -> ca.Function:
    """Bind a stage's numbers into its step, its weighted and normalized cost L, its flow f, and their derivatives."""
    stage = window.stages[s]
    functions = stage_functions(model, replace(without_end(stage_shape(stage)), moving=False))
    x = ca.SX.sym("x", 2 * model.n)
    dt = ca.SX.sym("dt")
    r = ca.SX.sym("r", len(stage.target))
    u = ca.SX.sym("u", functions.inputs)
    Lbar = functions.cost.function(x, u, r, stage.weights, stage.control_weights)
    L = window.omega[s] / np.max(window.omega) * (Lbar - window.offset[s]) / window.scale[s]
    after = functions.step(window.discretization)(x, u, dt)
    f = (model.f_1 if stage.input == "joint" else model.f_2)(x, u)
    terms = {"after": after, "after_x": ca.jacobian(after, x), "after_dt": ca.jacobian(after, dt), "L": L}
    terms |= {"L_x": ca.gradient(L, x), "L_r": ca.gradient(L, r), "f": f, "f_x": ca.jacobian(f, x)}
    return ca.Function("terms", [x, u, dt, r], list(terms.values()), ["x", "u", "dt", "r"], list(terms))
