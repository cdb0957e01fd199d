"""Rigid bodies of a planar robot: where they are at Q, as expressions, and their inertial parameters, as numbers."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from psmpc_cli.specs.robot import Arm, Base, Link, RobotSpec


@dataclass(frozen=True)
class PlanarFrame:
    """A rigid transform in the plane: origin (2,) [m] and unwrapped angle of the x axis [rad] in the inertial frame.

    Both are CasADi expressions of Q, or CasADi numbers.
    """

    position: Any
    angle: Any

    def turned(self, angle: Any) -> "PlanarFrame":
        """Return the frame turned about its own origin by `angle` [rad]."""
        return PlanarFrame(self.position, self.angle + angle)

    def moved(self, x: Any, y: Any = 0.0) -> "PlanarFrame":
        """Return the frame moved by (x, y) [m] along its own axes."""
        c, s = ca.cos(self.angle), ca.sin(self.angle)
        return PlanarFrame(self.position + ca.vertcat(x * c - y * s, x * s + y * c), self.angle)

    def pose(self) -> Any:
        """Return (x, y, angle) [m, m, rad], (3,)."""
        return ca.vertcat(self.position, self.angle)


@dataclass(frozen=True)
class Body:
    """A rigid body: mass [kg], inertia about its centre of mass [kg m^2], and a frame at the centre of mass."""

    mass: ca.SX
    inertia: ca.SX
    frame: PlanarFrame


@dataclass(frozen=True)
class Placement:
    """Frames of a robot at Q.

    Attributes:
        centres: At the nominal centre of mass of each body, in the order of `body_names`.
        frames: The frames of xi by name: `base`, then the end-effector of each arm.
        points: Joints of each arm from shoulder to tip, by arm.
    """

    centres: tuple[PlanarFrame, ...]
    frames: Mapping[str, PlanarFrame]
    points: Mapping[str, tuple[PlanarFrame, ...]]


def place_planar(spec: RobotSpec, Q: ca.SX) -> Placement:
    """Compute all frames of a planar robot at the generalized coordinates Q (n,) [m, rad]."""
    base = PlanarFrame(Q[:2], Q[2])
    centres, frames, points = [base], {"base": base}, {}
    first = 3
    for name, arm in spec.arms.items():
        placed = place_arm(arm, base, Q[first : first + len(arm.links)])
        centres += placed.centres
        frames[name], points[name] = placed.frames["tool"], placed.points["arm"]
        first += len(arm.links)
    return Placement(tuple(centres), frames, points)


def place_arm(arm: Arm, base: PlanarFrame, q: Any) -> Placement:
    """Compute the frames of one arm from its shoulder outward at joint angles q (links,) [rad].

    Its end-effector is the frame `tool`, its joints are the points `arm`.
    """
    frame = base.moved(*arm.mount.position).turned(arm.mount.angle)
    points, centres = [frame], []
    for joint, link in enumerate(arm.links):
        frame = frame.turned(q[joint])
        centres.append(frame.moved(link.a))
        frame = frame.moved(link.a + link.b)
        points.append(frame)
    return Placement(tuple(centres), {"tool": frame.turned(arm.tool.angle)}, {"arm": tuple(points)})


@dataclass(frozen=True, eq=False)
class InertialParameters:
    """Inertial parameters of the bodies of a planar robot in the order of `body_names`, and of what its grippers hold.

    Attributes:
        mass: (bodies,) [kg].
        inertia: About the centres of mass (bodies,) [kg m^2].
        offset: Of the centres of mass from the nominal ones, along the axes of the body (bodies, 2) [m].
        held_mass: Of the load in each gripper, at the end-effector frame (arms,) [kg].
        held_inertia: Of the load about that point (arms,) [kg m^2].
    """

    mass: np.ndarray
    inertia: np.ndarray
    offset: np.ndarray
    held_mass: np.ndarray
    held_inertia: np.ndarray

    @classmethod
    def nominal(cls, spec: RobotSpec) -> "InertialParameters":
        """Return the parameters of the robot's description, with empty grippers."""
        bodies: list[Base | Link] = [spec.base, *(link for arm in spec.arms.values() for link in arm.links)]
        return cls(
            mass=np.array([body.mass for body in bodies]),
            inertia=np.array([body.inertia for body in bodies]),
            offset=np.zeros((len(bodies), 2)),
            held_mass=np.zeros(len(spec.arms)),
            held_inertia=np.zeros(len(spec.arms)),
        )

    @property
    def vector(self) -> np.ndarray:
        """All parameters in one vector w, the last argument of the functions of `Dynamics`."""
        return np.concatenate(
            [self.mass, self.inertia, self.offset[:, 0], self.offset[:, 1], self.held_mass, self.held_inertia]
        )

    def holding(self, mass: np.ndarray, inertia: np.ndarray) -> "InertialParameters":
        """Return the same robot with loads of mass (arms,) [kg] and inertia (arms,) [kg m^2] in its grippers."""
        return replace(self, held_mass=mass, held_inertia=inertia)


def body_names(spec: RobotSpec) -> tuple[str, ...]:
    """Return the names of the bodies: `base`, then the links of each arm from the base outward, `arm_1.1`, ..."""
    links = (f"{name}.{number}" for name, arm in spec.arms.items() for number in range(1, len(arm.links) + 1))
    return ("base", *links)


def bodies_at(placed: Placement, w: ca.SX) -> tuple[Body, ...]:
    """Return all bodies of a placed robot, and the loads of its grippers, with the inertial parameters w."""
    count, grippers = len(placed.centres), [frame for name, frame in placed.frames.items() if name != "base"]
    sizes = [count] * 4 + [len(grippers)] * 2
    mass, inertia, along, across, held_mass, held_inertia = ca.vertsplit(w, [0, *np.cumsum(sizes).tolist()])
    own = (Body(mass[i], inertia[i], centre.moved(along[i], across[i])) for i, centre in enumerate(placed.centres))
    held = (Body(held_mass[i], held_inertia[i], gripper) for i, gripper in enumerate(grippers))
    return (*own, *held)
