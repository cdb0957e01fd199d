"""From the shape of a window to its NLP: direct multiple shooting with the durations as constant states.

The objective is that of docs/formulation.md divided by the window's largest priority; variables and rows are ordered so
that structure-exploiting solvers apply. Nothing but the shape is baked in.
"""

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from psmpc_cli.ocp.discretization import step_function
from psmpc_cli.ocp.layout import Layout, StageShape, WindowShape
from psmpc_cli.ocp.parameters import Parameters, reference, symbolic_parameters
from psmpc_cli.ocp.skills import SKILLS
from psmpc_cli.ocp.skills.base import quadratic_cost
from psmpc_cli.robot.model import RobotModel


@dataclass(frozen=True, eq=False)
class Nlp:
    """A window's NLP: min f(x, p) subject to bounds on x and g(x, p).

    Attributes:
        shape: The window's shape.
        layout: Where the decision variables stand.
        x, p, f, g: Expressions.
        nx, nu, ng: Sizes of state, input and path rows at each node, (K + 1,), for structure-exploiting solvers.
        equality: Whether each row of g is an equality.
        gap_rows: Rows of g that close the gap after each interval, (K, nx).
        x0_rows: Rows of g that fix the initial state.
        last_duration_row: Row of g with the last stage's duration, None with one stage.
        instant_rows: Row of g with the cumulated duration to the end of a stage with a fixed switching time.
        end_rows: Rows of g with the end condition, error rows first, then rates, by stage of the window.
        stage_costs: Function (x, p) -> normalized cost integrals of the stages, (S + 1,).
    """

    shape: WindowShape
    layout: Layout
    x: ca.SX
    p: ca.SX
    f: ca.SX
    g: ca.SX
    nx: tuple[int, ...]
    nu: tuple[int, ...]
    ng: tuple[int, ...]
    equality: tuple[bool, ...]
    gap_rows: np.ndarray
    x0_rows: np.ndarray
    last_duration_row: int | None
    instant_rows: dict[int, int]
    end_rows: dict[int, np.ndarray]
    costs: ca.SX

    @cached_property
    def stage_costs(self) -> ca.Function:
        """Normalized cost integral of each stage, without priorities: (x, p) -> (S + 1,)."""
        return ca.Function("stage_costs", [self.x, self.p], [self.costs])

    @property
    def problem(self) -> dict[str, ca.SX]:
        """The NLP as CasADi's solvers take it."""
        return {"x": self.x, "p": self.p, "f": self.f, "g": self.g}


@dataclass(frozen=True, eq=False)
class StageFunctions:
    """A stage's step, cost and end condition as CasADi functions."""

    step: ca.Function  # x, u, dt -> x_next
    cost: ca.Function  # x, u, target, weights, control_weights -> Lbar
    end: ca.Function  # x, target -> end rows of the error, then of its rate


def stage_functions(model: RobotModel, shape: StageShape, discretization: str) -> StageFunctions:
    """Return the functions a stage of this shape is made of."""
    skill = SKILLS[shape.space]
    x, target = ca.SX.sym("x", 2 * model.n), ca.SX.sym("target", skill.rows(model))
    u = ca.SX.sym("u", model.n if shape.input == "joint" else model.m)
    W, W_r = ca.SX.sym("W", target.shape[0]), ca.SX.sym("W_r", u.shape[0])
    Q, Qdot = x[: model.n], x[model.n :]
    error = skill.error(model, Q, target)
    rows = list(shape.end_rows)
    end = error[rows] if rows else ca.SX(0, 1)
    if shape.end_velocity:
        end = ca.vertcat(end, skill.rate(model, Q, Qdot)[rows])
    return StageFunctions(
        step=step_function(model, shape.input, discretization),
        cost=ca.Function("Lbar", [x, u, target, W, W_r], [quadratic_cost(error, u, W, W_r)]),
        end=ca.Function("h", [x, target], [end]),
    )


def window_layout(model: RobotModel, shape: WindowShape) -> Layout:
    """Return where the decision variables of a window of this shape stand."""
    return Layout(
        n=model.n,
        nodes=shape.nodes,
        inputs=tuple(model.n if s.input == "joint" else model.m for s in shape.stages),
        rows=tuple(SKILLS[s.space].rows(model) for s in shape.stages),
    )


def transcribe(model: RobotModel, shape: WindowShape) -> Nlp:
    """Return the NLP of a window of this shape. Paper eq. (20), with the departures of docs/formulation.md."""
    layout = window_layout(model, shape)
    parameters = symbolic_parameters(shape, layout)
    functions = [stage_functions(model, stage, shape.discretization) for stage in shape.stages]
    xs = [ca.SX.sym(f"x{k}", layout.nx) for k in range(layout.K + 1)]
    us = [ca.SX.sym(f"u{k}", layout.inputs[layout.stage_of[k]]) for k in range(layout.K)]
    variables = [v for pair in zip(xs, us, strict=False) for v in pair] + [xs[-1]]
    costs = _stage_costs(layout, functions, parameters, xs, us)
    rows = _Rows(layout, shape, functions, parameters)
    for k in range(layout.K + 1):
        rows.add_node(k, xs, us)
    return Nlp(
        shape=shape,
        layout=layout,
        x=ca.vertcat(*variables),
        p=ca.vertcat(*(ca.vec(piece) for piece in parameters.pieces())),
        f=_objective(layout, functions, parameters, xs, costs),
        g=ca.vertcat(*rows.expressions),
        nx=(layout.nx,) * (layout.K + 1),
        nu=(*(u.shape[0] for u in us), 0),
        ng=tuple(rows.path_rows),
        equality=tuple(rows.equality),
        gap_rows=np.array(rows.gap_rows),
        x0_rows=rows.x0_rows,
        last_duration_row=rows.last_duration_row,
        instant_rows=rows.instant_rows,
        end_rows=rows.end_rows,
        costs=ca.vertcat(*costs),
    )


def duration(layout: Layout, parameters: Parameters[ca.SX], x: ca.SX, stage: int) -> ca.SX:
    """Return tau_s of a stage from a node's state; the last stage takes what is left of the horizon."""
    tau = x[2 * layout.n :]
    return parameters.horizon - ca.sum1(tau) if stage == layout.switches else tau[stage]


def _stage_costs(
    layout: Layout, functions: list[StageFunctions], p: Parameters[ca.SX], xs: list[ca.SX], us: list[ca.SX]
) -> list[ca.SX]:
    """Return sum_i L_s(x_i, u_i) tau_s / N_s of each stage."""
    costs = [ca.SX(0) for _ in layout.nodes]
    for k, u in enumerate(us):
        s = int(layout.stage_of[k])
        tau = duration(layout, p, xs[k], s)
        wanted = reference(p, layout, s, k - int(layout.first_node[s]), tau)
        Lbar = functions[s].cost(xs[k][: 2 * layout.n], u, wanted, p.weights[s], p.control_weights[s])
        costs[s] += (Lbar - p.offset[s]) / p.scale[s] * tau / layout.nodes[s]
    return costs


def _objective(
    layout: Layout, functions: list[StageFunctions], p: Parameters[ca.SX], xs: list[ca.SX], costs: list[ca.SX]
) -> ca.SX:
    """Return J over the window's largest priority: stage costs, pending cost, terminal cost. Cf. paper eq. (16)."""
    S = layout.switches
    tau = xs[0][2 * layout.n :]
    pending = sum((ca.sum1(tau[:s]) for s in range(1, S + 1)), ca.SX(0))
    u, wanted = ca.SX.zeros(layout.inputs[S]), reference(p, layout, S, layout.nodes[S], duration(layout, p, xs[-1], S))
    last = functions[S].cost(xs[-1][: 2 * layout.n], u, wanted, p.weights[S], p.control_weights[S])
    terminal = p.omega[S] * (last - p.offset[S]) / p.scale[S]
    return ca.dot(p.omega, ca.vertcat(*costs)) + p.pending * pending + p.terminal * terminal


class _Rows:
    """Collects the rows of g node by node: the gap to the next node first, then the path rows of this one."""

    def __init__(
        self, layout: Layout, shape: WindowShape, functions: list[StageFunctions], p: Parameters[ca.SX]
    ) -> None:
        self.layout, self.shape, self.functions, self.p = layout, shape, functions, p
        self.expressions: list[ca.SX] = []
        self.equality: list[bool] = []
        self.path_rows: list[int] = []
        self.gap_rows: list[np.ndarray] = []
        self.x0_rows = np.zeros(0, int)
        self.last_duration_row: int | None = None
        self.instant_rows: dict[int, int] = {}
        self.end_rows: dict[int, np.ndarray] = {}

    def add_node(self, k: int, xs: list[ca.SX], us: list[ca.SX]) -> None:
        """Add the rows of node k."""
        if k < self.layout.K:
            self._add_gap(k, xs, us)
        before = len(self.equality)
        if k == 0:
            self._add_start(xs[0])
        elif k in self.layout.first_node[1:-1]:
            self._add_end_condition(int(np.searchsorted(self.layout.first_node, k)) - 1, xs[k])
        self.path_rows.append(len(self.equality) - before)

    def _add(self, expression: ca.SX, equality: bool) -> np.ndarray:
        first = len(self.equality)
        self.expressions.append(expression)
        self.equality += [equality] * expression.shape[0]
        return np.arange(first, len(self.equality))

    def _add_gap(self, k: int, xs: list[ca.SX], us: list[ca.SX]) -> None:
        layout, s = self.layout, int(self.layout.stage_of[k])
        dt = duration(layout, self.p, xs[k], s) / layout.nodes[s]
        after = self.functions[s].step(xs[k][: 2 * layout.n], us[k], dt)
        self.gap_rows.append(self._add(xs[k + 1] - ca.vertcat(after, xs[k][2 * layout.n :]), equality=True))

    def _add_start(self, x: ca.SX) -> None:
        self.x0_rows = self._add(x[: 2 * self.layout.n] - self.p.x0, equality=True)
        if self.layout.switches:
            last = duration(self.layout, self.p, x, self.layout.switches)
            self.last_duration_row = int(self._add(last, equality=False)[0])
        for s, stage in enumerate(self.shape.stages[:-1]):
            if stage.fixed_end:
                until = ca.sum1(x[2 * self.layout.n : 2 * self.layout.n + s + 1])
                self.instant_rows[s] = int(self._add(until, equality=True)[0])

    def _add_end_condition(self, s: int, x: ca.SX) -> None:
        if self.shape.stages[s].end_rows:
            h = self.functions[s].end(x[: 2 * self.layout.n], self.p.targets[s])
            self.end_rows[s] = self._add(h, equality=False)
