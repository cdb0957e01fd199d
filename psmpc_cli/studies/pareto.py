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
"""By which part of its objective another point has to be better for a problem before it is solved again from there."""

MOST_ROUNDS = 5
"""Most rounds in which points of a front are solved again from others."""


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
    """Compute Pareto fronts of the costs of two stages at several samples of a run, and write them into a file.

    The fronts show what other trade-offs between the stages than the run's own there would have been.

    Args:
        run: A run whose log has its plans.
        settings: The stages, the samples, and how the fronts are computed.
        path: The file, written whole or not at all.
        jobs: Number of processes, each of which computes the fronts of a sample; by default one for each core.
        force: Whether an existing file is overwritten.
        watch: Called with the progress, as by `compute_all`.

    Returns:
        The results, which are also in the file.

    Raises:
        InputError: The settings do not fit the run, or the file exists already or cannot be written.
        LogError: The run has no plans.
        RunError: A process was killed again and again.
    """
    if not run.has_plans:
        raise LogError(f"{run.path}: holds no plans; expected a log of a task with log: {{plans: true}}")
    check_output(path, force, inputs=[run.path])
    stages = parse_stages(settings.stages, run.task)
    first_stage = run.task.spec.stages[stages[0]]
    if settings.free and first_stage.at is not None:
        raise InputError(
            f"--free-instant: {first_stage.name} ends at a fixed time, expected a stage with an end condition"
        )
    samples = choose_samples(run, stages, settings.at)
    solves = [logged_solve(run, sample) for sample in samples]
    cells = {f"front at {solve.window.start:g} s": (run.task, settings, solve) for solve in solves}
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
    """Choose the samples of a run whose fronts are computed: those at given times, or else `SAMPLES` spread evenly.

    Only samples are possible whose window, the stages that the controller plans over, is exactly the two stages.

    Args:
        log: The run.
        stages: Indices of the two stages.
        at: Times [s]; empty to choose evenly among the possible samples.

    Returns:
        Numbers of the samples in the run, each once.

    Raises:
        InputError: There is no possible sample, or none at a given time.
    """
    possible = possible_samples(log, stages)
    first, second = (log.stage_names[stage] for stage in stages)
    if not len(possible):
        raise InputError(f"{log.path}: found no sample whose window holds {first} and {second} alone, expected some")
    if not at:
        evenly = np.linspace(0, len(possible) - 1, min(SAMPLES, len(possible)))
        return [int(sample) for sample in possible[np.round(evenly).astype(int)]]
    times = log.time[possible]
    half_sample_time = float(np.asarray(log.attributes["sample_time"])) / 2
    nearest = [int(np.argmin(np.abs(times - time))) for time in at]
    for time, place in zip(at, nearest, strict=True):
        if abs(times[place] - time) > half_sample_time + 1e-9:
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

    def solve(self, problem: Window, neighbour: Solution, wait: float | None) -> Solution:
        """Solve a window for one trade-off between its two costs, started from the solution of a similar problem.

        Args:
            problem: The window with weights of both costs, or with a bound on the cost J_2.
            neighbour: The solution of the similar problem.
            wait: How long after the present time T0 the switch time t_s between the stages is held [s]; None to leave
                it free.

        Returns:
            The solution. If none was found, its costs and objective are NaN and its plan is that of the neighbour, so
            that it can be the start of the next problem.
        """
        guess = neighbour.plan
        within = np.inf  # how far the solver may move the switch time [s]
        if wait is not None:
            guess = replace(guess, switch_times=np.array([problem.start + wait]))
            within = 0.0
        solver = self.solver if np.isinf(problem.cost_bound) else self._bounded
        point = solver.solve(problem, guess, within=within)
        if point.outcome.usable:
            return point
        unknown = np.full(2, np.nan)
        return replace(point, plan=neighbour.plan, costs=unknown, objective=np.nan, bound_multiplier=np.nan)


def weighted_sum(window: Window, ratio: float) -> Window:
    """Return the weighted sum with this omega_2 / omega_1: min J_1 + ratio J_2, over the larger weight."""
    return replace(window, omega=np.array([min(1.0, 1.0 / ratio), min(1.0, ratio)]))


def epsilon_constraint(window: Window, bound: float) -> Window:
    """Return the epsilon-constraint problem: min J_1 subject to J_2 <= bound."""
    return replace(window, omega=np.array([1.0, 0.0]), cost_bound=bound)


def point_costs(points: Sequence[Solution]) -> Vector:
    """Return J_1 and J_2 of points (P, 2), normalized as in the window."""
    return np.array([point.costs + np.array([0.0, point.terminal]) for point in points]).reshape(-1, 2)


def _waits_until_switch(points: Sequence[Solution]) -> Vector:
    """Return t_s - T0 of points (P,) [s]."""
    waits = [point.plan.switch_times[0] - point.window.start for point in points]
    return np.where(np.isnan(point_costs(points)[:, 0]), np.nan, waits)


def objective_values(problem: Window, points: Sequence[Solution]) -> Vector:
    """Compute the objective of a problem at points (P,) that were found for it or for other problems of one window.

    The problems of a window share one feasible set but for bounds on J_2, so each point is a candidate for every
    problem. The objective is infinite at points without an optimum and at those beyond the problem's bound.
    """
    J = point_costs(points)
    values = J @ problem.omega + problem.pending_cost * _waits_until_switch(points)
    return np.where(J[:, 1] <= problem.cost_bound * (1 + BOUND_TOLERANCE), np.nan_to_num(values, nan=np.inf), np.inf)


def _solve_sample(cell: tuple[Task, ParetoSettings, Solution]) -> list[Quantity]:
    """Compute the fronts at one sample of a run, in a process of its own.

    There is a front with the switch time t_s held where the run has optimized it. If the switch time is a criterion of
    its own (`settings.free`), there are also fronts with it held later, and one with it free.

    Args:
        cell: The task, the settings, and the run's solve at the sample.

    Returns:
        Named arrays for the results file: of the fronts, and of what the run itself chose at the sample.
    """
    task, settings, logged = cell
    problem = build_problem(converging(task))
    trade_off = TradeOff(problem)
    solve = logged
    if problem.model.space.has_quaternion:
        # the run makes one iteration a sample, which may leave an instant 1e-3 s before limits of omega allow it
        solve = trade_off.solve(logged.window.about(logged.guess), logged, None)
    window = solve.window
    instant = float(solve.plan.switch_times[0])
    wait = instant - window.start  # from the present time T0 until the switch [s]
    # the last stage keeps the shortest length that a stage may have
    waits = wait + settings.delays * max(window.horizon - SHORTEST - wait, 0.0)
    fronts_by_wait = [_front_at_switch_time(trade_off, solve, settings, float(held_wait)) for held_wait in waits]
    points, _ = fronts_by_wait[0]
    if settings.free:
        fronts_by_wait.append(_front_at_switch_time(trade_off, solve, settings, None))
        # the held fronts become one array with their switch times along `later`
        *points_by_wait, free_points = (quantities for quantities, _ in fronts_by_wait)
        points = [*_stacked_along("later", points_by_wait), *free_points]
    J_1, J_2 = trade_off.solver.costs(window, solve.plan)
    ratio = window.omega[1] / window.omega[0]
    solved_again = sum(count for _, count in fronts_by_wait)
    return [
        Quantity("instant", (), np.array(window.start), "s", "sampling instant T0"),
        Quantity("t_s", (), np.array(instant), "s", "switching instant, as the run optimized it"),
        Quantity("chosen_ratio", (), np.array(ratio), "1", "omega_2 / omega_1 of the run"),
        Quantity("chosen_J_1", (), np.array(J_1), "s", "J_1 of the run's optimum"),
        Quantity("chosen_J_2", (), np.array(J_2), "s", "J_2 of the run's optimum"),
        Quantity(
            "again", (), np.array(solved_again), "1", "points solved again because another one served them better"
        ),
        Quantity("scale", ("stage",), window.scale, "1", "normalization of each stage's cost, for all points"),
        *points,
    ]


def _stacked_along(dim: str, cells: Sequence[Sequence[Quantity]]) -> list[Quantity]:
    """Return arrays along a further dimension, made of those that every cell has in the same order."""
    return [
        replace(alike[0], dims=(dim, *alike[0].dims), values=np.array([each.values for each in alike]))
        for alike in zip(*cells, strict=True)
    ]


def _front_at_switch_time(
    trade_off: TradeOff, solve: Solution, settings: ParetoSettings, wait: float | None
) -> tuple[list[Quantity], int]:
    """Compute the front of one sample by weighted sums and epsilon constraints, with one switch time or a free one.

    A point of the front is the optimum of one problem: min J_1 + ratio J_2, a weighted sum, or min J_1 with a bound on
    J_2, an epsilon constraint. Each problem is started from the optimum of its neighbour, which differs little.
    Weighted sums begin at the ratio nearest to the run's own and go outwards from there. The bounds of epsilon
    constraints go from the J_2 of the smallest ratio, the largest bound, to that of the largest ratio.

    Args:
        trade_off: Solves the problems.
        solve: The run's solve at the sample, from which the first problem is started.
        settings: Methods and number of points.
        wait: Held switch time less present time, t_s - T0 [s]; None to leave the switch time free, for which weighted
            sums alone are computed.

    Returns:
        Named arrays of the points, and how many points were solved again because they were only local optima.
    """
    window = solve.window
    # the ends of the bounds need the sums with the smallest and the largest ratio, whatever the method
    keeps_weighted_sums = wait is None or settings.method != "epsilon-constraint"
    ratios = settings.ratios if keeps_weighted_sums else settings.ratios[[0, -1]]
    weighted_sums = [weighted_sum(window, ratio) for ratio in ratios]
    nearest_ratio = int(np.argmin(np.abs(np.log(ratios / (window.omega[1] / window.omega[0])))))
    # upwards from the ratio nearest to the run's own, then downwards; the first one from the run's own solve
    solved: dict[int, Solution] = {}
    for k in (*range(nearest_ratio, len(weighted_sums)), *range(nearest_ratio - 1, -1, -1)):
        neighbour = solved.get(k - 1 if k > nearest_ratio else k + 1, solve)
        solved[k] = trade_off.solve(weighted_sums[k], neighbour, wait)
    points, solved_again = without_local_optima(
        trade_off, weighted_sums, [solved[k] for k in range(len(weighted_sums))], wait
    )
    if wait is None or settings.method == "weighted-sum":
        return _arrays_of_points(FREE if wait is None else WEIGHTED, points), solved_again
    J_2 = point_costs(points)[:, 1]
    bounded_problems = [epsilon_constraint(window, bound) for bound in np.linspace(J_2[0], J_2[-1], settings.points)]
    neighbour = points[int(np.argmax(np.nan_to_num(J_2, nan=-np.inf)))]
    constrained_points = []
    for problem in bounded_problems:
        constrained_points.append(trade_off.solve(problem, neighbour, wait))
        neighbour = constrained_points[-1] if constrained_points[-1].outcome.usable else neighbour
    all_points, solved_again_later = without_local_optima(
        trade_off, weighted_sums + bounded_problems, points + constrained_points, wait
    )
    arrays = _arrays_of_points(WEIGHTED, all_points[: len(weighted_sums)]) if keeps_weighted_sums else []
    arrays += _arrays_of_points(CONSTRAINED, all_points[len(weighted_sums) :])
    return arrays, solved_again + solved_again_later


def without_local_optima(
    trade_off: TradeOff, problems: Sequence[Window], points: Sequence[Solution], wait: float | None
) -> tuple[list[Solution], int]:
    """Solve those points of a front again that are only local optima, as another point of the front shows.

    A point found for one problem of a window is a candidate for all others. So where it has a better objective than the
    point of another problem, or that one was not found, this problem is solved again from there.

    Args:
        trade_off: Solves the problems.
        problems: The problem of each point.
        points: The solutions of the problems so far.
        wait: Held switch time less present time, t_s - T0 [s]; None where it is free.

    Returns:
        The improved points, and how often a point was replaced.
    """
    points = list(points)
    solved_again = 0
    for _ in range(MOST_ROUNDS):  # a point that is replaced may help others in the next round
        improved_points = 0
        for i, problem in enumerate(problems):
            values_of_points = objective_values(problem, points)
            best = int(np.argmin(values_of_points))
            best_value = values_of_points[best]
            is_better = best_value + LEAST_GAIN * abs(best_value) < values_of_points[i]
            if not is_better:
                continue
            candidate = trade_off.solve(problem, points[best], wait)
            if objective_values(problem, [candidate])[0] < values_of_points[i]:
                points[i] = candidate
                improved_points += 1
        solved_again += improved_points
        if not improved_points:
            break
    return points, solved_again


def _arrays_of_points(method: str, points: Sequence[Solution]) -> list[Quantity]:
    """Arrange the points of one method as named arrays for the results file.

    Args:
        method: `WEIGHTED`, `CONSTRAINED` or `FREE`, with which the names begin.
        points: The solutions along the front.

    Returns:
        Costs, t_s - T0, objective and status of the points (P,); of epsilon constraints also the bounds on J_2 and the
        ratios of weights with the same optima. Numbers are NaN where no optimum was found.
    """
    is_constrained = method == CONSTRAINED
    J_1, J_2 = point_costs(points).T
    dims = ("bound",) if is_constrained else ("ratio",)
    status = np.array([STATUS.index(point.outcome.name.lower()) for point in points], "i1")
    objective_name = (
        f"{'J_1 with J_2 bounded' if is_constrained else 'weighted sum'} and pending cost, over the larger weight"
    )
    arrays = [
        Quantity(f"{method}_J_1", dims, J_1, "s", "normalized cost of the first stage"),
        Quantity(f"{method}_J_2", dims, J_2, "s", "normalized cost of the second stage"),
        Quantity(f"{method}_wait", dims, _waits_until_switch(points), "s", "t_s - T0"),
        Quantity(
            f"{method}_objective", dims, np.array([solution.objective for solution in points]), "1", objective_name
        ),
        Quantity(f"{method}_status", dims, status, "1", "outcome of the solve", STATUS),
    ]
    if is_constrained:
        # the multiplier of the bound is the weight of J_2, over that of J_1, with the same optimum
        bound_on_J_2, ratio = np.array(
            [(solution.window.cost_bound, solution.bound_multiplier) for solution in points]
        ).T
        arrays.append(Quantity(f"{method}_limit", dims, bound_on_J_2, "s", "bound on J_2"))
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
    """Join the fronts of several samples into the results of the study, and judge their points.

    The criteria are the costs J_1 and J_2, and the switch time if it is one (`settings.free`). A point is dominated if
    another point of its sample is no worse in all criteria and better in one. The hypervolume of a sample is the area
    or volume that its points dominate up to a reference point. This is the same for all samples: the worst values of
    all points and a tenth of what they span.

    Args:
        path: The results file, for messages; it is not written here.
        attributes: Attributes of the run, which the file will have.
        stages: Names of the two stages.
        settings: What was computed.
        cells: For each sample the arrays of `_solve_sample`.
    """
    by_name = {quantity.name: quantity for quantity in _stacked_along("instant", cells)}
    criteria_names = ["J_1", "J_2", "wait"] if settings.free else ["J_1", "J_2"]
    fronts = {
        method: np.stack([by_name[f"{method}_{name}"].values for name in criteria_names], axis=-1)
        for method in (WEIGHTED, CONSTRAINED, FREE)
        if f"{method}_J_1" in by_name
    }
    all_points = np.concatenate(
        [front.reshape(len(cells), -1, len(criteria_names)) for front in fronts.values()], axis=1
    )
    worst = np.nanmax(all_points, axis=(0, 1), initial=0.0)
    extent = extents(all_points.reshape(-1, len(criteria_names)))
    reference = worst + 0.1 * extent
    volumes = [hypervolume(points, reference) for points in all_points]
    units = "s^3" if settings.free else "s^2"
    # points of all methods compete with each other; what is found is then divided among the methods again
    ends_of_methods = np.cumsum([front[0, ..., 0].size for front in fronts.values()])[:-1]
    flags_by_method = np.split(np.array([dominated(points) for points in all_points], "i1"), ends_of_methods, axis=1)
    for method, flags in zip(fronts, flags_by_method, strict=True):
        J = by_name[f"{method}_J_1"]
        is_dominated = flags.reshape(J.values.shape)
        by_name[f"{method}_dominated"] = Quantity(
            f"{method}_dominated", J.dims, is_dominated, "1", "another point is better"
        )
    criteria = ["J_1", "J_2", "t_s - T0"][: len(criteria_names)]
    bounds = np.linspace(0.0, 1.0, settings.points)
    bound_meaning = "bound on J_2, from the smallest ratio's (0) to the largest one's (1)"
    later_meaning = (
        "how much later the instant is held than the run's optimum, as a part of what is left of the horizon"
    )
    dims_in_use = {"criterion", *(dim for quantity in by_name.values() for dim in quantity.dims)}
    common = [
        Quantity("stage", ("stage",), np.array(stages), "1", "the two stages"),
        Quantity("criterion", ("criterion",), np.array(criteria), "1", "what is to be small"),
        Quantity("ratio", ("ratio",), settings.ratios, "1", "omega_2 / omega_1"),
        Quantity("bound", ("bound",), bounds, "1", bound_meaning),
        Quantity("later", ("later",), settings.delays, "1", later_meaning),
        Quantity("reference", ("criterion",), reference, "s", "reference point of the hypervolume"),
        Quantity("hypervolume", ("instant",), np.array(volumes), units, "measure of what is dominated"),
    ]
    quantities = [*by_name.values(), *(quantity for quantity in common if dims_in_use.issuperset(quantity.dims))]
    return new_results(path, PARETO, {**attributes, "free_instant": int(settings.free)}, quantities)
