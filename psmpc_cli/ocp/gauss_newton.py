"""A window in the velocities, and its Gauss-Newton model: what a step of sequential quadratic programming minimizes.

Under joint input and a constant acceleration over each interval, `u = (Qdot+ - Qdot) / h` with h = tau_s / N_s, and of
(8) one bilinear row a coordinate is left, `Q+ - Q = h (Qdot + Qdot+) / 2` (explicit Euler: `h Qdot`). The unknowns are
Q and Qdot at the nodes and the durations: two thirds of the NLP's variables, and the same optimum.

The cost of the states is the square of a residual that carries `sqrt(omega_s tau_s / N_s / scale_s)`, so that the
durations enter it, and has the Gauss-Newton Hessian. The cost of the control, `|dQdot|^2 N_s / tau_s`, is convex in
velocities and duration together and has its exact one; the pending cost is linear. So the Hessian is positive
semidefinite. End conditions about poses are curved, see `VelocityForm.curved`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from psmpc_cli.ocp.objective import stage_functions
from psmpc_cli.ocp.plan import Grid
from psmpc_cli.ocp.window import Parameters, WindowShape
from psmpc_cli.robot.model import RobotModel


@dataclass(frozen=True, eq=False)
class Point:
    """A point in the velocity form: states x_k (K + 1, 2n) and free durations (S,) [s]."""

    X: np.ndarray
    tau: np.ndarray

    def moved(self, by: "Point", share: float) -> "Point":
        """Return the point a share of a step further."""
        return Point(self.X + share * by.X, self.tau + share * by.tau)


@dataclass(frozen=True, eq=False)
class Residuals:
    """Objective and constraints at a point.

    Attributes:
        objective: J over the window's largest priority.
        costs: Normalized cost integral of each stage, without priorities, (S + 1,). Paper eq. (16).
        terminal: Normalized terminal cost of the last stage, times kappa.
        gaps: Q+ - Q - h (Qdot + Qdot+) / 2 by interval, (K, n).
        ends: Rows of the end condition by stage that has one.
    """

    objective: float
    costs: np.ndarray
    terminal: float
    gaps: np.ndarray
    ends: dict[int, np.ndarray]


@dataclass(frozen=True, eq=False)
class Linearization:
    """Quadratic model at a point; derivatives by x_k and the free durations.

    Attributes:
        at: Objective and constraints there.
        gradient, gradient_tau: (K + 1, 2n), (S,).
        positions: Upper triangle of the Hessian by Q_k, (K + 1, n, n).
        velocities: Its diagonal by Qdot_k, (K + 1, n).
        coupling: Its diagonal by (Qdot_k, Qdot_k+1), (K, n).
        arrow: By x_k and tau, (K + 1, 2n, S).
        durations: By tau, (S, S).
        gap_velocity: Of the gaps by Qdot_k and Qdot_k+1, one number an interval, (K, 2).
        gap_tau: By tau, (K, n, S).
        end_derivatives: Nonzeros of the end rows' Jacobians by x.
    """

    at: Residuals
    gradient: np.ndarray
    gradient_tau: np.ndarray
    positions: np.ndarray
    velocities: np.ndarray
    coupling: np.ndarray
    arrow: np.ndarray
    durations: np.ndarray
    gap_velocity: np.ndarray
    gap_tau: np.ndarray
    end_derivatives: dict[int, np.ndarray]


class VelocityForm:
    """The windows of one shape in the velocities.

    Attributes:
        grid: Intervals of the stages.
        stages: What the stages are made of.
        nodes: N_s of each stage, (S + 1,).
        weights: Share of the velocity at either end of an interval in the change of position.
        curved_stages: Stages of the window whose end condition is curved.
    """

    def __init__(self, model: RobotModel, shape: WindowShape, native: bool = False) -> None:
        self.shape, self.grid = shape, Grid(model.n, shape.nodes)
        self.stages = [stage_functions(model, stage, native) for stage in shape.stages]
        self.nodes = np.array(shape.nodes)
        self.weights = (1.0, 0.0) if shape.discretization == "euler" else (0.5, 0.5)
        curvatures = {s: stage.end_curvature for s, stage in enumerate(self.stages)}
        self._curvatures = {s: function for s, function in curvatures.items() if function is not None}
        self.curved_stages = tuple(self._curvatures)

    @cached_property
    def stage_durations(self) -> np.ndarray:
        """Derivative of the durations of all stages by the free ones, (S + 1, S): the last stage takes what is left."""
        S = self.grid.switches
        return np.vstack([np.eye(S), -np.ones((1, S))])

    @cached_property
    def interval_steps(self) -> np.ndarray:
        """Derivative of h of each interval by the free durations, (K, S)."""
        return np.asarray((self.stage_durations / self.nodes[:, None])[self.grid.stage_of])

    @cached_property
    def waiting(self) -> np.ndarray:
        """Number of stages that wait while each free duration runs, (S,)."""
        return np.arange(self.grid.switches, 0, -1, dtype=float)

    def intervals(self, s: int) -> slice:
        """Return the intervals of a stage; they begin at nodes of the same numbers."""
        return slice(self.grid.first_node[s], self.grid.first_node[s + 1])

    def durations(self, point: Point, horizon: float) -> np.ndarray:
        """Return tau_s of all stages, (S + 1,) [s]."""
        return np.append(point.tau, horizon - point.tau.sum())

    def steps(self, point: Point, horizon: float) -> np.ndarray:
        """Return h of each interval, (K, 1) [s]."""
        return np.asarray((self.durations(point, horizon) / self.nodes)[self.grid.stage_of, None])

    def inputs(self, point: Point, horizon: float) -> np.ndarray:
        """Return the accelerations over the intervals, (K, n)."""
        return np.asarray(np.diff(point.X[:, self.grid.n :], axis=0) / self.steps(point, horizon))

    def reference(self, s: int, p: Parameters[np.ndarray], tau: float) -> tuple[np.ndarray, np.ndarray]:
        """Return what a stage's cost follows at its nodes, and its slope by the duration, (N_s + 1, numbers) each.

        Of a target at rest both are of one row.
        """
        path, N = p.paths[s], self.grid.nodes[s]
        if path.shape[1] == 0:
            return p.targets[s][None], np.zeros((1, len(p.targets[s])))
        return (path[:, : N + 1] + path[:, N + 1 :] * tau).T, path[:, N + 1 :].T

    def residuals(self, point: Point, p: Parameters[np.ndarray]) -> Residuals:
        """Return objective and constraints at a point."""
        n, horizon = self.grid.n, float(p.horizon)
        tau, costs, terminal = self.durations(point, horizon), np.zeros(len(self.stages)), 0.0
        for s, (stage, N) in enumerate(zip(self.stages, self.grid.nodes, strict=True)):
            at, (reference, _) = self.intervals(s), self.reference(s, p, tau[s])
            L = stage.state_costs(point.X[at, :n], p.weights[s], reference[:N], rows=N)[0]
            costs[s] = self.cost(s, point, p, tau[s], L)
        if p.terminal:
            L = stage.state_costs(point.X[-1, :n], p.weights[s], reference[-1])[0]
            terminal = terminal_cost(p, L.item())
        ends = {s: rows for s, (rows, _) in self.ends(point, p).items()}
        return Residuals(self.objective(point, p, costs, terminal), costs, terminal, self.gaps(point, horizon), ends)

    def cost(self, s: int, point: Point, p: Parameters[np.ndarray], tau: float, L: np.ndarray) -> float:
        """Return the cost integral of a stage of duration tau [s], L the weighted squares of its residual at nodes."""
        N, n = self.grid.nodes[s], self.grid.n
        dv = np.diff(point.X[self.grid.first_node[s] : self.grid.first_node[s + 1] + 1, n:], axis=0)
        effort = (dv**2 @ p.control_weights[s]).sum() * N / tau
        return float((tau * (L.sum() / N - p.offset[s]) + effort) / p.scale[s])

    def objective(self, point: Point, p: Parameters[np.ndarray], costs: np.ndarray, terminal: float) -> float:
        """Return J over the window's largest priority from what the stages add to it. Cf. paper eq. (16)."""
        return float(p.omega @ costs + p.omega[-1] * terminal + p.pending * (self.waiting @ point.tau))

    def gaps(self, point: Point, horizon: float) -> np.ndarray:
        """Return `Q+ - Q - h (Qdot + Qdot+) / 2` by interval, (K, n)."""
        n, (before, after) = self.grid.n, self.weights
        Q, Qdot = point.X[:, :n], point.X[:, n:]
        return np.asarray(np.diff(Q, axis=0) - self.steps(point, horizon) * (before * Qdot[:-1] + after * Qdot[1:]))

    def ends(self, point: Point, p: Parameters[np.ndarray]) -> dict[int, tuple[np.ndarray, np.ndarray]]:
        """Return the end rows of the stages that have some, and the nonzeros of their derivatives by x."""
        found = {}
        for s, stage in enumerate(self.stages):
            if stage.end_rows:
                h, by_x = stage.end_terms(point.X[self.grid.first_node[s + 1]], p.targets[s])
                found[s] = (h[0], by_x[0])
        return found

    def curved(
        self, model: Linearization, point: Point, p: Parameters[np.ndarray], multipliers: Mapping[int, np.ndarray]
    ) -> Linearization:
        """Return the model with the second derivatives by Q of the end rows, each times its multiplier by stage.

        Of the Lagrangian's second derivatives it is the part that matters: the multipliers of an end condition are as
        large as what a second of waiting costs, whatever the stage itself weighs. Without it steps overshoot in the
        motion that is flat in the costs, more than twofold in places, and one iteration a sample chatters.
        """
        positions, n = model.positions.copy(), self.grid.n
        for s, of_rows in multipliers.items():
            if s in self._curvatures:
                node = self.grid.first_node[s + 1]
                curvature = self._curvatures[s](point.X[node], p.targets[s], of_rows)[0]
                positions[node] += curvature.reshape(n, n)
        return replace(model, positions=positions)

    def linearize(self, point: Point, p: Parameters[np.ndarray]) -> Linearization:
        """Return the quadratic model at a point."""
        horizon, D = float(p.horizon), self.stage_durations
        sums = _Sums(self, point, self.durations(point, horizon))
        costs = np.array([sums.add_stage(s, p) for s in range(len(self.stages))])
        terminal = sums.add_terminal(p) if p.terminal else 0.0
        ends, (before, after) = self.ends(point, p), self.weights
        Qdot, of = point.X[:, self.grid.n :], self.grid.stage_of
        by_stage = -(before * Qdot[:-1] + after * Qdot[1:]) / self.nodes[of, None]
        at = Residuals(
            objective=self.objective(point, p, costs, terminal),
            costs=costs,
            terminal=terminal,
            gaps=self.gaps(point, horizon),
            ends={s: rows for s, (rows, _) in ends.items()},
        )
        return Linearization(
            at=at,
            gradient=sums.gradient,
            gradient_tau=D.T @ sums.by_tau + p.pending * self.waiting,
            positions=sums.positions,
            velocities=sums.velocities,
            coupling=sums.coupling,
            arrow=sums.arrow @ D,
            durations=D.T @ (sums.durations[:, None] * D),
            gap_velocity=-self.steps(point, horizon) * np.array(self.weights),
            gap_tau=by_stage[:, :, None] * D[of][:, None, :],
            end_derivatives={s: derivatives for s, (_, derivatives) in ends.items()},
        )


def terminal_cost(p: Parameters[np.ndarray], L: float) -> float:
    """Return kappa times the normalized cost of the last stage at the last node, L the square of its residual."""
    return float(p.terminal * (L - p.offset[-1]) / p.scale[-1])


class _Sums:
    """The sums of a linearization while it is put together; derivatives by the durations of all stages."""

    def __init__(self, form: VelocityForm, point: Point, tau: np.ndarray) -> None:
        K, n, S = form.grid.K, form.grid.n, form.grid.switches
        self.form, self.point, self.tau = form, point, tau
        self.gradient = np.zeros((K + 1, 2 * n))
        self.positions = np.zeros((K + 1, n, n))
        self.velocities = np.zeros((K + 1, n))
        self.coupling = np.zeros((K, n))
        self.arrow = np.zeros((K + 1, 2 * n, S + 1))
        self.durations = np.zeros(S + 1)
        self.by_tau = np.zeros(S + 1)

    def add_stage(self, s: int, p: Parameters[np.ndarray]) -> float:
        """Add omega_s times the cost integral of a stage; return the integral."""
        form, tau, n, N, at = self.form, self.tau[s], self.form.grid.n, self.form.grid.nodes[s], self.form.intervals(s)
        reference, slope = form.reference(s, p, tau)
        X, weights = self.point.X[at, :n], p.weights[s]
        L, r, q, g, m, H = form.stages[s].gauss_newtons(X, weights, reference[:N], slope[:N], rows=N)
        rows, columns = form.stages[s].hessian_places
        c = p.omega[s] / p.scale[s] / N
        self.gradient[at, :n] += 2 * c * tau * g
        self.positions[at, rows, columns] += 2 * c * tau * H
        self.arrow[at, :n, s] += c * (2 * tau * m + g)
        self.durations[s] += c * (2 * tau * q + 2 * r + L / (2 * tau)).sum()
        self.by_tau[s] += c * (L - p.offset[s] + 2 * tau * r).sum()
        self._add_control(s, p)
        return form.cost(s, self.point, p, tau, L)

    def _add_control(self, s: int, p: Parameters[np.ndarray]) -> None:
        """Add omega_s sum_i |dQdot|^2_Wr N_s / tau_s / scale_s, the same as |u|^2_Wr tau_s / N_s."""
        n, tau, at = self.form.grid.n, self.tau[s], self.form.intervals(s)
        after = slice(at.start + 1, at.stop + 1)
        dv = self.point.X[after, n:] - self.point.X[at, n:]
        b = 2 * p.omega[s] / p.scale[s] * self.form.nodes[s] / tau * p.control_weights[s]
        effort = float((dv**2 @ b).sum()) / 2
        self.gradient[after, n:] += b * dv
        self.gradient[at, n:] -= b * dv
        self.velocities[after] += b
        self.velocities[at] += b
        self.coupling[at] -= b
        self.arrow[after, n:, s] -= b * dv / tau
        self.arrow[at, n:, s] += b * dv / tau
        self.durations[s] += 2 * effort / tau**2
        self.by_tau[s] -= effort / tau

    def add_terminal(self, p: Parameters[np.ndarray]) -> float:
        """Add omega_S times the terminal cost; return that."""
        form, s, n, c = self.form, self.form.grid.switches, self.form.grid.n, p.terminal * p.omega[-1] / p.scale[-1]
        reference, slope = form.reference(s, p, self.tau[s])
        found = form.stages[s].gauss_newtons(self.point.X[-1, :n], p.weights[s], reference[-1], slope[-1])
        L, r, q, g, m, H = (values[0] for values in found)
        rows, columns = form.stages[s].hessian_places
        self.gradient[-1, :n] += 2 * c * g
        self.positions[-1, rows, columns] += 2 * c * H
        self.arrow[-1, :n, s] += 2 * c * m
        self.durations[s] += 2 * c * q[0]
        self.by_tau[s] += 2 * c * r[0]
        return terminal_cost(p, float(L[0]))
