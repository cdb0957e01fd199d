"""Pareto fronts of two stages' costs at several samples of a run: docs/pareto_model.md. Paper section IV-B, Fig. 7.

At each sample the window with both stages is solved for one trade-off between their costs after another: weighted sums
and epsilon constraints, each from the best point known.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from psmpc_cli.errors import InputError, LogError
from psmpc_cli.logs.files import check_output
from psmpc_cli.logs.results import Quantity, Results, new_results
from psmpc_cli.logs.run import Run
from psmpc_cli.logs.schema import PARETO
from psmpc_cli.ocp.end import SHORTEST
from psmpc_cli.ocp.problem import Problem, build_problem
from psmpc_cli.ocp.window import Window
from psmpc_cli.progress import Watch
from psmpc_cli.simulation.recorder import header
from psmpc_cli.simulation.replay import logged_solve
from psmpc_cli.simulation.run import build_experiment, converging
from psmpc_cli.solvers import NlpSolver, Solution, build_nlp_solver
from psmpc_cli.specs.load import Task
from psmpc_cli.studies.fronts import CONSTRAINED, FREE, STATUS, WEIGHTED, dominated, extents, hypervolume
from psmpc_cli.studies.runner import compute_all
from psmpc_cli.studies.sweep import parse_stages

Vector = np.ndarray

LOWEST = 1e-3
HIGHEST = 1e3
"""The ratios omega_2 / omega_1 lie between these."""

SAMPLES = 5
"""Samples that are looked at where none are named."""

DELAYS = np.linspace(0.0, 0.8, 5)
"""How much later the instant is held, as parts of what is left of the horizon, where it is a criterion of its own."""

BOUND_TOLERANCE = 1e-7
"""By how much a point may exceed a bound on J_2 and still stand for it, as a part of the bound."""

LEAST_GAIN = 1e-6
"""By how much another point has to serve a problem better before it is solved again from there."""


@dataclass(frozen=True)
class ParetoSettings:
    """What a Pareto study computes.

    Attributes:
        stages: The two stages as the user named them, such as 1,2.
        at: Sampling instants [s]; none for `SAMPLES` ones, evenly from the switch's detection to the switch.
        points: Points of a front, by each method; at least 3.
        method: How the points are found: weighted-sum, epsilon-constraint or both.
        free: Whether the switching instant is a criterion of its own.
    """

    stages: str
    at: tuple[float, ...]
    points: int
    method: str
    free: bool

    @property
    def ratios(self) -> Vector:
        """omega_2 / omega_1 of the weighted sums, rising (N,)."""
        return np.geomspace(LOWEST, HIGHEST, self.points)

    @property
    def delays(self) -> Vector:
        """How much later the instant is held than the run's optimum, as parts of what is left of the horizon (H,)."""
        return DELAYS if self.free else DELAYS[:1]


def solve_pareto(
    run: Run,
    settings: ParetoSettings,
    path: Path,
    jobs: int | None = None,
    force: bool = False,
    watch: Watch = lambda progress: None,
) -> Results:
    """Find the fronts at samples of a run and write them into a file, whole or not at all.

    Args:
        run: A run with its plans.
        settings: What is computed.
        path: The file.
        jobs: Processes; by default one for each core.
        force: Overwrite the file.
        watch: Called with the progress, as by `compute_all`.

    Raises:
        InputError: The settings do not fit the run, or the file exists already or cannot be written.
        LogError: The run has no plans.
        RunError: Processes are ended from outside again and again.
    """
    if not run.has_plans:
        raise LogError(f"{run.path}: holds no plans; expected a log of a task with log: {{plans: true}}")
    check_output(path, force, inputs=[run.path])
    stages = parse_stages(settings.stages, run.task)
    first = run.task.spec.stages[stages[0]]
    if settings.free and first.at is not None:
        raise InputError(f"--free-instant: {first.name} ends at a fixed time, expected a stage with an end condition")
    samples = choose_samples(run, stages, settings.at)
    solves = [logged_solve(run, sample) for sample in samples]
    cells = {f"front at {each.window.start:g} s": (run.task, settings, each) for each in solves}
    fronts = compute_all(_solve_sample, cells, jobs, watch, "fronts")
    attributes = {**header(build_experiment(run.task)).attributes, "method": settings.method}
    attributes["stages"] = ",".join(str(stage + 1) for stage in stages)
    names = [run.stage_names[stage] for stage in stages]
    results = join_samples(path, attributes, names, settings, list(fronts.values()))
    results.create(force)
    return results


def possible_samples(log: Run, stages: tuple[int, int]) -> Vector:
    """Return the samples whose window holds exactly the two stages and was solved (K,)."""
    alone = (log["window/first"] == stages[0]) & (log["window/count"] == 2)
    return np.flatnonzero(alone & (log["events/solve_failed"] == 0))


def choose_samples(log: Run, stages: tuple[int, int], at: Sequence[float]) -> list[int]:
    """Return the samples at these times [s]; without any, some evenly from the first to the last possible one.

    Raises:
        InputError: There is none, or none at a time.
    """
    possible = possible_samples(log, stages)
    first, second = (log.stage_names[stage] for stage in stages)
    if not len(possible):
        raise InputError(f"{log.path}: found no sample whose window holds {first} and {second} alone, expected some")
    if not at:
        places = np.linspace(0, len(possible) - 1, min(SAMPLES, len(possible)))
        return [int(sample) for sample in possible[np.round(places).astype(int)]]
    times = log.time[possible]
    half = float(np.asarray(log.attributes["sample_time"])) / 2
    nearest = [int(np.argmin(np.abs(times - time))) for time in at]
    for time, place in zip(at, nearest, strict=True):
        if abs(times[place] - time) > half + 1e-9:
            raise InputError(
                f"--at: found {time:g}, where no window holds {first} and {second} alone; expected times from "
                f"{times[0]:g} to {times[-1]:g} s"
            )
    return [int(possible[place]) for place in dict.fromkeys(nearest)]


class TradeOff:
    """Solves a window for the optima of problems that weigh its two costs differently.

    A problem is the window with other priorities, the larger one 1, and perhaps a bound on J_2; a point is its
    solution. J_s is what stage s adds to the objective at priority 1: its normalized cost integral, and of the last
    stage the terminal cost where the task has one. Paper eqs. (12), (29).

    Attributes:
        solver: The task's, which also computes the costs of a plan.
    """

    def __init__(self, problem: Problem) -> None:
        spec = problem.spec.solver
        self.solver = build_nlp_solver(problem, spec)
        # IPOPT, whatever the task says: a row that reaches over all nodes breaks the structure others live on
        self._bounded = NlpSolver(problem, spec.model_copy(update={"kind": "ipopt"}))

    def solve(self, problem: Window, near: Solution, wait: float | None) -> Solution:
        """Return the optimum, started from another point, with the instant so long after T0 [s], or free.

        Where there is none, costs and objective are NaN and the plan is the other point's.
        """
        guess = near.plan
        within = np.inf
        if wait is not None:
            guess = replace(guess, switch_times=np.array([problem.start + wait]))
            within = 0.0
        solver = self.solver if np.isinf(problem.cost_bound) else self._bounded
        point = solver.solve(problem, guess, within=within)
        if point.outcome.usable:
            return point
        unknown = np.full(2, np.nan)
        return replace(point, plan=near.plan, costs=unknown, objective=np.nan, bound_multiplier=np.nan)


def weighted_sum(window: Window, ratio: float) -> Window:
    """Return the weighted sum with this omega_2 / omega_1: min J_1 + ratio J_2, over the larger weight."""
    return replace(window, omega=np.array([min(1.0, 1.0 / ratio), min(1.0, ratio)]))


def constrained(window: Window, bound: float) -> Window:
    """Return the epsilon-constraint problem: min J_1 subject to J_2 <= bound."""
    return replace(window, omega=np.array([1.0, 0.0]), cost_bound=bound)


def point_costs(points: Sequence[Solution]) -> Vector:
    """Return J_1 and J_2 of points (P, 2), normalized as in the window."""
    return np.array([point.costs + np.array([0.0, point.terminal]) for point in points]).reshape(-1, 2)


def _waits(points: Sequence[Solution]) -> Vector:
    """Return t_s - T0 of points (P,) [s]."""
    waits = [point.plan.switch_times[0] - point.window.start for point in points]
    return np.where(np.isnan(point_costs(points)[:, 0]), np.nan, waits)


def values_of(problem: Window, points: Sequence[Solution]) -> Vector:
    """Return what a problem makes of points (P,), whatever they were found for; infinite where it is not allowed.

    All points of a window share one feasible set, so each is a candidate for every problem.
    """
    J = point_costs(points)
    values = J @ problem.omega + problem.pending_cost * _waits(points)
    return np.where(J[:, 1] <= problem.cost_bound * (1 + BOUND_TOLERANCE), np.nan_to_num(values, nan=np.inf), np.inf)


def _solve_sample(cell: tuple[Task, ParetoSettings, Solution]) -> list[Quantity]:
    """Find the fronts about a solve of a run."""
    task, settings, logged = cell
    problem = build_problem(converging(task))
    trade_off = TradeOff(problem)
    solve = logged
    if problem.model.space.has_quaternion:  # one iteration may leave an instant 1e-3 s before limits of omega allow it
        solve = trade_off.solve(logged.window.about(logged.guess), logged, None)
    window = solve.window
    instant = float(solve.plan.switch_times[0])
    wait = instant - window.start
    held = wait + settings.delays * max(window.horizon - SHORTEST - wait, 0.0)
    swept = [_sweep(trade_off, solve, settings, float(at)) for at in held]
    points = swept[0][0]
    if settings.free:
        swept.append(_sweep(trade_off, solve, settings, None))
        *held_points, free = (found for found, _ in swept)
        points = [*_stacked("later", held_points), *free]
    J_1, J_2 = trade_off.solver.costs(window, solve.plan)
    ratio = window.omega[1] / window.omega[0]
    again = sum(more for _, more in swept)
    return [
        Quantity("instant", (), np.array(window.start), "s", "sampling instant T0"),
        Quantity("t_s", (), np.array(instant), "s", "switching instant, as the run optimized it"),
        Quantity("chosen_ratio", (), np.array(ratio), "1", "omega_2 / omega_1 of the run"),
        Quantity("chosen_J_1", (), np.array(J_1), "s", "J_1 of the run's optimum"),
        Quantity("chosen_J_2", (), np.array(J_2), "s", "J_2 of the run's optimum"),
        Quantity("again", (), np.array(again), "1", "points solved again because another one served them better"),
        Quantity("scale", ("stage",), window.scale, "1", "normalization of each stage's cost, for all points"),
        *points,
    ]


def _stacked(dim: str, cells: Sequence[Sequence[Quantity]]) -> list[Quantity]:
    """Return arrays along a further dimension, made of those that every cell has in the same order."""
    return [
        replace(alike[0], dims=(dim, *alike[0].dims), values=np.array([each.values for each in alike]))
        for alike in zip(*cells, strict=True)
    ]


def _sweep(
    trade_off: TradeOff, solve: Solution, settings: ParetoSettings, wait: float | None
) -> tuple[list[Quantity], int]:
    """Find the fronts with the instant so long after T0 [s], or free, and how many points were solved again.

    Weighted sums are solved from the run's own ratio to both ends, epsilon constraints between what the first and the
    last ratio lead to from the point of largest J_2 downwards, each from its neighbour.
    """
    window = solve.window
    whole = wait is None or settings.method != "epsilon-constraint"
    ratios = settings.ratios if whole else settings.ratios[[0, -1]]
    sums = [weighted_sum(window, ratio) for ratio in ratios]
    first = int(np.argmin(np.abs(np.log(ratios / (window.omega[1] / window.omega[0])))))
    found: dict[int, Solution] = {}
    for i in (*range(first, len(sums)), *range(first - 1, -1, -1)):
        found[i] = trade_off.solve(sums[i], found.get(i - 1 if i > first else i + 1, solve), wait)
    points, again = improved(trade_off, sums, [found[i] for i in range(len(sums))], wait)
    if wait is None or settings.method == "weighted-sum":
        return _arrays(FREE if wait is None else WEIGHTED, points), again
    second = point_costs(points)[:, 1]
    limits = [constrained(window, bound) for bound in np.linspace(second[0], second[-1], settings.points)]
    near = points[int(np.argmax(np.nan_to_num(second, nan=-np.inf)))]
    bounded = []
    for limit in limits:
        bounded.append(trade_off.solve(limit, near, wait))
        near = bounded[-1] if bounded[-1].outcome.usable else near
    every, more = improved(trade_off, sums + limits, points + bounded, wait)
    weighted = _arrays(WEIGHTED, every[: len(sums)]) if whole else []
    return [*weighted, *_arrays(CONSTRAINED, every[len(sums) :])], again + more


def improved(
    trade_off: TradeOff, problems: Sequence[Window], points: Sequence[Solution], wait: float | None
) -> tuple[list[Solution], int]:
    """Return the points, those solved again that another one served better or that had none; and how many those are.

    So no point is left in a local optimum that any other knows to leave.
    """
    points = list(points)
    again = 0
    for _ in range(5):  # at most this often
        better = 0
        for i, problem in enumerate(problems):
            values = values_of(problem, points)
            best = int(np.argmin(values))
            if not values[best] + LEAST_GAIN * abs(values[best]) < values[i]:
                continue
            solved = trade_off.solve(problem, points[best], wait)
            if values_of(problem, [solved])[0] < values[i]:
                points[i] = solved
                better = better + 1
        again += better
        if not better:
            break
    return points, again


def _arrays(method: str, points: Sequence[Solution]) -> list[Quantity]:
    """Return the arrays of a method's points."""
    bounded = method == CONSTRAINED
    J_1, J_2 = point_costs(points).T
    dims = ("bound",) if bounded else ("ratio",)
    status = np.array([STATUS.index(point.outcome.name.lower()) for point in points], "i1")
    minimized = f"{'J_1 with J_2 bounded' if bounded else 'weighted sum'} and pending cost, over the larger weight"
    arrays = [
        Quantity(f"{method}_J_1", dims, J_1, "s", "normalized cost of the first stage"),
        Quantity(f"{method}_J_2", dims, J_2, "s", "normalized cost of the second stage"),
        Quantity(f"{method}_wait", dims, _waits(points), "s", "t_s - T0"),
        Quantity(f"{method}_objective", dims, np.array([each.objective for each in points]), "1", minimized),
        Quantity(f"{method}_status", dims, status, "1", "outcome of the solve", STATUS),
    ]
    if bounded:
        limit, ratio = np.array([(each.window.cost_bound, each.bound_multiplier) for each in points]).T
        arrays.append(Quantity(f"{method}_limit", dims, limit, "s", "bound on J_2"))
        arrays.append(
            Quantity(f"{method}_ratio", dims, ratio, "1", "omega_2 / omega_1 with the same optimum, -dJ_1/dJ_2")
        )
    return arrays


def join_samples(
    path: Path,
    attributes: Mapping[str, str | int | float],
    stages: Sequence[str],
    settings: ParetoSettings,
    cells: Sequence[Sequence[Quantity]],
) -> Results:
    """Put the fronts found at several samples together, with what they dominate."""
    found = {quantity.name: quantity for quantity in _stacked("instant", cells)}
    names = ["J_1", "J_2", "wait"] if settings.free else ["J_1", "J_2"]
    fronts = {
        method: np.stack([found[f"{method}_{name}"].values for name in names], axis=-1)
        for method in (WEIGHTED, CONSTRAINED, FREE)
        if f"{method}_J_1" in found
    }
    every = np.concatenate([values.reshape(len(cells), -1, len(names)) for values in fronts.values()], axis=1)
    worst = np.nanmax(every, axis=(0, 1), initial=0.0)
    span = extents(every.reshape(-1, len(names)))
    reference = worst + 0.1 * span
    volumes = [hypervolume(points, reference) for points in every]
    units = "s^3" if settings.free else "s^2"
    ends = np.cumsum([values[0, ..., 0].size for values in fronts.values()])[:-1]
    marks = np.split(np.array([dominated(points) for points in every], "i1"), ends, axis=1)
    for method, values in zip(fronts, marks, strict=True):
        J = found[f"{method}_J_1"]
        shaped = values.reshape(J.values.shape)
        found[f"{method}_dominated"] = Quantity(f"{method}_dominated", J.dims, shaped, "1", "another point is better")
    criteria = ["J_1", "J_2", "t_s - T0"][: len(names)]
    bounds = np.linspace(0.0, 1.0, settings.points)
    bound = "bound on J_2, from the smallest ratio's (0) to the largest one's (1)"
    later = "how much later the instant is held than the run's optimum, as a part of what is left of the horizon"
    along = {"criterion", *(dim for quantity in found.values() for dim in quantity.dims)}
    known = [
        Quantity("stage", ("stage",), np.array(stages), "1", "the two stages"),
        Quantity("criterion", ("criterion",), np.array(criteria), "1", "what is to be small"),
        Quantity("ratio", ("ratio",), settings.ratios, "1", "omega_2 / omega_1"),
        Quantity("bound", ("bound",), bounds, "1", bound),
        Quantity("later", ("later",), settings.delays, "1", later),
        Quantity("reference", ("criterion",), reference, "s", "reference point of the hypervolume"),
        Quantity("hypervolume", ("instant",), np.array(volumes), units, "measure of what is dominated"),
    ]
    quantities = [*found.values(), *(each for each in known if along.issuperset(each.dims))]
    return new_results(path, PARETO, {**attributes, "free_instant": int(settings.free)}, quantities)
