"""Stages of a task: what the task says of them, and what a sample of the controller sets."""

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import TypeAlias

import numpy as np

from psmpc_cli.ocp.loads import Load
from psmpc_cli.robot.configuration import space_of_pose
from psmpc_cli.robot.free_body import FreeBody
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.parts import Space
from psmpc_cli.specs.robot import Limits

FOLLOWED = 41
"""Points of the object's predicted motion that a cost follows: at 10 deg/s over 4 s straight to 0.03 mm at 0.6 m."""


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A desired trajectory: values (T, rows) at times (T,) [s] since the stage began.

    Between them numbers change at a constant rate, and attitudes turn at one about an axis (Shoemake: Animating
    rotation with quaternion curves, 1985).

    Attributes:
        attitudes: First columns of unit quaternions; from row to row each is the nearer one of the two for an attitude.
    """

    times: np.ndarray
    values: np.ndarray
    attitudes: tuple[int, ...] = ()

    def __repr__(self) -> str:
        return f"<Trajectory of {self.values.shape[1]} numbers: {len(self.times)} times to {self.times[-1]:g} s>"

    @cached_property
    def _angles(self) -> np.ndarray:
        """Angle by which the quaternion of each column turns from row to row (T - 1, rows) [rad]; 0 of a number."""
        angles = np.zeros((len(self.times) - 1, self.values.shape[1]))
        for at in self.attitudes:
            q = self.values[:, at : at + 4]
            difference = np.linalg.norm(q[1:] - q[:-1], axis=1)
            total = np.linalg.norm(q[1:] + q[:-1], axis=1)
            angles[:, at : at + 4] = 2 * np.arctan2(difference, total)[:, None]
        return angles

    def at(self, since: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
        """Interpolate the trajectory: what a stage's cost is to follow at given times, and how fast that moves.

        Between the rows a and b, which lie an angle phi apart, at the fraction s of the interval (Shoemake's slerp),

            value(s) = (sin((1 - s) phi) a + sin(s phi) b) / sin(phi).

        A number has phi = 0, where the limit is linear interpolation; so sin(x) is written as x sinc(x), which needs no
        case of its own. Before the first time and after the last one the trajectory stands still.

        Args:
            since: Times since the stage began (...,) [s].

        Returns:
            The values (..., rows) [m, rad], and their rates just after these times (..., rows) [m/s, rad/s].
        """
        interval = np.clip(self.times.searchsorted(since, side="right") - 1, 0, len(self.times) - 2)
        duration = np.diff(self.times)[interval][..., None]
        fraction = np.clip((since - self.times[interval])[..., None] / duration, 0.0, 1.0)
        moves = np.asarray((since >= self.times[0]) & (since < self.times[-1]))
        phi = self._angles[interval]
        before = self.values[interval]
        after = self.values[interval + 1]
        weight_before = (1 - fraction) * _sinc((1 - fraction) * phi) / _sinc(phi)
        weight_after = fraction * _sinc(fraction * phi) / _sinc(phi)
        values = weight_before * before + weight_after * after
        rates = (np.cos(fraction * phi) * after - np.cos((1 - fraction) * phi) * before) / _sinc(phi) / duration
        return values, rates * moves[..., None]


def _sinc(angle: np.ndarray) -> np.ndarray:
    """Return sin(angle) / angle."""
    return np.asarray(np.sinc(angle / np.pi))


@dataclass(frozen=True, eq=False)
class ObjectEnd:
    """The part of an end condition that is about the object a stage holds: near its destination, and at rest.

    In a window the object moves rigidly with the first gripper that holds it.

    Attributes:
        frame: The gripper.
        measures: What is bounded, of `MEASURES`; empty: nothing, and all else is empty too.
        tolerance: Its bounds, one for each measure [m, rad, m/s, rad/s].
        destination: Where the object has to be, (3,) or (7,).
        inside: Its pose in the frame of the gripper, (3,) or (7,).
    """

    frame: str
    measures: tuple[str, ...]
    tolerance: np.ndarray
    destination: np.ndarray
    inside: np.ndarray

    @property
    def names(self) -> tuple[str, ...]:
        """The gripper and the measures, which decide the structure of an optimization; empty without any."""
        return (self.frame, *self.measures) if self.measures else ()

    @property
    def numbers(self) -> np.ndarray:
        """What `StageFunctions` takes of it behind the numbers of a target."""
        return np.concatenate([self.inside, self.destination])

    @property
    def counts(self) -> tuple[int, ...]:
        """Number of components of each measure."""
        return component_counts(self.measures, space_of_pose(len(self.inside)).dimension) if self.measures else ()

    @property
    def row_tolerance(self) -> np.ndarray:
        """The bound of each component in a window, of c of them tolerance / sqrt(c): their length then keeps it."""
        counts = np.array(self.counts, int)
        return np.repeat(self.tolerance / np.sqrt(counts), counts)

    def is_met(self, pose: np.ndarray, v: np.ndarray) -> bool:
        """Tell whether an object of a pose, (3,) or (7,), and a velocity, (3,) or (6,), is where it has to be."""
        space = space_of_pose(len(pose))
        d = space.dimension
        error = space.pose_error(pose, self.destination)
        found = dict(zip(MEASURES, map(np.linalg.norm, (error[:d], error[d:], v[:d], v[d:])), strict=True))
        return all(found[measure] <= most for measure, most in zip(self.measures, self.tolerance, strict=True))


MEASURES = ("position", "angle", "velocity", "angular_velocity")
"""What an object's end condition may bound [m, rad, m/s, rad/s]."""

OF_ROTATION = ("angle", "angular_velocity")
"""Those of them that have as many components as a rotation."""


def component_counts(measures: Sequence[str], dimension: int) -> tuple[int, ...]:
    """Return how many components each of some `MEASURES` has in the plane or in space."""
    rotations = dimension * (dimension - 1) // 2
    return tuple(rotations if measure in OF_ROTATION else dimension for measure in measures)


NO_OBJECT_END = ObjectEnd("", (), np.zeros(0), np.zeros(0), np.zeros(0))
"""Of a stage that does not end by an object."""


@dataclass(frozen=True, eq=False)
class SampleView:
    """What a sample has for the arguments of constraints.

    Attributes:
        time: Of the sample [s].
        x: State in the chart (2n,).
        anchor: Of the chart.
        ahead: Times [s] and states (M, 2n) of the plan in force from now on; None before the first plan.
        object_state: Estimated pose and velocity of the object; None without one with a mass.
        is_current: The stage has begun.
        before: The argument at the sample before, or None.
    """

    time: float
    x: np.ndarray
    anchor: np.ndarray
    ahead: tuple[np.ndarray, np.ndarray] | None = None
    object_state: tuple[np.ndarray, np.ndarray] | None = None
    is_current: bool = True
    before: np.ndarray | None = None


ArgumentAtSample: TypeAlias = Callable[[RobotModel, SampleView], np.ndarray | None]
"""Robot, what a sample has -> argument (numbers,), NaN while the constraint has no rows; None where it is not said."""


@dataclass(frozen=True, eq=False)
class ConstraintNumbers:
    """What a constraint of `ocp.constraints` has of a stage that it concerns.

    Attributes:
        structure: What decides its functions beside the robot.
        argument: The numbers that its functions take (numbers,); NaN while they are not known.
        low, high: Bounds of its rows (rows,).
        at_sample: How a sample sets the argument, which records of windows then hold; None where the task says all of
            it.
        at_nodes: Argument, times of nodes since the sample (N,) -> what its functions take at each, (N, numbers); None
            where that is the argument itself.
    """

    structure: Hashable
    argument: np.ndarray
    low: np.ndarray
    high: np.ndarray
    at_sample: ArgumentAtSample | None = None
    at_nodes: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None

    @cached_property
    def is_known(self) -> bool:
        """Whether the argument is known; without it the constraint has no rows."""
        return bool(np.isfinite(self.argument).all())


@dataclass(frozen=True, eq=False)
class Stage:
    """One stage of the task, resolved for one robot: what does not change while the robot moves.

    Attributes:
        target: Target in the order of Q (n,) or xi (m,) [m, rad]; of a trajectory, its last value.
        trajectory: The desired trajectory the cost follows, or None where it is the target throughout.
        weights: Diagonal of W_q or W_p, as `target`.
        control_weights: Diagonal of W_r, one per input; behind it that of W_F, one per coordinate, where force costs.
        force_load: What the grippers are known to hold, where force costs; None where it does not.
        end_rows: Rows of the error on which the end condition (18) stands; empty where `at` is given.
        tolerance: Its tolerance, one per end row [m, rad].
        end_velocity: Bounds on the rates of those rows, as `tolerance` [m/s, rad/s], or None.
        hold: How long the end condition must be met without a break [s].
        at: Fixed switching time [s], or None.
        dwell: Minimum duration [s], that of the trajectory at least.
        onset_rows: Rows of the control whose norm marks the actual start.
        attitudes: Of a spatial robot, the first of the target's numbers of each quaternion, by frame.
        on_object: By frame, the pose in the object's frame at which its target is; the target follows the object.
        object_end: What the end condition asks of the object that the stage holds.
        constraints: What constraints have of it, by their name, where they concern it.
    """

    index: int
    name: str
    space: Space
    input: str
    priority: float
    target: np.ndarray
    trajectory: Trajectory | None
    weights: np.ndarray
    control_weights: np.ndarray
    end_rows: tuple[int, ...]
    tolerance: np.ndarray
    end_velocity: np.ndarray | float | None
    hold: float
    at: float | None
    dwell: float
    limits: Limits
    onset_rows: tuple[int, ...]
    attitudes: Mapping[str, int] = field(default_factory=dict)
    on_object: Mapping[str, np.ndarray] = field(default_factory=dict)
    object_end: ObjectEnd = NO_OBJECT_END
    constraints: Mapping[str, ConstraintNumbers] = field(default_factory=dict)
    force_load: Load | None = None

    def __repr__(self) -> str:
        size = f"{len(self.target)} numbers of its target"
        name = f"{type(self).__name__} {self.name}"
        return f"<{name}: index {self.index}, in {self.space} space, priority {self.priority:g}, {size}>"

    @cached_property
    def asked(self) -> np.ndarray:
        """Which rows of the error the weights or the end condition ask for (rows,)."""
        found = self.weights > 0
        found[list(self.end_rows)] = True
        return np.asarray(found)

    @property
    def has_end_condition(self) -> bool:
        """Whether an end condition (18) ends the stage, by the robot or by the object that it holds."""
        return bool(self.end_rows or self.object_end.measures)

    @cached_property
    def end_tolerance(self) -> np.ndarray:
        """Tolerance of each end row, positions first, then rates where they count, then the object's. Eq. (18)."""
        none = np.zeros(0)
        rates = none if self.end_velocity is None else np.broadcast_to(self.end_velocity, len(self.end_rows))
        return np.concatenate([self.tolerance, rates, self.object_end.row_tolerance])

    @property
    def end_counts(self) -> tuple[int, ...]:
        """Number of rows of each quantity that the end condition bounds: 1 of the robot's, the components of others."""
        of_robot = len(self.end_tolerance) - sum(self.object_end.counts)
        return (*(1,) * of_robot, *self.object_end.counts)

    @property
    def end_drift(self) -> np.ndarray:
        """About what each end row is bounded: 0 where the target stands still."""
        return np.zeros(len(self.end_tolerance))

    @property
    def sampled_constraints(self) -> dict[str, ConstraintNumbers]:
        """What constraints have of it whose arguments samples set."""
        return {name: each for name, each in self.constraints.items() if each.at_sample}

    @cached_property
    def end_numbers(self) -> np.ndarray:
        """Target, drift and tolerance, as `StageFunctions.met` takes them."""
        return np.concatenate([self.target, self.end_drift, self.end_tolerance])

    @property
    def waypoints(self) -> np.ndarray:
        """What the target leads through (T, rows) [m, rad]: the rows of the trajectory, or the target alone."""
        return self.target[None] if self.trajectory is None else self.trajectory.values

    def reference(self, since: np.ndarray | float | None) -> np.ndarray:
        """Return what the cost follows at times since the stage began (...,) [s], (..., rows).

        The target alone (rows,) where it stands still, or without times.
        """
        return self.target if self.trajectory is None or since is None else self.trajectory.at(since)[0]

    def placed(self) -> "PlacedStage":
        """Return the stage as a sample finds it before it sets anything."""
        return PlacedStage(**{each.name: getattr(self, each.name) for each in fields(self)})


@dataclass(frozen=True, eq=False, repr=False)
class PlacedStage(Stage):
    """A stage with what a sample sets: the numbers of its target, and those of the trajectory its cost follows.

    Attributes:
        signs: In a chart, by which each of the target's quaternions was multiplied.
        drift: Rate of the target's rows of error, due to an object that moves, (rows,) [m/s, rad/s]; 0 of one at rest.
        awaits_object: The object that it holds is not yet where the end condition wants it.
        object_state: Pose and velocity of the object that the target is for, (6,) or (13,); empty if it is for none.
        via: Numbers of the target at the point of a route that the cost follows instead; NaN where it is the target,
            empty in a task without routes.
    """

    signs: tuple[float, ...] = ()
    drift: np.ndarray | float = 0.0
    awaits_object: bool = False
    object_state: np.ndarray = field(default_factory=lambda: np.zeros(0))
    via: np.ndarray = field(default_factory=lambda: np.zeros(0))

    @property
    def is_on_route(self) -> bool:
        """Whether its cost follows a point of a route instead of the target."""
        return bool(len(self.via) and np.isfinite(self.via).all())

    @property
    def continued(self) -> "PlacedStage":
        """The stage as it goes on after its end: a trajectory is over before its stage may end, so the target rests."""
        return replace(self, trajectory=None)

    def heading_for(self, via: np.ndarray) -> "PlacedStage":
        """Return the stage with a cost that follows a point of a route (numbers,); NaN: its target."""
        stage = replace(self, via=via)
        if not stage.is_on_route:
            return stage
        standing = Trajectory(np.array([0.0, 1.0]), np.array([via, via]), tuple(self.attitudes.values()))
        return replace(stage, trajectory=standing)

    @cached_property
    def end_drift(self) -> np.ndarray:
        """About what each end row is bounded: 0, or the rate that a moving target gives its error."""
        rows = list(self.end_rows)
        counts = self.end_velocity is not None
        drift = np.broadcast_to(self.drift, self.weights.shape)[rows]
        return np.concatenate([np.zeros(len(rows)), drift[: len(rows) * counts], np.zeros(sum(self.object_end.counts))])

    def holding(self, grippers: Mapping[str, np.ndarray], pose: np.ndarray, v: np.ndarray) -> "PlacedStage":
        """Return a stage that ends by the object with the object where it is in the gripper that holds it.

        Args:
            grippers: Poses of all frames, (3,) or (7,).
            pose: Estimated pose of the object, as theirs.
            v: Its estimated velocity, (3,) or (6,).
        """
        if not self.object_end.measures:
            return self
        inside = space_of_pose(len(pose)).relative(pose, grippers[self.object_end.frame])
        return replace(
            self,
            object_end=replace(self.object_end, inside=inside),
            awaits_object=not self.object_end.is_met(pose, v),
        )

    def with_arguments(self, found: Mapping[str, np.ndarray]) -> "PlacedStage":
        """Return a stage with the arguments (numbers,) of constraints that samples set, by name; others are unknown."""
        sampled = {
            name: replace(each, argument=np.broadcast_to(found.get(name, np.nan), each.argument.shape))
            for name, each in self.sampled_constraints.items()
        }
        return replace(self, constraints={**self.constraints, **sampled}) if sampled else self

    def at_object(self, pose_rows: Mapping[str, slice], pose: np.ndarray, v: np.ndarray) -> "PlacedStage":
        """Return the stage with its target where an object of a pose and a velocity has it.

        The angular rate of an error is that near the target, where alone end conditions look at it.
        """
        space = space_of_pose(len(pose))
        target = self.target.copy()
        drift = np.zeros(len(self.weights))
        for frame, inside in self.on_object.items():
            rate = space.carried_rate(pose, v, inside)
            number = list(pose_rows).index(frame)
            target[pose_rows[frame]] = space.composed(pose, inside)
            drift[len(rate) * number : len(rate) * (number + 1)] = rate
        return replace(self, target=target, drift=drift, object_state=np.concatenate([pose, v]))

    def following(
        self, pose_rows: Mapping[str, slice], body: FreeBody, state: np.ndarray, elapsed: float, horizon: float
    ) -> "PlacedStage":
        """Return the stage with a cost that follows the object's free motion over the horizon, its target where it is.

        Args:
            pose_rows: Rows of each frame's pose in xi.
            body: The object.
            state: Its pose and velocity now, (6,) or (13,).
            elapsed: Time since the stage began [s].
            horizon: How far ahead the cost looks [s].
        """
        pose, v = np.split(state, [body.space.n_pose])
        ahead = np.linspace(0.0, horizon, FOLLOWED)
        placed = [self.at_object(pose_rows, *body.predicted(pose, v, each)) for each in ahead]
        values = np.array([stage.target for stage in placed])
        return replace(placed[0], trajectory=Trajectory(elapsed + ahead, values, tuple(self.attitudes.values())))

    def in_chart(self, anchor: np.ndarray, joints: np.ndarray, signs: Mapping[str, float]) -> "PlacedStage":
        """Return the stage of a spatial robot with the numbers of its target that a sample sets.

        Args:
            anchor: Attitude about which the chart is (4,).
            joints: Posture to which redundant joints are drawn (joints,) [rad, m].
            signs: Of the target's quaternions, by frame: of the two for one attitude the one meant.
        """

        def placed(numbers: np.ndarray) -> np.ndarray:
            numbers = numbers.copy()
            for frame, at in self.attitudes.items():
                numbers[..., at : at + 4] *= signs[frame]
            more = np.broadcast_to(of_sample, (*numbers.shape[:-1], len(of_sample)))
            return np.concatenate([numbers, more], axis=-1)

        of_sample = np.concatenate([anchor, joints, self.object_end.numbers])
        if not self.attitudes and not len(of_sample):
            return self
        path = self.trajectory and replace(self.trajectory, values=placed(self.trajectory.values))
        taken = tuple(signs[frame] for frame in self.attitudes)
        return replace(self, target=placed(self.target), trajectory=path, signs=taken)


@dataclass(frozen=True)
class StageShape:
    """What of a stage decides the structure of a window's optimization; all numbers are parameters.

    Attributes:
        space: Space of its skill.
        input: Whether its control is the acceleration of Q (`joint`) or of xi (`task`).
        end_rows: Rows of the error with an end condition at the stage's end; empty: none.
        end_velocity: The rates of those rows are bounded too.
        object_end: What the target's numbers say of the object behind those of the skill: the gripper that holds it,
            and what is bounded; empty: nothing.
        ends_by_object: This is an end condition at the stage's end.
        fixed_end: The stage switches at a given instant.
        moving: The cost follows a desired trajectory.
        force_load: What the grippers are known to hold, where force costs; None where it does not.
        constraints: Names and structures of the constraints that have rows in it.
    """

    space: str
    input: str = "joint"
    end_rows: tuple[int, ...] = ()
    end_velocity: bool = False
    object_end: tuple[str, ...] = ()
    ends_by_object: bool = False
    fixed_end: bool = False
    moving: bool = False
    force_load: Load | None = None
    constraints: tuple[tuple[str, Hashable], ...] = ()


def stage_shape(stage: Stage) -> StageShape:
    """Return the shape of a stage before the last of a window."""
    return StageShape(
        space=stage.space,
        input=stage.input,
        end_rows=stage.end_rows,
        end_velocity=stage.end_velocity is not None,
        object_end=stage.object_end.names,
        ends_by_object=bool(stage.object_end.measures),
        fixed_end=stage.at is not None,
        moving=stage.trajectory is not None,
        force_load=stage.force_load,
        constraints=tuple((name, each.structure) for name, each in stage.constraints.items() if each.is_known),
    )


def without_end(shape: StageShape) -> StageShape:
    """Return the shape of a stage whose end is not imposed: of the last one in a window."""
    return replace(shape, end_rows=(), end_velocity=False, ends_by_object=False, fixed_end=False)


def cost_shape(shape: StageShape) -> StageShape:
    """Return the shape that all stages share whose error and target are the same functions; force is left out."""
    return StageShape(shape.space, object_end=shape.object_end)
