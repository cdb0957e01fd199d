"""The Pareto front of one sample's window: weighted sums and epsilon constraints, each from the best point known."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from psmpc_cli.logs.read import read_log
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.ocp.window import SHORTEST
from psmpc_cli.simulation.setup import build_experiment, converging
from psmpc_cli.simulation.summary import task_of
from psmpc_cli.solvers import Outcome
from psmpc_cli.studies.one_window import window_at
from psmpc_cli.studies.trade_off import Point, Scalarization, TradeOff, constrained, weighted_sum

Vector = np.ndarray

BETTER = 1e-6
"""By how much another point has to serve a scalarization better before it is solved again from there."""

ROUNDS = 5
"""How often at most the points of a front are compared and solved again."""


@dataclass(frozen=True, eq=False)
class Grid:
    """Which problems are solved at every sample.

    Attributes:
        ratios: omega_2 / omega_1 of the weighted sums, rising (N,).
        weighted: Whether all of them are wanted; the first and the last one are always solved.
        bounds: Number of bounds on J_2, evenly between what the first and the last ratio lead to; 0 for none.
        parts: How much later the instant is held than the run's optimum, as parts of what is left of the horizon (H,);
            0 for that optimum itself.
        free: Whether the weighted sums are solved with the instant free as well.
    """

    ratios: Vector
    weighted: bool
    bounds: int
    parts: Vector
    free: bool


@dataclass(frozen=True, eq=False)
class Front:
    """What was found with one method at one instant, or with the instant free.

    Attributes:
        J: J_1 and J_2 of each point (P, 2).
        wait: t_s - T0 (P,) [s].
        objective: What was minimized (P,).
        ratio: omega_2 / omega_1 of each, given or found (P,).
        bound: The bound on J_2 (P,); infinite for weighted sums.
        outcome: Index of each solve's `Outcome` (P,).
    """

    J: Vector
    wait: Vector
    objective: Vector
    ratio: Vector
    bound: Vector
    outcome: Vector


@dataclass(frozen=True, eq=False)
class SampleFronts:
    """What was found at one sample.

    Attributes:
        start: T0 [s].
        wait: t_s - T0 of the run's optimum [s].
        J: J_1 and J_2 of the run's optimum (2,).
        ratio: Its omega_2 / omega_1.
        scale: Normalization of both costs (2,).
        weighted, constrained: The fronts with the instant held, one a part (H,); none of a method that was not wanted.
        free: The weighted sums with the instant free; None if not wanted.
        again: How many points were solved again because another one served them better.
    """

    start: float
    wait: float
    J: Vector
    ratio: float
    scale: Vector
    weighted: tuple[Front, ...]
    constrained: tuple[Front, ...]
    free: Front | None
    again: int


@dataclass(frozen=True, eq=False)
class SampleTask:
    """One sample of a log, and the problems to solve there."""

    log: Path
    sample: int
    grid: Grid


def solve_sample(task: SampleTask) -> SampleFronts:
    """Return the fronts at one sample."""
    log, grid = read_log(task.log), task.grid
    trade_off = TradeOff(window_at(log, build_experiment(converging(task_of(log))), task.sample))
    window, plan = trade_off.one.window, trade_off.one.plan
    wait = float(plan.instants[0]) - window.start
    ratio = float(window.omega[1] / window.omega[0])
    held = wait + grid.parts * max(window.horizon - SHORTEST - wait, 0.0)
    swept = [_sweep(trade_off, grid, ratio, float(at)) for at in held]
    free = _sweep(trade_off, grid, ratio, None) if grid.free else None
    return SampleFronts(
        start=window.start,
        wait=wait,
        J=trade_off.costs_of(plan),
        ratio=ratio,
        scale=window.scale,
        weighted=tuple(found.weighted for found in swept) if grid.weighted else (),
        constrained=tuple(found.constrained for found in swept) if grid.bounds else (),
        free=None if free is None else free.weighted,
        again=sum(found.again for found in [*swept, *([] if free is None else [free])]),
    )


@dataclass(frozen=True, eq=False)
class _Swept:
    weighted: Front
    constrained: Front
    again: int


def _sweep(trade_off: TradeOff, grid: Grid, ratio: float, wait: float | None) -> _Swept:
    """Return the front with the instant so long after T0 [s], or free, from the run's own ratio outward."""
    ratios = grid.ratios if grid.weighted or wait is None else grid.ratios[[0, -1]]
    sums = [weighted_sum(float(ratio)) for ratio in ratios]
    points = _outward(trade_off, sums, int(np.argmin(np.abs(np.log(ratios / ratio)))), wait)
    points, again = improved(trade_off, sums, points, wait)
    if wait is None or not grid.bounds:
        return _Swept(_front(sums, points), _front([], []), again)
    second = [point.J[1] for point in points]
    limits = [constrained(float(bound)) for bound in np.linspace(second[0], second[-1], grid.bounds)]
    every = points + _downward(trade_off, limits, points, wait)
    every, more = improved(trade_off, sums + limits, every, wait)
    weighted, found = every[: len(sums)], every[len(sums) :]
    return _Swept(_front(sums, weighted), _front(limits, found), again + more)


def _outward(trade_off: TradeOff, sums: Sequence[Scalarization], first: int, wait: float | None) -> list[Point]:
    """Solve weighted sums in order of their ratio, from `first` to both ends, each from its neighbour."""
    found: dict[int, Point] = {}
    near: Point | Plan = trade_off.one.plan
    for i in (*range(first, len(sums)), *range(first - 1, -1, -1)):
        near = found[first] if i == first - 1 else near
        found[i] = near = trade_off.solve(sums[i], near, wait)
    return [found[i] for i in range(len(sums))]


def _downward(trade_off: TradeOff, limits: Sequence[Scalarization], known: Sequence[Point], wait: float) -> list[Point]:
    """Solve epsilon-constraint problems, each from its neighbour, the first from the known point of largest J_2."""
    found: list[Point] = []
    near = max(known, key=lambda point: float(np.nan_to_num(point.J[1], nan=-np.inf)))
    for limit in limits:
        found.append(trade_off.solve(limit, near, wait))
        near = found[-1] if found[-1].outcome.usable else near
    return found


def improved(
    trade_off: TradeOff, problems: Sequence[Scalarization], points: Sequence[Point], wait: float | None
) -> tuple[list[Point], int]:
    """Return the points, those solved again that another one served better or that had none; and how many those are.

    So no point is left in a local optimum that any other knows to leave.
    """
    points, again = list(points), 0
    for _ in range(ROUNDS):
        better = 0
        for i, problem in enumerate(problems):
            values = np.array([trade_off.value(problem, point) for point in points])
            best = int(np.argmin(values))
            if not values[best] < values[i] - BETTER * abs(values[best]):
                continue
            solved = trade_off.solve(problem, points[best], wait)
            if trade_off.value(problem, solved) < values[i]:
                points[i], better = solved, better + 1
        again += better
        if not better:
            break
    return points, again


def _front(problems: Sequence[Scalarization], points: Sequence[Point]) -> Front:
    outcomes = list(Outcome)
    return Front(
        J=np.array([point.J for point in points]).reshape(-1, 2),
        wait=np.array([point.wait for point in points]),
        objective=np.array([point.objective for point in points]),
        ratio=np.array([point.ratio for point in points]),
        bound=np.array([problem.bound for problem in problems]),
        outcome=np.array([outcomes.index(point.outcome) for point in points], "i1"),
    )
