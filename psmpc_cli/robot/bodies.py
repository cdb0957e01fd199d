"""Where the bodies of a robot are: rigid transforms from the inertial frame outward, as expressions of Q.

Everything above this file speaks of `Frame` and `Body` only. A spatial robot is another `Frame` (position (3,),
rotation matrix, angular velocity (3,)) placed by another function like `place_planar`; energies, momenta and equations
of motion stay as they are.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import casadi as ca

from psmpc_cli.specs.robot import Arm, RobotSpec


class Frame(Protocol):
    """A rigid transform that depends on Q; d = 2 (planar) or 3 (spatial) position coordinates."""

    @property
    def position(self) -> ca.SX:
        """Origin in the inertial frame, (d,) [m]."""

    def pose(self) -> ca.SX:
        """Rows of xi: position [m], then orientation coordinates [rad]."""

    def angular_velocity(self, Q: ca.SX, Qdot: ca.SX) -> ca.SX:
        """Angular velocity in the axes of this frame, (1,) or (3,) [rad/s]."""

    def angular_momentum(self, spin: ca.SX, momentum: ca.SX) -> ca.SX:
        """About the inertial origin, (1,) or (3,) [N m s].

        Args:
            spin: Of the body about this frame's origin, in the axes of this frame, (1,) or (3,) [N m s].
            momentum: Linear, of the body, in inertial axes, (d,) [N s].
        """


@dataclass(frozen=True)
class PlanarFrame:
    """A transform in the plane: origin (2,) [m] and unwrapped angle of its x axis [rad], both in the inertial frame."""

    position: ca.SX
    angle: ca.SX

    def turned(self, angle: ca.SX | float) -> "PlanarFrame":
        """The frame turned about its own origin by `angle` [rad]."""
        return PlanarFrame(self.position, self.angle + angle)

    def moved(self, x: float | ca.SX, y: float | ca.SX = 0.0) -> "PlanarFrame":
        """The frame moved by (x, y) [m] along its own axes."""
        c, s = ca.cos(self.angle), ca.sin(self.angle)
        offset = ca.vertcat(x * c - y * s, x * s + y * c) if isinstance(y, ca.SX) or y else ca.vertcat(x * c, x * s)
        return PlanarFrame(self.position + offset, self.angle)

    def pose(self) -> ca.SX:
        """(x, y, angle) [m, m, rad], (3,)."""
        return ca.vertcat(self.position, self.angle)

    def angular_velocity(self, Q: ca.SX, Qdot: ca.SX) -> ca.SX:
        """About the plane's normal, (1,) [rad/s]."""
        return ca.jtimes(self.angle, Q, Qdot)

    def angular_momentum(self, spin: ca.SX, momentum: ca.SX) -> ca.SX:
        """About the inertial origin, (1,) [N m s]; see `Frame`."""
        return spin + self.position[0] * momentum[1] - self.position[1] * momentum[0]


@dataclass(frozen=True)
class Body:
    """A rigid body: mass [kg], inertia about its centre of mass [kg m^2] in the axes of `frame`, the frame there."""

    mass: float | ca.SX
    inertia: ca.DM | ca.SX
    frame: Frame

    def velocity(self, Q: ca.SX, Qdot: ca.SX) -> ca.SX:
        """Of the centre of mass in the inertial frame, (d,) [m/s]."""
        return ca.jtimes(self.frame.position, Q, Qdot)


@dataclass(frozen=True)
class Placement:
    """A robot put together at Q: its bodies, the frames of xi by name, and each arm's points from shoulder to tip."""

    bodies: tuple[Body, ...]
    frames: Mapping[str, Frame]
    points: Mapping[str, tuple[Frame, ...]]


def place_planar(spec: RobotSpec, Q: ca.SX) -> Placement:
    """Put a planar robot together at the generalized coordinates Q (n,) [m, rad]."""
    base = PlanarFrame(Q[:2], Q[2])
    bodies = [Body(spec.base.mass, ca.DM(spec.base.inertia), base)]
    frames: dict[str, Frame] = {"base": base}
    points: dict[str, tuple[Frame, ...]] = {}
    first = 3
    for name, arm in spec.arms.items():
        placed = _place_arm(arm, base, Q[first : first + len(arm.links)])
        bodies += placed.bodies
        frames[name], points[name] = placed.frames["tool"], placed.points["arm"]
        first += len(arm.links)
    return Placement(tuple(bodies), frames, points)


def _place_arm(arm: Arm, base: PlanarFrame, q: ca.SX) -> Placement:
    """Put one arm together, from its shoulder outward, at its joint angles q (links,) [rad]."""
    frame = base.moved(*arm.mount.position).turned(arm.mount.angle)
    points: list[Frame] = [frame]
    bodies = []
    for joint, link in enumerate(arm.links):
        frame = frame.turned(q[joint])
        bodies.append(Body(link.mass, ca.DM(link.inertia), frame.moved(link.a)))
        frame = frame.moved(link.a + link.b)
        points.append(frame)
    return Placement(tuple(bodies), {"tool": frame.turned(arm.tool.angle)}, {"arm": tuple(points)})
