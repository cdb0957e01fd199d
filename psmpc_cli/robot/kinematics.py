"""Frames of a robot, as expressions of its coordinates: in the plane, and in space."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Self

import casadi as ca

from psmpc_cli.robot.rotations import add, exp, minus, plus, product, rotate, scaled, times, turn
from psmpc_cli.specs.robots.robot import Attachment, Joint, RobotSpec


@dataclass(frozen=True)
class PlanarFrame:
    """A frame in the plane: origin (2,) [m] and unwrapped angle of the x axis [rad], as expressions or numbers."""

    position: Any
    angle: Any

    def carried(self, at: Attachment) -> Self:
        """Return a frame that is fixed to this one."""
        c = ca.cos(self.angle)
        s = ca.sin(self.angle)
        x, y, _ = at.position
        apart = ca.vertcat(minus(times(x, c), times(y, s)), plus(times(x, s), times(y, c)))
        return type(self)(plus(self.position, apart), self.angle).turned(at.rotation, 1.0)

    def moved(self, joint: Joint, q: Any) -> Self:
        """Return the frame carried through a joint at coordinate q [rad]."""
        return self.carried(joint.at).turned(joint.axis, q)

    def turned(self, axis: Sequence[float], angle: Any) -> Self:
        """Return the frame turned about its own origin."""
        return type(self)(self.position, plus(self.angle, times(axis[2], angle)))

    def in_space(self) -> "SpatialFrame":
        """Return the frame in space: that of the plane z = 0."""
        x, y = (self.position[i] for i in range(2))
        return SpatialFrame([x, y, 0.0], [ca.cos(self.angle / 2), 0.0, 0.0, ca.sin(self.angle / 2)])

    @property
    def pose(self) -> Any:
        """The pose (x, y, angle), (3,) [m, m, rad]."""
        return ca.vertcat(self.position, self.angle)


@dataclass(frozen=True)
class SpatialFrame:
    """A frame in space: origin (3,) [m] and unit quaternion (w, x, y, z), as lists of expressions or numbers."""

    position: Sequence[Any]
    quaternion: Sequence[Any]

    def carried(self, at: Attachment) -> Self:
        """Return a frame that is fixed to this one."""
        position = add(self.position, rotate(self.quaternion, at.position))
        return type(self)(position, product(self.quaternion, exp(at.rotation)))

    def moved(self, joint: Joint, q: Any) -> Self:
        """Return the frame carried through a joint at coordinate q [rad, m]."""
        frame = self.carried(joint.at)
        if joint.prismatic:
            along = rotate(frame.quaternion, scaled(joint.axis, q))
            return type(self)(add(frame.position, along), frame.quaternion)
        return type(self)(frame.position, product(frame.quaternion, turn(joint.axis, q)))

    def in_space(self) -> Self:
        """Return the frame itself."""
        return self

    @property
    def pose(self) -> Any:
        """The pose (x, y, z, quaternion), (7,) [m]."""
        return ca.vertcat(*self.position, *self.quaternion)


Frame = PlanarFrame | SpatialFrame


def place(spec: RobotSpec, base: Frame, joints: Any) -> tuple[list[Any], dict[str, Any]]:
    """Compute the frames of a robot's bodies in their order, and those of its end-effectors by arm.

    Its base is at a frame, its joints are at coordinates (joints,) [rad, m].
    """
    frames: list[Any] = [base]
    for number, joint in enumerate(spec.joints):
        frames.append(frames[joint.at.body].moved(joint, joints[number]))
    return frames, {name: frames[tool.body].carried(tool) for name, tool in spec.tools.items()}


def runge_kutta(rate: Callable[[Any], Any], y: Any, h: Any) -> Any:
    """Compute y after a classical Runge-Kutta step h of ydot = rate(y)."""
    k1 = rate(y)
    k2 = rate(y + h / 2 * k1)
    k3 = rate(y + h / 2 * k2)
    k4 = rate(y + h * k3)
    return y + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
