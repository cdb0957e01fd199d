"""A free rigid body, in the plane or in space: poses relative to it, its equations of motion, its prediction.

A pose is (x, y, angle), or position and unit quaternion; a velocity is that of the centre of mass in the inertial frame
with the rate of the angle, or the angular velocity in the body's frame. The frame's origin is the centre of mass.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from psmpc_cli.robot.kinematics import coordinate_rate, runge_kutta
from psmpc_cli.robot.rotations import add, conjugate, cross, dot, log, product, rotate, scaled, shorter, turn
from psmpc_cli.specs.object import ObjectSpec

Array = NDArray[np.float64]

STEP = 0.05
"""Largest turn in a step of the prediction [rad]: it is exact to 1e-8 rad over a turn."""


def lifted(pose: Any) -> tuple[list[Any], list[Any]]:
    """Return position (3,) and unit quaternion (4,) of a pose, that of the plane in space."""
    if len(pose) == 3:
        return [pose[0], pose[1], 0.0], turn((0.0, 0.0, 1.0), pose[2])
    return list(pose[:3]), list(pose[3:])


def lifted_rate(rate: Any) -> tuple[list[Any], list[Any]]:
    """Return the linear and the angular vector (3,) of a velocity or a wrench, those of the plane in space."""
    if len(rate) == 3:
        return [rate[0], rate[1], 0.0], [0.0, 0.0, rate[2]]
    return list(rate[:3]), list(rate[3:])


def counted(size: int, linear: Any, angular: Any) -> list[Any]:
    """Return the components of two vectors (3,) that count, (3,) or (6,), the inverse of `lifted_rate`."""
    return [*linear[:2], angular[2]] if size == 3 else [*linear, *angular]


def composed(pose: Any, inside: Any) -> Array:
    """Compute a pose that is given in the frame of another one; angles add up."""
    position, quaternion = lifted(pose)
    at, turned = lifted(inside)
    moved = add(position, rotate(quaternion, at))
    return np.array([*moved[:2], pose[2] + inside[2]] if len(pose) == 3 else [*moved, *product(quaternion, turned)])


def relative(pose: Any, to: Any) -> Array:
    """Compute a pose as it is in the frame of another one, the inverse of `composed`."""
    position, quaternion = lifted(to)
    at, turned = lifted(pose)
    back = conjugate(quaternion)
    apart = rotate(back, add(at, scaled(position, -1)))
    return np.array([*apart[:2], pose[2] - to[2]] if len(pose) == 3 else [*apart, *product(back, turned)])


def pose_error(pose: Any, wanted: Any) -> Array:
    """Compute the difference of a pose from a wanted one, (3,) or (6,) [m, rad]: the angle within half a turn."""
    turned = relative(pose, wanted)
    if len(pose) == 3:
        return np.array([pose[0] - wanted[0], pose[1] - wanted[1], np.arctan2(np.sin(turned[2]), np.cos(turned[2]))])
    return np.array([*(np.asarray(pose[:3]) - np.asarray(wanted[:3])), *log(shorter(list(turned[3:])))])


def carried_rate(pose: Any, v: Any, inside: Any) -> Array:
    """Compute the velocity of a pose fixed to a moving one: linear in the inertial frame, angular in its own frame."""
    _, quaternion = lifted(pose)
    at, turned = lifted(inside)
    linear, angular = lifted_rate(v)  # about the body's axes, which in the plane is the same
    moved = add(linear, rotate(quaternion, cross(angular, at)))
    return np.array(counted(len(v), moved, rotate(conjugate(turned), angular)))


@dataclass(frozen=True, eq=False)
class FreeBody:
    """A body of a mass [kg] and principal moments [kg m^2], one in the plane, three in space, in numbers or symbols."""

    mass: Any
    inertia: Any

    @property
    def dimension(self) -> int:
        """2 or 3."""
        return 2 if len(self.inertia) == 1 else 3

    @property
    def moments(self) -> list[Any]:
        """Moments of inertia about the three axes; of a planar body those in the plane have no effect."""
        return [*self.inertia] * (3 if self.dimension == 2 else 1)

    def rates(self, Q: Any, v: Any, wrench: Any) -> tuple[list[Any], list[Any]]:
        """Compute the rates of pose and velocity under a wrench about the centre of mass, in the inertial frame."""
        _, q = lifted(Q)
        _, omega = lifted_rate(v)
        force, moment = lifted_rate(wrench)
        spin = [moment * rate for moment, rate in zip(self.moments, omega, strict=True)]
        moment = add(rotate(conjugate(q), moment), scaled(cross(omega, spin), -1))
        alpha = [each / own for each, own in zip(moment, self.moments, strict=True)]
        return coordinate_rate(Q, v), counted(len(v), [each / self.mass for each in force], alpha)

    def momentum(self, Q: Any, v: Any) -> list[Any]:
        """Compute linear [N s] and angular momentum about the inertial origin [N m s], (3,) or (6,)."""
        position, quaternion = lifted(Q)
        linear, angular = lifted_rate(v)
        p = scaled(linear, self.mass)
        spin = rotate(quaternion, [moment * rate for moment, rate in zip(self.moments, angular, strict=True)])
        return counted(len(v), p, add(spin, cross(position, p)))

    def kinetic_energy(self, v: Any) -> Any:
        """Compute the kinetic energy [J]."""
        linear, angular = lifted_rate(v)
        turning = sum(moment * rate**2 for moment, rate in zip(self.moments, angular, strict=True))
        return (self.mass * dot(linear, linear) + turning) / 2

    def predicted(self, Q: Any, v: Any, time: float) -> tuple[Array, Array]:
        """Return pose and velocity after a time [s] of free motion."""
        Q = np.asarray(Q, dtype=float)
        v = np.asarray(v, dtype=float)
        if self.dimension == 2:
            return Q + time * v, v
        steps = max(1, int(np.ceil(abs(time) * float(np.linalg.norm(v[3:])) / STEP)))
        y = np.concatenate([Q, v])
        h = time / steps
        for _ in range(steps):
            y = runge_kutta(lambda y: np.concatenate(self.rates(y[:7], y[7:], np.zeros(6))), y, h)
        y[3:7] /= np.linalg.norm(y[3:7])
        return y[:7], y[7:]


def body_of(target_object: ObjectSpec) -> FreeBody | None:
    """Return the object as a free body; None if it has no mass."""
    return (
        None
        if target_object.mass is None or target_object.inertia is None
        else FreeBody(target_object.mass, target_object.inertia)
    )


def motion_of(target_object: ObjectSpec) -> Array:
    """Return the velocity of the object at the start, (3,) or (6,) [m/s, rad/s]."""
    size = 3 if len(target_object.pose) == 3 else 6
    return (
        np.zeros(size)
        if target_object.motion is None
        else np.array([*target_object.motion.linear, *target_object.motion.angular])
    )
