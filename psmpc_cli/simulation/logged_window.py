"""The window of a logged sample, from the log alone: what its solve was given and what it returned."""

from dataclasses import dataclass

import numpy as np

from psmpc_cli.control.sequence import MovingSequence, Switch, drop_met, drop_passed
from psmpc_cli.errors import InputError, LogError
from psmpc_cli.logs.run import Run
from psmpc_cli.ocp.window import Window
from psmpc_cli.simulation.setup import Experiment
from psmpc_cli.solvers import Outcome, Solution

MOST_NODES = 1000
"""Intervals a stage has at most; a log that says more is damaged."""


@dataclass(frozen=True, eq=False)
class LoggedSequence:
    """Which stages a sample's window held.

    Attributes:
        sequence: The stages, and the instants at which they hand over as the sample left them.
        switches: Hand-overs since the sample before.
    """

    sequence: MovingSequence
    switches: tuple[Switch, ...]


def logged_state(log: Run, sample: int) -> np.ndarray:
    """Return the state measured at a sample (2n,)."""
    return np.concatenate([log["state/Q"][sample], log["state/Qdot"][sample]])


def true_state(log: Run, sample: int) -> np.ndarray:
    """Return the true state at a sample (2n,), which is the measured one where that has no noise."""
    if "state/Q_true" not in log:
        return logged_state(log, sample)
    return np.concatenate([log["state/Q_true"][sample], log["state/Qdot_true"][sample]])


def ensure_sample(log: Run, sample: int) -> None:
    """Make sure that a log holds the plans of a sample.

    Raises:
        LogError: It holds no plans.
        InputError: It does not hold the sample.
    """
    if not log.plans:
        raise LogError(f"{log.path}: holds no plans; expected a log of a task with log: {{plans: true}}")
    held = len(log.time)
    if not 0 <= sample < held:
        choices = f"expected one from 0 to {held - 1}" if held else "it holds none"
        raise InputError(f"{log.path}: found no sample {sample}; {choices}")


def logged_sequences(log: Run, experiment: Experiment) -> list[LoggedSequence]:
    """Return the sequence of every sample of a log, hand-overs decided again by the rules of the run.

    Raises:
        LogError: They lead elsewhere than the log does.
    """
    found: list[LoggedSequence] = []
    sequence = MovingSequence(0, np.zeros(0), 0.0)
    for k, now in enumerate(map(float, log.time)):
        first, count = int(log["window/first"][k]), int(log["window/count"][k])
        switches: tuple[Switch, ...] = ()
        if first != sequence.first:
            sequence, switches = _hand_over(log, experiment, sequence, k)
        if not (sequence.first == first and 0 < count <= len(experiment.stages) - first):
            raise LogError(f"{log.path}: the stages in the window at {now:.2f} s do not follow from those before")
        sequence = MovingSequence(first, log["window/instants"][k, first : first + count - 1], sequence.entered)
        found.append(LoggedSequence(sequence, switches))
    return found


def _hand_over(
    log: Run, experiment: Experiment, sequence: MovingSequence, sample: int
) -> tuple[MovingSequence, tuple[Switch, ...]]:
    now = float(log.time[sample])
    sequence, passed = drop_passed(sequence, now)
    sequence, met = drop_met(sequence, experiment.stages, experiment.costs, now, logged_state(log, sample))
    return sequence, (*passed, *met)


def logged_solve(log: Run, experiment: Experiment, sequence: MovingSequence, sample: int) -> Solution:
    """Return the solve of a sample whose window holds a sequence; under HTMPC that of the first level.

    Its multipliers are those that it started from, and it knows no costs.

    Raises:
        LogError: The log has no plans, or what it holds is not of this window.
    """
    window = _window(log, experiment, sequence, sample)
    guess, solution, duals = (log.plan(name, sample) for name in ("guess", "solution", "guess_multipliers"))
    warm, scale = log.columns.get("solver/warm"), float(np.max(window.omega))
    try:
        return Solution(
            outcome=logged_outcome(log, sample),
            plan=window.plan_of(solution),
            objective=float(log["solver/objective"][sample]) / scale,
            iterations=int(log["solver/iterations"][sample]),
            wall_time=float(log["solver/wall_time"][sample]),
            window=window,
            guess=window.plan_of(guess),
            warm=bool(len(duals)) if warm is None else bool(warm[sample]),
            guess_duals=duals,
        )
    except ValueError:
        raise _not_of_the_window(log, sample) from None


def logged_outcome(log: Run, sample: int) -> Outcome:
    """Return how the solve of a sample ended.

    Raises:
        LogError: What the log says is no outcome.
    """
    status = log["solver/status"][sample]
    name = (status.decode(errors="replace") if isinstance(status, bytes) else str(status)).upper()
    if name not in Outcome.__members__:
        raise LogError(f"{log.path}: found the outcome {name.lower()!r} of sample {sample}, which this version has not")
    return Outcome[name]


def _window(log: Run, experiment: Experiment, sequence: MovingSequence, sample: int) -> Window:
    """Return the window of a sample."""
    task, stages = experiment.task, experiment.stages[sequence.first : sequence.last + 1]
    spec, numbers = task.controller, log.plan("parameters", sample)
    if len(numbers) != 1 + 3 * len(stages):
        raise _not_of_the_window(log, sample)
    omega, offset, scale = numbers[1:].reshape(3, -1)
    return Window(
        stages=stages,
        start=float(log.time[sample]),
        elapsed=float(numbers[0]),
        x0=logged_state(log, sample),
        omega=omega,
        offset=offset,
        scale=scale,
        horizon=spec.horizon,
        pending_cost=spec.pending_cost,
        terminal_cost=spec.terminal_cost,
        nodes=_nodes(log, experiment, sequence, sample),
        discretization=spec.discretization,
        soft=task.limits_are_soft,
    )


def _nodes(log: Run, experiment: Experiment, sequence: MovingSequence, sample: int) -> tuple[int, ...]:
    """Return the intervals of each stage in the window of a sample."""
    counts = log.columns.get("window/nodes")
    if counts is None:
        return (experiment.task.controller.uniform_nodes,) * sequence.count
    found = counts[sample, sequence.first : sequence.last + 1]
    if not (np.isfinite(found) & (found >= 1) & (found <= MOST_NODES)).all():
        raise _not_of_the_window(log, sample)
    return tuple(int(count) for count in found)


def _not_of_the_window(log: Run, sample: int) -> LogError:
    return LogError(f"{log.path}: the plan of sample {sample} is not one of the window that the log says it has")
