"""The moving sequence: which stages are in the window at a sample. Paper Algorithm 1."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import partial
from typing import NamedTuple

import numpy as np

from psmpc_cli.ocp.end import SHORTEST, StageProgress
from psmpc_cli.ocp.objective import StageCosts
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.ocp.stage import PlacedStage


@dataclass(frozen=True, eq=False)
class MovingSequence:
    """The stages in the window and when each ends.

    Between two samples switch times live here alone. Those of a plan are the ones that its solve has found.

    Attributes:
        segments: Index of the stage before each switch time of the window, and after the last: the current stage, then
            those that wait, or the current one again where it continues after its own end.
        switch_times: Planned switch times in the window [s], absolute, one fewer.
        progress: How far the current stage has come.
        ended_at: When the task's last stage ended [s]; infinite before. It stays the current one.
    """

    segments: tuple[int, ...]
    switch_times: np.ndarray
    progress: StageProgress
    ended_at: float = np.inf

    @classmethod
    def of(cls, stage: int, entered: float) -> "MovingSequence":
        """Return the sequence of one stage that began at a time [s]."""
        return cls((stage,), np.zeros(0), StageProgress(entered))

    @property
    def first(self) -> int:
        """Index of the current stage."""
        return self.segments[0]

    @property
    def last(self) -> int:
        """Index of the window's last stage."""
        return self.segments[-1]

    @property
    def count(self) -> int:
        """Number of stages in the window; one that continues after its own end counts once."""
        return self.last - self.first + 1

    @property
    def planned_end(self) -> float:
        """When the window has the current stage end [s]; infinite where it does not."""
        return float(self.switch_times[0]) if len(self.switch_times) else np.inf

    @property
    def begins(self) -> tuple[float, ...]:
        """When each stage in the window begins [s]."""
        return (self.progress.entered, *self.switch_times)[: self.count]

    @property
    def current_only(self) -> "MovingSequence":
        """The current stage, without a planned end and without stages that wait."""
        return replace(self, segments=self.segments[:1], switch_times=np.zeros(0))

    def up_to(self, stage: int) -> "MovingSequence":
        """Return the sequence without the stages after one of its own."""
        segments = tuple(index for index in self.segments if index <= stage)
        return replace(self, segments=segments, switch_times=self.switch_times[: len(segments) - 1])

    def extended(self, stage: int, switch_time: float) -> "MovingSequence":
        """Return the sequence with a stage that follows at a switch time [s]."""
        return replace(self, segments=(*self.segments, stage), switch_times=np.r_[self.switch_times, switch_time])

    def after_current(self, ended: float) -> "MovingSequence":
        """Return the sequence once the current stage has ended [s]: those that wait, or the task's next stage."""
        waiting = tuple(index for index in self.segments if index > self.first)
        return MovingSequence(waiting or (self.first + 1,), self.switch_times[1:], StageProgress(ended))

    def moves_grippers(self, holding: range, since: float, now: float) -> bool:
        """Tell whether grippers close or open between two times [s], by switch times.

        Args:
            holding: The stages that hold the object; empty of a task without one to hold.
            since: The earlier time.
            now: The later one.
        """
        switches = (self.first, self.progress.entered), (self.first + 1, self.planned_end)
        moving = (holding.start, holding.stop) if holding else ()
        return any(stage in moving and since <= switch <= now for stage, switch in switches)

    def since_closing(self, held: range) -> float:
        """Return since when the current stage, or what follows the last one, holds the object [s].

        Args:
            held: The stages that hold it; what follows the task's last stage has their number as its index.

        Returns:
            When that stage began; infinite where it does not hold the object.
        """
        has_ended = bool(np.isfinite(self.ended_at))
        began = self.ended_at if has_ended else self.progress.entered
        return began if self.first + has_ended in held else np.inf

    def guess(self, prediction: Plan) -> Plan:
        """Return a prediction with the switch times of the sequence: what a solve of its window starts from."""
        return replace(prediction, switch_times=self.switch_times)

    def with_measurement(
        self, stages: Sequence[PlacedStage], costs: StageCosts, now: float, x: np.ndarray
    ) -> "MovingSequence":
        """Return the sequence after a sample at time now [s] that measured x (2n,)."""
        stage = stages[self.first]
        progress = stage.end.observed(self.progress, now, partial(_is_met, costs, stage, x))
        return replace(self.current_only if progress.hold_lost else self, progress=progress)


class FaultKind(Enum):
    """Why grippers do not hold the object; values are what is said of it, with the name of the stage."""

    MISSED = "missed the object at the end of {stage}"
    """They have not held it since they closed."""

    LOST = "lost the object in {stage}"
    """They have held it since they closed."""

    TIMED_OUT = "did not take the object before the timeout of {stage}"
    """They have not closed in time."""


class GraspFault(NamedTuple):
    """Grippers hold nothing in a stage in which they are to hold the object, or have not taken it in time.

    Attributes:
        grippers: Their arms.
        kind: Why.
        stage: Index of the stage that takes the object, or in which they lost it.
        time: When they closed, when the loss was measured, or when the time was up [s].
    """

    grippers: tuple[str, ...]
    kind: FaultKind
    stage: int
    time: float

    def describe(self, stage_name: str, tries: int) -> str:
        """Write what is wrong, of a stage by its name and after so many tries."""
        what = self.kind.value.format(stage=stage_name)
        last = f", in the last of {tries} tries" if tries > 1 else ""
        return f"{' and '.join(self.grippers)} {what}, at {self.time:.1f} s{last}"


@dataclass(frozen=True)
class GraspProgress:
    """What grippers have reported since they closed last, and what came of earlier tries.

    Attributes:
        is_taken: Every gripper has reported since then that it holds the object.
        returns: How often the sequence has returned to an earlier stage, by index of the stage that allows it.
        fault: The fault after which there is no other try; None while the mission can succeed.
    """

    is_taken: bool = False
    returns: Mapping[int, int] = field(default_factory=dict)
    fault: GraspFault | None = None

    @property
    def has_failed(self) -> bool:
        """Whether there is no other try, so that the mission cannot succeed any more."""
        return self.fault is not None

    @property
    def tries(self) -> int:
        """How often the grippers were to close on the object, the last time included."""
        return 1 + sum(self.returns.values())

    def after_report(
        self,
        sequence: MovingSequence,
        held: range,
        grippers: Sequence[str],
        holding: Mapping[str, bool],
        time: float,
    ) -> tuple["GraspProgress", GraspFault | None]:
        """Take the reports of grippers into account: whether they hold the object, have missed it, or have lost it.

        They have missed it if one reports that it holds nothing before all have reported that they hold it; later, they
        have lost it. Reports from before the grippers closed do not count.

        Args:
            sequence: The stages in the window.
            held: The stages that hold the object.
            grippers: Those that are to hold it, by arm.
            holding: Whether each gripper holds it, by arm; a gripper that does not report is left out.
            time: When that was measured [s].

        Returns:
            The progress of the grasp with these reports, and what is wrong with it; None if nothing is.
        """
        closed = sequence.since_closing(held)
        if not time > closed:  # infinite while the grippers are to be open
            return replace(self, is_taken=False), None
        empty = tuple(gripper for gripper, holds in holding.items() if not holds)
        if not empty:
            is_taken = self.is_taken or all(holding.get(gripper, False) for gripper in grippers)
            return replace(self, is_taken=is_taken), None
        if self.is_taken:
            return self, GraspFault(empty, FaultKind.LOST, sequence.first, time)
        return self, GraspFault(empty, FaultKind.MISSED, held.start - 1, closed)


class Switch(NamedTuple):
    """A stage ended: its index and the switch time [s]."""

    stage: int
    time: float


def drop_passed_stages(sequence: MovingSequence, now: float) -> tuple[MovingSequence, list[Switch]]:
    """Return a sequence without the stages whose planned switch time has passed now [s], and their ends, in order."""
    switches = []
    while sequence.planned_end <= now + SHORTEST:
        switches.append(Switch(sequence.first, sequence.planned_end))
        sequence = sequence.after_current(sequence.planned_end)
    return sequence, switches


def drop_met_stage(
    sequence: MovingSequence, stages: Sequence[PlacedStage], costs: StageCosts, now: float, x: np.ndarray
) -> tuple[MovingSequence, list[Switch]]:
    """Return a sequence without its current stage if the state x (2n,), measured now [s], ends it, and that end.

    If the stage goes on, these are the sequence as it was and an empty list. The task's last stage stays in the
    sequence, with the time of its end.
    """
    stage = stages[sequence.first]
    has_ended = np.isfinite(sequence.ended_at)
    if has_ended or not stage.end.is_over(sequence.progress, now, partial(_is_met, costs, stage, x)):
        return sequence, []
    switches = [Switch(sequence.first, now)]
    if sequence.first == len(stages) - 1:
        return replace(sequence, ended_at=now), switches
    return sequence.after_current(now), switches


def _is_met(costs: StageCosts, stage: PlacedStage, x: np.ndarray) -> bool:
    return bool(costs.met(stage, x[None])[0])


def with_detected_stage(
    sequence: MovingSequence,
    stages: Sequence[PlacedStage],
    costs: StageCosts,
    guess: Plan,
    margin: float,
    is_of_one_stage: bool = False,
) -> MovingSequence | None:
    """Detect whether the last stage of a sequence ends within the horizon; if so, append the stage that follows.

    The stage that follows then enters the window, and its beginning is a free variable of the optimization. Paper
    Algorithm 1.

    Args:
        sequence: The stages in the window.
        stages: All stages of the task, placed at this sample.
        costs: Evaluates their end conditions.
        guess: The last plan from now on, in which the end is looked for.
        margin: The detection margin, by which the tolerances of end conditions are widened.
        is_of_one_stage: Windows hold the current stage alone. In place of the next stage it is appended itself, and
            continues after its own end.

    Returns:
        The longer sequence, with the switch time at which the plan reaches the end; None if it does not.
    """
    if is_of_one_stage and len(sequence.segments) > 1:
        return None
    stage = stages[sequence.last]
    progress = StageProgress(float(sequence.switch_times[-1])) if len(sequence.switch_times) else sequence.progress
    switch_time = stage.end.predicted_end(progress, guess, lambda X: costs.met(stage, X, margin))
    if not np.isfinite(switch_time):
        return None
    return sequence.extended(sequence.last if is_of_one_stage else sequence.last + 1, switch_time)
