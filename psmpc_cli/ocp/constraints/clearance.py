"""Bodies keep clear: the robot of itself, of obstacles and of the object, which keeps clear too while it is held.

A row is the signed distance of two shapes at a node, at least the margin. Rows are soft with an exact penalty; on
request they are hard, as long as the robot is outside the margin: a start inside is pushed out of it. The pairs of a
stage are in groups, about the robot itself, an obstacle or the object. A group has rows while the plan in force comes
near; between nodes nothing is kept. What moves is at each node where it is at the time of that node in the guess.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import product
from typing import Literal, TypeAlias

import casadi as ca
import numpy as np

from psmpc_cli.native.functions import BatchFunction
from psmpc_cli.ocp.constraints.base import Constraint, ConstraintFunctions, rows_at_nodes
from psmpc_cli.ocp.stage import ConstraintNumbers, SampleContext
from psmpc_cli.robot.distances import distances, part_count, witnesses
from psmpc_cli.robot.free_body import FreeBody
from psmpc_cli.robot.geometry import Piece, capsules_of, own_pairs, pieces_of
from psmpc_cli.robot.kinematics import Frame, SpatialFrame
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.robot.rotations import add, rotate
from psmpc_cli.robot.rotations import product as times
from psmpc_cli.specs.geometry import DEEP, OBJECT, ClearanceSpec, ObstacleSpec, Shape
from psmpc_cli.specs.robots.covers import cover_box
from psmpc_cli.specs.robots.robot import Attachment
from psmpc_cli.specs.task import TaskSpec

GROUP_ACTIVATION = 0.5
"""A group's pairs are in windows if the plan in force comes nearer to the margin than this [m]."""

ROW_ACTIVATION = 0.05
"""A pair is a row of a program at a node if its distance there is nearer to the margin than this [m]."""

MOST_ROWS = 60
"""Distances of a group; larger ones are split by arms. The derivatives of all 140 of a robot with two arms of seven
joints from itself are 180,000 operations, and most of the pairs are far apart most of the time."""

ITSELF = "robot, itself"
"""Name of the group of the robot's own pairs; no obstacle has a comma in its name."""

PoseState: TypeAlias = tuple[np.ndarray, np.ndarray]
"""Pose (n_pose,) and velocity (n_twist,) of a body that moves freely."""


@dataclass(frozen=True)
class Solid:
    """A shape and what carries it.

    Attributes:
        part: Whose it is: name of a body of the robot, of an obstacle, or `object`.
        shape: The shape.
        at: Its frame on the robot's body of that number, or in the pose of what carries it.
        carrier: The robot, the object or an obstacle.
    """

    part: str
    shape: Shape
    at: Attachment
    carrier: Literal["robot", "object", "obstacle"] = "robot"

    @classmethod
    def of(cls, piece: Piece) -> "Solid":
        """Return a piece of the robot."""
        return cls(piece.part, piece.shape, piece.at)


@dataclass(frozen=True)
class Pairs:
    """A group of pairs of solids.

    Attributes:
        pairs: The pairs; the first of each is a capsule.
        gripper: The arm that holds the object, whose pose is that in its gripper; None: its pose is that in the
            inertial frame.
        hard: Rows are hard.
    """

    pairs: tuple[tuple[Solid, Solid], ...]
    gripper: str | None = None
    hard: bool = False

    def __hash__(self) -> int:
        """Return the hash of all fields, computed once: every solve looks for the shape of its window."""
        return self._hash

    @cached_property
    def _hash(self) -> int:
        return hash((self.pairs, self.gripper, self.hard))

    @property
    def rows(self) -> int:
        """Number of their distances: shapes have several parts, each smooth."""
        return sum(part_count(first.shape, second.shape) for first, second in self.pairs)

    def has(self, carrier: str) -> bool:
        """Tell whether one carries a solid."""
        return any(solid.carrier == carrier for pair in self.pairs for solid in pair)

    @property
    def moves(self) -> bool:
        """Whether an obstacle is among them, or an object that no gripper holds."""
        return self.has("obstacle") or (self.has("object") and self.gripper is None)

    @property
    def pair_of_row(self) -> list[int]:
        """The number of the pair of each of the distances."""
        counts = [part_count(first.shape, second.shape) for first, second in self.pairs]
        return np.repeat(np.arange(len(counts)), counts).tolist()

    @property
    def names(self) -> list[tuple[str, str]]:
        """The parts that each pair is of."""
        return [(first.part, second.part) for first, second in self.pairs]


@dataclass(frozen=True, eq=False)
class Group:
    """A group of pairs, and where samples find what is not on the robot.

    Attributes:
        pairs: The pairs.
        state: What a sample has -> pose and velocity of the obstacle, or of an object that no gripper holds, or None.
    """

    pairs: Pairs
    state: Callable[[SampleContext], PoseState | None] = lambda sample: None


def groups(task: TaskSpec, model: RobotModel, stage: int) -> dict[str, Group]:
    """Return all pairs of bodies that can be kept apart in a stage, in groups by name, whatever the task asks for.

    Besides constraints, measured clearances of runs are made of them. There is a group of the robot with itself, and
    one of the robot with each obstacle. If the task has an object with a mass there are also: while it moves freely,
    one of the robot with the object; while a gripper holds it, one of the object with the robot, and one of the object
    with each obstacle. The hands of the grippers may touch the object and are left out, from the stage before the
    object is first held, in which they approach it.

    Args:
        task: The task.
        model: The robot.
        stage: Index of the stage.
    """
    pieces, robot_pairs = model.derived(groups, lambda: _solids_of_robot(model))  # capsules on bodies of the robot
    by_name = {ITSELF: Group(Pairs(robot_pairs))}
    obstacles = {  # shape of each, and where it is at a sample
        obstacle_spec.name: (_solid_of_obstacle(obstacle_spec), partial(state_of_obstacle, obstacle_spec, model))
        for obstacle_spec in task.obstacles
    }
    for name, (obstacle, state) in obstacles.items():
        by_name[name] = Group(Pairs(tuple((piece, obstacle) for piece in pieces)), state)
    if task.body.mass == 0.0:
        return by_name
    is_held = stage in task.held_stages
    hands = {f"{arm}.{model.spec.parts[arm]}" for arm in task.body.grippers}
    may_touch = hands if stage >= task.held_stages.start - 1 else set()  # held_stages: in which grippers hold it
    clear_pieces = [piece for piece in pieces if piece.part not in may_touch]
    if not is_held:
        body = Solid(OBJECT, _box_of_object(task.body.shape), _NO_OFFSET, "object")
        by_name[OBJECT] = Group(Pairs(tuple((piece, body) for piece in clear_pieces)), _state_of_object)
        return by_name
    # A held object is capsules that cover it: the first solid of a pair has to be one, here against the robot's
    # pieces and against obstacles.
    capsules = list(cover_of_object(task.body.shape))
    holder = task.body.holder
    by_name[f"{OBJECT}, held"] = Group(Pairs(tuple(product(capsules, clear_pieces)), holder))
    for name, (obstacle, state) in obstacles.items():
        pairs = Pairs(tuple((capsule, obstacle) for capsule in capsules), holder)
        by_name[f"{OBJECT}, held, {name}"] = Group(pairs, state)
    return by_name


def _solids_of_robot(model: RobotModel) -> tuple[list[Solid], tuple[tuple[Solid, Solid], ...]]:
    """Return the pieces of the robot as solids, and those pairs of them that can come near each other."""
    pieces = pieces_of(model.spec)
    solids = [Solid.of(piece) for piece in pieces]
    return solids, tuple((solids[i], solids[j]) for i, j in own_pairs(model, pieces))


_NO_OFFSET = Attachment(0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


def _solid_of_obstacle(obstacle: ObstacleSpec) -> Solid:
    return Solid(obstacle.name, obstacle.shape.shape, _NO_OFFSET, "obstacle")


def solids_of_obstacle(obstacle: ObstacleSpec) -> tuple[Solid, ...]:
    """Return an obstacle as capsules that cover it, or as a half-space."""
    solid = _solid_of_obstacle(obstacle)
    if solid.shape.kind != "box":
        return (solid,)
    covering = capsules_of(obstacle.name, 0, cover_box(solid.shape.edges))
    return tuple(Solid(obstacle.name, piece.shape, piece.at, "obstacle") for piece in covering)


def _box_of_object(lengths: tuple[float, ...]) -> Shape:
    return Shape("box", (*lengths, DEEP)[:3])


def cover_of_object(lengths: tuple[float, ...]) -> Iterator[Solid]:
    """Yield the capsules that cover the object."""
    for piece in capsules_of(OBJECT, 0, cover_box(lengths)):
        yield Solid(piece.part, piece.shape, piece.at, "object")


def state_of_obstacle(obstacle: ObstacleSpec, model: RobotModel, sample: SampleContext) -> PoseState:
    """Return where an obstacle is at a sample, and its velocity."""
    v = np.zeros(model.space.n_twist)
    v[: len(obstacle.velocity)] = obstacle.velocity
    if not v.any():
        return np.array(obstacle.pose, dtype=float), v
    return _free_sphere(model).predicted(obstacle.pose, v, sample.time)


def _free_sphere(model: RobotModel) -> FreeBody:
    """Return a body that moves freely in the robot's space; it turns about its axes as if it were a sphere."""
    return FreeBody(1.0, np.ones(model.space.n_principal))


def _state_of_object(sample: SampleContext) -> PoseState | None:
    return sample.object_state


def distance_limits(task: TaskSpec, model: RobotModel, stage: int) -> dict[str, ConstraintNumbers]:
    """Return the groups of a stage, by name; none where the task asks for no clearance in it."""
    spec = task.clearance_of(stage)
    if spec is None:
        return {}
    by_name = dict[str, ConstraintNumbers]()
    for name, group in groups_to_clear(task, model, stage).items():
        by_name[name] = _numbers(group, spec, model)
        if spec.hard:
            by_name[f"{name}, hard"] = _numbers(replace(group, pairs=replace(group.pairs, hard=True)), spec, model)
    return by_name


def _is_excepted(pair: tuple[Solid, Solid], spec: ClearanceSpec) -> bool:
    """Tell whether two solids need not keep clear of each other; the name of an arm means all of its bodies."""
    first, second = ({solid.part, solid.part.rpartition(".")[0]} for solid in pair)
    return any((a in first and b in second) or (b in first and a in second) for a, b in spec.excepted)


def _numbers(group: Group, spec: ClearanceSpec, model: RobotModel) -> ConstraintNumbers:
    pairs = group.pairs
    in_gripper = model.space.n_pose * (pairs.gripper is not None)
    in_world = (model.space.n_pose + model.space.n_twist) * pairs.moves
    return ConstraintNumbers(
        structure=pairs,
        argument=np.full(1 + in_gripper + in_world, np.nan),
        low=np.full(pairs.rows, spec.margin),
        high=np.full(pairs.rows, np.inf),
        at_sample=partial(_argument_if_near, group, spec),
        at_nodes=partial(poses_at, pairs, model) if pairs.moves else None,
    )


def _argument_if_near(group: Group, spec: ClearanceSpec, model: RobotModel, sample: SampleContext) -> np.ndarray | None:
    """Return the argument of a group's distances at a sample: poses of what is not on the robot; NaN for no rows.

    A group has no rows in programs while measured state and plan are farther from the margin than `GROUP_ACTIVATION`.
    Where the task asks for hard limits a stage has each group twice, hard and soft, and a sample turns one of them off:
    the hard one if the robot starts inside the margin, so that soft rows can push it out, else the soft one.

    Args:
        group: The pairs of bodies, and where a sample has the pose of what moves by itself.
        spec: The margin [m], and whether the task asks for hard limits.
        model: The robot.
        sample: The sample: measured state, plan in force, state of the object.

    Returns:
        The argument as `poses_at_sample` has it, (numbers,), all NaN if the group has no rows. Where poses are not
        known (of an object that is not held yet) the argument of the sample before, or None if it had none.
    """
    argument = poses_at_sample(group, model, sample)
    if argument is None:
        return sample.argument_before
    pairs = group.pairs
    # The distances now, in the first row, and along the plan in force.
    since = np.zeros(1)
    X = sample.x[None]
    if sample.prediction is not None:
        predicted_times, predicted_X = sample.prediction
        since = np.append(since, predicted_times - sample.time)
        X = np.vstack([X, predicted_X])
    anchors = np.tile(sample.anchor, (len(X), 1))
    arguments = np.hstack([anchors, poses_at(pairs, model, argument, since)])
    all_distances = distances_on_arrays(model, pairs)(X, arguments, rows=len(X))[0]
    is_far = sample.prediction is not None and all_distances.min() > spec.margin + GROUP_ACTIVATION
    starts_inside = bool(all_distances[0].min() < spec.margin)
    other_group_counts = spec.hard and pairs.hard == starts_inside
    return np.full(len(argument), np.nan) if is_far or other_group_counts else argument


def poses_at_sample(group: Group, model: RobotModel, sample: SampleContext) -> np.ndarray | None:
    """Return where the object and the obstacle of a group are at a sample, from which its distances are computed.

    Args:
        group: The pairs of bodies, and where a sample has the pose of what moves by itself.
        model: The robot.
        sample: The sample: measured state, state of the object.

    Returns:
        A 0 (NaN in its place would say that the group has no rows), then, if a gripper holds the object, its pose in
        that gripper (n_pose,), then, if an obstacle or a free object is in the group, its pose (n_pose,) and velocity
        (n_twist,). None where one of these is not known: of a held object before the stage has begun.
    """
    argument = np.zeros(1)
    if group.pairs.gripper is not None:
        if sample.object_state is None or not sample.is_current:
            return None
        xi = np.asarray(model.charted(sample.x[: model.n], sample.anchor)).ravel()
        object_pose, _ = sample.object_state
        gripper_pose = xi[model.pose_rows[group.pairs.gripper]]
        argument = np.append(argument, model.space.relative(object_pose, gripper_pose))
    if group.pairs.moves:
        state = group.state(sample)
        if state is None:
            return None
        argument = np.concatenate([argument, *state])
    return argument


def poses_at(pairs: Pairs, model: RobotModel, argument: np.ndarray, since: np.ndarray) -> np.ndarray:
    """Return what the functions take at times since the sample (N,): a 0 and the poses, (N, numbers).

    The 0 is there for groups of the robot alone, which have no pose: NaN in its place says that a group has no rows.
    """
    n_pose = model.space.n_pose
    first_of_pose = 1 + n_pose * (pairs.gripper is not None)
    first_of_velocity = first_of_pose + n_pose * pairs.moves
    at_nodes = np.empty((len(since), first_of_velocity))
    at_nodes[:] = argument[:first_of_velocity]
    v = argument[first_of_velocity:]
    if v.any():
        at_nodes[:, first_of_pose:] = poses_after(model, argument[first_of_pose:first_of_velocity], v, since)
    return at_nodes


def poses_after(model: RobotModel, pose: np.ndarray, v: np.ndarray, since: np.ndarray) -> np.ndarray:
    """Return the poses (N, n_pose) of a body that moves freely at times (N,) [s] after a pose and a velocity."""
    space = model.space
    if space.has_quaternion and v[space.rotation].any():
        return _free_sphere(model).predicted(pose, v, since)[0]
    moving = slice(space.dimension) if space.has_quaternion else slice(None)
    poses = np.empty((len(since), len(pose)))
    poses[:] = pose
    poses[:, moving] += since[:, None] * v[moving]
    return poses


def groups_to_clear(task: TaskSpec, model: RobotModel, stage: int) -> dict[str, Group]:
    """Return the pairs of bodies that a task asks to keep apart in a stage, in groups; none if it asks for nothing.

    These groups become constraints of the stage. Pairs that the task excepts are left out. A group with more than
    `MOST_ROWS` distances is split by arms: a part of it then has rows in programs only while these arms come near.

    Args:
        task: The task.
        model: The robot.
        stage: Index of the stage.

    Returns:
        Groups by name; none of them is empty.
    """
    spec = task.clearance_of(stage)
    if spec is None:
        return {}
    by_name = dict[str, Group]()
    for name, group in groups(task, model, stage).items():
        to_clear = tuple(pair for pair in group.pairs.pairs if not _is_excepted(pair, spec))
        is_small = replace(group.pairs, pairs=to_clear).rows <= MOST_ROWS
        parts = {name: to_clear} if is_small else _by_limbs(name, to_clear)
        for part_name, pairs_of_part in parts.items():
            if pairs_of_part:
                by_name[part_name] = replace(group, pairs=replace(group.pairs, pairs=pairs_of_part))
    return by_name


def _by_limbs(name: str, pairs: tuple[tuple[Solid, Solid], ...]) -> dict[str, tuple[tuple[Solid, Solid], ...]]:
    """Return pairs by the arms, or the base, that their solids are of: those that come near come near together."""
    by_limbs = dict[str, tuple[tuple[Solid, Solid], ...]]()
    for pair in pairs:
        limbs = [solid.part.rpartition(".")[0] or solid.part for solid in pair]
        key = f"{name}, {limbs[0]} and {limbs[1]}"
        by_limbs[key] = (*by_limbs.get(key, ()), pair)
    return by_limbs


def distance_rows(model: RobotModel, pairs: Pairs) -> ConstraintFunctions:
    """Return x, [anchor; 0; pose of the object; pose of the obstacle] -> the distances of every pair.

    The argument has the poses of what is among the solids.
    """
    x, argument, placed = _shapes_and_frames(model, pairs)
    apart = [distance for pair in placed for distance in distances(*pair)]
    return ConstraintFunctions(x, argument, ca.vertcat(*apart), is_convex=True)


def distances_on_arrays(model: RobotModel, pairs: Pairs) -> BatchFunction:
    """Return the function of the distances on arrays."""
    return model.cached((distance_rows, pairs), partial(distance_rows, model, pairs)).value


def nearest_points(model: RobotModel, pairs: Pairs) -> BatchFunction:
    """Return x, [anchor; 0; poses] -> the points of both surfaces that are nearest, pair by pair, (6 pairs,) [m]."""
    x, argument, placed = _shapes_and_frames(model, pairs)
    points = [ca.vertcat(*point, *other_point) for point, other_point in (witnesses(*pair) for pair in placed)]
    return BatchFunction(ca.Function("nearest_points", [x, argument], ca.cse([ca.densify(ca.vertcat(*points))])))


def _shapes_and_frames(
    model: RobotModel, pairs: Pairs
) -> tuple[ca.SX, ca.SX, list[tuple[Shape, SpatialFrame, Shape, SpatialFrame]]]:
    """Return the two shapes of every pair with their frames, as expressions of the state and the poses of other bodies.

    Distances and nearest points are derived from them.

    Args:
        model: The robot.
        pairs: The pairs of solids. Each solid is carried by a body of the robot, by the object or by an obstacle.

    Returns:
        The state x, a symbol (2n,); the argument, symbols [anchor of the chart; a number that no expression uses; pose
        of the object; pose of the obstacle], each pose only if such a solid is in a pair; and for each pair the shape
        and frame of its first solid, and those of its second, frames in the inertial frame.
    """
    space = model.space
    carriers = [carrier for carrier in ("object", "obstacle") if pairs.has(carrier)]
    x, anchor, bodies, tools = model.derived("frames at a state", lambda: _frames(model))
    poses = ca.SX.sym("poses", len(carriers) * space.n_pose)
    argument = ca.vertcat(anchor, ca.SX.sym("is_used"), poses)  # is_used: NaN for a group without rows, see `poses_at`
    frame_of_carrier = dict[str, SpatialFrame]()
    for i, carrier in enumerate(carriers):
        pose = poses[i * space.n_pose : (i + 1) * space.n_pose]
        frame_of_carrier[carrier] = SpatialFrame(*space.to_3d(ca.vertsplit(pose)))
    if pairs.gripper is not None:  # the pose of a held object is that in its gripper
        frame_of_carrier["object"] = _composed(tools[pairs.gripper].in_space(), frame_of_carrier["object"])
    frame_of_solid = dict[Solid, SpatialFrame]()
    for first, second in pairs.pairs:
        for solid in (first, second):
            if solid not in frame_of_solid:
                carrier_frame = bodies[solid.at.body] if solid.carrier == "robot" else frame_of_carrier[solid.carrier]
                frame_of_solid[solid] = carrier_frame.carried(solid.at).in_space()
    placed = [
        (first.shape, frame_of_solid[first], second.shape, frame_of_solid[second]) for first, second in pairs.pairs
    ]
    return x, argument, placed


def _frames(model: RobotModel) -> tuple[ca.SX, ca.SX, list[Frame], dict[str, Frame]]:
    """Return a state (2n,), an anchor, and the frames of the bodies and end-effectors there."""
    x = ca.SX.sym("x", 2 * model.n)
    anchor = ca.SX.sym("anchor", model.space.n_anchor)
    return x, anchor, *model.charted_frames(x[: model.n], anchor)


def _composed(frame: SpatialFrame, inside: SpatialFrame) -> SpatialFrame:
    """Return the frame that is at a pose inside another one."""
    position = add(frame.position, rotate(frame.quaternion, inside.position))
    return SpatialFrame(position, times(frame.quaternion, inside.quaternion))


def _is_soft(pairs: Pairs) -> bool:
    return not pairs.hard


CONSTRAINT = Constraint(rows_at_nodes("clearance", distance_rows, _is_soft, ROW_ACTIVATION), distance_limits)
