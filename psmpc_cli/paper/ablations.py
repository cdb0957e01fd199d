"""What each of our departures from the paper changes: a task as it is, and with each departure taken back.

Runs are compared, and one window of a run is solved again: instant fixed, from other guesses, on other meshes.

Nothing here draws: an `Ablation` carries plain arrays, and `psmpc_cli.paper.figures` draws them.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from psmpc_cli.errors import LogError
from psmpc_cli.logs.run import Run
from psmpc_cli.ocp.end import SHORTEST
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.ocp.problem import Problem, build_problem
from psmpc_cli.ocp.window import Window, normalization
from psmpc_cli.progress import Watch
from psmpc_cli.robot.motion import rollout
from psmpc_cli.simulation.replay import logged_solve
from psmpc_cli.simulation.run import converging
from psmpc_cli.solvers import Solver, build_solver
from psmpc_cli.specs.load import Task
from psmpc_cli.studies.compare import run_tasks
from psmpc_cli.studies.runner import documents_of

Curve = tuple[np.ndarray, np.ndarray]
Curves = Mapping[str, Curve]
Logs = Mapping[str, Run]

OURS = "ours"
EQUAL = "equal priorities"
PRINTED = "printed"
NONE = "none"
RANGE = "range"
ALL_PRINTED = "range and printed"

EVERY_RUN = ("controller.kind=psmpc", "log.plans=false", "log.shares=false")

CHANGES: Mapping[str, tuple[str, ...]] = {
    OURS: ("log.plans=true",),
    EQUAL: ("controller.kind=smpc", "log.plans=true"),
    PRINTED: ("controller.pending_cost=0",),
    NONE: ("controller.normalization=none",),
    RANGE: ("controller.normalization=range",),
    ALL_PRINTED: ("controller.normalization=range", "controller.pending_cost=0"),
}
"""The runs on the task's own mesh by name, with what each takes back."""

DISCRETIZATIONS = ("exact", "euler")

MESHES = (0.1, 0.2, 0.5, 1.0)
"""N_s of the runs with each discretization, as parts of the task's."""

END = "T_f"
"""The curve of the end of the horizon."""

JUMP = 0.3
"""A planned switch time that changes by more between two samples jumps [s]."""

GUESSES = (0.3, 0.5, 0.975)
"""Where in the horizon the solver starts, in the windows with a free switch time."""

PROMINENT = 0.01
"""Smallest depth of a minimum of J(t_s), as a part of the range of J."""

POINTS = 40
"""Switch times at which J(t_s) is computed."""

CLOSE = 0.005
"""How well the earliest feasible instant is found [s]."""


@dataclass(frozen=True, eq=False)
class SwitchWindow:
    """A window of a run with a switch in it, to be solved again.

    Attributes:
        label: Priorities of its stages, the first one's as 1, such as 1 : 100.
        problem: The run's problem, and
        solver: what solves its windows to convergence.
        window: The window.
        plan: Its optimum.
    """

    label: str
    problem: Problem
    solver: Solver
    window: Window
    plan: Plan


@dataclass(frozen=True, eq=False)
class Ablation:
    """One departure from the paper, and what becomes of a task without it.

    Attributes:
        name: Of the departure, and of its figure.
        panels: Curves (x, y) by panel and label; `psmpc_cli.paper.figures` says what they are.
        numbers: What was measured, by quantity and run or window.
    """

    name: str
    panels: Mapping[str, Curves]
    numbers: Mapping[str, float]


def run_ablations(
    task: Task, jobs: int | None = None, watch: Watch = lambda progress: None, points: int = POINTS
) -> list[Ablation]:
    """Run a task of several stages under PSMPC as it is and with each departure taken back, and compare.

    Windows are solved to convergence: a single iteration of the real-time solver does not show where the optimum is.

    Args:
        task: The task.
        jobs: Number of parallel processes; default the number of cores.
        watch: Called with the progress, as by `compute_all`.
        points: Switch times at which J(t_s) is computed.

    Raises:
        LogError: The task has a single stage.
        RunError: A process was killed each time.
    """
    nodes = task.spec.controller.uniform_nodes
    converged = ("solver.kind=fatrop", "solver.deadline=null") if task.spec.solver.traits.real_time else ()
    variants = dict(CHANGES)
    for count in meshes(nodes):
        for kind in DISCRETIZATIONS:
            changes = (f"controller.nodes={count}", f"controller.discretization={kind}")
            variants.setdefault(_on_mesh(kind, count, nodes), changes)
    documents = documents_of(task)
    tasks = {name: documents.changed((*converged, *EVERY_RUN, *changes)) for name, changes in variants.items()}
    logs = run_tasks(tasks, jobs=jobs, watch=watch)
    equal = pick_window(logs[EQUAL])
    ours = pick_window(logs[OURS])
    return [
        _pending_cost(logs, (equal, ours, with_priorities(ours, (1.0, 1.0))), points),
        _normalization(logs),
        _discretization(logs, ours, nodes),
    ]


def meshes(nodes: int) -> list[int]:
    """Return the N_s of the runs with each discretization for a task with this N_s, in ascending order."""
    return sorted({max(2, round(part * nodes)) for part in MESHES})


def _on_mesh(kind: str, count: int, nodes: int) -> str:
    """Return the name of the run with a discretization and N_s; one of them is the task itself."""
    return OURS if (kind, count) == ("exact", nodes) else f"{kind}, {count} nodes"


def _pending_cost(logs: Logs, windows: Sequence[SwitchWindow], points: int) -> Ablation:
    """Compare the objective as printed, delta = 0, with ours: the runs, and J(t_s) in windows of other runs."""
    runs = (PRINTED, OURS)
    panels = _over_time(logs, runs)
    panels |= {f"{what}, {name}": {} for what in ("J", "minima", "found") for name in runs}
    numbers = _measured(logs, runs)
    for one in windows:
        label = one.label
        window = one.window
        switch_times, printed = scan_instants(one, instant_grid(window.horizon, points))
        numbers |= {f"T0 [s], {label}": window.start, f"earliest t_s [s], {label}": float(switch_times[0])}
        for name, delta in ((PRINTED, 0.0), (OURS, window.pending_cost)):
            cost = printed + delta * switch_times
            panels[f"J, {name}"][label] = switch_times, cost / cost[0]
            for what, times in (("minima", minima(switch_times, cost)), ("found", optimize_instants(one, delta))):
                panels[f"{what}, {name}"][label] = times, np.interp(times, switch_times, cost / cost[0])
                numbers |= {f"{what} [s], {label}, {name}, {i}": float(time) for i, time in enumerate(times, start=1)}
    return Ablation("pending_cost", panels, numbers)


def _normalization(logs: Logs) -> Ablation:
    """Compare the normalization by the nadir with none, and with the range of eq. (12) as printed."""
    runs = (OURS, NONE, RANGE, ALL_PRINTED)
    stages = {}
    for name in runs:
        summaries = logs[name].summary().stages
        starts = np.array([stage.actual_start for stage in summaries])
        ends = np.array([stage.switch_time for stage in summaries])
        stages[name] = (starts, ends)
    return Ablation("normalization", {"stages": stages, **_over_time(logs, runs)}, _measured(logs, runs))


def _discretization(logs: Logs, one: SwitchWindow, nodes: int) -> Ablation:
    """Compare Euler's discretization, eq. (20), with the exact one over N_s: the runs, and plans in one window."""
    counts = meshes(nodes)
    panels: dict[str, dict[str, Curve]] = {"error": {}, "missed": {}, "end": {}}
    numbers = {"T0 [s]": one.window.start}
    for kind in DISCRETIZATIONS:
        values = [(*on_mesh(one, count, kind), _end(logs[_on_mesh(kind, count, nodes)])) for count in counts]
        for panel, unit, column in zip(panels, ("m, rad", "tolerances", "s"), np.array(values).T, strict=True):
            panels[panel][kind] = np.array(counts, float), column
            numbers |= {f"{panel} [{unit}], {kind}, {c} nodes": float(v) for c, v in zip(counts, column, strict=True)}
    return Ablation("discretization", panels, numbers)


def ahead(log: Run) -> Curve:
    """Return the time until the planned end of the current stage [s] over time [s]; NaN where none is planned."""
    switch_times = log["window/instants"]
    first = log["window/first"]
    return log.time, switch_times[np.arange(len(first)), first] - log.time


def variation(log: Run) -> Curve:
    """Return the total variation of the joints' control up to each sample [rad/s^2] over time [s]."""
    joints = np.array([not name.startswith("base.") for name in log.coordinates], bool)
    steps = np.abs(np.diff(log["control/u"][:, joints], axis=0)).sum(axis=1)
    return log.time, np.r_[0.0, np.cumsum(steps)]


def _over_time(logs: Logs, names: Iterable[str]) -> dict[str, dict[str, Curve]]:
    """Return the panels of runs over time: `ahead` with the end of their common horizon, and `variation`."""
    runs = {name: ahead(logs[name]) for name in names}
    horizon = max(logs[name].task.spec.controller.horizon for name in runs)
    latest = max(float(time[-1]) for time, _ in runs.values())
    end = np.array([0.0, latest]), np.full(2, horizon)
    return {"instant": {**runs, END: end}, "variation": {name: variation(logs[name]) for name in runs}}


def _measured(logs: Logs, names: Iterable[str]) -> dict[str, float]:
    """Return what runs are compared by, one number for each quantity and run."""
    numbers: dict[str, float] = {}
    for name in names:
        log = logs[name]
        time, to_go = ahead(logs[name])
        known = np.isfinite(to_go)
        same = np.diff(log["window/first"]) == 0
        moves = np.abs(np.diff(to_go + time))[same & known[1:] & known[:-1]]
        late = to_go[known] >= log.task.spec.controller.horizon - JUMP / 2
        numbers |= {
            f"planned t_s at T_f, {name}": float(np.mean(late)) if known.any() else 0.0,
            f"jumps of t_s, {name}": float(np.sum(moves > JUMP)),
            f"variation of the joints' control [rad/s^2], {name}": float(variation(log)[1][-1]),
            f"end [s], {name}": _end(log),
            **{f"start of {stage.name} [s], {name}": stage.actual_start for stage in log.summary().stages[1:]},
        }
    return numbers


def _end(log: Run) -> float:
    """Return when the last stage met its end condition [s]; NaN if it never did."""
    summary = log.summary()
    return summary.duration if summary.completed else np.nan


def minima(switch_times: np.ndarray, cost: np.ndarray) -> np.ndarray:
    """Return the switch times (G,) [s] at which J (G,) has a minimum, the lowest first, without shallow ones."""
    from scipy.signal import find_peaks

    depth = np.r_[-np.inf, -cost, -np.inf]  # J may be lowest at an end
    places, _ = find_peaks(depth, prominence=PROMINENT * np.ptp(cost))
    return np.asarray(switch_times[sorted(places - 1, key=lambda i: float(cost[i]))])


def pick_window(log: Run) -> SwitchWindow:
    """Choose the window in which the cost is scanned over the switch time: one switch, planned at 0.3 of the horizon.

    Of all windows of a log with its first switch alone it is the one nearest to that, so that there is time before the
    switch and after it.

    Raises:
        LogError: The log has no plans, or no window with one switch.
    """
    samples = np.flatnonzero(log["window/count"] == 2)
    first_stage = log["window/first"]
    if not len(samples):
        raise LogError(f"{log.path}: found no window with one switch, expected a run of several stages")
    samples = samples[first_stage[samples] == first_stage[samples[0]]]
    problem = build_problem(converging(log.task))
    _, time_to_switch = ahead(log)
    wanted = 0.3 * problem.spec.controller.horizon
    solve = logged_solve(log, int(samples[np.argmin(np.abs(time_to_switch[samples] - wanted))]))
    return SwitchWindow(_ratio(solve.window.omega), problem, build_solver(problem), solve.window, solve.plan)


def _ratio(omega: np.ndarray) -> str:
    return " : ".join(f"{part:.3g}" for part in omega / omega[0])


def with_priorities(one: SwitchWindow, priorities: tuple[float, float]) -> SwitchWindow:
    """Return the window with other priorities, in the state to which its own have led.

    It is normalized from the optimum they have with the old normalization, as at the sample after they were changed.
    """
    window = replace(one.window, omega=np.array(priorities))
    controller = one.problem.spec.controller
    plan = one.solver.solve(window, one.plan).plan
    begins = np.r_[window.start - window.elapsed, plan.switch_times]
    kind = controller.normalization
    zeta = controller.zeta
    step = controller.normalization_step
    offset, scale = normalization(kind, zeta, window.stages, begins, one.problem.costs, plan, step)
    window = replace(window, offset=offset, scale=scale)
    label = f"{_ratio(window.omega)} from {one.label}"
    plan = one.solver.solve(window, plan).plan
    return replace(one, label=label, window=window, plan=plan)


def scan_instants(one: SwitchWindow, grid: np.ndarray) -> Curve:
    """Return the switch times that can be met and J at each, with the switch time fixed and all else optimized.

    J is over the window's largest priority and without pending cost, which adds a constant where the instant is fixed.

    Args:
        one: The window.
        grid: Switch times after T0 (G,) [s]; the scan goes on from them down to the earliest feasible one.
    """
    window = replace(one.window, pending_cost=0.0)
    plan = one.plan
    scanned = dict[float, float]()
    infeasible = 0.0
    tried = sorted(map(float, grid))
    while tried or (scanned and min(scanned) - infeasible > CLOSE):
        instant = tried.pop() if tried else (min(scanned) + infeasible) / 2
        for guess in (plan, one.plan):
            at = replace(guess, switch_times=np.array([window.start + instant]))
            solved = one.solver.solve(window, at, within=0.0)
            if solved.outcome.usable:
                scanned[instant] = solved.objective
                plan = solved.plan
                break
        else:
            infeasible = instant
            tried = []
    switch_times = sorted(scanned)
    return np.array(switch_times), np.array([scanned[instant] for instant in switch_times])


def optimize_instants(one: SwitchWindow, pending_cost: float) -> np.ndarray:
    """Return the switch times after T0 (len(GUESSES),) [s] that the solver returns from each guess; NaN if it fails."""
    window = replace(one.window, pending_cost=pending_cost)
    optima = []
    for guess in GUESSES:
        started = replace(one.plan, switch_times=np.array([window.start + guess * window.horizon]))
        solved = one.solver.solve(window, started)
        optima.append(float(solved.plan.switch_times[0]) - window.start if solved.outcome.usable else np.nan)
    return np.array(optima)


def on_mesh(one: SwitchWindow, nodes: int, discretization: str) -> tuple[float, float]:
    """Return how far the prediction of a plan on another mesh is from where its control leads.

    First the largest difference of a coordinate at a node [m, rad], then the largest error at the switch over the
    tolerance of the end condition [1]; both NaN if there is no solution.
    """
    window = replace(one.window, nodes=(nodes,) * len(one.window.stages), discretization=discretization)
    solved = build_solver(one.problem).solve(window, one.plan)
    if not solved.outcome.usable:
        return np.nan, np.nan
    plan = solved.plan
    X = rollout(plan.X[0], plan.u, np.diff(plan.times))
    n = one.problem.model.n
    error = float(np.abs(plan.X[:, :n] - X[:, :n]).max())
    return error, one.problem.costs.end_error(one.window.stages[0], X[nodes])


def instant_grid(horizon: float, points: int) -> np.ndarray:
    """Return switch times after T0 [s], evenly through the horizon and ever denser towards its end."""
    near = horizon - SHORTEST * 4.0 ** np.arange(4)
    return np.union1d(np.linspace(0.0, horizon, points + 2)[1:-1], near)
