"""From the shape of a window to its NLP: direct multiple shooting with the durations as constant states.

The objective is that of docs/formulation.md divided by the window's largest priority; variables and rows are ordered so
that structure-exploiting solvers apply. Nothing but the shape is fixed in the program; all numbers are parameters.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import casadi as ca
import numpy as np

from psmpc_cli.ocp.objective import stage_functions
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
        problem: Decision variables x, parameters p, objective f and constraints g, as CasADi's solvers take them.
        nx, nu, ng: Sizes of state, of input with violations of soft limits, and of path rows at each node, (K + 1,).
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
        layout, self._p = self.layout, self._symbolic_parameters()
        xs = [ca.SX.sym(f"x{k}", layout.nx) for k in range(layout.K + 1)]
        us = [ca.SX.sym(f"u{k}", layout.inputs[layout.stage_of[k]]) for k in range(layout.K)]
        es = [ca.SX.sym(f"e{k}", layout.violations) for k in range(layout.K + 1)]
        x = ca.vertcat(*(v for node in zip(xs, [*us, ca.SX(0, 1)], es, strict=True) for v in node))
        costs, S = [ca.SX(0) for _ in layout.nodes], layout.switches
        for k, s in enumerate(layout.stage_of):
            costs[s] += self._L(int(s), k - int(layout.first_node[s]), xs[k], us[k]) * self._step(k, xs[k])
        kept = [
            [self._L(S + 1 + i, k, xs[k], us[k]) * self._step(k, xs[k]) for k in range(layout.K)]
            for i in range(len(shape.kept))
        ]
        terminal = self._p.terminal * self._L(S, layout.nodes[S], xs[-1], ca.SX.zeros(layout.inputs[S]))
        pending = sum((ca.sum1(xs[0][layout.durations][:s]) for s in range(1, S + 1)), ca.SX(0))
        J = ca.dot(self._p.omega, ca.vertcat(*costs)) + self._p.pending * pending + self._p.omega[-1] * terminal
        self._added, self.count = list[ca.SX](), 0
        ng = self._write_rows(xs, us, es, kept)
        if shape.bounded:
            self._add(costs[-1] + terminal)
            ng[-1] += 1
        self.nx, self.ng = (layout.nx,) * (layout.K + 1), tuple(ng)
        self.nu = tuple(inputs + layout.violations for inputs in (*(layout.inputs[s] for s in layout.stage_of), 0))
        numbers = ca.vertcat(*(ca.vec(piece) for piece in self._p.pieces()))
        self.problem = {"x": x, "p": numbers, "f": J + self._penalty(xs, es), "g": ca.vertcat(*self._added)}
        self._costs = ca.vertcat(*map(sum, kept), *costs), terminal

    @cached_property
    def costs(self) -> ca.Function:
        """x, p -> normalized cost integrals without priorities, of kept stages, then (S + 1,); the terminal cost."""
        return ca.Function("costs", [self.problem[name] for name in "xp"], list(self._costs))

    @cached_property
    def rows(self) -> ca.Function:
        """x, p -> g."""
        return ca.Function("rows", [self.problem[name] for name in "xp"], [self.problem["g"]])

    def _add(self, row: ca.SX) -> np.ndarray:
        """Add rows to g and return their indices."""
        self._added.append(row)
        self.count += row.shape[0]
        return np.arange(self.count - row.shape[0], self.count)

    def _L(self, s: int, node: int, x: ca.SX, u: ca.SX) -> ca.SX:
        """Return the normalized cost of a stage, or of a kept one, at one of its nodes, 0 to N_s."""
        p, n, S = self._p, self.layout.n, self.layout.switches
        wanted = self._reference(s, node, self._duration(min(s, S), x))
        Lbar = self._functions[s].cost(x[: 2 * n], u, wanted, p.weights[s], p.control_weights[s])
        return (Lbar - p.offset[s]) / p.scale[s]

    def _duration(self, s: int, x: ca.SX) -> ca.SX:
        """Return tau_s of a stage from a node's state; the last stage takes what is left of the horizon."""
        tau = x[self.layout.durations]
        return self._p.horizon - ca.sum1(tau) if s == self.layout.switches else tau[s]

    def _step(self, k: int, x: ca.SX) -> ca.SX:
        """Return the length of an interval from the state at one of its ends."""
        s = int(self.layout.stage_of[k])
        return self._duration(s, x) / self.layout.nodes[s]

    def _reference(self, s: int, node: int, tau: ca.SX) -> ca.SX:
        """Return what a stage's cost follows at one of its nodes if the stage lasts tau [s]."""
        path, nodes = self._p.paths[s], self._p.paths[s].shape[1] // 2
        return path[:, node] + path[:, nodes + node] * tau if nodes else self._p.targets[s]

    def _penalty(self, xs: list[ca.SX], es: list[ca.SX]) -> ca.SX:
        """Return what violated soft limits cost: rho times the integral of the violations, by the trapezoidal rule."""
        before, after = ([self._step(k, xs[k + i]) for k in range(self.layout.K)] for i in (1, 0))
        none = [ca.SX(0)]
        shares = [(one + other) / 2 for one, other in zip(none + before, after + none, strict=True)]
        return sum((share * ca.sum1(e) for share, e in zip(shares, es, strict=True)), ca.SX(0))

    def _write_rows(self, xs: list[ca.SX], us: list[ca.SX], es: list[ca.SX], kept: list[list[ca.SX]]) -> list[int]:
        """Write the constraints node by node and return the number of path rows at each."""
        layout, stages, ng = self.layout, self.shape.stages, []
        limits, size = [], 2 * layout.n
        self.end_rows: dict[int, np.ndarray] = {}
        kept_rows: list[list[np.ndarray]] = [[] for _ in kept]
        for k, (x, e) in enumerate(zip(xs, es, strict=True)):
            if k < layout.K:
                self._add(self._gap(k, xs, us, kept))
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
                    wanted = self._reference(s, k, self._p.horizon)
                    rows.append(self._add(self._functions[s].residual(x[: layout.n], wanted)))
                elif layout.sums and k == layout.K:
                    rows.append(self._add(x[layout.durations.stop + i]))
            violated = x[: layout.violations], e / PENALTY
            limits.append([self._add(violated[0] + violated[1]), self._add(violated[0] - violated[1])])
            ng.append(self.count - before)
        self.limit_rows = np.array(limits, int).transpose(1, 0, 2)
        self.kept_rows = [np.concatenate(rows) for rows in kept_rows]
        return ng

    def _write_start(self, x: ca.SX) -> None:
        layout = self.layout
        measured = ca.vertcat(self._p.x0, ca.SX.zeros(layout.sums))
        self.x0_rows = self._add(ca.vertcat(x[: 2 * layout.n], x[layout.durations.stop :]) - measured)
        self.last_duration_row: int | None = None
        if layout.switches:
            self.last_duration_row = int(self._add(self._duration(layout.switches, x))[0])
        tau, fixed = x[layout.durations], [s for s, stage in enumerate(self.shape.stages[:-1]) if stage.fixed_end]
        self.instant_rows = {s: int(self._add(ca.sum1(tau[: s + 1]))[0]) for s in fixed}

    def _gap(self, k: int, xs: list[ca.SX], us: list[ca.SX], kept: list[list[ca.SX]]) -> ca.SX:
        layout, s = self.layout, int(self.layout.stage_of[k])
        step = self._functions[s].step(self.shape.discretization)
        after = step(xs[k][: 2 * layout.n], us[k], self._step(k, xs[k]))
        sums = [xs[k][layout.durations.stop + i] + kept[i][k] for i in range(layout.sums)]
        return xs[k + 1] - ca.vertcat(after, xs[k][layout.durations], *sums)

    def _symbolic_parameters(self) -> Parameters[ca.SX]:
        """Return the parameters as symbols."""
        shape, each = self.shape, list(enumerate(self._functions))
        shapes, nodes = (*shape.stages, *shape.kept), (*shape.nodes, *(self.layout.K for _ in shape.kept))
        columns = [2 * (N + 1) if stage.moving else 0 for stage, N in zip(shapes, nodes, strict=True)]
        return Parameters(
            x0=ca.SX.sym("x0", 2 * self.layout.n),
            horizon=ca.SX.sym("T_h"),
            pending=ca.SX.sym("delta"),
            terminal=ca.SX.sym("kappa"),
            omega=ca.SX.sym("omega", len(shape.stages)),
            offset=ca.SX.sym("offset", len(each)),
            scale=ca.SX.sym("scale", len(each)),
            weights=tuple(ca.SX.sym(f"W_{s}", stage.rows) for s, stage in each),
            control_weights=tuple(ca.SX.sym(f"W_r_{s}", stage.inputs) for s, stage in each),
            targets=tuple(ca.SX.sym(f"target_{s}", stage.numbers) for s, stage in each),
            paths=tuple(ca.SX.sym(f"path_{s}", stage.numbers, columns[s]) for s, stage in each),
        )
