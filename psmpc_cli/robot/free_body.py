"""A free rigid body: its equations of motion and its prediction.

Its configuration space is that of a robot without joints. A velocity is that of the centre of mass in the inertial
frame with the rate of the angle, or the angular velocity in the body's frame. The frame's origin is the centre of mass.
"""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from psmpc_cli.robot.configuration import ConfigurationSpace, space_of_inertia
from psmpc_cli.robot.kinematics import runge_kutta
from psmpc_cli.robot.rotations import add, conjugate, cross, dot, rotate, scaled
from psmpc_cli.specs.object import ObjectBody

Array = NDArray[np.float64]

STEP = 0.05
"""Largest turn in a step of the prediction [rad]: it is exact to 1e-8 rad over a turn."""


@dataclass(frozen=True, eq=False)
class FreeBody:
    """A body of a mass [kg] and principal moments [kg m^2], one in the plane, three in space, in numbers or symbols."""

    mass: Any
    inertia: Any

    @classmethod
    def symbolic(cls, n_principal: int) -> tuple["FreeBody", ca.SX]:
        """Return a body with so many principal moments in symbols, and these in the order of `vector`."""
        symbols = ca.SX.sym("body", 1 + n_principal)
        return cls(symbols[0], ca.vertsplit(symbols[1:])), symbols

    @property
    def vector(self) -> Array:
        """Mass and principal moments in one vector."""
        return np.array([self.mass, *self.inertia])

    def vector_with(self, found: Array) -> Array:
        """Return mass and principal moments as they were found out, as the body has them where that is empty."""
        return np.concatenate([found, self.vector[len(found) :]])

    @property
    def space(self) -> ConfigurationSpace:
        """The space of its poses."""
        return space_of_inertia(len(self.inertia))

    @property
    def moments(self) -> list[Any]:
        """Moments of inertia about the three axes; of a planar body those in the plane have no effect."""
        return [*self.inertia] * (3 // self.space.n_principal)

    def rates(self, Q: Any, v: Any, wrench: Any) -> tuple[list[Any], list[Any]]:
        """Compute the rates of pose and velocity under a wrench about the centre of mass, in the inertial frame."""
        space = self.space
        _, q = space.to_3d(Q)
        _, omega = space.twist_to_3d(v)
        force, moment = space.twist_to_3d(wrench)
        spin = [moment * rate for moment, rate in zip(self.moments, omega, strict=True)]
        moment = add(rotate(conjugate(q), moment), scaled(cross(omega, spin), -1))
        alpha = [component / inertia for component, inertia in zip(moment, self.moments, strict=True)]
        return space.rate(Q, v), space.twist([component / self.mass for component in force], alpha)

    def momentum(self, Q: Any, v: Any) -> list[Any]:
        """Compute linear [N s] and angular momentum about the inertial origin [N m s], (3,) or (6,)."""
        position, quaternion = self.space.to_3d(Q)
        linear, angular = self.space.twist_to_3d(v)
        p = scaled(linear, self.mass)
        spin = rotate(quaternion, [moment * rate for moment, rate in zip(self.moments, angular, strict=True)])
        return self.space.twist(p, add(spin, cross(position, p)))

    def kinetic_energy(self, v: Any) -> Any:
        """Compute the kinetic energy [J]."""
        linear, angular = self.space.twist_to_3d(v)
        turning = sum(moment * rate**2 for moment, rate in zip(self.moments, angular, strict=True))
        return (self.mass * dot(linear, linear) + turning) / 2

    def predicted(self, Q: Any, v: Any, time: ArrayLike) -> tuple[Array, Array]:
        """Return pose and velocity of the body after times of free motion, with no force on it.

        A body in the plane, or one that turns about a principal axis, keeps its velocity, so that its pose follows in
        one step. For any other body Euler's equations are integrated, in steps of `STEP` at most.

        Args:
            Q: Pose at the beginning, (3,) or (7,).
            v: Velocity then, (3,) or (6,) [m/s, rad/s].
            time: A time, or several at once (...,) [s]; negative ones are earlier.

        Returns:
            Poses (..., 3) or (..., 7), and velocities (..., 3) or (..., 6).
        """
        Q = np.asarray(Q, dtype=float)
        v = np.asarray(v, dtype=float)
        time = np.asarray(time, dtype=float)
        space = self.space
        if not space.has_quaternion:
            return Q + time[..., None] * v, np.broadcast_to(v, (*time.shape, len(v)))
        omega = v[space.rotation]
        spin = [moment * rate for moment, rate in zip(self.moments, omega.tolist(), strict=True)]
        if not any(cross(omega.tolist(), spin)):  # about a principal axis: no gyroscopic moment
            poses = space.integrate(Q, np.multiply.outer(v, time))
            return np.stack(np.broadcast_arrays(*poses), axis=-1), np.broadcast_to(v, (*time.shape, len(v)))
        turned = np.abs(time).max(initial=0.0) * float(np.linalg.norm(v[space.rotation]))
        steps = max(1, int(np.ceil(turned / STEP)))
        no_wrench = np.zeros((space.n, *time.shape))

        def rate(y: Array) -> Array:
            of_pose, of_velocity = self.rates(y[: space.nq], y[space.nq :], no_wrench)
            return np.array([*of_pose, *of_velocity])

        y = np.multiply.outer(np.concatenate([Q, v]), np.ones(time.shape))  # all times in steps of the same number
        for _ in range(steps):
            y = runge_kutta(rate, y, time / steps)
        y = np.moveaxis(y, 0, -1)
        return space.normalized(y[..., : space.nq]), y[..., space.nq :]


def body_of(target_object: ObjectBody) -> FreeBody:
    """Return an object with a mass as a free body."""
    return FreeBody(target_object.mass, target_object.inertia)


def velocity_of(target_object: ObjectBody) -> Array:
    """Return the velocity of an object at the start, (3,) or (6,) [m/s, rad/s]."""
    return np.array([*target_object.motion.linear, *target_object.motion.angular])
