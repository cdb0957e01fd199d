"""The capsules that a robot is made of where distances count, and which of them are to keep apart."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from psmpc_cli.robot.configuration import pose_frames
from psmpc_cli.robot.distances import distance
from psmpc_cli.robot.kinematics import Frame, SpatialFrame, place
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.robot.shape import RobotShape
from psmpc_cli.specs.geometry import Shape
from psmpc_cli.specs.robots.covers import Cover, cover_box
from psmpc_cli.specs.robots.robot import Attachment, RobotSpec, Triple, resolve_limits

Array = NDArray[np.float64]

POSTURES = 1000
SEED = 0
"""Number of random postures that tell which pieces can meet, and their seed."""

TOUCHING = 0.02
TOGETHER = 0.95
"""Pieces nearer than TOUCHING in a share TOGETHER of the postures are always together: no joint parts them."""

NEAR = 0.1
"""Pieces that are never nearer than this are always apart; random postures do not meet the nearest one.

TOUCHING and NEAR are in lengths of the longest arm, see `RobotShape.reach`.
"""


@dataclass(frozen=True)
class Piece:
    """A capsule on a body of a robot.

    Attributes:
        part: Name of the body: `base`, or `<arm>.<number>`.
        at: The capsule's frame on the body.
        shape: The capsule.
    """

    part: str
    at: Attachment
    shape: Shape

    @property
    def body(self) -> int:
        """Number of the body, in the order of `RobotSpec.bodies`."""
        return self.at.body

    @property
    def ends(self) -> Array:
        """Ends of the segment that it is about, in the frame of the body (2, 3) [m]."""
        half = self.shape.size[1] / 2 * _rotation_matrix(self.at)[:, 0]
        return np.asarray(self.at.position + np.multiply.outer([-1.0, 1.0], half))

    def frame(self, bodies: Sequence[Frame]) -> SpatialFrame:
        """Return its frame in space, with the robot's bodies at frames, see `place`."""
        return bodies[self.body].carried(self.at).in_space()


def pieces_of(spec: RobotSpec) -> tuple[Piece, ...]:
    """Return the capsules of a robot, which cover it as far as its description tells, in the order of its bodies.

    They are those of its `geometry`, boxes covered by capsules. A robot whose file says nothing of it has that of its
    drawings, see `RobotShape`: capsules between joints, a base's box covered by capsules, and one about every gripper.
    """
    return tuple(_described_pieces(spec) if spec.geometry else _drawn_pieces(spec))


def _described_pieces(spec: RobotSpec) -> Iterator[Piece]:
    """Give the capsules of a robot's description."""
    for number, body in enumerate(spec.bodies):
        for placed in spec.geometry.get(body.name, ()):
            frame = np.eye(4) if placed.pose is None else pose_frames(np.array(placed.pose))
            yield from capsules_of(body.name, number, _cover(placed.shape.shape).moved(frame))


def _cover(shape: Shape) -> Cover:
    """Return the capsules that cover a shape about its frame."""
    if shape.kind == "box":
        return cover_box(shape.edges)
    radius, length = shape.size
    return Cover(np.array([[[-length / 2, 0.0, 0.0], [length / 2, 0.0, 0.0]]]), radius, 0.0)


def _drawn_pieces(spec: RobotSpec) -> Iterator[Piece]:
    """Give the capsules of a robot's drawing."""
    shape = RobotShape(spec)
    base = cover_box((2 * shape.box[: spec.dimension]).tolist()).moved(shape.box_frame)
    grippers = {spec.tools[arm].body: _about_gripper(outline) for arm, outline in shape.grippers.items()}
    for number, (body, ends) in enumerate(zip(spec.bodies, shape.capsules, strict=True)):
        covers = [base] if number == 0 else []
        covers.append(Cover(ends, shape.radius, 0.0))
        covers += [grippers[number]] if number in grippers else []
        for cover in covers:
            yield from capsules_of(body.name, number, cover)


def _about_gripper(outline: Array) -> Cover:
    """Return the capsule about the outline of a gripper (4, 3): from the middle of a finger to that of the other."""
    first, palm, other_palm, other = outline
    ends = np.array([[(first + palm) / 2, (other + other_palm) / 2]])
    return Cover(ends, float(np.linalg.norm(first - palm)) / 2, 0.0)


def capsules_of(part: str, body: int, cover: Cover) -> Iterator[Piece]:
    """Give the capsules of a cover in a body's frame."""
    for start, end in cover.ends:
        along = end - start
        length = float(np.linalg.norm(along))
        at = Attachment(body, _triple((start + end) / 2), _triple(_rotation_vector_to(along)))
        yield Piece(part, at, Shape("capsule", (cover.radius, length)))


def _rotation_matrix(at: Attachment) -> Array:
    return np.asarray(Rotation.from_rotvec(at.rotation).as_matrix())


def _rotation_vector_to(along: Array) -> Array:
    """Return a rotation vector that turns the x axis along a line; about z in the plane."""
    if not np.linalg.norm(along):
        return np.zeros(3)
    x, y, z = along / np.linalg.norm(along) * (1 if along[0] >= 0 else -1)
    across = float(np.hypot(y, z))
    return np.arctan2(across, x) * np.array([0.0, -z, y]) / across if across else np.zeros(3)


def _triple(values: Array) -> Triple:
    x, y, z = (float(value) for value in values)
    return x, y, z


def own_pairs(model: RobotModel, pieces: Sequence[Piece]) -> tuple[tuple[int, int], ...]:
    """Return the pairs of pieces of a robot that are to keep apart from each other.

    These are all pairs of pieces on different bodies, without three kinds: pieces on bodies that a joint connects,
    pieces that touch in nearly all postures, and pieces that never come near each other. The last two kinds are found
    from random postures within the limits of the joints, the same ones every time. The setup assistant of MoveIt does
    the same.

    Args:
        model: The robot.
        pieces: The capsules that it is made of.

    Returns:
        The pairs (i, j), i < j, of numbers of pieces.
    """
    neighbours = {(joint.at.body, number) for number, joint in enumerate(model.spec.joints, start=1)}
    pairs = [
        (i, j)
        for i, first in enumerate(pieces)
        for j, second in enumerate(pieces)
        if i < j and first.body != second.body and (first.body, second.body) not in neighbours
    ]
    if not pairs:
        return ()
    joints = ca.SX.sym("joints", len(model.spec.joints))
    bodies, _ = place(model.spec, model.space.base_frame(ca.SX(model.neutral)), joints)
    frames = [piece.frame(bodies) for piece in pieces]
    expressions = [distance(pieces[i].shape, frames[i], pieces[j].shape, frames[j]) for i, j in pairs]
    in_postures = ca.Function("own_distances", [joints], ca.cse([ca.vertcat(*expressions)])).map(POSTURES)
    distances = in_postures(_random_postures(model).T).full()  # (pairs, postures)
    distances = distances / model.shape.reach
    is_relevant = (distances < NEAR).any(axis=1) & ((distances < TOUCHING).mean(axis=1) < TOGETHER)
    return tuple(pair for pair, relevant in zip(pairs, is_relevant, strict=True) if relevant)


def _random_postures(model: RobotModel) -> Array:
    """Return random coordinates of the joints (POSTURES, joints): within their limits, or a turn, or the reach.

    One in three is at a limit: there bodies are nearest that hardly meet.
    """
    joints = model.spec.joints
    limits = resolve_limits(model.spec)
    first = len(limits.position_low) - len(joints)
    without = np.array([model.shape.reach if joint.prismatic else np.pi for joint in joints])
    low = np.maximum(limits.position_low[first:], -without)
    high = np.maximum(low, np.minimum(limits.position_high[first:], without))
    shares = np.random.default_rng(SEED).uniform(-0.25, 1.25, (POSTURES, len(joints)))
    return np.asarray(low + np.clip(shares, 0, 1) * (high - low))
