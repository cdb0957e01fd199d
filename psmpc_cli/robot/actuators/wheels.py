"""Reaction wheels on the base: what their motors give of a wrench, and what they store. docs/mobility_model.md.

W wheels have the unit axes A (k, W) along the k components of the base's turn, 1 in the plane and 3 in space. They
store h (W,), together h_w = A h, and their motors change h at the rates tau. The base needs the moment M of
`Dynamics.inverse` from elsewhere, omega x h_w included:

| what moves the base | motors | what thrusters give |
|---|---|---|
| wheels turn it, nothing pushes it | tau = -A^+ M, least in norm | nothing |
| thrusters push and turn it | unloading: towards the first h by a constant torque; by default off | M + A tau |
| nothing | off | nothing |

A motor gives no more than its largest torque, and no more over a tick than leads to its largest momentum. What of the
moment it does not give is missing. Markley, Crassidis: Fundamentals of Spacecraft Attitude Determination and Control
(2014), section 7.5.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from psmpc_cli.robot.configuration import ConfigurationSpace, configuration_space
from psmpc_cli.robot.rotations import rotate
from psmpc_cli.specs.robots.robot import RobotSpec, wheel_axes

Array = NDArray[np.float64]

NO_SHARE = 1e-9
"""Part of the largest share up to which a wheel bears nothing."""

Clip = Callable[[Any, Any, Any], Any]
"""Value, low, high -> the value, or the limit that it is beyond."""


@dataclass(frozen=True, eq=False)
class Wheels:
    """The W wheels of a base.

    Functions of theirs take numbers or expressions alike, and return lists.

    Attributes:
        space: Coordinates of the robot.
        axes: Unit axes A along the components of the base's turn (k, W).
        inertia: About their axes (W,) [kg m^2].
        torque: Largest torques of their motors (W,) [N m].
        momentum: Largest angular momenta that they store (W,) [N m s].
        initial: Those at first (W,) [N m s].
        unloading: Torques with which they are brought back to these while thrusters push the base (W,) [N m].
    """

    space: ConfigurationSpace
    axes: Array
    inertia: Array
    torque: Array
    momentum: Array
    initial: Array
    unloading: Array

    @classmethod
    def of(cls, robot: RobotSpec) -> "Wheels":
        """Return those of a robot, which may have none."""
        wheels = robot.wheels
        return cls(
            space=configuration_space(robot),
            axes=wheel_axes(robot),
            inertia=np.array([wheel.inertia for wheel in wheels]),
            torque=np.array([wheel.torque for wheel in wheels]),
            momentum=np.array([wheel.momentum for wheel in wheels]),
            initial=np.array([wheel.initial for wheel in wheels]),
            unloading=np.array([wheel.unloading for wheel in wheels]),
        )

    @property
    def count(self) -> int:
        """Number of wheels W."""
        return len(self.inertia)

    @property
    def at_first(self) -> list[float]:
        """What they store together at first, along the base's axes (k,) [N m s]."""
        return self.along_base(self.initial.tolist())

    @cached_property
    def allocation(self) -> Array:
        """A^+ (W, k): the wheels' shares, least in norm, of what they have together."""
        return np.asarray(np.linalg.pinv(self.axes))

    def along(self, moment: Array) -> tuple[float, float]:
        """Return how many times torques and momenta of wheels can be a moment along the base's axes (k,), that alone.

        Both are 0 where the wheels' axes do not give it.
        """
        shares = self.allocation @ moment
        if not np.allclose(self.axes @ shares, moment):
            return 0.0, 0.0
        bears = np.abs(shares) > NO_SHARE * np.abs(shares).max()
        torque, momentum = (most[bears] / np.abs(shares[bears]) for most in (self.torque, self.momentum))
        return float(torque.min()), float(momentum.min())

    @cached_property
    def unseen(self) -> Array:
        """I - A^+ A (W, W): of what wheels store the part that adds up to nothing, which their motors leave."""
        return np.asarray(np.eye(self.count) - self.allocation @ self.axes)

    def along_base(self, values: Sequence[Any]) -> list[Any]:
        """Return what torques or momenta of the wheels (W,) are together, along the base's axes (k,)."""
        return [sum((a * value for a, value in zip(row, values, strict=True)), 0.0) for row in self.axes.tolist()]

    def unloading_torques(self, h: Sequence[Any], tick: float, clip: Clip) -> list[Any]:
        """Return the torques (W,) that bring stored momenta h (W,) back to the first ones [N m]."""
        wanted = [(at_first - stored) / tick for at_first, stored in zip(self.initial.tolist(), h, strict=True)]
        return [clip(torque, -most, most) for torque, most in zip(wanted, self.unloading.tolist(), strict=True)]

    def turning_torques(self, moment: Sequence[Any], h: Sequence[Any], tick: float, clip: Clip) -> list[Any]:
        """Return the torques of the wheels' motors that give a moment on the base, as far as limits allow.

        Each torque is limited by what the motor can give, and by the largest momentum that the wheel may store at the
        end of the tick. Arguments are numbers, or CasADi expressions for compiled plants; `clip` is the function that
        bounds one of them.

        Args:
            moment: Wanted moment along the base's axes (k,) [N m].
            h: Momenta that the wheels store (W,) [N m s].
            tick: For how long the torques hold [s].
            clip: Value, low, high -> the value, or the limit that it is beyond.

        Returns:
            The torques (W,) [N m]. A torque turns the base the other way, hence the sign.
        """
        # a wheel's shares are its row of the pseudoinverse of the axes: with them the norm of all torques is least
        torques = []
        wheels = zip(self.allocation.tolist(), h, self.torque.tolist(), self.momentum.tolist(), strict=True)
        for shares, stored, largest_torque, largest_momentum in wheels:
            wanted = -sum((share * part for share, part in zip(shares, moment, strict=True)), 0.0)
            storable = clip(wanted, (-largest_momentum - stored) / tick, (largest_momentum - stored) / tick)
            torques.append(clip(storable, -largest_torque, largest_torque))
        return torques

    def with_unloading(self, F: Array, h: Array, driven: tuple[float, ...], tick: float) -> tuple[Array, Array]:
        """Have motors unload the wheels while thrusters push the base: bring momenta back to the first ones.

        Args:
            F: Generalized force of the low-level law (n,) [N, N m].
            h: Momenta that the wheels store (W,) [N m s].
            driven: 1 for each coordinate of the base on which something acts, else 0, see `RobotModel.driven`. The
                first one is 1 if thrusters push the base.
            tick: For how long the torques hold [s].

        Returns:
            The force that thrusters and joints have to give, with what balances the motors (n,); and the torques of the
            motors (W,) [N m], 0 if nothing pushes the base.
        """
        torques = driven[0] * np.array(self.unloading_torques(h.tolist(), tick, clip_numbers))
        return self.with_moment(F, torques), torques

    def with_turning(
        self, F: Array, h: Array, driven: tuple[float, ...], tick: float, unloading: Array
    ) -> tuple[Array, Array]:
        """Have motors of wheels give the moment on the base, if wheels turn it and nothing pushes it.

        Args:
            F: Generalized force as `with_unloading` returns it, within its limits (n,) [N, N m].
            h: Momenta that the wheels store (W,) [N m s].
            driven: 1 for each coordinate of the base on which something acts, else 0: first those of its translation,
                last those of its rotation.
            tick: For how long the torques hold [s].
            unloading: Torques that unload the wheels (W,) [N m].

        Returns:
            The generalized force that acts on the robot, motors included (n,), and the torques of the motors (W,)
            [N m]. If wheels turn the base, its moment is what the motors give within their limits.
        """
        by_wheels = (1 - driven[0]) * driven[-1]
        turning = np.array(self.turning_torques(F[self.space.rotation].tolist(), h.tolist(), tick, clip_numbers))
        torques = unloading + by_wheels * turning
        F = F.copy()
        F[self.space.rotation] *= 1 - by_wheels
        return self.with_moment(F, -torques), torques

    def with_moment(self, F: Array, torques: Array) -> Array:
        """Return a generalized force (n,) with a moment of torques along the wheels' axes (W,) added."""
        F = F.copy()
        F[self.space.rotation] += self.along_base(torques.tolist())
        return F

    def spins(self, h: Array, v: Array) -> Array:
        """Return the rates at which wheels with momenta h (W,) spin on a base of velocity v (n,), (W,) [rad/s]."""
        return np.asarray(h / self.inertia - v[self.space.rotation] @ self.axes)

    def momenta(self, spins: Array, v: Array) -> Array:
        """Return what wheels that spin so (W,) store on a base of velocity v (n,), (W,) [N m s]."""
        return np.asarray(self.inertia * (spins + v[self.space.rotation] @ self.axes))

    def momentum_and_energy(self, Q: Array, h: Array) -> Array:
        """Return what the wheels add to momentum and kinetic energy of the robot's bodies, at K states.

        The momentum is R h_w, with the attitude R of the base and h_w, what the wheels store together along the base's
        axes. The energy is the sum of h^2 / 2 J over the wheels, of momentum h and inertia J each.

        Args:
            Q: Positions of the robot (K, nq).
            h: Momenta of the wheels (K, W) [N m s].

        Returns:
            Columns: linear momentum, which is 0, and angular momentum, (3,) in the plane and (6,) in space [N s,
            N m s]; then the energy [J]. So (K, 4) or (K, 7).
        """
        space = self.space
        no_linear = [np.zeros(len(Q))] * space.dimension
        _, angular = space.twist_to_3d([*no_linear, *(h @ self.axes.T).T])
        _, quaternion = space.to_3d(Q.T[space.base_coordinates])
        turned = space.twist([np.zeros(len(Q))] * 3, rotate(quaternion, angular))
        return np.column_stack([*turned, (h**2 / (2 * self.inertia)).sum(axis=1)])


def clip_numbers(value: float, low: float, high: float) -> float:
    """Bound a number."""
    return min(max(value, low), high)


def clip_expressions(value: Any, low: Any, high: Any) -> Any:
    """Bound a CasADi expression."""
    return ca.fmin(ca.fmax(value, low), high)
