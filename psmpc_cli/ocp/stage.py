"""Stages of a task: what the task says of them, and what a sample of the controller sets."""

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Self, TypeAlias

import numpy as np

from psmpc_cli.ocp.end import OPEN, End, EndShape
from psmpc_cli.ocp.loads import NO_KNOWN_LOAD, UNWEIGHED, UNWEIGHED_LOAD, Load, LoadKind
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.ocp.reference import Constant, Reference, Trajectory
from psmpc_cli.ocp.skills import TargetPart
from psmpc_cli.robot.free_body import FreeBody
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.robot.rotations import rotate
from psmpc_cli.specs.parts import BASE, MobilityTraits, Space
from psmpc_cli.specs.robots.robot import Limits

JERK = "jerk"
"""Name of the constraint that limits the rate of the acceleration."""

REFERENCE_POINTS = 41
"""Points of the object's predicted motion that a cost follows: at 10 deg/s over 4 s straight to 0.03 mm at 0.6 m."""


@dataclass(frozen=True, eq=False)
class SampleContext:
    """A sample as the arguments of constraints depend on it.

    Attributes:
        time: Of the sample [s].
        x: State in the chart (2n,).
        anchor: Of the chart.
        prediction: Times [s] and states (M, 2n) of the plan in force from now on; None before the first plan.
        object_state: Estimated pose and velocity of the object; None without one with a mass.
        load: Mass [kg] and principal moments [kg m^2] that the load is taken to have; empty where the task says them.
        stored: What is known of wheels in the stage, as `LoadKind.stores` says; None of a robot without any.
        unseen: The part of the momenta of wheels that adds up to nothing (W,); None without any.
        is_current: The stage has begun.
        argument_before: The constraint's argument at the sample before, or None.
        plan: The plan in force; None before the first.
    """

    time: float
    x: np.ndarray
    anchor: np.ndarray
    prediction: tuple[np.ndarray, np.ndarray] | None = None
    object_state: tuple[np.ndarray, np.ndarray] | None = None
    load: np.ndarray = field(default_factory=lambda: np.zeros(0))
    stored: np.ndarray | None = None
    unseen: np.ndarray | None = None
    is_current: bool = True
    argument_before: np.ndarray | None = None
    plan: Plan | None = None


ArgumentAtSample: TypeAlias = Callable[[RobotModel, SampleContext], np.ndarray | None]
"""Robot, sample -> argument (numbers,), NaN while the constraint has no rows; None where the sample leaves it."""


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
        for_bounds: How many numbers at the end of the argument its functions do not take, but `over_intervals` does.
        over_intervals: These numbers, times of nodes since the sample (N + 1,) -> low and high of its rows over the
            intervals between them, (N, rows) each; None where these are always `low` and `high`.
    """

    structure: Hashable
    argument: np.ndarray
    low: np.ndarray
    high: np.ndarray
    at_sample: ArgumentAtSample | None = None
    at_nodes: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None
    for_bounds: int = 0
    over_intervals: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]] | None = None

    @property
    def of_functions(self) -> np.ndarray:
        """The numbers of the argument that its functions take."""
        return self.argument[: len(self.argument) - self.for_bounds]

    @property
    def of_bounds(self) -> np.ndarray:
        """The other numbers of the argument (for_bounds,)."""
        return self.argument[len(self.argument) - self.for_bounds :]

    @cached_property
    def is_known(self) -> bool:
        """Whether the argument is known; without it the constraint has no rows."""
        return bool(np.isfinite(self.argument).all())


@dataclass(frozen=True, eq=False)
class PlaceOnObject:
    """A pose in the frame of the task's object, at which a part of a target is.

    Attributes:
        body: The object.
        inside: The pose, (3,) or (7,).
        met_in: For how long the robot floats from there before it meets the object [s]; 0 of a place that moves rigidly
            with the object.
    """

    body: FreeBody
    inside: np.ndarray
    met_in: float = 0.0

    def pose_and_velocity(self, pose: np.ndarray, v: np.ndarray, moving: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return where the place is, and the velocity at which a robot is to be there.

        A place with `met_in` is one from which the robot floats for that time until it meets the object. It keeps its
        velocity, and nothing turns it about the object. So the place is where it will be, fixed to the object, when
        they meet, moved back at the constant velocity of the object's centre and at its angular velocity then. A robot
        that leaves with this velocity turns with the object when they meet, and is there displaced by `moving` times
        `met_in`, along the object's axes.

        Args:
            pose: Pose of the object, (3,) or (7,).
            v: Velocity of the object, (3,) or (6,).
            moving: Velocity that the robot is to have relative to the object, its linear part along the object's axes,
                (3,) or (6,).

        Returns:
            Pose of the place, as `pose`, and the velocity there, `moving` added, as `v`.
        """
        space = self.body.space
        if self.met_in:
            pose, v = self.body.predicted(pose, v, self.met_in)
        place = space.composed(pose, self.inside)
        velocity = space.carried_rate(pose, v, self.inside)
        if self.met_in:
            # the linear part is that of the object's centre: it does not turn about the object
            velocity[: space.dimension] = v[: space.dimension]
            place = np.array(space.integrate(place, -self.met_in * velocity))
        if moving.any():
            _, attitude = space.to_3d(pose)
            linear, angular = space.twist_to_3d(moving)
            velocity = velocity + space.twist(rotate(attitude, linear), angular)
        return place, velocity


@dataclass(frozen=True, eq=False)
class Stage:
    """One stage of the task, resolved for one robot: what does not change while the robot moves.

    Attributes:
        target: The numbers of its target [m, rad], which end conditions are about; of a trajectory, its last value.
        reference: What its cost follows.
        weights: Diagonal of W_q or W_p, as `target`.
        control_weights: Diagonal of W_r, one per input; behind it that of W_F, one per coordinate, where force costs.
        force_load: What the grippers are known to hold, where force costs; `UNWEIGHED_LOAD` where it does not.
        rate_weights: Diagonal of W_j, of the rate of Qddot, one per coordinate; (0,) where it costs nothing.
        end: How it ends.
        onset_rows: Rows of the control whose norm marks the actual start.
        moved_by: What moves the base.
        parts: Of its target, by their name.
        attitudes: Of a spatial robot, the first of the target's numbers of each quaternion, by frame.
        on_object: By frame, where on the object its target is; the target follows the object.
        constraints: What constraints have of it, by their name, where they concern it.
    """

    index: int
    name: str
    space: Space
    input: str
    priority: float
    target: np.ndarray
    reference: Reference
    weights: np.ndarray
    control_weights: np.ndarray
    end: End
    limits: Limits
    onset_rows: tuple[int, ...]
    moved_by: MobilityTraits
    parts: Mapping[str, TargetPart] = field(default_factory=dict)
    attitudes: Mapping[str, int] = field(default_factory=dict)
    on_object: Mapping[str, PlaceOnObject] = field(default_factory=dict)
    constraints: Mapping[str, ConstraintNumbers] = field(default_factory=dict)
    force_load: Load = UNWEIGHED_LOAD
    rate_weights: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def __repr__(self) -> str:
        size = f"{len(self.target)} numbers of its target"
        name = f"{type(self).__name__} {self.name}"
        return f"<{name}: index {self.index}, in {self.space} space, priority {self.priority:g}, {size}>"

    @cached_property
    def relevant_rows(self) -> np.ndarray:
        """Which rows of the error have a weight or are in the end condition (rows,)."""
        is_relevant = self.weights > 0
        is_relevant[list(self.end.rows)] = True
        return np.asarray(is_relevant)

    @property
    def has_rates(self) -> bool:
        """Whether changes of the acceleration cost, or are limited."""
        return len(self.rate_weights) > 0 or JERK in self.constraints

    @property
    def sampled_constraints(self) -> dict[str, ConstraintNumbers]:
        """What constraints have of it whose arguments samples set."""
        return {name: constraint for name, constraint in self.constraints.items() if constraint.at_sample}

    @cached_property
    def end_numbers(self) -> np.ndarray:
        """Target, and the bounds of the end condition, as `StageFunctions.met` takes them."""
        return np.concatenate([self.target, self.end.centers, self.end.half_widths])

    @property
    def load_numbers(self) -> np.ndarray:
        """Numbers of the load that the cost of force takes; empty where force costs nothing."""
        return self.force_load.numbers

    @property
    def poses_of_arms(self) -> dict[str, np.ndarray]:
        """The pose (n_pose,) of each arm that the target wants at one, by name."""
        return {
            name: self.target[part.numbers] for name, part in self.parts.items() if name != BASE and part.kind.is_pose
        }

    @property
    def parts_in_Q(self) -> tuple[TargetPart, ...]:
        """The parts whose numbers are coordinates of Q: the base, and arms at joint coordinates."""
        return tuple(part for name, part in self.parts.items() if name == BASE or part.kind.is_joints)

    @property
    def arms_at_joints(self) -> tuple[str, ...]:
        """The arms that the target wants at joint coordinates."""
        return tuple(name for name, part in self.parts.items() if part.kind.is_joints)

    def with_target(self, target: np.ndarray) -> Self:
        """Return the stage with another target (numbers,), at rest."""
        return replace(self, target=target, reference=Constant(target))

    def wanted(self, since: np.ndarray | float | None) -> np.ndarray:
        """Return what the cost follows at times since the stage began (...,) [s], (..., numbers).

        That alone (numbers,) where it stands still; without times the target.
        """
        return self.target if since is None else self.reference.at(since)[0]

    @property
    def target_at_rest(self) -> np.ndarray:
        """What a cost follows that is at rest, the target or a point of a route; of others the target (numbers,)."""
        return self.target if self.reference.moves else self.reference.points[0]

    def unplaced_copy(self) -> "PlacedStage":
        """Return the stage as a sample finds it before it sets anything."""
        return PlacedStage(**{attribute.name: getattr(self, attribute.name) for attribute in fields(self)})


@dataclass(frozen=True, eq=False, repr=False)
class PlacedStage(Stage):
    """A stage with what a sample sets: the numbers of its target, and those of the trajectory its cost follows.

    Attributes:
        signs: In a chart, by which each of the target's quaternions was multiplied.
        object_state: Pose and velocity of the object that the target is for, (6,) or (13,); empty if it is for none.
        waypoint: For the record: numbers of the point of a route that the cost follows instead of the target; NaN
            where it is the target, empty in a task without routes.
        speed_reserve: By how much its limits of velocities are tighter than the task's, lower and upper ones, (2, n)
            [m/s, rad/s]; (2, 0) in a task without such a reserve.
    """

    signs: tuple[float, ...] = ()
    object_state: np.ndarray = field(default_factory=lambda: np.zeros(0))
    waypoint: np.ndarray = field(default_factory=lambda: np.zeros(0))
    speed_reserve: np.ndarray = field(default_factory=lambda: np.zeros((2, 0)))

    @property
    def continued(self) -> "PlacedStage":
        """The stage as it goes on after its end: a trajectory is over before its stage may end, so the target rests."""
        return self.with_target(self.target)

    def with_waypoint(self, waypoint: np.ndarray | None) -> "PlacedStage":
        """Return the stage of a task with routes, its cost following a point of its own (numbers,), or its target."""
        if waypoint is None:
            return replace(self, waypoint=np.full(len(self.target), np.nan))
        return replace(self, waypoint=waypoint, reference=Constant(waypoint), end=self.end.unplanned())

    def with_end(self, end: End) -> "PlacedStage":
        """Return the stage with another end."""
        return replace(self, end=end)

    def with_held_object(self, grippers: Mapping[str, np.ndarray], pose: np.ndarray, v: np.ndarray) -> "PlacedStage":
        """Return the stage with the object where it is seen in the gripper that holds it, see `End`."""
        return self.with_end(self.end.with_held_object(grippers, pose, v))

    def with_load(self, numbers: np.ndarray) -> "PlacedStage":
        """Return the stage with the mass and moments that its load is taken to have, see `End`."""
        end = self.end.with_load(numbers)
        return self if end is self.end else self.with_end(end)

    def with_speed_reserve(self, reserve: np.ndarray) -> "PlacedStage":
        """Return the stage with limits of velocities that are tighter by a reserve, (2, n) [m/s, rad/s]."""
        return replace(self, limits=self.limits.with_speed_reserve(reserve), speed_reserve=reserve)

    def with_arguments(self, arguments: Mapping[str, np.ndarray]) -> "PlacedStage":
        """Return a stage with the arguments (numbers,) of constraints that samples set, by name; others are unknown."""
        sampled = {
            name: replace(constraint, argument=np.broadcast_to(arguments.get(name, np.nan), constraint.argument.shape))
            for name, constraint in self.sampled_constraints.items()
        }
        return replace(self, constraints={**self.constraints, **sampled}) if sampled else self

    def at_object(self, pose: np.ndarray, v: np.ndarray) -> "PlacedStage":
        """Return the stage with its target placed on an object that moves, as each sample estimates it.

        The parts of the target that the task gives relative to the object become poses in the inertial frame. The end
        condition then bounds velocities relative to the moving target. The angular rate of an error is taken as it is
        near the target, since end conditions look at it only there.

        Args:
            pose: Pose of the object, (n_pose,).
            v: Velocity of the object, (n_twist,).
        """
        target = self.target.copy()
        target_rates = np.zeros(len(self.weights))
        target_rates[: len(self.end.own_rates)] = self.end.own_rates  # relative to the object, as the task says them
        for frame, on_object in self.on_object.items():
            part = self.parts[frame]
            target[part.numbers], target_rates[part.rows] = on_object.pose_and_velocity(
                pose, v, target_rates[part.rows]
            )
        return replace(
            self.with_target(target),
            end=self.end.with_target_rates(target_rates),
            object_state=np.concatenate([pose, v]),
        )

    def following(self, body: FreeBody, state: np.ndarray, elapsed: float, horizon: float) -> "PlacedStage":
        """Return the stage with a cost that follows the object's free motion over the horizon, its target where it is.

        Args:
            body: The object.
            state: Its pose and velocity now, (6,) or (13,).
            elapsed: Time since the stage began [s].
            horizon: How far ahead the cost looks [s].
        """
        pose, v = np.split(state, [body.space.n_pose])
        times = np.linspace(0.0, horizon, REFERENCE_POINTS)
        at_times = [self.at_object(*body.predicted(pose, v, time)) for time in times]
        values = np.array([stage.target for stage in at_times])
        return replace(at_times[0], reference=Trajectory(elapsed + times, values, tuple(self.attitudes.values())))

    def in_chart(self, anchor: np.ndarray, joints: np.ndarray, signs: Mapping[str, float]) -> "PlacedStage":
        """Return the stage with its target and reference as the functions of windows take them at a sample.

        In a window attitudes are coordinates in a chart: rotation vectors about an anchor. The target keeps
        quaternions; each gets the sign that is nearer to the robot's. Appended to the target's numbers are those that a
        sample sets: the anchor, the posture of redundant joints, and what the end says of object and load. A planar
        robot, which has no chart, has only these last.

        Args:
            anchor: Attitude about which the chart is, (4,); (0,) for a planar robot.
            joints: Posture to which redundant joints are drawn, (joints,) [rad, m].
            signs: 1 or -1 for each of the target's quaternions, by frame: q and -q are one attitude, and the errors
                need the one meant.
        """
        sample_numbers = np.concatenate([anchor, joints, self.end.arguments])
        if not (self.attitudes or len(sample_numbers)):
            return self

        def completed(values: np.ndarray) -> np.ndarray:
            """Return numbers of a target (..., numbers) with these signs, and with the sample's numbers appended."""
            values = values.copy()
            for frame, first in self.attitudes.items():  # where the quaternion of a frame begins
                values[..., first : first + 4] *= signs[frame]
            behind = np.broadcast_to(sample_numbers, (*values.shape[:-1], len(sample_numbers)))
            return np.concatenate([values, behind], axis=-1)

        return replace(
            self,
            target=completed(self.target),
            reference=self.reference.mapped(completed),
            signs=tuple(signs[frame] for frame in self.attitudes),
        )


@dataclass(frozen=True)
class StageShape:
    """What of a stage decides the structure of a window's optimization; all numbers are parameters.

    Attributes:
        space: Space of its skill.
        input: Whether its control is the acceleration of Q (`joint`) or of xi (`task`).
        end: What is imposed at its end.
        object_names: What the target's numbers say of the object behind those of the skill: the gripper that holds it,
            and what is bounded; empty: nothing.
        end_load: What kind of load they say behind that, where the end bounds the momentum of robot and load.
        moving: The cost follows a desired trajectory.
        force_load: What kind of load the grippers are known to hold, where force costs; `UNWEIGHED` where it does not.
        weighs_rate: Changes of the acceleration cost.
        constraints: Names and structures of the constraints that have rows in it.
    """

    space: Space
    input: str = "joint"
    end: EndShape = OPEN
    object_names: tuple[str, ...] = ()
    end_load: LoadKind = NO_KNOWN_LOAD.kind
    moving: bool = False
    force_load: LoadKind = UNWEIGHED
    weighs_rate: bool = False
    constraints: tuple[tuple[str, Hashable], ...] = ()

    @property
    def has_rates(self) -> bool:
        """Whether changes of the acceleration cost, or are limited."""
        return self.weighs_rate or any(name == JERK for name, _ in self.constraints)


def stage_shape(stage: Stage) -> StageShape:
    """Return what of a stage decides the structure of optimizations, its end imposed; see `without_end` for the last.

    Numbers of the stage are left out, so that what is compiled for one shape serves every window with such a stage.
    """
    return StageShape(
        space=stage.space,
        input=stage.input,
        end=stage.end.shape,
        object_names=stage.end.object_names,
        end_load=stage.end.load.kind,
        moving=stage.reference.moves,
        force_load=stage.force_load.kind,
        weighs_rate=len(stage.rate_weights) > 0,
        constraints=tuple(
            (name, constraint.structure) for name, constraint in stage.constraints.items() if constraint.is_known
        ),
    )


def without_end(shape: StageShape) -> StageShape:
    """Return the shape of a stage whose end is not imposed: of the last one in a window."""
    return replace(shape, end=OPEN)


def end_shape(shape: StageShape) -> StageShape:
    """Return the shape that all stages share whose end condition is the same function."""
    return replace(cost_shape(shape), end=replace(shape.end, is_fixed=False))


def cost_shape(shape: StageShape) -> StageShape:
    """Return the shape that all stages share whose error and target are the same functions; without force and rate."""
    return StageShape(shape.space, object_names=shape.object_names, end_load=shape.end_load)


def in_segments(stages: Sequence[PlacedStage]) -> tuple[PlacedStage, ...]:
    """Return the stages between the switch times of a window, where one that comes again is continued."""
    indices = [stage.index for stage in stages]
    return tuple(stage.continued if stage.index in indices[:place] else stage for place, stage in enumerate(stages))
