"""From the shape of a window to its NLP: direct multiple shooting with the durations as constant states.

The objective is that of docs/formulation.md divided by the window's largest priority; variables and rows are ordered so
that structure-exploiting solvers apply. Nothing but the shape is baked in.
"""

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from psmpc_cli.ocp.layout import Layout, WindowShape
from psmpc_cli.ocp.parameters import Parameters, reference, symbolic_parameters
from psmpc_cli.ocp.rows import place_rows
from psmpc_cli.ocp.skills import SKILLS
from psmpc_cli.ocp.soft_limits import PENALTY
from psmpc_cli.ocp.stage_functions import StageFunctions, stage_functions
from psmpc_cli.robot.model import RobotModel


@dataclass(frozen=True, eq=False)
class Expressions:
    """Variables, parameters, objective, constraints of an NLP, and what the stages add to the objective.

    Attributes:
        x, p, f, g: As CasADi's solvers take them.
        costs: Normalized cost integral of each stage, without priorities, (S + 1,).
        terminal: Normalized terminal cost of the last stage, times kappa.
    """

    x: ca.SX
    p: ca.SX
    f: ca.SX
    g: ca.SX
    costs: ca.SX
    terminal: ca.SX


@dataclass(frozen=True, eq=False)
class Nlp:
    """A window's NLP: min f(x, p) subject to bounds on x and g(x, p).

    Its expressions are written when they are first asked for: not every back-end needs them.

    Attributes:
        model: The robot.
        shape: The window's shape.
        layout: Where the decision variables stand.
        ng: Number of path rows at each node, (K + 1,).
        equality: Whether each row of g is an equality.
        gap_rows: Rows of g that close the gap after each interval, (K, nx).
        x0_rows: Rows of g that fix the initial state.
        last_duration_row: Row of g with the last stage's duration, None with one stage.
        instant_rows: Row of g with the cumulated duration to the end of a stage with a fixed switching time.
        end_rows: Rows of g with the end condition, error rows first, then rates, by stage of the window.
        limit_rows: Rows of g with the soft limits at the nodes, below and above, (2, K + 1, 2n); (2, K + 1, 0) if hard.
    """

    model: RobotModel
    shape: WindowShape
    layout: Layout
    ng: tuple[int, ...]
    equality: tuple[bool, ...]
    gap_rows: np.ndarray
    x0_rows: np.ndarray
    last_duration_row: int | None
    instant_rows: dict[int, int]
    end_rows: dict[int, np.ndarray]
    limit_rows: np.ndarray

    @cached_property
    def expressions(self) -> Expressions:
        """All expressions."""
        return _write(self.model, self.shape, self.layout)

    @property
    def x(self) -> ca.SX:
        """Decision variables."""
        return self.expressions.x

    @property
    def p(self) -> ca.SX:
        """Parameters."""
        return self.expressions.p

    @property
    def f(self) -> ca.SX:
        """Objective."""
        return self.expressions.f

    @property
    def g(self) -> ca.SX:
        """Constraints."""
        return self.expressions.g

    @cached_property
    def costs(self) -> ca.Function:
        """x, p -> normalized cost integral of each stage, without priorities, (S + 1,), and the terminal cost."""
        return ca.Function("costs", [self.x, self.p], [self.expressions.costs, self.expressions.terminal])

    @cached_property
    def rows(self) -> ca.Function:
        """x, p -> g."""
        return ca.Function("rows", [self.x, self.p], [self.g])

    @property
    def nx(self) -> tuple[int, ...]:
        """Size of the state at each node, (K + 1,)."""
        return (self.layout.nx,) * (self.layout.K + 1)

    @property
    def nu(self) -> tuple[int, ...]:
        """Size of the input at each node, violations of soft limits included, (K + 1,)."""
        layout = self.layout
        return tuple(inputs + layout.violations for inputs in (*(layout.inputs[s] for s in layout.stage_of), 0))

    @property
    def problem(self) -> dict[str, ca.SX]:
        """The NLP as CasADi's solvers take it."""
        return {"x": self.x, "p": self.p, "f": self.f, "g": self.g}


def window_layout(model: RobotModel, shape: WindowShape) -> Layout:
    """Return where the decision variables of a window of this shape stand."""
    return Layout(
        n=model.n,
        nodes=shape.nodes,
        inputs=tuple(model.n if s.input == "joint" else model.m for s in shape.stages),
        rows=tuple(SKILLS[s.space].rows(model) for s in shape.stages),
        soft=shape.soft,
    )


def transcribe(model: RobotModel, shape: WindowShape) -> Nlp:
    """Return the NLP of a window of this shape. Paper eq. (20), with the departures of docs/formulation.md."""
    layout = window_layout(model, shape)
    rows = place_rows(layout, shape)
    return Nlp(
        model=model,
        shape=shape,
        layout=layout,
        ng=rows.path,
        equality=rows.equality,
        gap_rows=rows.gaps,
        x0_rows=rows.x0,
        last_duration_row=rows.last_duration,
        instant_rows=rows.instants,
        end_rows=rows.ends,
        limit_rows=rows.limits,
    )


def _write(model: RobotModel, shape: WindowShape, layout: Layout) -> Expressions:
    """Return the expressions of an NLP, unrolled node by node."""
    parameters = symbolic_parameters(shape, layout)
    functions = [stage_functions(model, stage, shape.discretization) for stage in shape.stages]
    xs = [ca.SX.sym(f"x{k}", layout.nx) for k in range(layout.K + 1)]
    us = [ca.SX.sym(f"u{k}", layout.inputs[layout.stage_of[k]]) for k in range(layout.K)]
    es = [ca.SX.sym(f"e{k}", layout.violations) for k in range(layout.K + 1)]
    variables = [v for node in zip(xs, [*us, ca.SX(0, 1)], es, strict=True) for v in node]
    costs = _stage_costs(layout, functions, parameters, xs, us)
    terminal = _terminal_cost(layout, functions, parameters, xs[-1])
    pending = sum((ca.sum1(xs[0][2 * layout.n :][:s]) for s in range(1, layout.switches + 1)), ca.SX(0))
    J = ca.dot(parameters.omega, ca.vertcat(*costs)) + parameters.pending * pending + parameters.omega[-1] * terminal
    constraints = _Constraints(layout, shape, functions, parameters)
    rows = [row for k in range(layout.K + 1) for row in constraints.at_node(k, xs, us, es)]
    return Expressions(
        x=ca.vertcat(*variables),
        p=ca.vertcat(*(ca.vec(piece) for piece in parameters.pieces())),
        f=J + _penalty(layout, parameters, xs, es),
        g=ca.vertcat(*rows, *([costs[-1] + terminal] if shape.bounded else [])),
        costs=ca.vertcat(*costs),
        terminal=terminal,
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


def _terminal_cost(layout: Layout, functions: list[StageFunctions], p: Parameters[ca.SX], x: ca.SX) -> ca.SX:
    """Return the normalized cost of the last stage at the last node without control, times kappa."""
    S = layout.switches
    u, wanted = ca.SX.zeros(layout.inputs[S]), reference(p, layout, S, layout.nodes[S], duration(layout, p, x, S))
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


class _Constraints:
    """The rows of g node by node, in the order of `place_rows`."""

    def __init__(
        self, layout: Layout, shape: WindowShape, functions: list[StageFunctions], p: Parameters[ca.SX]
    ) -> None:
        self.layout, self.shape, self.functions, self.p = layout, shape, functions, p

    def at_node(self, k: int, xs: list[ca.SX], us: list[ca.SX], es: list[ca.SX]) -> list[ca.SX]:
        """Return the gap to the next node, then the path rows of node k."""
        rows = [self._gap(k, xs, us)] if k < self.layout.K else []
        if k == 0:
            return rows + self._start(xs[0]) + self._limits(xs[0], es[0])
        if k in self.layout.first_node[1:-1]:
            s = int(self.layout.stage_of[k - 1])
            if self.shape.stages[s].end_rows:
                rows.append(self.functions[s].end(xs[k][: 2 * self.layout.n], self.p.targets[s]))
        return rows + self._limits(xs[k], es[k])

    def _limits(self, x: ca.SX, e: ca.SX) -> list[ca.SX]:
        """Return the rows of soft limits, none where they are hard."""
        x, violated = x[: self.layout.violations], e / PENALTY
        return [x + violated, x - violated]

    def _gap(self, k: int, xs: list[ca.SX], us: list[ca.SX]) -> ca.SX:
        layout, s = self.layout, int(self.layout.stage_of[k])
        dt = duration(layout, self.p, xs[k], s) / layout.nodes[s]
        after = self.functions[s].step(xs[k][: 2 * layout.n], us[k], dt)
        return xs[k + 1] - ca.vertcat(after, xs[k][2 * layout.n :])

    def _start(self, x: ca.SX) -> list[ca.SX]:
        layout = self.layout
        rows = [x[: 2 * layout.n] - self.p.x0]
        if layout.switches:
            rows.append(duration(layout, self.p, x, layout.switches))
        tau = x[2 * layout.n :]
        return rows + [ca.sum1(tau[: s + 1]) for s, stage in enumerate(self.shape.stages[:-1]) if stage.fixed_end]
