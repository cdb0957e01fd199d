"""How a stage ends: at a time, or by its end condition (18): on the robot, on momentum, on the object that it holds."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self

import numpy as np

from psmpc_cli.ocp.loads import NO_KNOWN_LOAD, Load
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.robot.configuration import space_of_pose

SHORTEST = 1e-3
"""Shortest duration of a stage in a window [s], eps of (14)."""

ROUNDING = 1e-9
"""By how much sums of times may miss an instant [s]."""

MEASURES = ("position", "angle", "velocity", "angular_velocity")
"""What an object's end condition may bound [m, rad, m/s, rad/s]."""

MOMENTA = ("linear_momentum", "angular_momentum")
"""What an end condition may bound of robot and held load: momentum, that of rotation about their centre of mass."""

OF_ROTATION = ("angle", "angular_velocity", "angular_momentum")
"""Those of all these that have as many components as a rotation."""


def component_counts(measures: Sequence[str], dimension: int) -> tuple[int, ...]:
    """Return how many components each of some `MEASURES` and `MOMENTA` has in the plane or in space."""
    rotations = dimension * (dimension - 1) // 2
    return tuple(rotations if measure in OF_ROTATION else dimension for measure in measures)


@dataclass(frozen=True)
class NormBound:
    """The largest norm of a vector at the end of a stage.

    Attributes:
        measure: Which vector, of `MEASURES` or `MOMENTA`.
        most: Its largest norm [m, rad, m/s, rad/s, N s, N m s].
        components: How many it has.
    """

    measure: str
    most: float
    components: int


@dataclass(frozen=True)
class StageProgress:
    """How far the current stage has come.

    Attributes:
        entered: When it began [s].
        met_since: Since when every sample has met its end condition [s], where the stage has to hold it; infinite if
            the last one did not.
        hold_lost: The end condition was met and lost again. The next stage then waits until the current one is over.
    """

    entered: float
    met_since: float = np.inf
    hold_lost: bool = False


@dataclass(frozen=True, eq=False)
class PlannedEnd:
    """The end of the current stage as the last plan has it.

    Attributes:
        instant: When [s]; infinite of a plan without one.
        now, next_sample: Times of this sample and the next [s].
        is_renewed: The last solve counts.
        moves_grippers: Grippers close or open at it.
        is_near: Tells whether the measured state meets the end condition within the detection margin.
    """

    instant: float
    now: float
    next_sample: float
    is_renewed: bool
    moves_grippers: bool
    is_near: Callable[[], bool]

    @property
    def has_passed(self) -> bool:
        """Whether it lies in the past."""
        return self.instant < self.now - ROUNDING

    @property
    def is_done(self) -> bool:
        """Whether the grippers have moved by now, which nothing undoes."""
        return self.moves_grippers and self.has_passed


@dataclass(frozen=True)
class EndShape:
    """What of an end decides the structure of a window's optimization.

    Attributes:
        rows: Rows of the error with an end condition at the stage's end; empty: none.
        has_rates: The rates of those rows are bounded too.
        measures: The vectors whose norms are bounded, of the object that the stage holds and of the momentum.
        is_fixed: The stage ends at a given instant.
    """

    rows: tuple[int, ...] = ()
    has_rates: bool = False
    measures: tuple[str, ...] = ()
    is_fixed: bool = False


OPEN = EndShape()
"""Of the last stage of a window, whose end is not imposed."""


@dataclass(frozen=True, eq=False)
class End(ABC):
    """The end of a stage.

    Attributes:
        dwell: Minimum duration of the stage [s], that of its trajectory at least.
        is_planned: Windows may have it as a switch time: not of the task's last stage, not where windows never plan an
            end, and not while the robot is on a route to the stage's target.
        rows: Rows of the error with an end condition (18); empty of a stage that ends otherwise.
        tolerance: Of each [m, rad].
        rate_tolerance: Bounds on their rates, (rows,) [m/s, rad/s]; None where they do not count.
        target_rates: The rates of the rows at which the stage ends, (rows,) [m/s, rad/s]: as the task says, and those
            of a target that moves; empty where both are 0.
        own_rates: Of these what the task says, of all rows of the error, whether or not the end condition has them;
            empty where that is rest. Linear ones of a target on the object are along the object's axes.
        norms: Bounds of vectors of the object and of the momentum.
        load: What momentum is of, beside the robot, where it is bounded.
        hold: How long the end condition must be met without a break [s].
    """

    dwell: float = 0.0
    is_planned: bool = True
    rows: tuple[int, ...] = ()
    tolerance: np.ndarray = field(default_factory=lambda: np.zeros(0))
    rate_tolerance: np.ndarray | None = None
    target_rates: np.ndarray = field(default_factory=lambda: np.zeros(0))
    own_rates: np.ndarray = field(default_factory=lambda: np.zeros(0))
    norms: tuple[NormBound, ...] = ()
    load: Load = NO_KNOWN_LOAD
    hold: float = 0.0

    @property
    def shape(self) -> EndShape:
        """What decides the structure of an optimization."""
        measures = tuple(bound.measure for bound in self.norms)
        return EndShape(rows=self.rows, has_rates=self.rate_tolerance is not None, measures=measures)

    @cached_property
    def half_widths(self) -> np.ndarray:
        """Bounds of all that the end condition measures: its rows, then their rates, then components of vectors.

        Of the c components of a vector it is the bound of the norm / sqrt(c), which keeps the norm.
        """
        rates = np.zeros(0) if self.rate_tolerance is None else self.rate_tolerance
        most = np.array([bound.most for bound in self.norms])
        components = np.array([bound.components for bound in self.norms], int)
        return np.concatenate([self.tolerance, rates, np.repeat(most / np.sqrt(components), components)])

    @cached_property
    def centers(self) -> np.ndarray:
        """About what each of them is bounded: 0, or the rate at which the stage ends."""
        centers = np.zeros(len(self.half_widths))
        if self.rate_tolerance is not None and len(self.target_rates):
            centers[len(self.rows) : 2 * len(self.rows)] = self.target_rates
        return centers

    @property
    def component_numbers(self) -> tuple[int, ...]:
        """How many components each bounded quantity has: 1 for a row of the error or its rate, more for a vector."""
        of_vectors = tuple(bound.components for bound in self.norms)
        return (*(1,) * (len(self.half_widths) - sum(of_vectors)), *of_vectors)

    @property
    def has_condition(self) -> bool:
        """Whether an end condition ends the stage."""
        return len(self.half_widths) > 0

    @property
    def earliest(self) -> float:
        """The first instant at which the stage may end, whatever its duration [s]."""
        return -np.inf

    @property
    def latest(self) -> float:
        """The last instant at which it may [s]."""
        return np.inf

    @property
    def object_names(self) -> tuple[str, ...]:
        """The gripper that holds the object, and what is bounded of it; empty where the object does not matter."""
        return ()

    @property
    def record(self) -> np.ndarray:
        """What samples set of it, for a log: the pose of the object in that gripper, and a load that is found out."""
        return self.load.sampled_numbers if self.norms else np.zeros(0)

    @property
    def arguments(self) -> np.ndarray:
        """What functions of stages take of the object and of the load, behind the numbers of a target."""
        return self.load.numbers

    @property
    def awaits_object(self) -> bool:
        """Whether the object that the stage holds is not yet where the end condition wants it."""
        return False

    def with_dwell(self, dwell: float) -> Self:
        """Return the end of a stage that lasts at least so long [s]."""
        return replace(self, dwell=dwell)

    def unplanned(self) -> Self:
        """Return the end as of a stage whose end no window has."""
        return replace(self, is_planned=False)

    def with_target_rates(self, rates: np.ndarray) -> Self:
        """Return the end of a stage that ends with all rows of its error at these rates (rows,) [m/s, rad/s]."""
        return replace(self, target_rates=rates[list(self.rows)])

    def recorded(self, record: np.ndarray) -> Self:
        """Return the end with what a record of it says, see `record`."""
        return self.with_load(record)

    def with_load(self, numbers: np.ndarray) -> Self:
        """Return the end with the mass and moments of a load, where samples find them out and momentum is bounded."""
        return replace(self, load=self.load.sampled(numbers)) if self.load.is_estimated else self

    def with_held_object(self, grippers: Mapping[str, np.ndarray], pose: np.ndarray, v: np.ndarray) -> Self:
        """Return the end with the held object where it is seen.

        Args:
            grippers: Poses of all frames, (3,) or (7,).
            pose: Estimated pose of the object, as theirs.
            v: Its estimated velocity, (3,) or (6,).
        """
        return self

    def observed(self, progress: StageProgress, now: float, is_met: Callable[[], bool]) -> StageProgress:
        """Return how far the stage has come after a sample at time now [s]."""
        return progress

    def hold_left(self, progress: StageProgress, now: float) -> float:
        """Return for how long the end condition must still be met from time now [s] on [s]."""
        return 0.0

    def time_left(self, progress: StageProgress, now: float, sample_time: float) -> float:
        """Return for how long the stage goes on at least from time now [s] on, beside its dwell time [s]."""
        return self.hold_left(progress, now)

    @abstractmethod
    def is_over(self, progress: StageProgress, now: float, is_met: Callable[[], bool]) -> bool:
        """Tell whether the stage is over, by what is measured at time now [s]."""

    def predicted_end(self, progress: StageProgress, plan: Plan, met: Callable[[np.ndarray], np.ndarray]) -> float:
        """Predict when the stage will end, so that the next stage can be added to the window behind it.

        The prediction is read from a plan in which this is the last stage, which goes on to the end of the horizon.

        Args:
            progress: Progress of the stage: when it was entered. For a stage that begins in the plan, that is its
                planned beginning.
            plan: The plan, from now on.
            met: Tells at which states (K, 2n) the end condition holds within its detection margin (K,).

        Returns:
            The time [s]; infinite if the plan does not reach the end, or windows never plan it (`is_planned`). The next
            stage needs some time: no end is predicted within ten shortest durations of the horizon's end.
        """
        if not self.is_planned:
            return np.inf
        begins = max(plan.start, progress.entered)
        return self._predicted_end(progress, begins, plan.end - 10 * SHORTEST, plan, met)

    @abstractmethod
    def _predicted_end(
        self,
        progress: StageProgress,
        begins: float,
        latest: float,
        plan: Plan,
        met: Callable[[np.ndarray], np.ndarray],
    ) -> float:
        """Return the same for one kind of end, that windows may plan.

        Args:
            progress: Progress of the stage.
            begins: When the stage begins in the plan, at the earliest now [s].
            latest: No end is predicted after this time [s].
            plan: The plan, from now on.
            met: Tells at which states (K, 2n) the end condition holds within its detection margin (K,).
        """

    def accepts(self, planned: PlannedEnd) -> bool:
        """Tell whether the plan may end the stage.

        One that could not be renewed may not where the measured state is far from where it had the stage end.
        """
        if not self.is_planned:
            return False
        return planned.is_done or self._accepts(planned)

    def _accepts(self, planned: PlannedEnd) -> bool:
        return planned.is_renewed or planned.instant > planned.now + SHORTEST or planned.is_near()


@dataclass(frozen=True, eq=False)
class AtTime(End):
    """The end of a stage that switches at a given time.

    Attributes:
        at: The time [s]; infinite of a stage that goes on until the run ends.
    """

    at: float = np.inf

    @property
    def shape(self) -> EndShape:
        """A given instant, unless it never comes."""
        return EndShape(is_fixed=bool(np.isfinite(self.at)))

    @property
    def earliest(self) -> float:
        """The time [s]."""
        return self.at

    @property
    def latest(self) -> float:
        """The time [s]."""
        return self.at

    def is_over(self, progress: StageProgress, now: float, is_met: Callable[[], bool]) -> bool:
        """Tell whether the time has come, and the dwell time has passed."""
        return now - progress.entered >= self.dwell - ROUNDING and now >= self.at - SHORTEST

    def _predicted_end(
        self,
        progress: StageProgress,
        begins: float,
        latest: float,
        plan: Plan,
        met: Callable[[np.ndarray], np.ndarray],
    ) -> float:
        return self.at if begins < self.at < latest else np.inf

    def _accepts(self, planned: PlannedEnd) -> bool:
        return True


NEVER = AtTime()
"""Of a stage without an end."""


@dataclass(frozen=True, eq=False)
class ByState(End):
    """The end of a stage by the state of the robot: errors, their rates and momenta within tolerances. Eq. (18)."""

    def observed(self, progress: StageProgress, now: float, is_met: Callable[[], bool]) -> StageProgress:
        """Return the progress with since when the end condition is met, where it must be held."""
        if self.hold == 0.0:
            return progress
        if is_met():
            return replace(progress, met_since=min(progress.met_since, now))
        hold_lost = progress.hold_lost or bool(np.isfinite(progress.met_since))
        return replace(progress, met_since=np.inf, hold_lost=hold_lost)

    def hold_left(self, progress: StageProgress, now: float) -> float:
        """Return what is left of the time to hold the end condition, all of it while it is not met [s]."""
        return min(max(self.hold - (now - progress.met_since), 0.0), self.hold)

    def is_over(self, progress: StageProgress, now: float, is_met: Callable[[], bool]) -> bool:
        """Tell whether the end condition is met and has been held, and the dwell time has passed."""
        too_early = now - progress.entered < self.dwell - ROUNDING or self.hold_left(progress, now) > ROUNDING
        return not too_early and is_met()

    def _predicted_end(
        self,
        progress: StageProgress,
        begins: float,
        latest: float,
        plan: Plan,
        met: Callable[[np.ndarray], np.ndarray],
    ) -> float:
        """Return when predicted states first meet the end condition within its detection margin [s]; else infinity.

        A plan whose last stage this is only creeps up to the target, so the margin counts. An end condition that has to
        be held for some time is treated otherwise: its end is predicted only once the measured state meets it, and not
        after it was met and lost, so that the next stage cannot break the hold again and again.
        """
        earliest = max(begins, progress.entered + self.dwell)
        if self.hold > 0.0:
            over = max(plan.start + self.hold_left(progress, plan.start), earliest)
            is_holding = np.isfinite(progress.met_since) and not progress.hold_lost
            hits = np.array([over] if is_holding and over <= latest else [])
        else:
            inside = slice(*plan.times.searchsorted((earliest, latest)))
            hits = plan.times[inside][met(plan.X[inside])]
        return max(float(hits[0]), begins + 10 * SHORTEST) if len(hits) else np.inf


@dataclass(frozen=True, eq=False)
class ByObject(ByState):
    """The end of a stage by the object that it holds: near its destination, and at rest; and by the robot's state.

    In a window the object moves rigidly with the first gripper that holds it.

    Attributes:
        frame: The gripper.
        destination: Where the object has to be, (3,) or (7,).
        inside: Its pose in the frame of the gripper, (3,) or (7,).
        awaits_object: It is not yet where it has to be.
    """

    frame: str = ""
    destination: np.ndarray = field(default_factory=lambda: np.zeros(0))
    inside: np.ndarray = field(default_factory=lambda: np.zeros(0))
    awaits_object: bool = False

    @property
    def object_names(self) -> tuple[str, ...]:
        """The gripper, and what is bounded."""
        return (self.frame, *(bound.measure for bound in self.norms if bound.measure in MEASURES))

    @property
    def arguments(self) -> np.ndarray:
        """Where the object is in the gripper, where it has to be, and the numbers of the load."""
        return np.concatenate([self.inside, self.destination, super().arguments])

    @property
    def record(self) -> np.ndarray:
        """Where the object is in the gripper, and a load that is found out."""
        return np.concatenate([self.inside, super().record])

    def recorded(self, record: np.ndarray) -> Self:
        """Return the end with the object at a pose in the gripper, and with a load."""
        inside, of_load = np.split(record, [len(self.inside)])
        return replace(self, inside=inside).with_load(of_load)

    def with_held_object(self, grippers: Mapping[str, np.ndarray], pose: np.ndarray, v: np.ndarray) -> Self:
        """Return the end with the object where it is seen in its gripper; it is awaited until it is delivered."""
        inside = space_of_pose(len(pose)).relative(pose, grippers[self.frame])
        return replace(self, inside=inside, awaits_object=not self._is_delivered(pose, v))

    def _is_delivered(self, pose: np.ndarray, v: np.ndarray) -> bool:
        """Tell whether an object of a pose, (3,) or (7,), and a velocity, (3,) or (6,), is where it has to be."""
        space = space_of_pose(len(pose))
        d = space.dimension
        error = space.pose_error(pose, self.destination)
        lengths = dict(zip(MEASURES, map(np.linalg.norm, (error[:d], error[d:], v[:d], v[d:])), strict=True))
        return all(lengths[bound.measure] <= bound.most for bound in self.norms if bound.measure in lengths)

    def time_left(self, progress: StageProgress, now: float, sample_time: float) -> float:
        """Return the same; an object that is awaited cannot be seen to be there before the next sample."""
        return max(self.hold_left(progress, now), sample_time * self.awaits_object)

    def is_over(self, progress: StageProgress, now: float, is_met: Callable[[], bool]) -> bool:
        """Tell whether the object has been seen where it has to be, and the robot's end condition is met."""
        return not self.awaits_object and super().is_over(progress, now, is_met)

    def _accepts(self, planned: PlannedEnd) -> bool:
        """Tell the same; while the object is awaited the plan may not end the stage before the next sample sees it."""
        if self.awaits_object:
            return planned.has_passed or planned.instant > planned.next_sample
        return super()._accepts(planned)
