"""The cost of a window with its states simulated, and its gradient by costates. Paper eqs. (21) to (27).

The variables are the durations of the stages and the inputs over their intervals; end conditions and limits are left
aside. The discrete adjoint, algorithmic differentiation and differences hold U fixed on the mesh, which stretches with
the switch times. The paper's costate formula holds u(t) fixed in physical time: it agrees where the control is
stationary, but for an error O(1/N_s).
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np

from psmpc_cli.ocp.objective import stage_functions
from psmpc_cli.ocp.stage import StageShape, without_end
from psmpc_cli.ocp.window import Parameters, Window, WindowShape, reference_at, slope_at, window_numbers, window_shape
from psmpc_cli.robot.model import RobotModel

Inputs = Sequence[Sequence[Any]]
"""The inputs over the intervals of each stage (inputs,)."""


class Shooting:
    """J of the windows of one shape over durations tau (S + 1,) [s] and inputs U, the states simulated.

    Parameters, durations and inputs are numbers or symbols of CasADi, and so is what the methods return.

    Args:
        model: The robot.
        shape: The shape.
        p: The parameters of a window of this shape.
    """

    def __init__(self, model: RobotModel, shape: WindowShape, p: Parameters[Any]) -> None:
        self.nodes = shape.nodes
        self._p = p
        stages = [replace(without_end(stage), moving=False) for stage in shape.stages]
        functions = [stage_functions(model, stage) for stage in stages]
        self._steps = [of_stage.step(shape.discretization) for of_stage in functions]
        self._anchors = [target[of_stage.anchor] for target, of_stage in zip(p.targets, functions, strict=False)]
        self._terms = [_terms_of_interval(model, stage, shape.discretization) for stage in stages]

    def states(self, tau: Any, U: Inputs) -> list[Any]:
        """Return the states (2n,) at the nodes."""
        X = [self._p.x0]
        for s, N in enumerate(self.nodes):
            for u in U[s]:
                X.append(self._steps[s](X[-1], u, tau[s] / N, self._anchors[s]))
        return X

    def objective(self, tau: Any, U: Inputs) -> Any:
        """Return J over the window's largest priority. Paper eq. (20)."""
        X = self.states(tau, U)
        last = len(self.nodes) - 1
        J = self._p.pending * sum((last - s) * tau[s] for s in range(last + 1))
        k = 0
        for s, N in enumerate(self.nodes):
            for i, u in enumerate(U[s]):
                J += self._terms_at_node(s, i, X[k], u, tau)["L"] * tau[s] / N
                k += 1
        return J + self._p.terminal * self._terms_at_last_node(X[k], tau)["L"]

    def adjoint(self, tau: Any, U: Inputs) -> tuple[list[Any], list[list[Any]]]:
        """Return the exact gradient of J by all variables, by the discrete adjoint: one sweep backwards over the nodes.

        With x_k+1 = F(x_k, u_k, h), h = tau_s / N_s, L weighted with the priority of its stage, and costates psi,

            psi_k = F_x' psi_k+1 + h L_x,     dJ/du_k = F_u' psi_k+1 + h L_u,
            dJ/dtau_s = 1 / N_s sum_k (F_h' psi_k+1 + L_k) + sum_k h L_r' dr_k/dtau_s.

        The last sum is of trajectories r, which are read at the nodes.

        Args:
            tau: Durations of the stages, (S + 1,) [s], numbers or symbols.
            U: Inputs over the intervals, by stage.

        Returns:
            dJ/dtau_s of each stage; dJ/du_k of each interval, by stage.
        """
        X = self.states(tau, U)
        k = len(X) - 1
        last = len(self.nodes) - 1
        terms = self._terms_at_last_node(X[k], tau)
        costate = self._p.terminal * terms["L_x"]
        by_duration = [self._p.pending * (last - s) for s in range(last + 1)]
        by_duration[last] += self._p.terminal * ca.dot(terms["L_r"], slope_at(self._p, last, self.nodes[last]))
        by_input: list[list[Any]] = [[] for _ in self.nodes]
        for s in reversed(range(len(self.nodes))):
            N = self.nodes[s]
            h = tau[s] / N
            for i in reversed(range(N)):
                k -= 1
                terms = self._terms_at_node(s, i, X[k], U[s][i], tau)
                by_duration[s] += (ca.dot(terms["F_h"], costate) + terms["L"]) / N
                by_duration[s] += h * ca.dot(terms["L_r"], slope_at(self._p, s, i))
                by_input[s].insert(0, terms["F_u"].T @ costate + h * terms["L_u"])
                costate = terms["F_x"].T @ costate + h * terms["L_x"]
        return by_duration, by_input

    def by_costate(self, tau: Any, U: Inputs, printed: bool = False) -> list[Any]:
        """Return dJ/dt_s by each switch time, by the paper's formula in continuous time, its costate psi by (27).

        It is one of several ways to compute this gradient, and is compared with the others. At an optimum the control
        jumps at a switch, because the weight on it does. Here each side of the jump has its own control and its own
        priority,

            psi' (f_s(x, u-) - f_s+1(x, u+)) + omega_s L_s(x, u-) - omega_s+1 L_s+1(x, u+),

        while (26), `printed`, has u- and omega_s on both sides.

        Args:
            tau: Durations of the stages, (S + 1,) [s], numbers or symbols.
            U: Inputs over the intervals, by stage.
            printed: Take (26) as the paper prints it.

        Returns:
            dJ/dt_s of each of the S switch times.
        """
        X = self.states(tau, U)
        k = len(X) - 1
        last = len(self.nodes) - 1
        costate = self._p.terminal * self._terms_at_last_node(X[k], tau)["L_x"]
        gradient: list[Any] = [self._p.pending] * last  # a later switch lets the stages after it wait longer
        for s in reversed(range(len(self.nodes))):
            h = tau[s] / self.nodes[s]
            if s < last:
                before = self._terms_at_node(s, self.nodes[s], X[k], U[s][-1], tau)
                u_after = U[s][-1] if printed else U[s + 1][0]
                omega_after = self._p.omega[s if printed else s + 1]
                after = self._terms_at_node(s + 1, 0, X[k], u_after, tau, omega=omega_after)
                gradient[s] += ca.dot(costate, before["f"] - after["f"]) + before["L"] - after["L"]
            for i in reversed(range(self.nodes[s])):
                k -= 1
                terms = self._terms_at_node(s, i, X[k], U[s][i], tau)
                costate = costate + h * (terms["f_x"].T @ costate + terms["L_x"])
                if s > 0:  # a trajectory begins with its stage: it moves with the switch before
                    change = reference_at(self._p, s, i + 1, tau[s]) - reference_at(self._p, s, i, tau[s])
                    gradient[s - 1] -= ca.dot(terms["L_r"], change)
        return gradient

    def _terms_at_node(self, s: int, i: int, x: Any, u: Any, tau: Any, **changes: Any) -> dict[str, Any]:
        """Evaluate what the gradients are made of at a node: cost L, flow f, and derivatives of these and the step F.

        Args:
            s: The stage.
            i: The node, counted from the stage's first.
            x: State there.
            u: Input over the interval that begins there.
            tau: Durations of the stages [s].
            changes: Values for arguments of the terms in place of the stage's own, such as another priority `omega`.
        """
        p = self._p
        arguments = {
            "x": x,
            "u": u,
            "h": tau[s] / self.nodes[s],
            "r": reference_at(p, s, i, tau[s]),
            "W": p.weights[s],
            "W_r": p.control_weights[s],
            "load": p.loads[s],
            "omega": p.omega[s],
            "offset": p.offset[s],
            "scale": p.scale[s],
        }
        terms: dict[str, Any] = self._terms[s](**{**arguments, **changes})
        return terms

    def _terms_at_last_node(self, x: Any, tau: Any) -> dict[str, Any]:
        """Return the terms of the last stage at its end, where neither control nor force costs."""
        last = len(self.nodes) - 1
        return self._terms_at_node(last, self.nodes[last], x, 0.0, tau, W_r=0.0)


def by_switch_times(by_duration: Iterable[Any]) -> list[Any]:
    """Return dJ/dt_s of the switch times from dJ/dtau_s: each lengthens one stage and shortens the next."""
    return [before - after for before, after in pairwise(by_duration)]


class Rollout:
    """The gradient of one window's cost by its switch times, over given controls, computed in independent ways.

    Args:
        model: The robot.
        window: The window.
        switch_times: Guessed switch times (S,) [s], about which trajectories are linear.
    """

    def __init__(self, model: RobotModel, window: Window, switch_times: np.ndarray) -> None:
        self._shooting = Shooting(model, window_shape(window), window_numbers(window, switch_times).mapped(ca.DM))

    def by_adjoint(self, tau: np.ndarray, U: list[np.ndarray]) -> np.ndarray:
        """Return dJ/dt_s (S,) by the discrete adjoint, for durations tau (S + 1,) and inputs U, (N_s, inputs) each."""
        by_duration, _ = self._shooting.adjoint(ca.DM(tau), _columns(U))
        return np.array(by_switch_times(by_duration), float).ravel()

    def by_differentiation(self, tau: np.ndarray, U: list[np.ndarray]) -> np.ndarray:
        """Return dJ/dt_s (S,) by algorithmic differentiation of the rollout."""
        symbol = ca.MX.sym("tau", len(tau))
        J = self._shooting.objective(symbol, _columns(U))
        gradient = ca.Function("gradient", [symbol], [ca.gradient(J, symbol)])
        return np.array(by_switch_times(np.asarray(gradient(tau)).ravel()))

    def by_differences(self, tau: np.ndarray, U: list[np.ndarray], h: float = 1e-4) -> np.ndarray:
        """Return dJ/dt_s (S,) by central differences with step h [s]."""
        inputs = _columns(U)

        def J(tau: np.ndarray) -> float:
            return float(self._shooting.objective(ca.DM(tau), inputs))

        return np.array(by_switch_times([(J(tau + h * e) - J(tau - h * e)) / (2 * h) for e in np.eye(len(tau))]))

    def by_costate(self, tau: np.ndarray, U: list[np.ndarray], printed: bool = False) -> np.ndarray:
        """Return dJ/dt_s (S,) by the costate formula, paper eqs. (26), (27): corrected, or as printed."""
        gradient = self._shooting.by_costate(ca.DM(tau), _columns(U), printed)
        return np.array(gradient, float).ravel()


def _columns(U: Sequence[np.ndarray]) -> list[list[ca.DM]]:
    """Return inputs (N_s, inputs) of each stage as columns."""
    return [[ca.DM(u) for u in of_stage] for of_stage in U]


def _terms_of_interval(model: RobotModel, shape: StageShape, discretization: str) -> ca.Function:
    """Return what gradients of J by durations and inputs are made of at one interval of a stage, as one function.

    Its results are the weighted and normalized running cost L = omega (cost - offset) / scale, the flow f, and the
    derivatives of these and of the step F by their arguments: F_x is dF / dx. The discrete adjoint is made of F and L,
    the paper's costate formula (26) of f and L.

    Args:
        model: The robot.
        shape: The structure of the stage.
        discretization: How the step integrates the motion over an interval.

    Returns:
        A function with named arguments: state x, control u, step h, target and anchor r, weights W and W_r, load,
        priority omega, offset and scale of the normalization.
    """
    functions = stage_functions(model, shape)
    x = ca.SX.sym("x", 2 * model.n)
    u = ca.SX.sym("u", functions.inputs)
    h = ca.SX.sym("h")
    r = ca.SX.sym("r", functions.numbers)
    cost = functions.cost.function  # of x, u, r, W, W_r, load
    W = ca.SX.sym("W", cost.size1_in(3))
    W_r = ca.SX.sym("W_r", cost.size1_in(4))
    load = ca.SX.sym("load", cost.size1_in(5))
    omega = ca.SX.sym("omega")
    offset = ca.SX.sym("offset")
    scale = ca.SX.sym("scale")
    L = omega * (cost(x, u, r, W, W_r, load) - offset) / scale
    anchor = r[functions.anchor]
    F = functions.step(discretization)(x, u, h, anchor)
    f = model.field(shape.input)(x, u, anchor)
    arguments = {
        "x": x,
        "u": u,
        "h": h,
        "r": r,
        "W": W,
        "W_r": W_r,
        "load": load,
        "omega": omega,
        "offset": offset,
        "scale": scale,
    }
    terms = {
        "F_x": ca.jacobian(F, x),
        "F_u": ca.jacobian(F, u),
        "F_h": ca.jacobian(F, h),
        "L": L,
        "L_x": ca.gradient(L, x),
        "L_u": ca.gradient(L, u),
        "L_r": ca.gradient(L, r),
        "f": f,
        "f_x": ca.jacobian(f, x),
    }
    return ca.Function("terms", [*arguments.values()], [*terms.values()], [*arguments], [*terms])
