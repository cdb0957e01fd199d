"""A window's NLP in the velocities.

Under joint input and a constant acceleration over each interval, `u = (Qdot+ - Qdot) / h` with h = tau_s / N_s, and of
(8) one bilinear row a coordinate is left, `Q+ - Q = h (Qdot + Qdot+) / 2` (explicit Euler: `h Qdot`). The unknowns are
Q and Qdot at the nodes and the durations: two thirds of the NLP's variables, and the same optimum.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from psmpc_cli.native.functions import RowFunction
from psmpc_cli.ocp.layout import Layout, WindowShape
from psmpc_cli.ocp.parameters import Parameters
from psmpc_cli.ocp.stage_terms import stage_terms
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


class VelocityForm:
    """The windows of one shape.

    Attributes:
        terms: What the stages are made of.
        cost: Their functions `cost` at the rows of arrays.
    """

    def __init__(self, model: RobotModel, shape: WindowShape, layout: Layout, native: bool = False) -> None:
        self.shape, self.layout = shape, layout
        self.terms = [stage_terms(model, stage, native) for stage in shape.stages]
        self.cost = [RowFunction(terms.cost) for terms in self.terms]
        self._error = [RowFunction(terms.error) for terms in self.terms]
        self._end = [RowFunction(terms.end) for terms in self.terms]
        self.nodes = np.array(shape.nodes)
        self.weights = (1.0, 0.0) if shape.discretization == "euler" else (0.5, 0.5)
        """Share of the velocity at either end of an interval in the change of position."""

    @cached_property
    def stage_durations(self) -> np.ndarray:
        """Derivative of the durations of all stages by the free ones, (S + 1, S): the last stage takes what is left."""
        S = self.layout.switches
        return np.vstack([np.eye(S), -np.ones((1, S))])

    @cached_property
    def waiting(self) -> np.ndarray:
        """Number of stages that wait while each free duration runs, (S,)."""
        return np.arange(self.layout.switches, 0, -1, dtype=float)

    def intervals(self, s: int) -> slice:
        """Return the intervals of a stage; they begin at nodes of the same numbers."""
        return slice(self.layout.first_node[s], self.layout.first_node[s + 1])

    def durations(self, point: Point, horizon: float) -> np.ndarray:
        """Return tau_s of all stages, (S + 1,) [s]."""
        return np.append(point.tau, horizon - point.tau.sum())

    def steps(self, point: Point, horizon: float) -> np.ndarray:
        """Return h of each interval, (K, 1) [s]."""
        return np.asarray((self.durations(point, horizon) / self.nodes)[self.layout.stage_of, None])

    def inputs(self, point: Point, horizon: float) -> np.ndarray:
        """Return the accelerations over the intervals, (K, n)."""
        return np.asarray(np.diff(point.X[:, self.layout.n :], axis=0) / self.steps(point, horizon))

    def reference(self, s: int, p: Parameters[np.ndarray], tau: float) -> tuple[np.ndarray, np.ndarray]:
        """Return what a stage's cost follows at its nodes, and its slope by the duration, (rows, N_s + 1) each."""
        path, N = np.asarray(p.paths[s]), self.layout.nodes[s]
        if path.shape[1] == 0:
            return np.tile(p.targets[s][:, None], N + 1), np.zeros((self.layout.rows[s], N + 1))
        return path[:, : N + 1] + path[:, N + 1 :] * tau, path[:, N + 1 :]

    def residuals(self, point: Point, p: Parameters[np.ndarray]) -> Residuals:
        """Return objective and constraints at a point."""
        n, tau = self.layout.n, self.durations(point, float(p.horizon))
        dv, costs, terminal = np.diff(point.X[:, n:], axis=0), np.zeros(len(tau)), 0.0
        for s, N in enumerate(self.layout.nodes):
            at, (reference, _) = self.intervals(s), self.reference(s, p, tau[s])
            L = self._error[s](point.X[at, :n], p.weights[s], reference[:, :N].T, rows=N)[0].sum() / N
            effort = (dv[at] ** 2 @ p.control_weights[s]).sum() * N / tau[s]
            costs[s] = (tau[s] * (L - p.offset[s]) + effort) / p.scale[s]
        if p.terminal:
            L = self._error[s](point.X[-1, :n], p.weights[s], reference[:, -1])[0].item()
            terminal = float(p.terminal * (L - p.offset[s]) / p.scale[s])
        ends = {s: rows for s, (rows, _) in self.ends(point, p).items()}
        return Residuals(
            self.objective(point, p, costs, terminal), costs, terminal, self.gaps(point, float(p.horizon)), ends
        )

    def objective(self, point: Point, p: Parameters[np.ndarray], costs: np.ndarray, terminal: float) -> float:
        """Return J over the window's largest priority from what the stages add to it. Cf. paper eq. (16)."""
        return float(p.omega @ costs + p.omega[-1] * terminal + p.pending * (self.waiting @ point.tau))

    def gaps(self, point: Point, horizon: float) -> np.ndarray:
        """Return `Q+ - Q - h (Qdot + Qdot+) / 2` by interval, (K, n)."""
        n, (before, after) = self.layout.n, self.weights
        Q, Qdot = point.X[:, :n], point.X[:, n:]
        return np.asarray(np.diff(Q, axis=0) - self.steps(point, horizon) * (before * Qdot[:-1] + after * Qdot[1:]))

    def ends(self, point: Point, p: Parameters[np.ndarray]) -> dict[int, tuple[np.ndarray, np.ndarray]]:
        """Return the end rows of the stages that have some, and the nonzeros of their derivatives by x."""
        found = {}
        for s, terms in enumerate(self.terms):
            if terms.end_rows:
                h, by_x = self._end[s](point.X[self.layout.first_node[s + 1]], p.targets[s])
                found[s] = (h[0], by_x[0])
        return found
