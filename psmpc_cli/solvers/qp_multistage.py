"""The quadratic programs of a window, solved by PIQP's back-end for multistage problems.

Unknowns are the steps of x_1 .. x_K = [Q; Qdot] node by node, then those of the durations; x_0 is measured. The
durations couple all nodes, which PIQP knows as an arrow. Soft limits on a node's state are rows of it, each with an
unknown of its own for its violation. The sparsity is set up once; from one program to the next only values change.
"""

import numpy as np
import piqp
from scipy.sparse import csc_matrix

from psmpc_cli.ocp.gauss_newton import Linearization, Point, VelocityForm
from psmpc_cli.ocp.window import PENALTY, shares_of_time
from psmpc_cli.solvers.sqp_window import QpShape, QpSolution, QpStatus, WindowBounds

MAX_ITERATIONS = 60
"""Interior-point iterations of one program; a solvable one takes 8 to 25."""


SMALLEST_REGULARIZATION = 1e-10
"""PIQP lowers its regularization to 1e-13 where it gets stuck; with tiny intervals that loses the digits it needs."""

FAR = 1e6
"""Where a soft limit stands for which there is none: PIQP complains of rows without any."""

NEARLY = 1e-6
"""Residuals and duality gap at which a program that ran out of iterations counts as solved."""


class _Pattern:
    """A sparse matrix put together from pieces whose places never change."""

    def __init__(self, places: list[tuple[np.ndarray, np.ndarray]], shape: tuple[int, int]) -> None:
        row, column = (np.concatenate([np.ravel(place[i]) for place in places]) for i in (0, 1))
        self._order = np.lexsort((row, column))
        self._indptr = np.r_[0, np.cumsum(np.bincount(column, minlength=shape[1]))].astype(np.int32)
        self._indices, self._shape = row[self._order].astype(np.int32), shape

    def matrix(self, values: list[np.ndarray]) -> csc_matrix:
        data = np.concatenate([np.ravel(piece) for piece in values])[self._order]
        return csc_matrix((data, self._indices, self._indptr), shape=self._shape)


class MultistageQp:
    """The programs of windows of one shape."""

    def __init__(self, form: VelocityForm, shape: QpShape, tolerance: float) -> None:
        self.form, self.shape = form, shape
        layout = form.grid
        self._n, self._K, self._S = layout.n, layout.K, layout.switches
        node = (4 if shape.soft else 2) * self._n
        self._x = node * np.arange(self._K)[:, None] + np.arange(2 * self._n)
        self._e = node * np.arange(self._K)[:, None] + np.arange(2 * self._n, node)
        self._tau = node * self._K + np.arange(self._S)
        self._P, self._A, self._G = self._place_hessian(), self._place_equalities(), self._place_inequalities()
        self._solver = piqp.SparseSolver()
        settings = self._solver.settings
        settings.kkt_solver = piqp.KKTSolver.sparse_multistage
        settings.max_iter = MAX_ITERATIONS
        settings.reg_finetune_lower_limit = SMALLEST_REGULARIZATION
        settings.eps_abs = settings.eps_duality_gap_abs = tolerance
        self._ready = False

    def solve(self, model: Linearization, limits: WindowBounds, point: Point, horizon: float) -> QpSolution:
        """Solve the program about a point."""
        low, high = self._inequality_bounds(model, limits, point, horizon)
        tied = np.array([limits.until[s] - point.tau[: s + 1].sum() for s in self.shape.tied])
        fixed = (limits.tau_low - point.tau)[list(self.shape.fixed)]
        x_low, x_high = self._bounds(limits, point)
        cost = np.zeros(self._size)
        cost[self._e] = PENALTY * shares_of_time(self.form.steps(point, horizon))[1:]
        cost[self._x], cost[self._tau] = model.gradient[1:], model.gradient_tau
        rows = {"G": self._G.matrix(self._inequalities(model, limits)), "h_l": low, "h_u": high} if len(low) else {}
        (self._solver.update if self._ready else self._solver.setup)(
            P=self._P.matrix(self._hessian(model)),
            c=cost,
            A=self._A.matrix(self._equalities(model)),
            b=np.r_[-model.at.gaps.ravel(), tied, fixed],
            x_l=x_low,
            x_u=x_high,
            **rows,
        )
        self._ready = True
        return self._solution(self._solver.solve())

    def _bounds(self, limits: WindowBounds, point: Point) -> tuple[np.ndarray, np.ndarray]:
        """Return low and high of the unknowns."""
        low, high = np.full(self._size, -np.inf), np.full(self._size, np.inf)
        free = np.isin(np.arange(self._S), self.shape.fixed, invert=True)
        low[self._tau] = np.where(free, limits.tau_low - point.tau, -np.inf)
        high[self._tau] = np.where(free, limits.tau_high - point.tau, np.inf)
        low[self._e] = 0.0
        if not limits.soft:
            low[self._x], high[self._x] = limits.X_low - point.X[1:], limits.X_high - point.X[1:]
        return low, high

    def _place_hessian(self) -> _Pattern:
        Q, v = self._x[:, : self._n], self._x[:, self._n :]
        places = [
            (Q[self._nodes(s)][:, stage.hessian_places[0]], Q[self._nodes(s)][:, stage.hessian_places[1]])
            for s, stage in enumerate(self.form.stages)
        ]
        places += [(v, v), (v[:-1], v[1:]), (np.repeat(self._x, self._S), np.tile(self._tau, self._x.size))]
        i, j = np.triu_indices(self._S)
        return _Pattern([*places, (self._tau[i], self._tau[j])], (self._size, self._size))

    def _hessian(self, model: Linearization) -> list[np.ndarray]:
        positions = [
            model.positions[1:][self._nodes(s)][:, stage.hessian_places[0], stage.hessian_places[1]]
            for s, stage in enumerate(self.form.stages)
        ]
        i, j = np.triu_indices(self._S)
        return [*positions, model.velocities[1:], model.coupling[1:], model.arrow[1:], model.durations[i, j]]

    @property
    def _size(self) -> int:
        return int(self._x.size + self._e.size + self._S)

    def _nodes(self, s: int) -> slice:
        """Nodes of a stage's cost, counted from node 1; the last stage's include the window's last."""
        first = self.form.grid.first_node
        return slice(max(first[s] - 1, 0), first[s + 1] - 1 if s < self._S else self._K)

    def _place_equalities(self) -> _Pattern:
        n, K = self._n, self._K
        row, Q, v = np.arange(K * n).reshape(K, n), self._x[:, : self._n], self._x[:, self._n :]
        places = [(row, Q), (row, v), (row[1:], Q[:-1]), (row[1:], v[:-1])]
        places.append((np.repeat(row, self._S), np.tile(self._tau, K * n)))
        given = [self._tau[: s + 1] for s in self.shape.tied] + [self._tau[[s]] for s in self.shape.fixed]
        places += [(np.full(len(taus), K * n + i), taus) for i, taus in enumerate(given)]
        return _Pattern(places, (K * n + len(given), self._size))

    def _equalities(self, model: Linearization) -> list[np.ndarray]:
        n, K, by_v = self._n, self._K, model.gap_velocity
        values = [np.ones(K * n), np.repeat(by_v[:, 1], n), -np.ones((K - 1) * n), np.repeat(by_v[1:, 0], n)]
        return [*values, model.gap_tau, np.ones(sum(s + 1 for s in self.shape.tied) + len(self.shape.fixed))]

    def _place_inequalities(self) -> _Pattern:
        """Rows: the last stage's duration, end conditions by stage, accelerations, soft limits, from both sides."""
        n, at, places = self._n, min(self._S, 1), [(np.zeros(self._S, int), self._tau)]
        for s, stage in enumerate(self.form.stages):
            if rows := stage.end_rows:
                row, column = stage.end_places
                places.append((at + row, self._x[self.form.grid.first_node[s + 1] - 1][column]))
                at += rows
        for index in (np.array(self.shape.input_low, int), np.array(self.shape.input_high, int)):
            row, v = at + np.arange(len(index)), self._x[:, n:].ravel()
            places += [(row, v[index]), (row[index >= n], v[index[index >= n] - n])]
            places.append((np.repeat(row, self._S), np.tile(self._tau, len(index))))
            at += len(index)
        if self.shape.soft:
            row = at + np.arange(2 * self._x.size).reshape(2, *self._x.shape)
            places += [(row, np.array([self._x, self._x])), (row, np.array([self._e, self._e]))]
            at += row.size
        return _Pattern(places, (at, self._size))

    def _inequalities(self, model: Linearization, limits: WindowBounds) -> list[np.ndarray]:
        values = [np.ones(self._S), *model.end_derivatives.values()]
        share = self.form.interval_steps
        for index, limit in self._limited(limits):
            values += [np.ones(len(index)), -np.ones(int((index >= self._n).sum()))]
            values.append(-limit.ravel()[index][:, None] * share[index // self._n])
        if self.shape.soft:
            violated = np.ones(self._e.size)
            values += [np.ones(2 * self._x.size), violated, -violated]
        return values

    def _limited(self, limits: WindowBounds) -> list[tuple[np.ndarray, np.ndarray]]:
        shape = self.shape
        return [
            (np.array(shape.input_low, int), limits.input_low),
            (np.array(shape.input_high, int), limits.input_high),
        ]

    def _inequality_bounds(
        self, model: Linearization, limits: WindowBounds, point: Point, horizon: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return low and high of the rows' change."""
        low, high = [np.full(min(self._S, 1), -np.inf)], [np.full(min(self._S, 1), limits.together - point.tau.sum())]
        for s, rows in model.at.ends.items():
            low.append(limits.ends[s][0] - rows)
            high.append(limits.ends[s][1] - rows)
        if self.shape.input_low or self.shape.input_high:
            h = self.form.steps(point, horizon)
            dv = np.diff(point.X[:, self._n :], axis=0)
            (from_low, _), (from_high, _) = self._limited(limits)
            low += [(h * limits.input_low - dv).ravel()[from_low], np.full(len(from_high), -np.inf)]
            high += [np.full(len(from_low), np.inf), (h * limits.input_high - dv).ravel()[from_high]]
        if limits.soft:
            low += [np.maximum(limits.X_low - point.X[1:], -FAR).ravel(), np.full(self._x.size, -np.inf)]
            high += [np.full(self._x.size, np.inf), np.minimum(limits.X_high - point.X[1:], FAR).ravel()]
        return np.concatenate(low), np.concatenate(high)

    def _solution(self, status: piqp.Status) -> QpSolution:
        result, n, K, shape = self._solver.result, self._n, self._K, self.shape
        x, y, z = np.array(result.x), np.array(result.y), np.array(result.z_u) - np.array(result.z_l)
        bound, given, at, ends = np.array(result.z_bu) - np.array(result.z_bl), K * n + len(shape.tied), 0, {}
        together, at = (float(z[0]), 1) if self._S else (0.0, 0)
        for s, stage in enumerate(self.form.stages):
            if rows := stage.end_rows:
                ends[s], at = z[at : at + rows], at + rows
        inputs = np.zeros(K * n)
        for index in (list(shape.input_low), list(shape.input_high)):
            inputs[index] += z[at : at + len(index)]
            at += len(index)
        states = bound[self._x] if not shape.soft else z[at:].reshape(2, K, 2 * n).sum(axis=0)
        return QpSolution(
            status=_status(status, result.info),
            shape=shape,
            step=Point(np.vstack([np.zeros(2 * n), x[self._x]]), x[self._tau]),
            gaps=y[: K * n].reshape(K, n),
            until=y[K * n : given],
            fixed=y[given:],
            together=together,
            ends=ends,
            inputs=inputs.reshape(K, n),
            X=states,
            tau=bound[self._tau],
            iterations=int(result.info.iter),
        )


def _status(status: piqp.Status, info: piqp.Info) -> QpStatus:
    if status == piqp.Status.PIQP_PRIMAL_INFEASIBLE:
        return QpStatus.INFEASIBLE
    nearly = max(info.primal_res, info.dual_res, abs(info.duality_gap)) <= NEARLY
    return QpStatus.SOLVED if status == piqp.Status.PIQP_SOLVED or nearly else QpStatus.FAILED
