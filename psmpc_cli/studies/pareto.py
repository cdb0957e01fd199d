"""Pareto fronts of two stages' costs at several samples of a run. Paper section IV-B, Fig. 7.

At each sample the window with both stages is solved for one trade-off between their costs after another: weighted sums
and epsilon constraints, each from the best point known.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from psmpc_cli.errors import InputError, LogError, RunError
from psmpc_cli.logs.run import Run, read_run
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.ocp.window import SHORTEST
from psmpc_cli.simulation.run import header
from psmpc_cli.simulation.setup import build_experiment, converging
from psmpc_cli.solvers import NlpSolver, Outcome, Solution
from psmpc_cli.specs.load import Task
from psmpc_cli.studies.fronts import CONSTRAINED, FREE, WEIGHTED, Front, FrontGrid, SampleFronts, write_pareto
from psmpc_cli.studies.one_window import OneWindow, window_at
from psmpc_cli.studies.runner import compute
from psmpc_cli.studies.weights import parse_stages

Vector = np.ndarray

METHODS = ("weighted-sum", "epsilon-constraint", "both")

LOWEST, HIGHEST = 1e-3, 1e3
"""The ratios omega_2 / omega_1 lie between these."""

SAMPLES = 5
"""Samples that are looked at where none are named."""

LATER = np.linspace(0.0, 0.8, 5)
"""How much later the instant is held, as parts of what is left of the horizon, where it is a criterion of its own."""

FEWEST = 3
"""Points of a front."""

HDF5 = b"\x89HDF\r\n\x1a\n"
"""How an HDF5 file begins."""

SLACK = 1e-7
"""By how much a point may exceed a bound on J_2 and still stand for it, as a part of the bound."""

BETTER = 1e-6
"""By how much another point has to serve a scalarization better before it is solved again from there."""

ROUNDS = 5
"""How often at most the points of a front are compared and solved again."""


@dataclass(frozen=True)
class Question:
    """What a Pareto study is asked.

    Attributes:
        stages: The two stages as the user named them, such as 1,2.
        at: Sampling instants [s]; none for `SAMPLES` ones, evenly from the switch's detection to the switch.
        points: Points of a front, by each method.
        method: One of `METHODS`.
        free: Whether the switching instant is a criterion of its own.
    """

    stages: str
    at: tuple[float, ...]
    points: int
    method: str
    free: bool


def parse_times(text: str | None) -> tuple[float, ...]:
    """Return the times of a list such as 6.1,8.0 [s], rising, each once; none without one.

    Raises:
        InputError: They are not finite numbers.
    """
    if text is None:
        return ()
    try:
        times = tuple(sorted({float(part) for part in text.split(",")}))
    except ValueError:
        times = (np.nan,)
    if not np.isfinite(times).all():
        raise InputError(f"--at: found '{text}', expected times in seconds between commas, such as 6.1,8.0")
    return times


def is_log(reference: str) -> bool:
    """Return whether what a user named is a file of ours rather than a task."""
    path = Path(reference)
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(len(HDF5)) == HDF5


def ensure_answerable(question: Question) -> None:
    """Refuse a question that no run can answer.

    Raises:
        InputError: The method is unknown, or there are too few points.
    """
    if question.method not in METHODS:
        raise InputError(f"--method: found '{question.method}', expected one of {', '.join(METHODS)}")
    if question.points < FEWEST:
        raise InputError(f"--points: found {question.points}, expected at least {FEWEST}")


def solve_pareto(
    run: Path,
    question: Question,
    path: Path,
    jobs: int | None = None,
    force: bool = False,
    done: Callable[[float, int, int], None] = lambda instant, ended, count: None,
) -> None:
    """Find the fronts at samples of a run and write them into a file, whole or not at all.

    Args:
        run: Run of the run, with its plans.
        question: What is asked.
        path: The file.
        jobs: Processes; by default one for each core.
        force: Overwrite the file.
        done: Told the instant of each sample as it is done [s], how many are, and how many there are.

    Raises:
        InputError: The question does not fit the run, or the file exists already or cannot be written.
        LogError: The log has no plans, or cannot be read.
        RunError: Processes are ended from outside again and again.
    """
    ensure_answerable(question)
    log = read_run(run)
    if not log.has_plans:
        raise LogError(f"{run}: holds no plans; expected a log of a task with log: {{plans: true}}")
    loaded = log.task
    stages = _stages(question, loaded)
    names = [log.stage_names[stage] for stage in stages]
    grid = _grid(question)
    tasks = [SampleTask(run.absolute(), sample, grid) for sample in choose_samples(log, stages, question.at)]
    found: dict[int, SampleFronts] = {}
    for index, fronts in compute(solve_sample, tasks, jobs):
        if fronts is None:
            raise RunError("a process was killed each time, perhaps for lack of memory: try fewer --jobs")
        found[index] = fronts
        done(fronts.start, len(found), len(tasks))
    attributes = {**header(build_experiment(loaded)).attributes, "method": question.method}
    attributes["stages"] = ",".join(str(stage + 1) for stage in stages)
    write_pareto(path, attributes, names, grid, [found[i] for i in range(len(tasks))], force)


def _stages(question: Question, loaded: Task) -> tuple[int, int]:
    """Return the two stages; refuse a free instant where it is given."""
    stages = parse_stages(question.stages, loaded)
    first = loaded.spec.stages[stages[0]]
    if question.free and first.at is not None:
        raise InputError(f"--free-instant: {first.name} ends at a fixed time, expected a stage with an end condition")
    return stages


def _grid(question: Question) -> FrontGrid:
    return FrontGrid(
        ratios=np.geomspace(LOWEST, HIGHEST, question.points),
        weighted=question.method != "epsilon-constraint",
        bounds=0 if question.method == "weighted-sum" else question.points,
        parts=LATER if question.free else LATER[:1],
        free=question.free,
    )


def possible_samples(log: Run, stages: tuple[int, int]) -> np.ndarray:
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
    times, half = log.time[possible], float(np.asarray(log.attributes["sample_time"])) / 2
    nearest = [int(np.argmin(np.abs(times - time))) for time in at]
    for time, place in zip(at, nearest, strict=True):
        if abs(times[place] - time) > half + 1e-9:
            raise InputError(
                f"--at: found {time:g}, where no window holds {first} and {second} alone; expected times from "
                f"{times[0]:g} to {times[-1]:g} s"
            )
    return [int(possible[place]) for place in dict.fromkeys(nearest)]


@dataclass(frozen=True)
class Scalarization:
    """What makes one problem of two costs: min w_1 J_1 + w_2 J_2 subject to J_2 <= bound.

    Attributes:
        weights: w_1 and w_2, the larger one 1.
        bound: The largest J_2; infinite for a weighted sum.
    """

    weights: tuple[float, float]
    bound: float = np.inf


def weighted_sum(ratio: float) -> Scalarization:
    """Return the weighted sum with this omega_2 / omega_1."""
    return Scalarization((min(1.0, 1.0 / ratio), min(1.0, ratio)))


def constrained(bound: float) -> Scalarization:
    """Return the epsilon-constraint problem: J_1 alone, with J_2 bounded."""
    return Scalarization((1.0, 0.0), bound)


@dataclass(frozen=True, eq=False)
class FrontPoint:
    """The optimum of a scalarization.

    Attributes:
        J: J_1 and J_2, normalized as in the window (2,); NaN if there is none.
        wait: t_s - T0 [s].
        objective: What was minimized, the pending cost included.
        ratio: omega_2 / omega_1 of the weighted sum with the same optimum, -dJ_1/dJ_2 of the front there.
        outcome: How the solve ended.
        plan: The plan.
        solution: The solve, where J_2 was bounded: its multipliers can start the next one.
    """

    J: Vector
    wait: float
    objective: float
    ratio: float
    outcome: Outcome
    plan: Plan
    solution: Solution | None = None


class TradeOff:
    """Solves scalarizations of one window.

    J_s is what stage s adds to the objective at priority 1: its normalized cost integral, and of the last stage the
    terminal cost where the task has one. Paper eqs. (12), (29).
    """

    def __init__(self, one: OneWindow) -> None:
        self.one = one
        problem = one.experiment.problem
        self._solver = NlpSolver(problem, problem.spec.solver)

    @cached_property
    def _bounded(self) -> NlpSolver:
        """IPOPT, whatever the task says: a row that reaches over all nodes breaks the structure others live on."""
        problem = self.one.experiment.problem
        return NlpSolver(problem, problem.spec.solver.model_copy(update={"kind": "ipopt"}))

    def solve(self, scalarization: Scalarization, near: FrontPoint | Plan, wait: float | None) -> FrontPoint:
        """Return the optimum, started from a plan or another point, with the instant so long after T0 [s], or free."""
        window = replace(self.one.window, omega=np.array(scalarization.weights), cost_bound=scalarization.bound)
        plan, before = (near.plan, near.solution) if isinstance(near, FrontPoint) else (near, None)
        guess, within = plan, np.inf
        if wait is not None:
            guess, within = replace(plan, instants=np.array([window.start + wait])), 0.0
        if np.isinf(scalarization.bound):
            solution = self._solver.solve(window, guess, within=within)
            return self._point(solution, scalarization.weights[1] / scalarization.weights[0], plan)
        solution = self._bounded.solve(window, guess, before, within)
        point = self._point(solution, solution.bound_multiplier, plan)
        return replace(point, solution=solution) if solution.outcome.usable else point

    def _point(self, solution: Solution, ratio: float, guess: Plan) -> FrontPoint:
        """Return what a solve has come to; without a solution nothing but its outcome, and the guess."""
        window, plan, outcome = self.one.window, solution.plan, solution.outcome
        if not outcome.usable:
            return FrontPoint(np.full(2, np.nan), np.nan, np.nan, np.nan, outcome, guess)
        J = solution.costs + np.array([0.0, solution.terminal])
        return FrontPoint(J, float(plan.instants[0]) - window.start, solution.objective, ratio, outcome, plan)

    def costs_of(self, plan: Plan) -> Vector:
        """Return J_1 and J_2 (2,) of a plan."""
        return self._solver.costs(self.one.window, plan)

    def value(self, scalarization: Scalarization, point: FrontPoint) -> float:
        """Return what a scalarization makes of a point, whatever that was found for; infinite where it is not allowed.

        All points of a window share one feasible set, so each is a candidate for every scalarization.
        """
        allowed = point.J[1] <= scalarization.bound * (1 + SLACK)
        value = float(np.dot(scalarization.weights, point.J)) + self.one.window.pending_cost * point.wait
        return value if allowed and np.isfinite(value) else np.inf


@dataclass(frozen=True, eq=False)
class SampleTask:
    """One sample of a log, and the problems to solve there."""

    log: Path
    sample: int
    grid: FrontGrid


def solve_sample(task: SampleTask) -> SampleFronts:
    """Return the fronts at one sample."""
    log, grid = read_run(task.log), task.grid
    trade_off = TradeOff(window_at(log, build_experiment(converging(log.task)), task.sample))
    window, plan = trade_off.one.window, trade_off.one.plan
    wait = float(plan.instants[0]) - window.start
    ratio = float(window.omega[1] / window.omega[0])
    held = wait + grid.parts * max(window.horizon - SHORTEST - wait, 0.0)
    swept = [_sweep(trade_off, grid, ratio, float(at)) for at in held]
    free = [_sweep(trade_off, grid, ratio, None)] if grid.free else []
    wanted = {WEIGHTED: grid.weighted, CONSTRAINED: bool(grid.bounds)}
    fronts = {method: tuple(found[method] for found, _ in swept) for method in wanted if wanted[method]}
    return SampleFronts(
        start=window.start,
        wait=wait,
        J=trade_off.costs_of(plan),
        ratio=ratio,
        scale=window.scale,
        fronts=fronts | ({FREE: (free[0][0][WEIGHTED],)} if free else {}),
        again=sum(again for _, again in [*swept, *free]),
    )


def _sweep(trade_off: TradeOff, grid: FrontGrid, ratio: float, wait: float | None) -> tuple[dict[str, Front], int]:
    """Find the fronts with the instant so long after T0 [s], or free, and how many points were solved again."""
    ratios = grid.ratios if grid.weighted or wait is None else grid.ratios[[0, -1]]
    sums = [weighted_sum(float(ratio)) for ratio in ratios]
    points = _outward(trade_off, sums, int(np.argmin(np.abs(np.log(ratios / ratio)))), wait)
    points, again = improved(trade_off, sums, points, wait)
    if wait is None or not grid.bounds:
        return {WEIGHTED: _front(sums, points)}, again
    second = [point.J[1] for point in points]
    limits = [constrained(float(bound)) for bound in np.linspace(second[0], second[-1], grid.bounds)]
    every = points + _downward(trade_off, limits, points, wait)
    every, more = improved(trade_off, sums + limits, every, wait)
    weighted, found = every[: len(sums)], every[len(sums) :]
    return {WEIGHTED: _front(sums, weighted), CONSTRAINED: _front(limits, found)}, again + more


def _outward(trade_off: TradeOff, sums: Sequence[Scalarization], first: int, wait: float | None) -> list[FrontPoint]:
    """Solve weighted sums in order of their ratio, from `first` to both ends, each from its neighbour."""
    found: dict[int, FrontPoint] = {}
    near: FrontPoint | Plan = trade_off.one.plan
    for i in (*range(first, len(sums)), *range(first - 1, -1, -1)):
        near = found[first] if i == first - 1 else near
        found[i] = near = trade_off.solve(sums[i], near, wait)
    return [found[i] for i in range(len(sums))]


def _downward(
    trade_off: TradeOff, limits: Sequence[Scalarization], known: Sequence[FrontPoint], wait: float
) -> list[FrontPoint]:
    """Solve epsilon-constraint problems, each from its neighbour, the first from the known point of largest J_2."""
    found: list[FrontPoint] = []
    near = max(known, key=lambda point: float(np.nan_to_num(point.J[1], nan=-np.inf)))
    for limit in limits:
        found.append(trade_off.solve(limit, near, wait))
        near = found[-1] if found[-1].outcome.usable else near
    return found


def improved(
    trade_off: TradeOff, problems: Sequence[Scalarization], points: Sequence[FrontPoint], wait: float | None
) -> tuple[list[FrontPoint], int]:
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


def _front(problems: Sequence[Scalarization], points: Sequence[FrontPoint]) -> Front:
    outcomes = list(Outcome)
    return Front(
        J=np.array([point.J for point in points]).reshape(-1, 2),
        wait=np.array([point.wait for point in points]),
        objective=np.array([point.objective for point in points]),
        ratio=np.array([point.ratio for point in points]),
        bound=np.array([problem.bound for problem in problems]),
        outcome=np.array([outcomes.index(point.outcome) for point in points], "i1"),
    )
