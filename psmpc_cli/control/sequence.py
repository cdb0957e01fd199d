"""The moving sequence: which stages are in the window at a sample. Paper Algorithm 1."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from psmpc_cli.ocp.objective import StageCosts
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.ocp.stage import PlacedStage
from psmpc_cli.ocp.window import SHORTEST


@dataclass(frozen=True, eq=False)
class MovingSequence:
    """The stages in the window and when each ends.

    Between two samples switch times live here alone. Those of a plan are the ones that its solve has found.

    Attributes:
        first: Index of the current stage.
        instants: Planned switch times in the window [s], absolute; as many as stages that follow the current one, or
            the planned end of the current one alone where it continues.
        entered: When the current stage began [s].
        met_since: Since when every sample has met the end condition of the current stage [s], where the stage has to
            hold it; infinite if the last one did not.
        broken: The end condition was met and lost again. The next stage then waits until the current one is over.
        ended_at: When the task's last stage ended [s]; infinite before. It stays the current one.
        continues: The current stage itself follows upon its planned end in the window, in place of the next one.
    """

    first: int
    instants: np.ndarray
    entered: float
    met_since: float = np.inf
    broken: bool = False
    ended_at: float = np.inf
    continues: bool = False

    @property
    def count(self) -> int:
        """Number of stages in the window; one that continues after its planned end counts once."""
        return self.last - self.first + 1

    @property
    def plans_end(self) -> bool:
        """Whether the window has a planned end of the current stage."""
        return len(self.instants) > 0

    @property
    def begins(self) -> tuple[float, ...]:
        """When each stage in the window begins [s]."""
        return (self.entered, *self.instants)[: self.count]

    @property
    def alone(self) -> "MovingSequence":
        """The current stage, without a planned end and without stages that wait."""
        return replace(self, instants=np.zeros(0), continues=False)

    @property
    def last(self) -> int:
        """Index of the window's last stage."""
        return self.first if self.continues else self.first + len(self.instants)

    @property
    def parts(self) -> tuple[int, ...]:
        """Indices of the stages between the window's switch times: the current one twice where it continues."""
        return (self.first, self.first) if self.continues else tuple(range(self.first, self.last + 1))

    def guess(self, prediction: Plan) -> Plan:
        """Return a prediction with the switch times of the sequence: what a solve of its window starts from."""
        return replace(prediction, instants=self.instants)

    def with_measurement(
        self, stages: Sequence[PlacedStage], costs: StageCosts, now: float, x: np.ndarray
    ) -> "MovingSequence":
        """Return the sequence after a sample at time now [s] that measured x (2n,)."""
        stage = stages[self.first]
        if not stage.hold:
            return self
        if costs.met(stage, x[None])[0]:
            return replace(self, met_since=min(self.met_since, now))
        broken = self.broken or np.isfinite(self.met_since)
        return replace(self.alone if broken else self, met_since=np.inf, broken=broken)

    def hold_left(self, stages: Sequence[PlacedStage], now: float) -> float:
        """Return for how long the end condition of the current stage must still be met at time now [s] on [s]."""
        hold = stages[self.first].hold
        return min(max(hold - (now - self.met_since), 0.0), hold)


class Switch(NamedTuple):
    """A stage ended: its index and the switch time [s]."""

    stage: int
    time: float


def drop_passed(sequence: MovingSequence, now: float) -> tuple[MovingSequence, list[Switch]]:
    """Drop the stages whose planned switch time lies before now."""
    switches = []
    while sequence.plans_end and sequence.instants[0] <= now + SHORTEST:
        at = float(sequence.instants[0])
        switches.append(Switch(sequence.first, at))
        sequence = MovingSequence(sequence.first + 1, sequence.instants[1:], at)
    return sequence, switches


def is_over(
    sequence: MovingSequence, stages: Sequence[PlacedStage], costs: StageCosts, now: float, x: np.ndarray
) -> bool:
    """Tell whether the current stage is over: at its fixed time, or when its end condition is met and has been held.

    The end condition is that of x (2n,), and of the object where the stage ends by the object that it holds.
    """
    stage = stages[sequence.first]
    if stage.awaits_object:
        return False
    if now - sequence.entered < stage.dwell - 1e-9 or sequence.hold_left(stages, now) > 1e-9:
        return False
    return bool(costs.met(stage, x[None])[0] if stage.at is None else now >= stage.at - SHORTEST)


def drop_met(
    sequence: MovingSequence, stages: Sequence[PlacedStage], costs: StageCosts, now: float, x: np.ndarray
) -> tuple[MovingSequence, list[Switch]]:
    """Drop the current stage if it is over; the task's last stage ends, and stays."""
    if np.isfinite(sequence.ended_at) or not is_over(sequence, stages, costs, now, x):
        return sequence, []
    switches = [Switch(sequence.first, now)]
    if sequence.first == len(stages) - 1:
        return replace(sequence, ended_at=now), switches
    return MovingSequence(sequence.first + 1, sequence.instants[1:], now), switches


def detect(
    sequence: MovingSequence, stages: Sequence[PlacedStage], costs: StageCosts, guess: Plan, margin: float
) -> MovingSequence | None:
    """Return the sequence with the next stage appended if its switch is seen in the prediction, else None.

    It is seen when the predicted states meet the end condition of the window's last stage within its detection margin
    (a stage alone only creeps up to its target), or when its fixed switching time lies in the horizon. The successor of
    a stage that has to hold its end condition is seen once the current state meets it, unless it was lost before: so
    that its pull cannot break the hold again and again. Nothing follows a stage that continues.
    """
    if sequence.continues or sequence.last == len(stages) - 1:
        return None
    stage = stages[sequence.last]
    begins = float(sequence.instants[-1]) if sequence.plans_end else guess.start
    since = begins if sequence.plans_end else sequence.entered
    latest = guess.end - 10 * SHORTEST
    if stage.at is not None:
        return _appended(sequence, stage.at) if begins < stage.at < latest else None
    earliest = max(begins, since + stage.dwell)
    if stage.hold:
        over = max(guess.start + sequence.hold_left(stages, guess.start), earliest)
        holding = not sequence.plans_end and np.isfinite(sequence.met_since) and not sequence.broken
        return _appended(sequence, max(over, begins + 10 * SHORTEST)) if holding and over <= latest else None
    inside = slice(*guess.times.searchsorted((earliest, latest)))
    hits = guess.times[inside][costs.met(stage, guess.X[inside], margin)]
    return _appended(sequence, max(float(hits[0]), begins + 10 * SHORTEST)) if len(hits) else None


def _appended(sequence: MovingSequence, instant: float) -> MovingSequence:
    return replace(sequence, instants=np.r_[sequence.instants, instant])
