"""What a robot looks like as far as its description tells, for drawings: a box, capsules between joints, grippers."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from psmpc_cli.specs.robots.robot import Attachment, Body, Joint, RobotSpec, limits_of_part

Array = NDArray[np.float64]

THICKNESS = 0.028
FINGER = 0.09
"""Radius of a capsule, and length of a gripper's finger, in lengths of the longest arm."""


MASSLESS_BOX = 0.1
"""Half an edge of the cube that a spatial base without a mass is drawn as, in lengths of the longest arm."""

SHORTEST = 1e-9
"""Lengths up to this are 0 [m]."""


class RobotShape:
    """The shape of a robot by its description; every part is fixed to a body's frame, see `RobotModel.body_frames`.

    The base's box goes through the arms' mounts in the plane; in space it is the solid box with the base's inertia. A
    capsule goes from a body's joint to every joint and end-effector that the body carries, and along the travel of a
    prismatic joint; on the base only to mounts outside its box.

    Attributes:
        reach: Length of the longest arm, or half the diagonal of the base if that is more [m].
        radius: Of the capsules [m].
        box: Half edges of the base's box (3,) [m].
        box_frame: Frame of the box in the base's (4, 4) [m].
        capsules: By body, in the order of `RobotSpec.bodies`: from where to where a capsule goes (., 2, 3) [m].
        grippers: By arm, on its last body: end of a finger, palm, end of the other finger (4, 3) [m].
    """

    def __init__(self, spec: RobotSpec) -> None:
        """Find box, capsules and grippers from the places of joints and end-effectors.

        Args:
            spec: The robot.
        """
        arms = (float(np.linalg.norm(spec.link_ends(arm), axis=1).sum()) for arm in spec.arms)
        longest = max(arms, default=0.0)
        self.box, self.box_frame = (
            _planar_box(spec, longest)
            if spec.dimension == 2
            else _solid_box(spec.bodies[0], half=MASSLESS_BOX * longest)
        )
        self.reach = max(longest, float(np.linalg.norm(self.box)))
        self.radius = THICKNESS * self.reach
        # of each body, from where to where its capsules go
        ends: list[list[Sequence[Sequence[float]]]] = [[] for _ in spec.bodies]
        for number, joint in enumerate(spec.joints, start=1):
            at = joint.at
            inside = self.box_frame[:3, :3].T @ (np.array(at.position) - self.box_frame[:3, 3])
            if at.body or (np.abs(inside) > self.box + SHORTEST).any():  # not inside the base's box
                ends[at.body].append(((0, 0, 0), at.position))
            if joint.prismatic:
                along = np.multiply.outer(_travel_limits(spec, number), _rotation_matrix(at) @ joint.axis)
                ends[at.body].append((along + at.position).tolist())
        for tool in spec.tools.values():
            ends[tool.body].append(((0, 0, 0), tool.position))
        visible = (
            [segment for segment in of_body if np.linalg.norm(np.subtract(segment[1], segment[0])) > SHORTEST]
            for of_body in ends
        )
        self.capsules: tuple[Array, ...] = tuple(np.reshape(of_body, (-1, 2, 3)) for of_body in visible)
        finger = FINGER * self.reach
        tools = spec.tools.items()
        self.grippers = {arm: _gripper_outline(spec.joints[tool.body - 1], tool, finger) for arm, tool in tools}


def _planar_box(spec: RobotSpec, longest: float) -> tuple[Array, Array]:
    """Return half edges and frame of a planar robot's base: a box through the arms' mounts."""
    mounts = np.abs([joint.at.position[:2] for joint in spec.joints if joint.at.body == 0])
    half = np.maximum(mounts.max(axis=0), 0.1 * longest)
    return np.array([*np.maximum(half, 0.6 * half.max()), 0.12 * longest]), np.eye(4)


def _solid_box(base: Body, half: float) -> tuple[Array, Array]:
    """Return the solid box that moves as a body does, which is how a body without a shape is drawn.

    A uniform box with half edges a, b, c has principal moments of inertia such as I_a = m (b^2 + c^2) / 3. So
    a^2 = 3 (I_b + I_c - I_a) / (2 m), which is 1.5 / m times the sum of all three less 2 I_a.

    Args:
        base: The body.
        half: Half edges of the cube that a body without a mass is drawn as instead [m].

    Returns:
        Half edges (3,) [m], and the frame of the box in that of the body (4, 4).
    """
    if not base.mass:
        return np.full(3, half), np.eye(4)
    xx, yy, zz, xy, xz, yz = base.inertia
    moments, axes = np.linalg.eigh(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
    if not (xy or xz or yz):
        moments = np.array([xx, yy, zz])
        axes = np.eye(3)
    squared_half_edges = 1.5 / base.mass * (moments.sum() - 2 * moments)
    frame = np.eye(4)
    frame[:3, :3] = axes * np.linalg.det(axes)  # eigenvectors may be left-handed, of determinant -1
    frame[:3, 3] = base.centre
    # a thin body would have no width to be seen
    return np.sqrt(np.maximum(squared_half_edges, 1e-3 * squared_half_edges.max())), frame


def _travel_limits(spec: RobotSpec, number: int) -> Array:
    """Return the lower and upper limit of a body's joint [m], 0 where there is none."""
    arm, _, link = spec.bodies[number].name.rpartition(".")
    limits = limits_of_part(spec.limits, arm, "position")
    return np.array((limits and limits[int(link) - 1]) or (0.0, 0.0))


def _rotation_matrix(at: Attachment) -> Array:
    return np.asarray(Rotation.from_rotvec(at.rotation).as_matrix())


def _gripper_outline(joint: Joint, tool: Attachment, finger: float) -> Array:
    """Return the outline of a gripper, open along the last link, its fingers apart in the plane its joint turns in."""
    tip = np.array(tool.position)
    turned = _rotation_matrix(tool)
    along = tip / length if (length := np.linalg.norm(tip)) > 1e-9 else turned[:, 2]
    across = np.cross(joint.axis, along)
    if np.linalg.norm(across) < 0.1:  # a wrist that rolls
        across = turned[:, 1] - (turned[:, 1] @ along) * along
    if np.linalg.norm(across) < 0.1:
        across = np.cross(turned[:, 0], along)
    along = finger * along
    across = 0.7 * finger * across / np.linalg.norm(across)
    return np.array([tip + across + along, tip + across, tip - across, tip - across + along])
