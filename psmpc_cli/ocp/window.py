"""A window: the stages inside the current prediction horizon, with every number its optimization needs.

Also how these numbers follow from the previous prediction: the normalization of the costs and automatic meshes.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, Generic, TypeVar

import numpy as np

from psmpc_cli.ocp.end import SHORTEST
from psmpc_cli.ocp.objective import StageCosts
from psmpc_cli.ocp.plan import Plan, mesh
from psmpc_cli.ocp.stage import ConstraintNumbers, PlacedStage, Stage, StageShape, stage_shape, without_end
from psmpc_cli.robot.configuration import IDENTITY, Chart

T = TypeVar("T")
U = TypeVar("U")

COUNTS = (4, 6, 8, 11, 16, 23, 32, 45, 64, 90, 128, 180, 200)
"""Numbers of intervals a stage may have: few, so that what is built for a window serves again."""

SPARE = 2
"""A stage keeps its number of intervals until it needs more, or so many times fewer."""


@dataclass(frozen=True, eq=False)
class Kept:
    """An earlier stage that a level of HTMPC must not make worse over the whole window. Paper eq. (32).

    Attributes:
        stage: The stage.
        scale: Normalization of its cost.
        bound: The largest its cost integral may be, (), or each of its errors at the nodes after the first, (K, rows).
        ends: Its end condition holds at the window's first switch time.
    """

    stage: PlacedStage
    scale: float
    bound: np.ndarray
    ends: bool = False


@dataclass(frozen=True, eq=False)
class Window:
    """The stages of one prediction horizon [T0, T0 + T_h].

    Attributes:
        stages: The stages, the current one first.
        start: T0 [s].
        elapsed: Time the current stage has run already [s].
        hold: Time for which the end condition of the current stage must still be met before the stage may end [s].
        x0: Measured state (2n,).
        omega: Priorities in force, (S + 1,).
        offset, scale: Normalization of each stage's cost, (S + 1,) each. Paper eq. (12).
        horizon, pending_cost, terminal_cost: T_h [s], delta, kappa.
        nodes: N_s, intervals of each stage, (S + 1,).
        discretization: `exact` or `euler`.
        soft: Limits on the states may be violated, at a cost.
        cost_bound: The largest cost integral of the last stage, for epsilon constraints; IPOPT alone takes one.
        kept: Earlier stages that must not get worse, under HTMPC; IPOPT and fatrop take them, switch times held.
        ends: The stages before the last end by their end conditions; not so where `kept` alone says what ends.
        chart: The chart that its states are in.
        applied: Acceleration that was commanded last (n,), in the chart: changes of acceleration count from it. (0,)
            where they neither cost nor are limited.
        tick: How long a commanded acceleration holds [s].
        rate_shift: Qdot - v at the nodes (K + 1, n), by which limits of v are moved; None: that of the guess.
    """

    stages: tuple[PlacedStage, ...]
    start: float
    elapsed: float
    x0: np.ndarray
    omega: np.ndarray
    offset: np.ndarray
    scale: np.ndarray
    horizon: float
    pending_cost: float
    terminal_cost: float
    nodes: tuple[int, ...]
    discretization: str = "exact"
    soft: bool = False
    hold: float = 0.0
    cost_bound: float = np.inf
    kept: tuple[Kept, ...] = ()
    ends: bool = True
    chart: Chart = IDENTITY
    applied: np.ndarray = field(default_factory=lambda: np.zeros(0))
    tick: float = 1e-3
    rate_shift: np.ndarray | None = None

    def __repr__(self) -> str:
        end = self.start + self.horizon
        stages = (f"{stage.name} ({N} nodes)" for stage, N in zip(self.stages, self.nodes, strict=True))
        return f"<Window from {self.start:g} s to {end:g} s: {', '.join(stages)}>"

    @property
    def K(self) -> int:
        """Number of intervals."""
        return sum(self.nodes)

    @property
    def has_rates(self) -> bool:
        """Whether changes of the acceleration cost, or are limited."""
        return any(stage.has_rates for stage in (*self.stages, *(each.stage for each in self.kept)))

    @property
    def indices(self) -> tuple[int, ...]:
        """Index of the stage between each two switch times: one may be there before and after its own end."""
        return tuple(stage.index for stage in self.stages)

    @property
    def count(self) -> int:
        """Number of stages; one before and after its own end counts once."""
        return len(set(self.indices))

    def about(self, plan: Plan) -> "Window":
        """Return the window with limits of v as they are about a plan, whatever a solve starts from.

        So solves from different guesses share one feasible set in space too.
        """
        return replace(self, rate_shift=self.shift_of_limits(on_mesh(plan, self)))

    def shift_of_limits(self, guess: Plan) -> np.ndarray:
        """Return by how much limits of v are moved at the nodes (K + 1, n) in a solve from a guess on this mesh."""
        return self.chart.rate_shift(guess.X) if self.rate_shift is None else self.rate_shift

    def times(self, switch_times: np.ndarray) -> np.ndarray:
        """Return the node times (K + 1,) [s] with switch times (S,) [s], absolute."""
        return mesh(np.array([self.start, *switch_times, self.start + self.horizon]), self.nodes)

    def plan_of(self, flat: np.ndarray) -> Plan:
        """Return the plan on this window's mesh from `Plan.flat`.

        Raises:
            ValueError: It does not have the size of such a plan.
        """
        S = len(self.stages) - 1
        n = len(self.x0) // 2
        switch_times, X, u = np.split(flat, [S, S + 2 * n * (self.K + 1)])
        return Plan(
            self.times(switch_times), X.reshape(self.K + 1, 2 * n), u.reshape(self.K, n), switch_times, self.chart
        )


@dataclass(frozen=True)
class WindowShape:
    """The structure of a window: what is compiled for one serves all windows of the same shape.

    Attributes:
        stages: Of each stage.
        nodes: N_s, intervals of each stage.
        discretization: `exact` or `euler`.
        soft: Limits on the states may be violated, at a cost.
        bounded: The cost integral of the last stage is bounded.
        kept: Of each earlier stage that must not get worse; one that ends does so at the first switch.
        kept_errors: Their errors are bounded node by node, not their cost integrals.
    """

    stages: tuple[StageShape, ...]
    nodes: tuple[int, ...]
    discretization: str
    soft: bool = False
    bounded: bool = False
    kept: tuple[StageShape, ...] = ()
    kept_errors: bool = False

    @property
    def has_rates(self) -> bool:
        """Whether changes of the acceleration cost, or are limited."""
        return any(stage.has_rates for stage in (*self.stages, *self.kept))


def window_shape(window: Window) -> WindowShape:
    """Return the shape of a window; the last stage's end condition is not imposed."""
    stages = [stage_shape(stage) for stage in window.stages]
    ending = len(stages) - 1 if window.ends else 0
    kept = [stage_shape(each.stage) if each.ends else without_end(stage_shape(each.stage)) for each in window.kept]
    return WindowShape(
        stages=(*stages[:ending], *map(without_end, stages[ending:])),
        nodes=window.nodes,
        discretization=window.discretization,
        soft=window.soft,
        bounded=np.isfinite(window.cost_bound),
        kept=tuple(replace(shape, input="joint") for shape in kept),
        kept_errors=any(each.bound.ndim for each in window.kept),
    )


@dataclass(frozen=True, eq=False)
class Parameters(Generic[T]):
    """The NLP's parameters; what is of each stage is of the window's stages, then of those that are kept.

    Attributes:
        x0: Measured state (2n,).
        horizon: T_h [s].
        before: What was applied before, where changes of acceleration count: the acceleration commanded last, and for
            how long, (n + 1,); else (0,).
        pending, terminal: delta and kappa.
        omega: Priorities over the window's largest, (S + 1,).
        offset, scale: Of each stage, normalization L = (Lbar - offset) / scale. Paper eq. (12).
        weights, control_weights: Of each stage, (rows,) and (inputs,).
        rate_weights: Of each stage, (n,), or (0,) where changes of acceleration cost nothing.
        loads: Of each stage, the numbers of its load where force costs, else none.
        targets: Of each stage, (rows,): what its end condition is about, and its cost where the target stands still.
        paths: Of each stage, (rows, 2 (N_s + 1)): what its cost follows at its nodes as functions of its duration,
            first the values at duration 0, then the slopes; (rows, 0) where the target stands still.
        constraints: Of each stage of the window, by name of the constraints that have rows in it: the chart's anchor,
            then their argument, (numbers,); of one that moves as it is at each node after the first, at the times of
            the guess, (N_s, numbers).
    """

    x0: T
    horizon: T
    before: T
    pending: T
    terminal: T
    omega: T
    offset: T
    scale: T
    weights: tuple[T, ...]
    control_weights: tuple[T, ...]
    rate_weights: tuple[T, ...]
    loads: tuple[T, ...]
    targets: tuple[T, ...]
    paths: tuple[T, ...]
    constraints: tuple[Mapping[str, T], ...]

    def pieces(self) -> tuple[T, ...]:
        """Return all of them in order; matrices are meant column by column."""
        head = (self.x0, self.horizon, self.before, self.pending, self.terminal, self.omega, self.offset, self.scale)
        of_constraints = (each for by_name in self.constraints for each in by_name.values())
        of_stages = (
            *self.weights,
            *self.control_weights,
            *self.rate_weights,
            *self.loads,
            *self.targets,
            *self.paths,
        )
        return (*head, *of_stages, *of_constraints)

    def mapped(self, of: Callable[[T], U]) -> "Parameters[U]":
        """Return what a function makes of each of them."""
        return Parameters(**{each.name: _mapped(of, getattr(self, each.name)) for each in fields(self)})


def _mapped(of: Callable[[Any], Any], found: Any) -> Any:
    """Return what a function makes of a parameter, or of each in a tuple or a mapping of them."""
    if isinstance(found, tuple):
        return tuple(_mapped(of, each) for each in found)
    if isinstance(found, Mapping):
        return {name: of(each) for name, each in found.items()}
    return of(found)


def window_numbers(window: Window, switch_times: np.ndarray) -> Parameters[np.ndarray]:
    """Return all numbers of a window as parameters of its optimization.

    Optimizations are compiled for a structure and take all numbers as parameters, so that one serves any window of that
    structure. `Parameters` says what each of them is.

    Args:
        window: The window.
        switch_times: The guessed switch times, (S,) [s], about which trajectories and moving obstacles are linear.
    """
    # Kept stages, earlier ones that HTMPC must not make worse, are numbered behind the stages of the window. Their
    # costs are not shifted by an offset, only scaled.
    stages = (*window.stages, *(kept.stage for kept in window.kept))
    no_offsets = np.zeros(len(window.kept))
    return Parameters(
        x0=window.x0,
        horizon=np.array(window.horizon),
        before=_applied_before(window),
        pending=np.array(window.pending_cost),  # delta: cost of each second that a stage waits
        terminal=np.array(window.terminal_cost),  # kappa: weight of the last stage's cost at the end of the horizon
        omega=window.omega / float(np.max(window.omega)),
        offset=np.append(window.offset, no_offsets),
        scale=np.append(window.scale, [kept.scale for kept in window.kept]),
        weights=tuple(stage.weights for stage in stages),
        control_weights=tuple(stage.control_weights for stage in stages),
        rate_weights=tuple(stage.rate_weights for stage in stages),
        loads=tuple(stage.load_numbers for stage in stages),
        targets=tuple(stage.target_at_rest for stage in stages),
        paths=_paths(window, switch_times),
        constraints=_constraint_arguments(window, switch_times),
    )


def _applied_before(window: Window) -> np.ndarray:
    """Return the acceleration commanded last, none by default, and for how long (n + 1,); (0,) where it has no part."""
    if not window.has_rates:
        return np.zeros(0)
    n = len(window.x0) // 2
    return np.append(window.applied if len(window.applied) else np.zeros(n), window.tick)


def _constraint_arguments(window: Window, switch_times: np.ndarray) -> tuple[dict[str, np.ndarray], ...]:
    """Return the numbers that the functions of constraints take, by name of the constraint, for each stage of a window.

    They are the anchor of the chart and the constraint's argument, (numbers,). Where obstacles or the object move, each
    node of the stage after its first has an argument of its own, (N_s, numbers), at the time that it has with the
    guessed switch times. Constraints whose argument is not known have no rows, and are left out.

    Args:
        window: The window, its stages placed at a sample.
        switch_times: The guessed switch times, (S,) [s].
    """
    anchor = window.chart.anchor

    def completed(constraint: ConstraintNumbers, s: int) -> np.ndarray:
        """Return the anchor and the argument of a constraint in stage s, at each node where that changes with time."""
        if constraint.at_nodes is None:
            return np.concatenate([anchor, constraint.of_functions])
        first = sum(window.nodes[:s])
        since = window.times(switch_times)[first + 1 : first + 1 + window.nodes[s]] - window.start
        at_nodes = constraint.at_nodes(constraint.argument, since)
        numbers = np.empty((len(at_nodes), len(anchor) + at_nodes.shape[1]))
        numbers[:, : len(anchor)] = anchor
        numbers[:, len(anchor) :] = at_nodes
        return numbers

    arguments = list[dict[str, np.ndarray]]()
    for s, stage in enumerate(window.stages):
        known = {name: constraint for name, constraint in stage.constraints.items() if constraint.is_known}
        arguments.append({name: completed(constraint, s) for name, constraint in known.items()})
    return tuple(arguments)


def _paths(window: Window, switch_times: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return what each stage's cost follows, about the durations that guessed switch times give; see `Parameters`.

    A trajectory's time counts from where its stage begins: for the current stage in the past, for others at an instant.
    A node moves along the trajectory as the stage gets longer. Between two of its times the trajectory is straight, and
    so is this; a node that passes one of them is put right by the next solve.
    """
    tau = durations(switch_times, window.start, window.horizon)
    elapsed = [window.elapsed, *np.zeros(len(switch_times))]
    paths = [_path_of_stage(*each) for each in zip(window.stages, window.nodes, tau, elapsed, strict=True)]
    return (*paths, *(_kept_path(each.stage, window, switch_times) for each in window.kept))


def _kept_path(stage: Stage, window: Window, switch_times: np.ndarray) -> np.ndarray:
    """Return what a kept stage's cost follows at all nodes, as `Parameters.paths`; its switch times are held."""
    if not stage.reference.moves:
        return np.zeros((len(stage.target), 0))
    values, _ = stage.reference.at(window.elapsed + window.times(switch_times) - window.start)
    return np.vstack([values, np.zeros_like(values)]).T


def _path_of_stage(stage: Stage, N: int, tau: float, elapsed: float) -> np.ndarray:
    if not stage.reference.moves:
        return np.zeros((len(stage.target), 0))
    share = np.arange(N + 1) / N
    values, rates = stage.reference.at(elapsed + share * tau)
    slopes = rates * share[:, None]
    return np.vstack([values - tau * slopes, slopes]).T


def reference(p: Parameters[np.ndarray], s: int, tau: float) -> tuple[np.ndarray, np.ndarray]:
    """Return what a stage's cost follows at its nodes, and its slope by the duration tau [s], (N_s + 1, numbers) each.

    Of a target at rest both are of one row.
    """
    path = p.paths[s]
    nodes = p.paths[s].shape[1] // 2
    if not nodes:
        return p.targets[s][None], np.zeros((1, len(p.targets[s])))
    return (path[:, :nodes] + path[:, nodes:] * tau).T, path[:, nodes:].T


def reference_at(p: Parameters[Any], s: int, node: int, tau: Any) -> Any:
    """Return what a stage's cost follows at one of its nodes if it lasts tau [s], as numbers or symbols (numbers,)."""
    path = p.paths[s]
    nodes = path.shape[1] // 2
    return path[:, node] + path[:, nodes + node] * tau if nodes else p.targets[s]


def slope_at(p: Parameters[Any], s: int, node: int) -> Any:
    """Return the slope of what `reference_at` returns by the duration, as numbers or symbols (numbers,)."""
    path = p.paths[s]
    nodes = path.shape[1] // 2
    return path[:, nodes + node] if nodes else 0 * p.targets[s]


def shortest_durations(window: Window) -> np.ndarray:
    """Return the shortest duration of each stage (S + 1,): eps, or what is left of its dwell and hold times."""
    dwell = np.array([stage.end.dwell for stage in window.stages])
    dwell[0] = max(dwell[0] - window.elapsed, window.hold)
    dwell[-1] = 0.0
    return np.asarray(np.maximum(dwell, SHORTEST))


def durations(switch_times: np.ndarray, start: float, horizon: float) -> np.ndarray:
    """Return the durations (S + 1,) [s] between start, the switch times and the end of the horizon."""
    ends = np.concatenate(([start], switch_times, [start + horizon]))
    return np.asarray(ends[1:] - ends[:-1])


def on_mesh(plan: Plan, window: Window) -> Plan:
    """Return a plan read at the nodes of a window, begun at its measured state; the plan's switch times (S,) stay."""
    times = window.times(plan.switch_times)
    X, u = plan.at(times)
    X[0] = window.x0
    return Plan(times, X, u[:-1], plan.switch_times, plan.chart)


def plan_on_mesh(window: Window, X: np.ndarray, u: np.ndarray, tau: np.ndarray) -> Plan:
    """Return the plan of states X (K + 1, 2n) and accelerations u (K, n) at the nodes, free durations tau (S,) [s]."""
    switch_times = window.start + tau.cumsum()
    return Plan(window.times(switch_times), X, u, switch_times, window.chart)


def normalization(
    kind: str,
    zeta: float,
    stages: Sequence[Stage],
    begins: Sequence[float] | np.ndarray,
    costs: StageCosts,
    prediction: Plan,
    step: float | None,
) -> tuple[np.ndarray, np.ndarray]:
    """Return offset and scale of each stage's cost, L = (Lbar - offset) / scale, from its values along the prediction.

    Costs of different units so become comparable, and priorities mean the same in every window. Paper eq. (12): the
    nadir is the largest value of a stage's cost over the prediction, the utopia point the smallest.

    Args:
        kind: `nadir` divides by the nadir; `range` is eq. (12) as printed; `none` leaves the cost as it is.
        zeta: What is added to the scale, so that it is not 0.
        stages: The stages.
        begins: When each of them begins, (S + 1,) [s].
        costs: Evaluates the costs of stages of this robot.
        prediction: The plan along which costs are evaluated, of the sample before.
        step: Step of the uniform grid on which it is read [s], its control averaged over each step; None: it is read at
            its nodes, as line 9 of Algorithm 1 has it. There the maximum depends on the mesh, whose intervals shrink to
            nothing before a switch, and one tall control sets the scale of the next window (docs/decisions.md).

    Returns:
        Offset and scale, (S + 1,) each.
    """
    if kind == "none":
        return np.zeros(len(stages)), np.ones(len(stages))
    times, X, u = _nodes_of(prediction) if step is None else _resampled(prediction, step)
    costs_over_time = [costs.at(stage, X, u, times - begin) for stage, begin in zip(stages, begins, strict=True)]
    nadir = np.array([cost.max() for cost in costs_over_time])
    if kind == "nadir":
        return np.zeros(len(stages)), nadir + zeta
    utopia = np.array([cost.min() for cost in costs_over_time])
    return utopia, nadir - utopia + zeta


def _nodes_of(plan: Plan) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the times (K + 1,) [s], states (K + 1, 2n) and controls (K + 1, n) of a plan at its nodes."""
    return plan.times, plan.X, np.concatenate((plan.u, plan.u[-1:]))


def _resampled(plan: Plan, step: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the same on a uniform grid of about this step [s], the control averaged from each time to the next."""
    length = plan.end - plan.start
    count = round(length / step)
    times = plan.start + length / count * np.arange(count + 1)
    u = plan.mean_control(times)
    return times, plan.states_at(times), np.concatenate((u, u[-1:]))


def node_counts(
    window: Window, plan: Plan, costs: StageCosts, step: float, tolerance: float, before: Sequence[int | None]
) -> tuple[int, ...]:
    """Return how many intervals each stage gets (controller.nodes: auto): as few as the accuracy of J allows.

    With N_s intervals the sum over nodes that stands for the integral of J has an error of c_s / N_s in stage s. Twice
    as many intervals change J by half of that, which may be tolerance J at most: sum_s c_s / N_s = 2 tolerance J. Of
    all such N_s those with the smallest sum are in proportion to sqrt(c_s):

        N_s = sqrt(c_s) sum_r sqrt(c_r) / (2 tolerance J).

    No interval is longer than `step`, the sample time: the first control of a plan is to be that of one sample.

    Args:
        window: The window; its own numbers of intervals are not used.
        plan: The prediction, with the switch times of the window (S,) [s].
        costs: Evaluates the costs of stages of this robot.
        step: Longest interval, and longest time between two states at which costs are evaluated [s].
        tolerance: Largest change of J, relative to J.
        before: Number of intervals of each stage in the window of the sample before, (S + 1,), None for a stage that it
            did not have. A number stays while it is enough and at most `SPARE` times too large.
    """
    tau = durations(plan.switch_times, window.start, window.horizon)
    errors, J = _quadrature_errors(window, plan, tau, costs, step)
    root = np.sqrt(errors)
    needed = np.maximum(root * root.sum() / (2 * tolerance * J), tau / step)
    return tuple(_fewest_intervals(need, had) for need, had in zip(needed, before, strict=True))


def first_counts(window: Window, switch_times: np.ndarray, tolerance: float, step: float) -> tuple[int, ...]:
    """Return the counts of a window without a plan before it: its costs may fall from their largest to nothing."""
    tau = durations(switch_times, window.start, window.horizon)
    return tuple(
        _fewest_intervals(need, None) for need in np.maximum(1 / (2 * tolerance) * tau / window.horizon, tau / step)
    )


def _quadrature_errors(
    window: Window, plan: Plan, tau: np.ndarray, costs: StageCosts, step: float
) -> tuple[np.ndarray, float]:
    """Return how large the error of J is for a number of intervals of each stage, and J itself, along the prediction.

    J is an integral that windows replace by a sum over nodes. Its error falls as c_s / N_s with the number of intervals
    N_s of a stage. A cost that falls and rises again counts with both, as if the errors of its parts did not cancel.
    The cost of the control is left out.

    Args:
        window: The window.
        plan: The prediction.
        tau: Durations of the stages, (S + 1,) [s].
        costs: Evaluates the costs of stages of this robot.
        step: Longest time between two states at which costs are evaluated [s].

    Returns:
        c_s of each stage, (S + 1,), and J, at least the smallest positive float since errors are divided by it.
    """
    omega = window.omega / window.omega.max()
    begins = np.r_[window.start, plan.switch_times]
    errors = np.zeros(len(tau))
    J = window.pending_cost * float((plan.switch_times - window.start).sum())
    for s, stage in enumerate(window.stages):
        times = np.linspace(begins[s], begins[s] + tau[s], max(2, int(np.ceil(tau[s] / step)) + 1))
        since = times - begins[s] + (window.elapsed if s == 0 else 0.0)
        L = costs.of_states(stage, plan.states_at(times), since)
        weight = omega[s] * tau[s] / window.scale[s]
        # A sum over left ends of intervals misses half of what the cost changes over each of them.
        errors[s] = weight / 2 * float(np.abs(np.diff(L)).sum())
        # The trapezoidal rule; absolute, so that normalized costs below their offset do not cancel others.
        J += weight * abs(float((L[:-1] + L[1:]).mean()) / 2 - window.offset[s])
    return errors, max(J, np.finfo(float).tiny)


def _fewest_intervals(needed: float, before: int | None) -> int:
    """Return the number before if it serves, else the smallest of `COUNTS` that is large enough, or its largest."""
    if before is not None and needed <= before <= SPARE * needed:
        return before
    return next((count for count in COUNTS if count >= needed), COUNTS[-1])
