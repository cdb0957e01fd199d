"""Windows of real runs, each kept with all that it takes to solve it again, on any mesh."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from psmpc_cli.control.controller import SwitchingController
from psmpc_cli.control.decision import Decision
from psmpc_cli.control.sequence import detect
from psmpc_cli.ocp.window import Window
from psmpc_cli.simulation.loop import closed_loop
from psmpc_cli.simulation.setup import Experiment, build_experiment
from psmpc_cli.solvers import Solution
from psmpc_cli.specs.load import Task

PHASES = ("before", "at", "after")
"""Which samples are kept around one whose window a stage enters."""

RECORDED = ("solver.kind=sqp", "log.shares=false")
"""What the runs that windows are taken from have in common."""


@dataclass(frozen=True, eq=False)
class Recorded:
    """A window of a run.

    Attributes:
        controller: The run's, psmpc or smpc.
        phase: Where it stands with regard to an append, one of `PHASES`.
        window: The window, with the measured state, priorities and normalization of the run.
        instants: Where its solve guessed the instants (S,) [s], the detected one among them.
        before: The solve of the sample before, with its window, plan and multipliers.
    """

    controller: str
    phase: str
    window: Window
    instants: np.ndarray
    before: Solution

    @property
    def stages(self) -> int:
        """Number of stages in the window."""
        return len(self.window.stages)


class _Recorder(SwitchingController):
    """A controller that keeps every window it solved, None where it or the one before was not solved."""

    def __init__(self, controller: SwitchingController) -> None:
        super().__init__(controller.problem, controller.solver)
        self.samples: list[Recorded | None] = []
        self.appends: list[int] = []

    def decide(self, now: float, x: np.ndarray) -> Decision:
        """Return the decision at time now [s] from the measured state x (2n,)."""
        begun, before = self.sequence, self.solved
        decision = super().decide(now, x)
        if decision.appended:
            self.appends.append(len(self.samples))
            longer = detect(begun, self.stages, self.costs, decision.prediction, self.spec.detection_margin)
            begun = longer or begun
        if before is None or decision.solve_failed or not before.outcome.usable:
            self.samples.append(None)
        else:
            self.samples.append(Recorded(self.spec.kind, "", decision.solved.window, begun.instants, before))
        return decision

    def around_appends(self) -> list[Recorded]:
        """Return the windows before, at and after each append, where all three are there."""
        found = []
        for k in self.appends:
            around = [recorded for recorded in self.samples[max(k - 1, 0) : k + 2] if recorded is not None]
            if len(around) == len(PHASES):
                found += [replace(recorded, phase=phase) for phase, recorded in zip(PHASES, around, strict=True)]
        return found


def record_windows(
    loaded: Task, most: int | None = None, passed: Callable[[], None] = lambda: None
) -> tuple[Experiment, list[Recorded]]:
    """Run the closed loop of a task and return its experiment with the windows around every append.

    Args:
        loaded: The task, its controller psmpc or smpc.
        most: So many appends are enough, and the run ends after them.
        passed: Called after every sample.
    """
    experiment = build_experiment(loaded)
    recorder = _Recorder(experiment.controller)
    for _ in closed_loop(replace(experiment, controller=recorder)):
        passed()
        if most is not None and len(recorder.around_appends()) >= most * len(PHASES):
            break
    return experiment, recorder.around_appends()


def distinct(windows: Sequence[Recorded]) -> list[Recorded]:
    """Return the windows without those that an earlier one equals: while one stage stands alone, so do the runs."""
    kept: list[Recorded] = []
    for recorded in windows:
        if not any(_equal(recorded.window, other.window) for other in kept):
            kept.append(recorded)
    return kept


def _equal(one: Window, other: Window) -> bool:
    """Tell whether two windows are one problem: priorities count by their ratios."""
    if one.start != other.start or [s.index for s in one.stages] != [s.index for s in other.stages]:
        return False
    scaled = [window.omega / window.omega.max() for window in (one, other)]
    pairs = ((one.x0, other.x0), (one.offset, other.offset), (one.scale, other.scale), (scaled[0], scaled[1]))
    return all(np.array_equal(first, second) for first, second in pairs)
