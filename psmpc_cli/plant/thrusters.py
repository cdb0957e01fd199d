"""How thrusters fire: the wrench that the low-level law wants on the base, in pulses, once a period.

At the beginning of a period the law says which wrench the mean acceleration over the period takes; where the period
goes on after the sample, the mean over what is left of the sample, since no more is commanded yet. What is wanted is
its impulse and what is owed from before: what pulses gave too little or too much because they last whole ticks and no
shorter than the shortest, and what the law's wrench was besides. A part that no thrusts can give is refused, and not
owed. So the impulse of the pulses follows that of the law, and differs from it by no more than some shortest pulses.
Where the law begins to account for a load, or no longer does, it asks for another wrench: a new period begins.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from psmpc_cli.robot.actuators.thrusters import Thrusters
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.task import TaskSpec

ROUNDING = 1e-9
"""Error by rounding of a time [s], and of a number of samples."""

ROUNDING_OF_TICKS = 1e-6
"""Error by rounding of a number of ticks."""


@dataclass(frozen=True, eq=False)
class ThrusterTicks:
    """What the T thrusters of a base did over one sample; impulses are of wrenches along the base's own axes.

    Attributes:
        thrusts: Over each tick (M, T) [N].
        impulses: Of each thruster (T,) [N s].
        firings: How often each began to fire (T,).
        owed: Impulse wanted by the law until the end of the sample, and neither given nor refused (3,) or (6,) [N s,
            N m s].
        refused: Impulse wanted over periods that began in the sample and that no thrusts can give (3,) or (6,) [N s,
            N m s].
        shut: Share of the ticks at which each was shut because of its plume (T,).
    """

    thrusts: np.ndarray
    impulses: np.ndarray
    firings: np.ndarray
    owed: np.ndarray
    refused: np.ndarray
    shut: np.ndarray

    @classmethod
    def joined(cls, parts: Sequence["ThrusterTicks"]) -> "ThrusterTicks":
        """Return what they did over a sample whose ticks were advanced part by part."""
        return cls(
            thrusts=np.concatenate([part.thrusts for part in parts]),
            impulses=np.sum([part.impulses for part in parts], axis=0),
            firings=np.sum([part.firings for part in parts], axis=0),
            owed=parts[-1].owed,
            refused=np.sum([part.refused for part in parts], axis=0),
            shut=np.average([part.shut for part in parts], axis=0, weights=[len(part.thrusts) for part in parts]),
        )


@dataclass(frozen=True)
class FiringSpan:
    """Ticks of a sample in which thrusters are all off, or which are within one period of pulses.

    Attributes:
        first: The first tick.
        last: The tick after the last one.
        is_pushed: Whether thrusters push the base.
        begins: Whether a period of pulses begins at the first.
    """

    first: int
    last: int
    is_pushed: bool
    begins: bool

    @property
    def ticks(self) -> slice:
        """The ticks."""
        return slice(self.first, self.last)

    @property
    def count(self) -> int:
        """Number of ticks."""
        return self.last - self.first


class ThrusterFiring:
    """What the thrusters of one run fire, tick by tick; wrenches are about the base's origin, along its own axes.

    Attributes:
        thrusters: The thrusters.
        period: Number of ticks in which each fires at most one pulse.
        mean_wrench: Mean wrench over the period that has begun (d,) [N, N m].
    """

    def __init__(self, thrusters: Thrusters, period: int, tick: float, pulsed: bool = True) -> None:
        """Set up thrusters that are not firing.

        Once a period they plan pulses whose mean is the wrench that the low-level law wants.

        Args:
            thrusters: The thrusters, with their wrenches and shortest pulses.
            period: Number of ticks in which each fires at most one pulse.
            tick: Length of a tick of the low-level loop [s].
            pulsed: Whether they fire in pulses; otherwise they give the mean over the period at each of its ticks.
        """
        self.thrusters = thrusters
        self.period = period
        self._tick = tick
        self._pulsed = pulsed
        d = len(thrusters.wrenches)
        T = thrusters.count

        # of the period of pulses
        self.mean_wrench = np.zeros(d)  # [N, N m]
        self._next_period_ticks = period  # ticks of the period that begins next
        self._planned_thrusts = np.zeros((0, T))  # over the ticks that are left of the period [N]
        # thrusts of pulses of the period before that go on in this one, over its first ticks [N]
        self._unfinished_thrusts = self._planned_thrusts
        # impulse that the law has asked for, and pulses have not given yet [N s, N m s]
        self._owed_impulse = np.zeros(d)
        self._law_has_load = False  # whether the law accounts for a load in the grippers

        # of the sample, for its log
        self._thrusts_of_sample: list[np.ndarray] = []  # thrusts over its ticks so far [N]
        self._fired_last = np.zeros(T, bool)  # which fired at the last tick of the sample before
        self._refused_impulse = np.zeros(d)  # impulse that no thrusts can give [N s, N m s]
        # which are shut, since their plumes would hit something, at the ticks that are left; None: none
        self._is_shut: np.ndarray | None = None
        self._share_shut = np.zeros(T)  # share of its ticks at which each is shut

    def begin_sample(self, is_shut: np.ndarray | None) -> None:
        """Take in which thrusters are shut at the ticks of the sample that begins (M, T); None: none is."""
        if is_shut is None or not is_shut.any():
            return
        self._is_shut = is_shut
        self._share_shut = is_shut.mean(axis=0)

    @property
    def ticks_left(self) -> int:
        """Number of ticks until another period begins."""
        return len(self._planned_thrusts)

    def next_span(self, driven: np.ndarray | None, first: int, last: int) -> "FiringSpan":
        """Return the ticks, from one on, in which thrusters are all off or which are within one period of pulses.

        Plants advance over them at once. A period begins where thrusters push the base and no period is under way; the
        caller then calls `begin_period`.

        Args:
            driven: At each tick of the sample, 1 for a coordinate of the base on which something acts, else 0 (M, d).
                Thrusters push the base where something acts on its position. None: they always do.
            first: The first tick.
            last: The tick after the last that may be among them.
        """
        end_of_phase = last  # where thrusters next begin or cease to push
        if driven is not None:
            # wheels can turn a base but not move it: the first coordinate, of position, tells
            is_pushed = driven[first:last, 0] > 0
            change_ticks = np.flatnonzero(is_pushed != is_pushed[0])
            end_of_phase = first + int(change_ticks[0]) if change_ticks.size else last
            if not is_pushed[0]:
                return FiringSpan(first, end_of_phase, is_pushed=False, begins=False)
        end_of_period = first + (self.ticks_left or self._next_period_ticks)
        return FiringSpan(first, min(end_of_period, end_of_phase), is_pushed=True, begins=not self.ticks_left)

    def end_period_if_load_changed(self, is_loaded: bool) -> None:
        """End the period of pulses early where the low-level law begins or ceases to account for a held load.

        The law then wants another wrench than the period was planned for. The next period lasts as long as the rest of
        this one, so that periods stay in step with samples; if that is too short for a pulse, it lasts a whole period
        more. Pulses that have begun go on to their ends.

        Args:
            is_loaded: Whether the law accounts for a load in the grippers from this tick on.
        """
        if is_loaded == self._law_has_load:
            return
        self._law_has_load = is_loaded
        ticks_left = self.ticks_left
        if not ticks_left:
            return
        pulse_fits = ticks_left * self._tick >= self.thrusters.shortest_pulse.max() - ROUNDING
        self._next_period_ticks = ticks_left if pulse_fits else ticks_left + self.period
        is_firing = self._thrusts_of_sample[-1][-1] > 0 if self._thrusts_of_sample else self._fired_last
        # at which ticks a thruster (T,) that fires now goes on: up to its first tick without thrust
        is_same_pulse = self._pulsed & is_firing & np.logical_and.accumulate(self._planned_thrusts > 0, axis=0)
        self._unfinished_thrusts = np.where(is_same_pulse, self._planned_thrusts, 0.0)
        self._planned_thrusts = self._planned_thrusts[:0]  # none is left: a new period is due

    def begin_period(self, wanted: np.ndarray) -> None:
        """Begin a period of pulses: plan thrusts, tick by tick, that give a wanted mean wrench.

        What earlier periods owe (impulse that pulses could not give, as they last whole ticks) is wanted too, less what
        pulses that have not ended yet will give. What the thrusters cannot give together is refused, and not owed any
        more, so that it does not add up.

        Args:
            wanted: Mean wrench that the law wants on the base over the period, along the base's axes (d,) [N, N m].
        """
        period_ticks = self._next_period_ticks
        period_length = period_ticks * self._tick
        is_shut = None if self._is_shut is None else self._is_shut[0]
        if is_shut is not None:
            self._unfinished_thrusts = np.where(is_shut, 0.0, self._unfinished_thrusts)
        # wrenches (d, T) of unit thrusts, times the sum over the ticks
        impulse_of_unfinished = self._tick * self.thrusters.wrenches @ self._unfinished_thrusts.sum(axis=0)
        allocation = self.thrusters.allocate(
            wanted + (self._owed_impulse - impulse_of_unfinished) / period_length, is_shut
        )
        self._refused_impulse += allocation.residual * period_length
        self._owed_impulse -= allocation.residual * period_length
        if self._pulsed:
            self._planned_thrusts = self.thrusters.pulses(allocation.thrusts, period_ticks, self._tick)
            # a thruster in an unfinished pulse fires no second one meanwhile
            unfinished_ticks = slice(len(self._unfinished_thrusts))
            self._planned_thrusts[unfinished_ticks] = np.maximum(
                self._planned_thrusts[unfinished_ticks], self._unfinished_thrusts
            )
        else:
            self._planned_thrusts = np.tile(allocation.thrusts, (period_ticks, 1))
        self.mean_wrench = self.thrusters.wrenches @ self._planned_thrusts.mean(axis=0)
        self._next_period_ticks = self.period
        self._unfinished_thrusts = self._unfinished_thrusts[:0]

    def wrenches(self, ticks: int) -> np.ndarray:
        """Return the wrenches that the thrusters give at the next ticks of this period (ticks, d) [N, N m]."""
        return np.asarray(self._fired_thrusts(ticks) @ self.thrusters.wrenches.T)

    def _fired_thrusts(self, ticks: int) -> np.ndarray:
        """Return the thrusts at the next ticks of this period (ticks, T) [N], 0 where a thruster is shut."""
        thrusts = self._planned_thrusts[:ticks]
        return thrusts if self._is_shut is None else np.where(self._is_shut[:ticks], 0.0, thrusts)

    def record_ticks(self, wanted: np.ndarray, is_pushed: bool) -> None:
        """Account for ticks that have passed: record what was fired, and update what is owed to the low-level law.

        Impulse is owed that the law wanted and the thrusters have not given; the next period makes up for it. Where
        thrusters do not push the base they are off, nothing is owed, and the period of pulses is over.

        Args:
            wanted: Wrenches that the law wanted on the base at the ticks, along the base's axes (ticks, d) [N, N m].
            is_pushed: Whether thrusters pushed the base.
        """
        ticks = len(wanted)
        if is_pushed:
            self._owed_impulse += self._tick * (wanted - self.wrenches(ticks)).sum(axis=0)
            self._thrusts_of_sample.append(self._fired_thrusts(ticks))
            self._planned_thrusts = self._planned_thrusts[ticks:]
        else:
            self._owed_impulse[:] = 0.0
            self._thrusts_of_sample.append(np.zeros((ticks, self.thrusters.count)))
            self._planned_thrusts = self._planned_thrusts[:0]
            self._unfinished_thrusts = self._unfinished_thrusts[:0]
            self._next_period_ticks = self.period
        if self._is_shut is not None:
            self._is_shut = self._is_shut[ticks:]

    def end_sample(self) -> ThrusterTicks:
        """Return what was fired over the sample that ends, for its log, and begin the record of the next one.

        A thruster begins to fire at a tick if it did not at the tick before, which may be the last of the sample
        before.
        """
        thrusts = np.concatenate(self._thrusts_of_sample)
        is_firing = np.vstack([self._fired_last, thrusts > 0])
        sample = ThrusterTicks(
            thrusts=thrusts,
            impulses=self._tick * thrusts.sum(axis=0),
            firings=(np.diff(is_firing.astype(int), axis=0) > 0).sum(axis=0),
            owed=self._owed_impulse.copy(),
            refused=self._refused_impulse.copy(),
            shut=self._share_shut,
        )
        self._thrusts_of_sample = []
        self._is_shut = None
        self._share_shut = np.zeros(self.thrusters.count)
        self._fired_last = is_firing[-1]
        self._refused_impulse[:] = 0.0
        return sample


def firing_of(task: TaskSpec, model: RobotModel) -> ThrusterFiring | None:
    """Set up how the thrusters of a task's robot fire, for the plants that simulate forces.

    The period of pulses is that of the robot's description, rounded up to whole ticks. By default it is the sample
    time, since the law follows another acceleration in each sample. Where thrusters need longer pulses than that, it is
    as many samples as all of them need for their shortest pulse.

    Args:
        task: The task, with its rates, and whether thrusters fire in pulses.
        model: The robot.

    Returns:
        The thrusters before they fire; None if the task fires none, or the plant has no forces.
    """
    if not (task.fires(model.spec) and task.plant.traits.has_forces):
        return None
    thrusters = Thrusters.of(model.spec.thrusters)
    tick = 1 / task.plant.low_level_rate
    sample_time = task.controller.sample_time
    period = model.spec.pulse_period  # [s]
    # by rounding a quotient may be a little more than a whole number, which must not become the next one
    if period is None:
        period = sample_time * max(1.0, np.ceil(thrusters.shortest_pulse.max() / sample_time - ROUNDING))
    period_ticks = int(np.ceil(period / tick - ROUNDING_OF_TICKS))
    return ThrusterFiring(thrusters, period_ticks, tick, pulsed=task.plant.thrusters == "pulsed")
