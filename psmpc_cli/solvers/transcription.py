"""From the shape of a window to its NLP: direct multiple shooting with the durations as constant states.

The objective is that of docs/formulation.md divided by the window's largest priority; variables and rows are ordered so
that structure-exploiting solvers apply. Nothing but the shape is fixed in the program; all numbers are parameters.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import casadi as ca
import numpy as np

from psmpc_cli.ocp.objective import StageFunctions, stage_functions
from psmpc_cli.ocp.plan import Grid
from psmpc_cli.ocp.window import PENALTY, Parameters, WindowShape
from psmpc_cli.robot.model import RobotModel


@dataclass(frozen=True)
class Layout(Grid):
    """Offsets of the decision variables x_0, u_0, x_1, u_1, ..., x_K, each x_k = [Q; Qdot; tau_0 .. tau_{S-1}].

    Where costs of other stages are bounded, their sums so far follow on the durations in each x_k. Where limits are
    soft, rho times the violations of [Q; Qdot], e_k, follow on u_k, and on x_K.

    Attributes:
        inputs: Inputs of each stage.
        soft: Limits on the states may be violated.
        sums: Number of sums of costs.
    """

    inputs: tuple[int, ...]
    soft: bool = False
    sums: int = 0

    @property
    def nx(self) -> int:
        """Size of x_k, durations and sums included."""
        return 2 * self.n + self.switches + self.sums

    @property
    def durations(self) -> slice:
        """Where the durations are in x_k."""
        return slice(2 * self.n, 2 * self.n + self.switches)

    @cached_property
    def offsets(self) -> np.ndarray:
        """Offset of x_k in the decision vector, (K + 1,)."""
        sizes = [self.nx + self.inputs[s] + self.violations for s in self.stage_of]
        return np.concatenate([[0], np.cumsum(sizes)]).astype(int)

    @property
    def size(self) -> int:
        """Size of the decision vector."""
        return int(self.offsets[-1]) + self.nx + self.violations

    @property
    def violations(self) -> int:
        """Number of violations e_k at a node: 0 where limits are hard."""
        return 2 * self.n if self.soft else 0

    @cached_property
    def state_index(self) -> np.ndarray:
        """Indices of [Q; Qdot] at each node, (K + 1, 2n)."""
        return self.offsets[:, None] + np.arange(2 * self.n)[None, :]

    @cached_property
    def duration_index(self) -> np.ndarray:
        """Indices of the durations at each node, (K + 1, S)."""
        return self.offsets[:, None] + 2 * self.n + np.arange(self.switches)[None, :]

    @cached_property
    def violation_index(self) -> np.ndarray:
        """Indices of the violations e_k at the nodes, (K + 1, 2n); (K + 1, 0) where limits are hard."""
        inputs = np.array([*(self.inputs[s] for s in self.stage_of), 0])
        return np.asarray((self.offsets + self.nx + inputs)[:, None] + np.arange(self.violations))

    @cached_property
    def input_index(self) -> tuple[np.ndarray, ...]:
        """Indices of the inputs of each stage's intervals, (N_s, inputs)."""
        first = [self.offsets[a:b] for a, b in pairwise(self.first_node)]
        return tuple(k[:, None] + self.nx + np.arange(inputs) for k, inputs in zip(first, self.inputs, strict=True))


class Nlp:
    """A window's NLP: min f(x, p) subject to bounds on x and g(x, p), for the windows of one shape.

    Paper eq. (20), with the departures of docs/formulation.md. The rows of g are node by node: the gap to the next node
    first, then the path rows of the node.

    Attributes:
        shape: The window's shape.
        layout: Offsets of the decision variables.
        x, p, f, g: Decision variables, parameters, objective, constraints; `problem` as CasADi's solvers take them.
        nx, nu, ng: Sizes of state, of input with violations of soft limits, and of path rows at each node, (K + 1,).
        gap_rows: Rows of g that close the gap after each interval, (K, nx).
        x0_rows: Rows that fix the initial state, (2n,).
        last_duration_row: Row with the last stage's duration, None with one stage.
        instant_rows: Row with the cumulated duration to the end of a stage with a fixed switching time, by stage.
        end_rows: Rows with the end condition, error rows first, then rates, by stage of the window.
        limit_rows: Rows of soft limits at the nodes, below and above, (2, K + 1, 2n); (2, K + 1, 0) if hard.
        kept_rows: Rows with the cost integral of each kept stage, or with its errors at the nodes after the first.
    """

    def __init__(self, model: RobotModel, shape: WindowShape) -> None:
        self._functions = [stage_functions(model, stage) for stage in (*shape.stages, *shape.kept)]
        inputs = tuple(functions.inputs for functions in self._functions[: len(shape.stages)])
        sums = 0 if shape.kept_errors else len(shape.kept)
        self.shape, self.layout = shape, Layout(model.n, shape.nodes, inputs, shape.soft, sums)
        layout = self.layout
        self._p = symbolic_parameters(shape, layout, self._functions)
        xs = [ca.SX.sym(f"x{k}", layout.nx) for k in range(layout.K + 1)]
        us = [ca.SX.sym(f"u{k}", layout.inputs[layout.stage_of[k]]) for k in range(layout.K)]
        es = [ca.SX.sym(f"e{k}", layout.violations) for k in range(layout.K + 1)]
        self.x = ca.vertcat(*(v for node in zip(xs, [*us, ca.SX(0, 1)], es, strict=True) for v in node))
        self.p = ca.vertcat(*(ca.vec(piece) for piece in self._p.pieces()))
        costs = [ca.SX(0) for _ in layout.nodes]
        for k, s in enumerate(layout.stage_of):
            costs[s] += self._added_cost(s, k, k - int(layout.first_node[s]), xs, us)
        kept = [
            [self._added_cost(len(costs) + i, k, k, xs, us) for k in range(layout.K)] for i in range(len(shape.kept))
        ]
        terminal = _terminal_cost(layout, self._functions, self._p, xs[-1])
        pending = sum((ca.sum1(xs[0][layout.durations][:s]) for s in range(1, layout.switches + 1)), ca.SX(0))
        J = ca.dot(self._p.omega, ca.vertcat(*costs)) + self._p.pending * pending + self._p.omega[-1] * terminal
        self.f = J + _penalty(layout, self._p, xs, es)
        self._added, self.count = list[ca.SX](), 0
        ng = self._write_rows(xs, us, es, kept)
        if shape.bounded:
            self._add(costs[-1] + terminal)
            ng[-1] += 1
        self.ng = tuple(ng)
        self.g = ca.vertcat(*self._added)
        self.problem = {"x": self.x, "p": self.p, "f": self.f, "g": self.g}
        self.nx = (layout.nx,) * (layout.K + 1)
        self.nu = tuple(inputs + layout.violations for inputs in (*(layout.inputs[s] for s in layout.stage_of), 0))
        self._costs = ca.vertcat(*map(sum, kept), *costs), terminal

    @cached_property
    def costs(self) -> ca.Function:
        """x, p -> normalized cost integrals without priorities, of kept stages, then (S + 1,); the terminal cost."""
        return ca.Function("costs", [self.x, self.p], list(self._costs))

    @cached_property
    def rows(self) -> ca.Function:
        """x, p -> g."""
        return ca.Function("rows", [self.x, self.p], [self.g])

    def _add(self, row: ca.SX) -> np.ndarray:
        """Add rows to g and return their indices."""
        self._added.append(row)
        self.count += row.shape[0]
        return np.arange(self.count - row.shape[0], self.count)

    def _added_cost(self, s: int, k: int, node: int, xs: list[ca.SX], us: list[ca.SX]) -> ca.SX:
        """Return L_s(x_k, u_k) tau / N of a stage over an interval, which begins at one of the stage's own nodes."""
        layout, p, of = self.layout, self._p, int(self.layout.stage_of[k])
        tau = duration(layout, p, xs[k], of)
        numbers = reference(p, s, node, tau), p.weights[s], p.control_weights[s]
        Lbar = self._functions[s].cost(xs[k][: 2 * layout.n], us[k], *numbers)
        return (Lbar - p.offset[s]) / p.scale[s] * tau / layout.nodes[of]

    def _write_rows(self, xs: list[ca.SX], us: list[ca.SX], es: list[ca.SX], kept: list[list[ca.SX]]) -> list[int]:
        """Write the constraints node by node and return the number of path rows at each."""
        layout, stages, ng = self.layout, self.shape.stages, []
        gaps, limits, size = [], [], 2 * layout.n
        self.end_rows: dict[int, np.ndarray] = {}
        kept_rows: list[list[np.ndarray]] = [[] for _ in kept]
        for k, (x, e) in enumerate(zip(xs, es, strict=True)):
            if k < layout.K:
                gaps.append(self._add(self._gap(k, xs, us, kept)))
            before = self.count
            if k == 0:
                self._write_start(x)
            elif k in layout.first_node[1:-1]:
                s = int(layout.stage_of[k - 1])
                if stages[s].end_rows:
                    self.end_rows[s] = self._add(self._functions[s].end(x[:size], self._p.targets[s]))
            for i, rows in enumerate(kept_rows):
                if self.shape.kept_errors and k:
                    s = len(stages) + i
                    wanted = reference(self._p, s, k, self._p.horizon)
                    rows.append(self._add(self._functions[s].residual(x[: layout.n], wanted)))
                elif layout.sums and k == layout.K:
                    rows.append(self._add(x[layout.durations.stop + i]))
            violated = x[: layout.violations], e / PENALTY
            limits.append([self._add(violated[0] + violated[1]), self._add(violated[0] - violated[1])])
            ng.append(self.count - before)
        self.gap_rows, self.limit_rows = np.array(gaps), np.array(limits, int).transpose(1, 0, 2)
        self.kept_rows = [np.concatenate(rows) for rows in kept_rows]
        return ng

    def _write_start(self, x: ca.SX) -> None:
        layout = self.layout
        measured = ca.vertcat(self._p.x0, ca.SX.zeros(layout.sums))
        self.x0_rows = self._add(ca.vertcat(x[: 2 * layout.n], x[layout.durations.stop :]) - measured)
        self.last_duration_row: int | None = None
        if layout.switches:
            self.last_duration_row = int(self._add(duration(layout, self._p, x, layout.switches))[0])
        tau, fixed = x[layout.durations], [s for s, stage in enumerate(self.shape.stages[:-1]) if stage.fixed_end]
        self.instant_rows = {s: int(self._add(ca.sum1(tau[: s + 1]))[0]) for s in fixed}

    def _gap(self, k: int, xs: list[ca.SX], us: list[ca.SX], kept: list[list[ca.SX]]) -> ca.SX:
        layout, s = self.layout, int(self.layout.stage_of[k])
        dt = duration(layout, self._p, xs[k], s) / layout.nodes[s]
        after = self._functions[s].step(self.shape.discretization)(xs[k][: 2 * layout.n], us[k], dt)
        sums = [xs[k][layout.durations.stop + i] + kept[i][k] for i in range(layout.sums)]
        return xs[k + 1] - ca.vertcat(after, xs[k][layout.durations], *sums)


def duration(layout: Layout, parameters: Parameters[ca.SX], x: ca.SX, stage: int) -> ca.SX:
    """Return tau_s of a stage from a node's state; the last stage takes what is left of the horizon."""
    tau = x[layout.durations]
    return parameters.horizon - ca.sum1(tau) if stage == layout.switches else tau[stage]


def _terminal_cost(layout: Layout, functions: list[StageFunctions], p: Parameters[ca.SX], x: ca.SX) -> ca.SX:
    """Return the normalized cost of the last stage at the last node without control, times kappa."""
    S = layout.switches
    u, wanted = ca.SX.zeros(layout.inputs[S]), reference(p, S, layout.nodes[S], duration(layout, p, x, S))
    last = functions[S].cost(x[: 2 * layout.n], u, wanted, p.weights[S], p.control_weights[S])
    return p.terminal * (last - p.offset[S]) / p.scale[S]


def _penalty(layout: Layout, p: Parameters[ca.SX], xs: list[ca.SX], es: list[ca.SX]) -> ca.SX:
    """Return what violated soft limits cost: rho times the integral of the violations, by the trapezoidal rule."""
    stage_of = [int(s) for s in layout.stage_of]
    none = [ca.SX(0)]
    before = [duration(layout, p, x, s) / layout.nodes[s] for x, s in zip(xs[1:], stage_of, strict=True)]
    after = [duration(layout, p, x, s) / layout.nodes[s] for x, s in zip(xs[:-1], stage_of, strict=True)]
    weights = [(one + other) / 2 for one, other in zip(none + before, after + none, strict=True)]
    return sum((w * ca.sum1(e) for w, e in zip(weights, es, strict=True)), ca.SX(0))


def symbolic_parameters(shape: WindowShape, layout: Layout, functions: list[StageFunctions]) -> Parameters[ca.SX]:
    """Return the parameters as symbols; `functions` are those of the stages and of the kept ones."""
    shapes, nodes = (*shape.stages, *shape.kept), (*shape.nodes, *(layout.K for _ in shape.kept))
    columns = [2 * (N + 1) if stage.moving else 0 for stage, N in zip(shapes, nodes, strict=True)]
    each = list(enumerate(functions))
    return Parameters(
        x0=ca.SX.sym("x0", 2 * layout.n),
        horizon=ca.SX.sym("T_h"),
        pending=ca.SX.sym("delta"),
        terminal=ca.SX.sym("kappa"),
        omega=ca.SX.sym("omega", layout.switches + 1),
        offset=ca.SX.sym("offset", len(functions)),
        scale=ca.SX.sym("scale", len(functions)),
        weights=tuple(ca.SX.sym(f"W_{s}", stage.rows) for s, stage in each),
        control_weights=tuple(ca.SX.sym(f"W_r_{s}", stage.inputs) for s, stage in each),
        targets=tuple(ca.SX.sym(f"target_{s}", stage.numbers) for s, stage in each),
        paths=tuple(ca.SX.sym(f"path_{s}", stage.numbers, columns[s]) for s, stage in each),
    )


def reference(p: Parameters[ca.SX], stage: int, node: int, tau: ca.SX) -> ca.SX:
    """Return what a stage's cost follows at one of its nodes, 0 to N_s, if the stage lasts tau [s]."""
    path = p.paths[stage]
    if path.shape[1] == 0:
        return p.targets[stage]
    return path[:, node] + path[:, path.shape[1] // 2 + node] * tau
