"""From a log alone: one horizon solved again (replay), the run repeated (rerun), an unfinished run completed."""

import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path

import numpy as np

from psmpc_cli import __version__
from psmpc_cli.errors import LogError
from psmpc_cli.logs.comparison import Comparison, compare_runs
from psmpc_cli.logs.files import check_output
from psmpc_cli.logs.run import Run
from psmpc_cli.logs.schema import FORMAT_VERSION, Sample
from psmpc_cli.native.library import describe_compiler, describe_processor
from psmpc_cli.ocp.problem import build_problem
from psmpc_cli.ocp.window_record import WindowFrame, read_window
from psmpc_cli.simulation.recorder import OWN_LOOP, Watch
from psmpc_cli.simulation.run import simulate
from psmpc_cli.solvers import Outcome, Solution, build_solver
from psmpc_cli.specs.load import parse_task


def logged_solve(run: Run, sample: int) -> Solution:
    """Rebuild the solve of a sample from a log, so that its window can be solved again or its plan integrated.

    A log has the numbers of the window, the guess, the solution and the multipliers that the solve started from. It
    lacks the multipliers and the stages' costs at the solution, so the returned one has none of these. Under HTMPC,
    which solves one window for each priority level, it is the solve of the first level.

    Args:
        run: A run with plans.
        sample: The number of the sample.

    Returns:
        The solution of that sample, with its window and guess.

    Raises:
        LogError: The run holds no plans, not this sample, or a plan that is not of its window.
    """
    logged_vectors = (run.plan(name, sample) for name in ("parameters", "guess", "solution", "guess_multipliers"))
    window_numbers, guess, solution, guess_duals = logged_vectors
    try:
        problem = run.problem_at(float(run.time[sample]))  # with the targets then: a user may change them during a run
        window = read_window(problem, _window_frame(run, sample), window_numbers)
        return Solution(
            outcome=Outcome[run["solver/status"][sample].upper()],
            plan=window.plan_of(solution),
            # the log has J itself, and the objective of a solver is J over the largest priority
            objective=float(run["solver/objective"][sample]) / float(np.max(window.omega)),
            iterations=int(run["solver/iterations"][sample]),
            wall_time=float(run["solver/wall_time"][sample]),
            window=window,
            guess=window.plan_of(guess),
            warm=bool(run["solver/warm"][sample]),
            guess_duals=guess_duals,
        )
    except (KeyError, ValueError):
        raise LogError(f"{run.path}: the plan of sample {sample} is not one of the window that the log has") from None


def _window_frame(run: Run, sample: int) -> WindowFrame:
    """Read what the datasets of a log say of a sample's window: stages, nodes, time and state."""
    first = int(run["window/first"][sample])
    count = int(run["window/count"][sample])
    stages = range(first, first + count)
    nodes = [int(run["window/nodes"][sample, stage]) for stage in stages]
    # a stage that continues after its own end has a second segment, with nodes of its own
    nodes_after_end = int(run["window/nodes_after_end"][sample]) if "window/nodes_after_end" in run else 0
    return WindowFrame(
        segments=(*stages, first) if nodes_after_end else tuple(stages),
        nodes=(*nodes, nodes_after_end) if nodes_after_end else tuple(nodes),
        start=float(run.time[sample] + (run["delay/expected"][sample] if "delay/expected" in run else 0.0)),
        Q=run["state/Q"][sample],
        v=run["state/Qdot"][sample],
    )


@dataclass(frozen=True, eq=False)
class Replay:
    """A solve done again.

    Attributes:
        logged: The solve as it was logged.
        solution: The solution of the repeated solve.
        iterations: The solver's table of iterations, line by line; its objective is J over the largest priority.
        compared: By name of the quantity (objective, planned switch times, control of the first tick): its value as
            logged, and in the repeated solve.
        largest_of_controls: Largest difference of a control in the plan [m/s^2, rad/s^2].
        remarks: Sentences for the user: why the logged solve is not the one behind the applied control.
        same_solver: Whether the solver is the run's.
    """

    logged: Solution
    solution: Solution
    iterations: tuple[str, ...]
    compared: Mapping[str, tuple[float, float]]
    largest_of_controls: float
    remarks: tuple[str, ...]
    same_solver: bool

    @property
    def largest(self) -> float:
        """The largest of all differences."""
        return max(self.largest_of_controls, *(abs(again - logged) for logged, again in self.compared.values()))


def replay(log: Run, sample: int, solver: str | None = None) -> Replay:
    """Solve the window of one logged sample again, and compare the result with what the log has.

    The solve has no deadline, so that it does not depend on the machine. It starts from the logged guess.

    Args:
        log: A run with plans.
        sample: The number of the sample.
        solver: Name of the solver; by default the run's own.

    Returns:
        Both solutions, and their differences.

    Raises:
        LogError: The log holds no plans, not this sample, or a plan that is not of its window.
        SpecError: The solver does not exist or cannot solve this task.
    """
    _require_newest_format(log)
    task = log.task
    logged = logged_solve(log, sample)
    iterations = list[str]()
    if solver is not None and solver != task.spec.solver.kind:
        # deadline and gradient of the task are made for the run's solver: another one may not take them
        overrides = (f"solver.kind={json.dumps(solver)}", "solver.deadline=null", "solver.gradient=exact")
        changes = [(f"--solver {solver}", override) for override in overrides]  # messages name the option
        task = parse_task(task.task_yaml, task.robot_yaml, task.spec.name, changes)
    solver_spec = task.spec.solver.model_copy(update={"deadline": None})
    same_solver = task.spec.solver.kind == log.task.spec.solver.kind
    problem = log.problem if task is log.task else build_problem(task)
    window_solver = build_solver(problem, solver_spec, iterations.append)
    # a window that a stage has just entered had more iterations in the run
    if log["events/appended"][sample]:
        window_solver = window_solver.stopping(stop_at=np.inf, most_iterations=solver_spec.entry_iterations)
    # multipliers of another solver are of other rows
    guess_duals = logged.guess_duals if same_solver else np.zeros(0)
    # a warm solve starts from the solution of the sample before, for which the logged guess and multipliers stand
    previous = replace(logged, outcome=Outcome.OPTIMAL, plan=logged.guess, duals=guess_duals) if logged.warm else None
    solution = window_solver.solve(logged.window, logged.guess, previous)
    # compared are the objective, the planned switch times, and the mean control over the first tick
    first_tick = logged.window.start + np.array([0.0, 1 / task.spec.plant.low_level_rate])
    names_of_switch_times = (f"{stage.name} ends [s]" for stage in logged.window.stages[:-1])
    names = ["objective J", *names_of_switch_times, *(f"control of {name}" for name in log.coordinates)]
    compared_values = [
        np.r_[solve.J, solve.plan.switch_times, solve.plan.mean_control(first_tick)[0]] for solve in (logged, solution)
    ]
    return Replay(
        logged=logged,
        solution=solution,
        iterations=tuple(iterations),
        compared=dict(zip(names, zip(*np.array(compared_values).tolist(), strict=True), strict=True)),
        largest_of_controls=float(np.abs(solution.plan.u - logged.plan.u).max()),
        remarks=tuple(_remarks(log, sample)),
        same_solver=same_solver,
    )


def _remarks(log: Run, sample: int) -> Iterator[str]:
    """Say in which ways a logged solve is not the one that gave the applied control, so that a replay is not misread.

    It may be that of a shorter window, a failed one, or that of the first priority level of HTMPC alone; and it may
    have had a deadline.

    Args:
        log: The run.
        sample: The number of the sample.

    Yields:
        One sentence for the user for each of these.
    """
    names = log.stage_names
    last_stage = int(log["window/first"][sample] + log["window/count"][sample]) - 1
    if log["events/postponed"][sample] and last_stage + 1 < len(names):
        yield (
            f"{names[last_stage + 1]} was seen, but the window with it had no solution: logged, and solved again, "
            "is the window without it"
        )
    if log["events/solve_failed"][sample]:
        consequence = "the plan was used up" if log["events/braking"][sample] else "the plan before it went on"
        yield f"the solve failed and {consequence}: compared is the last iterate of the failed solve"
    if "levels/solved" in log:
        window = f"the window of its first level alone, that of {names[last_stage]}"
        yield f"the log of HTMPC holds {window}: the applied control is that of the last level"
    if log.task.spec.solver.deadline is not None:
        yield "solves of the run had a deadline, this one has none"


def _require_newest_format(log: Run) -> None:
    """Raise an error if a log has an older format, whose windows and measurements are not those of this version.

    Raises:
        LogError: The log is of an older format.
    """
    format_version = log.attributes.get("format_version", FORMAT_VERSION)
    if format_version != FORMAT_VERSION:
        raise LogError(
            f"{log.path}: found log format {format_version}, expected {FORMAT_VERSION} to repeat a run or a solve: "
            f"repeat it with a version that writes format {format_version}; show, plot, view and report read it here"
        )


def rerun(
    log: Run, path: Path | None = None, force: bool = False, watch: Watch = lambda sample: None
) -> Comparison | None:
    """Repeat a run and compare every dataset but the wall times, to check that its results can be reproduced.

    A run that was interrupted is repeated up to the sample at which its log ends.

    Args:
        log: The run.
        path: File of the new log; by default it is kept in memory alone.
        force: Overwrite an earlier log.
        watch: Called with each sample of the new run.

    Returns:
        The comparison; None if the repetition was itself interrupted.

    Raises:
        LogError: The log holds no samples, or does not describe a run of this version.
        InputError: The new log exists already or cannot be written.
        RunError: It could not be written any further.
    """
    _require_newest_format(log)
    samples = len(log.time)
    if not samples:
        raise LogError(f"{log.path}: holds no samples, so there is nothing to compare a run with")
    if path is not None:
        check_output(path, force, inputs=[log.path])

    def watch_until_log_ends(sample: Sample) -> None:
        watch(sample)
        if log.interrupted and sample.number + 1 == samples:
            # ends the new run as an interruption has ended the logged one
            raise KeyboardInterrupt(str(log.attributes["end_reason"]) or "as far as the log goes")

    new_run = simulate(
        log.task, path, watch_until_log_ends, force, keep_going=log.keeps_going, new_targets=log.new_targets
    )
    was_interrupted_early = new_run.interrupted and (len(new_run.time) < samples or not log.interrupted)
    return None if was_interrupted_early else compare_runs(log, new_run)


def continue_run(log: Run, path: Path | None = None, watch: Watch = lambda sample: None) -> Comparison | None:
    """Run the task of an unfinished log again from its beginning, to the end.

    Every row that the log holds is compared with the new one, wall times left out. Where all are equal the new log
    takes the place of the old one in one step; where they are not, or if interrupted, the old one stays as it is.

    Args:
        log: The run, as its unfinished log has it.
        path: File of the new log; by default it replaces the old one.
        watch: Called with each sample of the new run.

    Returns:
        The comparison of the old rows with the new ones; None if the new run was interrupted.

    Raises:
        LogError: The run has ended, or the log does not describe a run of this version.
        InputError: The new log cannot be written.
        RunError: The new log could not be written any further.
    """
    _require_newest_format(log)
    if not log.interrupted:
        reason = log.attributes["end_reason"]
        raise LogError(f"{log.path}: this run has ended ({reason}), so there is nothing to continue")
    new_run = simulate(log.task, path, watch, keep_going=log.keeps_going, new_targets=log.new_targets)
    if new_run.interrupted:
        return None
    comparison = compare_runs(log, new_run)
    if path is None and not comparison.differences:
        new_run.save(log.path, force=True)
    return comparison


def unequal_conditions(log: Run) -> tuple[str, ...]:
    """List the reasons why a repeated run need not be equal to the last bit, in sentences for the user.

    Such reasons are other versions of packages, sums over several threads, deadlines of solves, a log that was not
    simulated, and another machine. The list is empty if there is none.
    """
    versions_here = {"psmpc": __version__, "casadi": version("casadi"), "numpy": np.__version__}
    versions_of_log = {name: str(log.attributes.get(f"{name}_version", "unknown")) for name in versions_here}
    conditions = [
        f"{name} {versions_of_log[name]} wrote the log, this is {versions_here[name]}"
        for name in versions_here
        if versions_of_log[name] != versions_here[name]
    ]
    if os.environ.get("OMP_NUM_THREADS") != "1" and (os.cpu_count() or 1) > 1:
        conditions.append("OMP_NUM_THREADS is not 1: sums over several threads may be rounded otherwise")
    if (deadline := log.task.spec.solver.deadline) is not None:
        conditions.append(f"solves have a deadline of {deadline:g} s: how far they come depends on the machine")
    if log.attributes.get("plant") == OWN_LOOP:
        plant = log.task.spec.plant.kind
        conditions.append(f"the log was recorded in a loop of its own, this is a simulation with plant {plant}")
    return (*conditions, *_differences_of_machine(log))


def _differences_of_machine(log: Run) -> Iterator[str]:
    """Yield processor and compiler where they are not those of a log's run, since they round otherwise."""
    here = {"processor": describe_processor(), "compiler": ""}
    if log.attributes.get("compiled"):
        here["compiler"] = describe_compiler()
    for name, value in here.items():
        logged = str(log.attributes.get(name, value))
        if logged != value:
            yield f"the {name} was {logged or 'none'}, this is {value or 'none'}"
