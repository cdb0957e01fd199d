"""The levels of a lexicographic OCP: minimize one stage's cost without making the earlier ones worse. Paper eq. (32).

The earlier stages' costs are carried as extra states (`constraint: cost`), or their errors are bounded node by node by
what their own level reached (`constraint: error`); either way the stage structure that solvers exploit stays.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np

from psmpc_cli.ocp.objective import StageShape, stage_functions
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.ocp.problem import Problem, Stage
from psmpc_cli.ocp.window import Window
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.solvers.base import Solution, attempt
from psmpc_cli.solvers.nlp import Bounds, PluginSolver
from psmpc_cli.specs.task import SolverSpec


@dataclass(frozen=True)
class LevelShape:
    """What decides the structure of a level: the spaces of its stages, the minimized one last, and the mesh."""

    spaces: tuple[str, ...]
    constraint: str  # cost or error
    nodes: int
    discretization: str

    @property
    def earlier(self) -> int:
        """Number of stages that must not get worse."""
        return len(self.spaces) - 1

    @property
    def accumulators(self) -> int:
        """Number of extra states, one a cost that is bounded."""
        return self.earlier if self.constraint == "cost" else 0


class LevelNlp:
    """A level's NLP, structured node by node as the window's is.

    Attributes:
        problem: The NLP as CasADi's solvers take it.
        nx, nu, ng: Sizes of state, input and path rows at each node, (K + 1,).
        states, inputs: Indices of [Q; Qdot] at the nodes (K + 1, 2n) and of u over the intervals (K, n).
        bound_rows: Rows of g with an earlier stage's cost at the end (`cost`), or its error at each node (`error`).
        costs: (x, p) -> J_i of every stage of the level, (stages,).
    """

    def __init__(self, model: RobotModel, shape: LevelShape) -> None:
        n, K, A = model.n, shape.nodes, shape.accumulators
        x0, dt, scale = ca.SX.sym("x0", 2 * n), ca.SX.sym("dt"), ca.SX.sym("scale", len(shape.spaces))
        stages = [_StageTerms(model, space, scale[i], K) for i, space in enumerate(shape.spaces)]
        xs = [ca.SX.sym(f"x{k}", 2 * n + A) for k in range(K + 1)]
        us = [ca.SX.sym(f"u{k}", n) for k in range(K)]
        step = stages[0].functions.step(shape.discretization)
        rows: list[ca.SX] = []
        bound_rows: list[list[np.ndarray]] = [[] for _ in range(shape.earlier)]
        count, ng = 0, [0] * (K + 1)
        for k, x in enumerate(xs):
            if k < K:
                grown = [x[2 * n + i] + dt * stages[i].cost(x, us[k], k) for i in range(A)]
                rows.append(xs[k + 1] - ca.vertcat(step(x[: 2 * n], us[k], dt), *grown))
                count += 2 * n + A
            for i, expression in _path_rows(shape, stages, xs, x0, k):
                if i is not None:
                    bound_rows[i].append(np.arange(count, count + expression.shape[0]))
                rows.append(expression)
                count, ng[k] = count + expression.shape[0], ng[k] + expression.shape[0]
        J = [sum((dt * stage.cost(xs[k], us[k], k) for k in range(K)), ca.SX(0)) for stage in stages]
        z = ca.vertcat(*(v for pair in zip(xs, us, strict=False) for v in pair), xs[-1])
        p = ca.vertcat(x0, dt, scale, *(ca.vec(piece) for stage in stages for piece in stage.parameters))
        offsets = (3 * n + A) * np.arange(K + 1)
        self.problem = {"x": z, "p": p, "f": J[-1], "g": ca.vertcat(*rows)}
        self.nx, self.nu, self.ng = (2 * n + A,) * (K + 1), (*(n for _ in range(K)), 0), tuple(ng)
        self.states = offsets[:, None] + np.arange(2 * n)
        self.inputs = offsets[:-1, None] + 2 * n + A + np.arange(n)
        self.bound_rows = tuple(np.concatenate(found) for found in bound_rows)
        self.costs = ca.Function("costs", [z, p], [ca.vertcat(*J)])


class _StageTerms:
    """A stage's normalized cost and error as expressions of its own parameters."""

    def __init__(self, model: RobotModel, space: str, scale: ca.SX, K: int) -> None:
        self.functions, self._n, self._scale = stage_functions(model, StageShape(space)), model.n, scale
        self._weights, self._control_weights = ca.SX.sym("W", self.functions.rows), ca.SX.sym("W_r", model.n)
        self._targets = ca.SX.sym("target", self.functions.numbers, K + 1)

    @property
    def parameters(self) -> tuple[ca.SX, ...]:
        return self._weights, self._control_weights, self._targets

    def error(self, x: ca.SX, k: int) -> ca.SX:
        return self.functions.residual(x[: self._n], self._targets[:, k])

    def cost(self, x: ca.SX, u: ca.SX, k: int) -> ca.SX:
        numbers = (self._targets[:, k], self._weights, self._control_weights)
        return self.functions.cost(x[: 2 * self._n], u, *numbers) / self._scale


def _path_rows(
    shape: LevelShape, stages: list[_StageTerms], xs: list[ca.SX], x0: ca.SX, k: int
) -> list[tuple[int | None, ca.SX]]:
    """Return node k's path rows: the initial state, and the bounds on the stage they belong to."""
    if k == 0:
        return [(None, xs[0] - ca.vertcat(x0, ca.SX.zeros(shape.accumulators)))]
    if shape.constraint == "error":
        return [(i, stages[i].error(xs[k], k)) for i in range(shape.earlier)]
    if k == shape.nodes:
        return [(i, xs[k][x0.shape[0] + i]) for i in range(shape.earlier)]
    return []


@dataclass(frozen=True, eq=False)
class Level:
    """The numbers of one level.

    Attributes:
        window: The window of the first level, over the current stage alone: its state, horizon and start.
        stages: The stages, the minimized one last.
        scale: Normalization of each stage's cost, (stages,).
        constraint: What the earlier stages must keep: `cost` or `error`.
        bounds: Of each earlier stage its cost (`cost`), or its errors at the nodes (K, rows) (`error`).
        tolerance: Added to every bound.
        reached: States at the nodes after the first (K, 2n) to which soft limits give way, those of the first level;
            None where limits are hard.
    """

    window: Window
    stages: tuple[Stage, ...]
    scale: np.ndarray
    constraint: str
    bounds: tuple[np.ndarray, ...]
    tolerance: float
    reached: np.ndarray | None = None

    @property
    def nodes(self) -> int:
        """Intervals of the horizon: those of the window."""
        return self.window.nodes[0]

    @property
    def shape(self) -> LevelShape:
        """The structure of its NLP."""
        spaces = tuple(stage.space for stage in self.stages)
        return LevelShape(spaces, self.constraint, self.nodes, self.window.discretization)


class LevelSolver:
    """Levels by fatrop or IPOPT: one transcribed and compiled NLP for each shape, kept for all levels of that shape.

    Earlier costs are constraints and need their curvature, so `sqp` leaves its levels to fatrop.
    """

    def __init__(self, problem: Problem, spec: SolverSpec) -> None:
        self._problem = problem
        self._spec = spec.model_copy(update={"kind": "fatrop" if spec.kind == "sqp" else spec.kind})
        self._compiled: dict[LevelShape, tuple[LevelNlp, PluginSolver]] = {}

    def solve(self, level: Level, plan: Plan) -> Solution:
        """Solve a level from a plan, which is read at its nodes; its costs are those of all its stages."""
        times = level.window.start + level.window.horizon * np.arange(level.nodes + 1) / level.nodes
        guess = Plan(times, plan.states_at(times), plan.control_at(times[:-1]), np.zeros(0))
        return attempt(level.window, guess, lambda: self._solve(level, guess))

    def _solve(self, level: Level, guess: Plan) -> Solution:
        shape = level.shape
        if shape not in self._compiled:
            nlp = LevelNlp(self._problem.model, shape)
            self._compiled[shape] = nlp, PluginSolver(nlp, self._spec)
        nlp, solver = self._compiled[shape]
        z, p = np.zeros(nlp.problem["x"].shape[0]), _parameters(level)
        z[nlp.states], z[nlp.inputs] = guess.X, guess.u
        found = solver.solve(z, p, _bounds(nlp, level))
        return Solution(
            outcome=found.outcome,
            plan=Plan(guess.times, found.z[nlp.states], found.z[nlp.inputs], guess.instants),
            objective=found.objective,
            iterations=found.iterations,
            wall_time=found.wall_time,
            window=level.window,
            guess=guess,
            costs=np.asarray(nlp.costs(found.z, p)).ravel(),
        )


def _parameters(level: Level) -> np.ndarray:
    """Return the parameter vector of a level."""
    K, window = level.nodes, level.window
    grid = window.horizon * np.arange(K + 1) / K
    pieces = [window.x0, np.array([window.horizon / K]), level.scale]
    for i, stage in enumerate(level.stages):
        since = window.elapsed + grid if i == 0 else np.zeros(K + 1)  # a later stage's trajectory has not begun
        pieces += [stage.weights, stage.control_weights, stage.reference(since).ravel()]
    return np.concatenate(pieces)


def _bounds(nlp: LevelNlp, level: Level) -> Bounds:
    """Return the bounds of a level; the limits are those of the current stage."""
    size, rows = nlp.problem["x"].shape[0], nlp.problem["g"].shape[0]
    lbx, ubx, lbg, ubg = np.full(size, -np.inf), np.full(size, np.inf), np.zeros(rows), np.zeros(rows)
    limits = level.stages[0].limits
    low = np.concatenate([limits.position_low, limits.velocity_low])
    high = np.concatenate([limits.position_high, limits.velocity_high])
    lbx[nlp.states[1:]] = low if level.reached is None else np.minimum(low, level.reached)
    ubx[nlp.states[1:]] = high if level.reached is None else np.maximum(high, level.reached)
    lbx[nlp.inputs], ubx[nlp.inputs] = limits.acceleration_low, limits.acceleration_high
    for found, bound in zip(nlp.bound_rows, level.bounds, strict=True):
        allowed = np.abs(bound).ravel() + level.tolerance
        lbg[found], ubg[found] = -np.inf if level.constraint == "cost" else -allowed, allowed
    return Bounds(lbx, ubx, lbg, ubg)
