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

WANTED_SWITCH = 0.3
"""Where in the horizon the switch of the window is to be whose cost is computed over the switch time."""

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
    """Run a task of several stages under PSMPC as it is and with each departure from the paper taken back, and compare.

    Windows are solved to convergence: a single iteration of the real-time solver does not show where the optimum is.
    The results say what each departure is good for; `psmpc reproduce --ablations` prints and draws them.

    Args:
        task: The task.
        jobs: Number of parallel processes; default the number of cores.
        watch: Called with the progress, as by `compute_all`.
        points: Number of switch times at which J(t_s) is computed.

    Returns:
        One ablation for each departure: pending cost, normalization, discretization.

    Raises:
        LogError: The task has a single stage.
        RunError: A process was killed each time.
    """
    nodes = task.spec.controller.uniform_nodes
    converged = ("solver.kind=fatrop", "solver.deadline=null") if task.spec.solver.traits.real_time else ()
    variants = dict(CHANGES)
    for count in interval_counts(nodes):
        for kind in DISCRETIZATIONS:
            changes = (f"controller.nodes={count}", f"controller.discretization={kind}")
            variants.setdefault(_run_name(kind, count, nodes), changes)  # the task itself is there already
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


def interval_counts(nodes: int) -> list[int]:
    """Return the N_s of the runs with each discretization for a task with this N_s, in ascending order."""
    return sorted({max(2, round(part * nodes)) for part in MESHES})


def _run_name(kind: str, count: int, nodes: int) -> str:
    """Return the name of the run with a discretization and N_s; one of them is the task itself."""
    return OURS if (kind, count) == ("exact", nodes) else f"{kind}, {count} nodes"


def _pending_cost(logs: Logs, windows: Sequence[SwitchWindow], points: int) -> Ablation:
    """Compare the objective as printed, without pending cost (delta = 0), with ours.

    The pending cost adds delta t_s to the cost J of a window, so that a switch is not put off. Two things are compared:
    runs with and without it, and J over a fixed switch time t_s, all else optimized, in some windows.

    Args:
        logs: The runs by name.
        windows: Windows with one switch, in which J(t_s) is computed.
        points: Number of switch times at which it is computed.
    """
    runs = (PRINTED, OURS)
    panels = _panels_over_time(logs, runs)
    panels |= {f"{what}, {name}": {} for what in ("J", "minima", "found") for name in runs}
    numbers = _measures_of_runs(logs, runs)
    for switch_window in windows:
        label = switch_window.label
        window = switch_window.window
        switch_times, printed = scan_switch_times(switch_window, switch_time_grid(window.horizon, points))
        numbers |= {f"T0 [s], {label}": window.start, f"earliest t_s [s], {label}": float(switch_times[0])}
        for name, delta in ((PRINTED, 0.0), (OURS, window.pending_cost)):
            cost = printed + delta * switch_times  # where t_s is fixed, the pending cost changes nothing else
            panels[f"J, {name}"][label] = switch_times, cost / cost[0]
            minima = switch_times_of_minima(switch_times, cost)
            found = switch_times_from_guesses(switch_window, delta)
            for what, times in (("minima", minima), ("found", found)):
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
    return Ablation("normalization", {"stages": stages, **_panels_over_time(logs, runs)}, _measures_of_runs(logs, runs))


def _discretization(logs: Logs, switch_window: SwitchWindow, nodes: int) -> Ablation:
    """Compare Euler's discretization, eq. (20), with the exact one, on several meshes.

    Args:
        logs: The runs by name, one for each discretization and number of intervals N_s of a stage.
        switch_window: The window that is solved again with each of them.
        nodes: N_s of the task itself.
    """
    counts = interval_counts(nodes)
    panels: dict[str, dict[str, Curve]] = {"error": {}, "missed": {}, "end": {}}
    numbers = {"T0 [s]": switch_window.window.start}
    for kind in DISCRETIZATIONS:
        values = [
            (*errors_on_mesh(switch_window, count, kind), _mission_end(logs[_run_name(kind, count, nodes)]))
            for count in counts
        ]
        for panel, unit, column in zip(panels, ("m, rad", "tolerances", "s"), np.array(values).T, strict=True):
            panels[panel][kind] = np.array(counts, float), column
            numbers |= {f"{panel} [{unit}], {kind}, {c} nodes": float(v) for c, v in zip(counts, column, strict=True)}
    return Ablation("discretization", panels, numbers)


def time_to_switch(log: Run) -> Curve:
    """Return how far ahead the end of the current stage is planned, over the samples of a run.

    Returns:
        Times of the samples (K,) [s], and the time from each to the planned switch (K,) [s]; NaN where none is planned.
    """
    switch_times = log["window/instants"]
    first = log["window/first"]
    return log.time, switch_times[np.arange(len(first)), first] - log.time


def control_variation(log: Run) -> Curve:
    """Return the total variation of the joints' control up to each sample [rad/s^2] over time [s]."""
    joints = np.array([not name.startswith("base.") for name in log.coordinates], bool)
    steps = np.abs(np.diff(log["control/u"][:, joints], axis=0)).sum(axis=1)
    return log.time, np.r_[0.0, np.cumsum(steps)]


def _panels_over_time(logs: Logs, names: Iterable[str]) -> dict[str, dict[str, Curve]]:
    """Return two panels of curves over the time of runs: their `time_to_switch` and their `control_variation`.

    The first also has the end of the horizon as a constant: a switch that is put off stays there.
    """
    runs = {name: time_to_switch(logs[name]) for name in names}
    horizon = max(logs[name].task.spec.controller.horizon for name in runs)
    latest = max(float(time[-1]) for time, _ in runs.values())
    end = np.array([0.0, latest]), np.full(2, horizon)
    return {"instant": {**runs, END: end}, "variation": {name: control_variation(logs[name]) for name in runs}}


def _measures_of_runs(logs: Logs, names: Iterable[str]) -> dict[str, float]:
    """Return the numbers by which runs are compared, one for each quantity and run, by its text in tables.

    The quantities are: the part of the samples at which the switch is planned at the end of the horizon, that is put
    off; how often a planned switch time jumps between two samples of the same stage; the variation of the control; the
    end of the mission; and the actual starts of all stages but the first.
    """
    numbers: dict[str, float] = {}
    for name in names:
        log = logs[name]
        time, to_go = time_to_switch(log)
        is_planned = np.isfinite(to_go)
        is_same_stage = np.diff(log["window/first"]) == 0
        # from sample to sample, by how much the planned switch time itself moves, where it is of the same switch
        moves = np.abs(np.diff(to_go + time))[is_same_stage & is_planned[1:] & is_planned[:-1]]
        # at the end of the horizon, to within half of what counts as a jump
        is_put_off = to_go[is_planned] >= log.task.spec.controller.horizon - JUMP / 2
        numbers |= {
            f"planned t_s at T_f, {name}": float(np.mean(is_put_off)) if is_planned.any() else 0.0,
            f"jumps of t_s, {name}": float(np.sum(moves > JUMP)),
            f"variation of the joints' control [rad/s^2], {name}": float(control_variation(log)[1][-1]),
            f"end [s], {name}": _mission_end(log),
            **{f"start of {stage.name} [s], {name}": stage.actual_start for stage in log.summary().stages[1:]},
        }
    return numbers


def _mission_end(log: Run) -> float:
    """Return when the last stage met its end condition [s]; NaN if it never did."""
    summary = log.summary()
    return summary.duration if summary.completed else np.nan


def switch_times_of_minima(switch_times: np.ndarray, cost: np.ndarray) -> np.ndarray:
    """Return at which of the switch times (G,) [s] the cost J (G,) has a minimum, the lowest first.

    Minima that are shallower than `PROMINENT` are left out.
    """
    from scipy.signal import find_peaks

    depth = np.r_[-np.inf, -cost, -np.inf]  # J may be lowest at an end
    places, _ = find_peaks(depth, prominence=PROMINENT * np.ptp(cost))
    return np.asarray(switch_times[sorted(places - 1, key=lambda i: float(cost[i]))])


def pick_window(log: Run) -> SwitchWindow:
    """Choose the window of a run in which the cost is computed over the switch time.

    Of all windows that hold the first switch of the run and no other it is the one with the switch planned nearest to
    `WANTED_SWITCH` of the horizon, so that there is time before the switch and after it.

    Raises:
        LogError: The log has no plans, or no window with one switch.
    """
    samples = np.flatnonzero(log["window/count"] == 2)
    first_stage = log["window/first"]
    if not len(samples):
        raise LogError(f"{log.path}: found no window with one switch, expected a run of several stages")
    samples = samples[first_stage[samples] == first_stage[samples[0]]]  # windows of two stages, with the first switch
    problem = build_problem(converging(log.task))
    _, to_go = time_to_switch(log)
    wanted = WANTED_SWITCH * problem.spec.controller.horizon
    solve = logged_solve(log, int(samples[np.argmin(np.abs(to_go[samples] - wanted))]))
    return SwitchWindow(_format_ratio(solve.window.omega), problem, build_solver(problem), solve.window, solve.plan)


def _format_ratio(omega: np.ndarray) -> str:
    return " : ".join(f"{part:.3g}" for part in omega / omega[0])


def with_priorities(switch_window: SwitchWindow, priorities: tuple[float, float]) -> SwitchWindow:
    """Return a window with other priorities, solved, in the state to which its own have led.

    The costs of a window are normalized by those of its last plan. So the window is solved twice: with the old
    normalization, whose optimum gives the new one, and then with that, as at the sample after priorities were changed.

    Args:
        switch_window: The window as the run had it.
        priorities: Those of its two stages.
    """
    window = replace(switch_window.window, omega=np.array(priorities))
    controller = switch_window.problem.spec.controller
    plan = switch_window.solver.solve(window, switch_window.plan).plan
    begins = np.r_[window.start - window.elapsed, plan.switch_times]  # of both stages; the current one began earlier
    kind = controller.normalization
    zeta = controller.zeta
    step = controller.normalization_step
    offset, scale = normalization(kind, zeta, window.stages, begins, switch_window.problem.costs, plan, step)
    window = replace(window, offset=offset, scale=scale)
    label = f"{_format_ratio(window.omega)} from {switch_window.label}"
    plan = switch_window.solver.solve(window, plan).plan
    return replace(switch_window, label=label, window=window, plan=plan)


def scan_switch_times(switch_window: SwitchWindow, grid: np.ndarray) -> Curve:
    """Compute the cost J of a window over its switch time: the switch time fixed, all else optimized.

    The scan goes from the latest switch time of the grid down, each solve starting from the plan of the last one. At
    the first that has no solution it leaves the grid, and bisects for the earliest feasible switch time, up to `CLOSE`.

    Args:
        switch_window: The window.
        grid: Switch times after T0 (G,) [s].

    Returns:
        The feasible switch times after T0 in ascending order [s], and J at each. J is over the window's largest
        priority, and without pending cost, which adds a constant where the switch time is fixed.
    """
    window = replace(switch_window.window, pending_cost=0.0)
    plan = switch_window.plan
    scanned = dict[float, float]()
    infeasible = 0.0  # the latest switch time that is known to have no solution
    to_try = sorted(map(float, grid))
    while to_try or (scanned and min(scanned) - infeasible > CLOSE):
        # the latest one that is left of the grid; without any, half way between feasible and infeasible
        instant = to_try.pop() if to_try else (min(scanned) + infeasible) / 2
        for guess in (plan, switch_window.plan):
            fixed = replace(guess, switch_times=np.array([window.start + instant]))
            solved = switch_window.solver.solve(window, fixed, within=0.0)  # which holds the switch time
            if solved.outcome.usable:
                scanned[instant] = solved.objective
                plan = solved.plan
                break
        else:  # neither guess leads to a solution
            infeasible = instant
            to_try = []
    switch_times = sorted(scanned)
    return np.array(switch_times), np.array([scanned[instant] for instant in switch_times])


def switch_times_from_guesses(switch_window: SwitchWindow, pending_cost: float) -> np.ndarray:
    """Return the switch times after T0 (len(GUESSES),) [s] that the solver returns from each guess; NaN if it fails."""
    window = replace(switch_window.window, pending_cost=pending_cost)
    optima = []
    for guess in GUESSES:
        started = replace(switch_window.plan, switch_times=np.array([window.start + guess * window.horizon]))
        solved = switch_window.solver.solve(window, started)
        optima.append(float(solved.plan.switch_times[0]) - window.start if solved.outcome.usable else np.nan)
    return np.array(optima)


def errors_on_mesh(switch_window: SwitchWindow, nodes: int, discretization: str) -> tuple[float, float]:
    """Solve a window on another mesh, and compare the predicted states of the plan with where its control leads.

    Args:
        switch_window: The window.
        nodes: Number of intervals N_s of each stage.
        discretization: `exact` or `euler`.

    Returns:
        The largest difference of a coordinate at a node [m, rad], and the largest error at the switch over the
        tolerance of the end condition [1]; both NaN if there is no solution.
    """
    window = replace(
        switch_window.window, nodes=(nodes,) * len(switch_window.window.stages), discretization=discretization
    )
    solved = build_solver(switch_window.problem).solve(window, switch_window.plan)
    if not solved.outcome.usable:
        return np.nan, np.nan
    plan = solved.plan
    X = rollout(plan.X[0], plan.u, np.diff(plan.times))  # exact for piecewise constant accelerations
    n = switch_window.problem.model.n
    error = float(np.abs(plan.X[:, :n] - X[:, :n]).max())
    return error, switch_window.problem.costs.end_error(switch_window.window.stages[0], X[nodes])


def switch_time_grid(horizon: float, points: int) -> np.ndarray:
    """Return switch times after T0 [s], evenly through the horizon and ever denser towards its end."""
    near_end = horizon - SHORTEST * 4.0 ** np.arange(4)
    return np.union1d(np.linspace(0.0, horizon, points + 2)[1:-1], near_end)
