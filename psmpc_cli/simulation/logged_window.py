"""The window of a logged sample, from the log alone: what its solve was given and what it returned."""

from dataclasses import dataclass

import numpy as np

from psmpc_cli.control.controller import priorities_in_force
from psmpc_cli.control.sequence import Sequence, Switch, drop_met, drop_passed
from psmpc_cli.errors import InputError, LogError
from psmpc_cli.logs.read import Log, read_plan
from psmpc_cli.ocp.parameters import split_parameters
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.ocp.transcription import Nlp, window_layout
from psmpc_cli.ocp.window import Window, unpack_plan, window_shape
from psmpc_cli.simulation.setup import Experiment
from psmpc_cli.solvers import Guess, Outcome

MOST_NODES = 1000
"""Intervals a stage has at most; a log that says more is damaged."""


@dataclass(frozen=True, eq=False)
class LoggedSequence:
    """Which stages a sample's window held.

    Attributes:
        sequence: The stages, and the instants at which they hand over as the sample left them.
        switches: Hand-overs since the sample before.
    """

    sequence: Sequence
    switches: tuple[Switch, ...]


@dataclass(frozen=True, eq=False)
class LoggedSolve:
    """The solve of a sample as it stands in the log.

    Attributes:
        window: The window.
        nlp: Its NLP, transcribed anew.
        guess: Where the solve started.
        parameters: The NLP's parameter vector.
        z: What the solve returned; its last iterate if it failed.
        plan: The same as a plan.
        outcome: How the solve ended.
        objective: J in the task's own priorities.
    """

    window: Window
    nlp: Nlp
    guess: Guess
    parameters: np.ndarray
    z: np.ndarray
    plan: Plan
    outcome: Outcome
    objective: float


def logged_state(log: Log, sample: int) -> np.ndarray:
    """Return the state measured at a sample (2n,)."""
    return np.concatenate([log["state/Q"][sample], log["state/Qdot"][sample]])


def true_state(log: Log, sample: int) -> np.ndarray:
    """Return the true state at a sample (2n,), which is the measured one where that has no noise."""
    if "state/Q_true" not in log.columns:
        return logged_state(log, sample)
    return np.concatenate([log["state/Q_true"][sample], log["state/Qdot_true"][sample]])


def ensure_sample(log: Log, sample: int) -> None:
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


def logged_sequences(log: Log, experiment: Experiment) -> list[LoggedSequence]:
    """Return the sequence of every sample of a log, hand-overs decided again by the rules of the run.

    Raises:
        LogError: They lead elsewhere than the log does.
    """
    found: list[LoggedSequence] = []
    sequence = Sequence(0, np.zeros(0), 0.0)
    for k, now in enumerate(map(float, log.time)):
        first, count = int(log["window/first"][k]), int(log["window/count"][k])
        switches: tuple[Switch, ...] = ()
        if first != sequence.first:
            sequence, switches = _hand_over(log, experiment, sequence, k)
        if not (sequence.first == first and 0 < count <= len(experiment.stages) - first):
            raise LogError(f"{log.path}: the stages in the window at {now:.2f} s do not follow from those before")
        sequence = Sequence(first, log["window/instants"][k, first : first + count - 1], sequence.entered)
        found.append(LoggedSequence(sequence, switches))
    return found


def _hand_over(
    log: Log, experiment: Experiment, sequence: Sequence, sample: int
) -> tuple[Sequence, tuple[Switch, ...]]:
    now = float(log.time[sample])
    sequence, passed = drop_passed(sequence, now)
    sequence, met = drop_met(sequence, experiment.stages, experiment.costs, now, logged_state(log, sample))
    return sequence, (*passed, *met)


def logged_solve(log: Log, experiment: Experiment, sequence: Sequence, sample: int) -> LoggedSolve:
    """Return the solve of a sample whose window holds a sequence; under HTMPC that of the first level.

    Raises:
        LogError: The log has no plans, or what it holds is not of this window.
    """
    window, parameters = _window(log, experiment, sequence, sample)
    windows = experiment.controller.windows
    nlp, _ = windows.compiled_for(window)
    size, rows = nlp.layout.size, len(nlp.equality)
    guess, solution, multipliers = (
        read_plan(log.path, name, sample) for name in ("guess", "solution", "guess_multipliers")
    )
    if len(guess) != size or len(solution) != size or len(multipliers) not in (0, size + rows):
        raise _not_of_the_window(log, sample)
    return LoggedSolve(
        window=window,
        nlp=nlp,
        guess=_guess(log, sample, guess, multipliers),
        parameters=parameters,
        z=solution,
        plan=unpack_plan(nlp, window, solution),
        outcome=logged_outcome(log, sample),
        objective=float(log["solver/objective"][sample]),
    )


def _guess(log: Log, sample: int, z: np.ndarray, multipliers: np.ndarray) -> Guess:
    warm = log.columns.get("solver/warm")
    shifted = bool(len(multipliers)) if warm is None else bool(warm[sample])
    lam_x, lam_g = np.split(multipliers, [len(z)]) if len(multipliers) else (None, None)
    return Guess(z, lam_x, lam_g, shifted)


def logged_outcome(log: Log, sample: int) -> Outcome:
    """Return how the solve of a sample ended.

    Raises:
        LogError: What the log says is no outcome.
    """
    status = log["solver/status"][sample]
    name = (status.decode(errors="replace") if isinstance(status, bytes) else str(status)).upper()
    if name not in Outcome.__members__:
        raise LogError(f"{log.path}: found the outcome {name.lower()!r} of sample {sample}, which this version has not")
    return Outcome[name]


def _window(log: Log, experiment: Experiment, sequence: Sequence, sample: int) -> tuple[Window, np.ndarray]:
    """Return the window of a sample and the parameter vector of its NLP."""
    spec, stages = experiment.task.controller, experiment.stages[sequence.first : sequence.last + 1]
    nodes = _nodes(log, experiment, sequence, sample)
    shape = window_shape(stages, nodes, spec.discretization, experiment.task.limits_are_soft)
    parameters = read_plan(log.path, "parameters", sample)
    try:
        p = split_parameters(parameters, shape, window_layout(experiment.model, shape))
    except (ValueError, IndexError):
        raise _not_of_the_window(log, sample) from None
    start = float(log.time[sample])
    window = Window(
        stages=stages,
        start=start,
        elapsed=start - sequence.entered,
        x0=p.x0,
        omega=priorities_in_force(spec, stages),
        offset=p.offset,
        scale=p.scale,
        horizon=float(p.horizon),
        pending_cost=float(p.pending),
        terminal_cost=float(p.terminal),
        nodes=nodes,
    )
    return window, parameters


def _nodes(log: Log, experiment: Experiment, sequence: Sequence, sample: int) -> tuple[int, ...]:
    """Return the intervals of each stage in the window of a sample."""
    counts = log.columns.get("window/nodes")
    if counts is None:
        return (experiment.task.controller.uniform_nodes,) * sequence.count
    found = counts[sample, sequence.first : sequence.last + 1]
    if not (np.isfinite(found) & (found >= 1) & (found <= MOST_NODES)).all():
        raise _not_of_the_window(log, sample)
    return tuple(int(count) for count in found)


def _not_of_the_window(log: Log, sample: int) -> LogError:
    return LogError(f"{log.path}: the plan of sample {sample} is not one of the window that the log says it has")
