"""From a log alone: one horizon solved again (replay), the run repeated (rerun), an unfinished run completed."""

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path

import numpy as np

from psmpc_cli import __version__
from psmpc_cli.control.controller import ends_in_plan
from psmpc_cli.errors import InputError, LogError
from psmpc_cli.logs.comparison import Comparison, compare_logs
from psmpc_cli.logs.run import Run
from psmpc_cli.logs.schema import Sample
from psmpc_cli.ocp.plan import Chart
from psmpc_cli.ocp.window import Window
from psmpc_cli.robot.free_body import body_of
from psmpc_cli.simulation.run import Experiment, Watch, build_experiment, simulate
from psmpc_cli.solvers import Outcome, Solution, build_solver
from psmpc_cli.specs.load import Task, parse_task

MOST_NODES = 1000
"""Intervals a stage has at most; a log with more is damaged."""


def logged_solve(run: Run, sample: int) -> Solution:
    """Read the solve of a sample; under HTMPC that of the first level.

    Its multipliers are those that it started from, and it has no costs.

    Args:
        run: A run with plans.
        sample: The number of the sample.

    Raises:
        LogError: The run holds no plans, not this sample, or a plan that is not of its window.
    """
    vectors = (run.plan(name, sample) for name in ("parameters", "guess", "solution", "guess_multipliers"))
    numbers, guess, solution, duals = vectors
    status = run["solver/status"][sample]
    status = status.decode(errors="replace") if isinstance(status, bytes) else str(status)
    if status.upper() not in Outcome.__members__:
        raise LogError(f"{run.path}: found the outcome {status!r} of sample {sample}, which this version does not know")
    try:
        window = _window(run, numbers, sample)
        return Solution(
            outcome=Outcome[status.upper()],
            plan=window.plan_of(solution),
            objective=float(run["solver/objective"][sample]) / float(np.max(window.omega)),
            iterations=int(run["solver/iterations"][sample]),
            wall_time=float(run["solver/wall_time"][sample]),
            window=window,
            guess=window.plan_of(guess),
            warm=bool(run["solver/warm"][sample]),
            guess_duals=duals,
        )
    except ValueError:
        raise LogError(f"{run.path}: the plan of sample {sample} is not one of the window that the log has") from None


def _window(run: Run, numbers: np.ndarray, sample: int) -> Window:
    """Return the window of a sample from its numbers; raise ValueError where they are not of that window."""
    first, count, problem = int(run["window/first"][sample]), int(run["window/count"][sample]), run.problem
    stages, nodes, spec = (
        problem.stages[first : first + count],
        run["window/nodes"][sample, first : first + count],
        problem.spec,
    )
    if len(stages) != count or not (np.isfinite(nodes) & (nodes >= 1) & (nodes <= MOST_NODES)).all():
        raise ValueError
    (elapsed, hold), signs = numbers[:2], numbers[2 + 3 * count :]
    omega, offset, scale = numbers[2 : 2 + 3 * count].reshape(3, count)
    Q, v = run["state/Q"][sample], run["state/Qdot"][sample]
    chart, model = Chart.at(Q, len(v)), problem.model
    moving = [stage for stage in stages if stage.on_object]
    if moving:
        signs, states = np.split(signs, [len(signs) - len(moving) * (13 if chart.spatial else 6)])
        seen = {stage.index: each for stage, each in zip(moving, states.reshape(len(moving), -1), strict=True)}
        size = 7 if chart.spatial else 3
        stages = tuple(
            stage.at_object(model.pose_rows, *np.split(seen[stage.index], [size])) if stage.on_object else stage
            for stage in stages
        )
        body = None if spec.object is None else body_of(spec.object)
        planned = ends_in_plan(spec.controller.kind, first, problem.stages)
        if body is not None and stages[0].on_object and not planned:
            state, horizon = seen[first], spec.controller.horizon
            stages = (stages[0].following(model.pose_rows, body, state, float(elapsed), horizon), *stages[1:])
    if chart.spatial:
        *parts, _ = np.split(signs, np.cumsum([len(stage.attitudes) for stage in stages]))
        taken = [dict(zip(stage.attitudes, part, strict=True)) for stage, part in zip(stages, parts, strict=True)]
        stages = tuple(stage.in_chart(chart.anchor, Q[7:], each) for stage, each in zip(stages, taken, strict=True))
    return Window(
        stages=stages,
        start=float(run.time[sample]),
        elapsed=float(elapsed),
        hold=float(hold),
        x0=np.asarray(chart.enter(Q[None], v[None])[0]),
        omega=omega,
        offset=offset,
        scale=scale,
        horizon=spec.controller.horizon,
        pending_cost=spec.controller.pending_cost,
        terminal_cost=spec.controller.terminal_cost,
        nodes=tuple(int(count) for count in nodes),
        discretization=spec.controller.discretization,
        soft=spec.limits_are_soft,
        chart=chart,
    )


@dataclass(frozen=True, eq=False)
class Replay:
    """A solve done again.

    Attributes:
        experiment: The run's experiment, built anew; its solver may be another one.
        logged: The solve as it was logged.
        solution: What came out again.
        iterations: The solver's table of iterations, line by line; its objective is J over the largest priority.
        compared: Objective, planned switch times and the control of the first tick: as logged, and again.
        apart: Largest difference of a control in the plan [m/s^2, rad/s^2].
        remarks: What was logged that is not the solve behind the applied control.
        same_solver: Whether the solver is the run's.
    """

    experiment: Experiment
    logged: Solution
    solution: Solution
    iterations: tuple[str, ...]
    compared: Mapping[str, tuple[float, float]]
    apart: float
    remarks: tuple[str, ...]
    same_solver: bool

    @property
    def largest_priority(self) -> float:
        """What the objective is divided by in the NLP."""
        return float(np.max(self.logged.window.omega))

    @property
    def largest(self) -> float:
        """The largest of all differences."""
        return max(self.apart, *(abs(again - logged) for logged, again in self.compared.values()))


def replay(log: Run, sample: int, solver: str | None = None) -> Replay:
    """Solve the horizon of a sample again, by default with the run's own solver.

    Raises:
        LogError: The log holds no plans, not this sample, or a plan that is not of its window.
        InputError: The name of the solver is none.
        SpecError: The solver does not exist or cannot solve this task.
    """
    loaded = log.task
    chosen = loaded if solver is None else _with_solver(loaded, solver)
    experiment = build_experiment(chosen)
    logged, same = logged_solve(log, sample), chosen.spec.solver.kind == loaded.spec.solver.kind
    solution, iterations = solve_again(experiment, logged, same)
    return Replay(
        experiment=experiment,
        logged=logged,
        solution=solution,
        iterations=iterations,
        compared=_compared(log, experiment, logged, solution),
        apart=float(np.abs(solution.plan.u - logged.plan.u).max()),
        remarks=tuple(_remarks(log, experiment, sample)),
        same_solver=same,
    )


def _with_solver(loaded: Task, solver: str) -> Task:
    if re.fullmatch(r"[\w-]+", solver) is None:
        raise InputError(f"--solver: found {solver!r}, expected the name of a solver such as ipopt")
    change = (f"--solver {solver}", f"solver.kind={solver}")
    return parse_task(loaded.task_yaml, loaded.robot_yaml, loaded.spec.name, [change])


def solve_again(experiment: Experiment, logged: Solution, same_solver: bool = True) -> tuple[Solution, tuple[str, ...]]:
    """Return what a logged solve returns without a deadline, and the solver's table of iterations."""
    lines: list[str] = []
    spec = experiment.problem.spec.solver.model_copy(update={"deadline": None, "compiled": experiment.compiled})
    solver = build_solver(experiment.problem, spec, lines.append)
    duals = logged.guess_duals if same_solver else np.zeros(0)
    start = replace(logged, outcome=Outcome.OPTIMAL, plan=logged.guess, duals=duals)
    return solver.solve(logged.window, logged.guess, start if logged.warm else None), tuple(lines)


def _compared(log: Run, experiment: Experiment, logged: Solution, again: Solution) -> dict[str, tuple[float, float]]:
    start, names = logged.window.start, [f"{stage.name} ends [s]" for stage in logged.window.stages]
    tick = start + np.array([0.0, 1 / experiment.problem.spec.plant.low_level_rate])
    names = ["objective J", *names[:-1], *(f"control of {name}" for name in log.coordinates)]
    solves = [np.r_[each.J, each.plan.instants, each.plan.mean_control(tick)[0]] for each in (logged, again)]
    return dict(zip(names, zip(*np.array(solves).tolist(), strict=True), strict=True))


def _remarks(log: Run, experiment: Experiment, sample: int) -> list[str]:
    stages, found = experiment.problem.stages, []
    last = int(log["window/first"][sample] + log["window/count"][sample]) - 1
    if log["events/postponed"][sample] and last + 1 < len(stages):
        found.append(
            f"{stages[last + 1].name} was seen, but the window with it had no solution: logged, and solved again, is "
            "the window without it"
        )
    if log["events/braking"][sample]:
        found.append("the solve failed and the plan was used up: compared is the last iterate of the failed solve")
    elif log["events/solve_failed"][sample]:
        found.append(
            "the solve failed and the plan before it went on: compared is the last iterate of the failed solve"
        )
    if "levels/solved" in log:
        found.append(
            f"the log of HTMPC holds the window of its first level alone, that of {stages[last].name}: the applied "
            "control is that of the last level"
        )
    if experiment.problem.spec.solver.deadline is not None:
        found.append("solves of the run had a deadline, this one has none")
    return found


def rerun(log: Run, path: Path, force: bool = False, watch: Watch = lambda sample: None) -> Comparison | None:
    """Repeat a run, up to where its log ends, and compare every dataset but the wall times; None if interrupted.

    Raises:
        LogError: The log holds no samples, or does not describe a run of this version.
        InputError: The new log exists already or cannot be written.
        RunError: It could not be written any further.
    """
    ended, samples = not log.interrupted, len(log.time)
    if not samples:
        raise LogError(f"{log.path}: holds no samples, so there is nothing to compare a run with")
    reason = str(log.attributes["end_reason"])

    def watch_samples(sample: Sample) -> None:
        watch(sample)
        if not ended and sample.number + 1 == samples:
            raise KeyboardInterrupt(reason or "as far as the log goes")

    again = simulate(log.task, path, watch_samples, force)
    if again.interrupted and (ended or len(again.time) < samples):
        return None
    # a killed run has judged no monitor, and may have noted no switch of its last sample
    return compare_logs(log.path, path, None if ended else samples, () if reason else ("stages/", "monitors/"))


def continue_run(log: Run, path: Path | None = None, watch: Watch = lambda sample: None) -> Comparison | None:
    """Run the task of an unfinished log again from its beginning, to the end; None if interrupted.

    Every row that the log holds is compared with the new one, wall times left out. Where all are equal the new log
    takes the place of the old one in one step; where they are not, or if interrupted, the old one stays as it is.

    Args:
        log: The log.
        path: Where the new log goes; the old one's place by default.
        watch: Called with each sample.

    Raises:
        LogError: The run has ended, or the log does not describe a run of this version.
        InputError: The new log cannot be written.
        RunError: The new log could not be written any further.
    """
    if not log.interrupted:
        reason = log.attributes["end_reason"]
        raise LogError(f"{log.path}: this run has ended ({reason}), so there is nothing to continue")
    target = log.path.resolve()
    new = path or target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        again = simulate(log.task, new, watch)
        if again.interrupted:
            return None
        comparison = compare_logs(log.path, new, len(log.time), ("stages/", "monitors/", "final/"))
        if path is None and not comparison.differences:
            os.replace(new, target)
        return comparison
    finally:
        if path is None:
            new.unlink(missing_ok=True)


def unequal_conditions(log: Run) -> tuple[str, ...]:
    """Return what makes it pointless to expect equal numbers: other versions, several threads, a deadline."""
    here = {
        "psmpc_version": __version__,
        "casadi_version": version("casadi"),
        "numpy_version": np.__version__,
    }
    found = [
        f"{name.removesuffix('_version')} {log.attributes.get(name, 'unknown')} wrote the log, this is {running}"
        for name, running in here.items()
        if str(log.attributes.get(name)) != running
    ]
    if os.environ.get("OMP_NUM_THREADS") != "1" and (os.cpu_count() or 1) > 1:
        found.append("OMP_NUM_THREADS is not 1: sums over several threads may be rounded otherwise")
    if (deadline := log.task.spec.solver.deadline) is not None:
        found.append(f"solves have a deadline of {deadline:g} s: how far they come depends on the machine")
    return tuple(found)
