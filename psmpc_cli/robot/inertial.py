"""A robot whose bodies weigh what an argument says: its equations of motion with masses and inertias as inputs.

One set of functions serves every draw of an uncertain robot, with and without what it carries.
"""

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from psmpc_cli.robot.bodies import Body, Frame, PlanarFrame, place_planar
from psmpc_cli.robot.dynamics import Dynamics, derive
from psmpc_cli.specs.robot import Base, Link, RobotSpec


@dataclass(frozen=True, eq=False)
class Inertials:
    """What the bodies of a planar robot weigh: the base, then the links arm by arm, from the base outward.

    Attributes:
        mass: (bodies,) [kg].
        inertia: About the centres of mass (bodies,) [kg m^2].
        offset: Of the centres of mass from where the description has them, along the axes of the body (bodies, 2) [m].
        held_mass: Of what each gripper holds, at its frame (arms,) [kg].
        held_inertia: The same about that point (arms,) [kg m^2].
    """

    mass: np.ndarray
    inertia: np.ndarray
    offset: np.ndarray
    held_mass: np.ndarray
    held_inertia: np.ndarray

    @property
    def vector(self) -> np.ndarray:
        """All of it in one row, as `WeighedRobot` takes it."""
        return np.concatenate(
            [self.mass, self.inertia, self.offset[:, 0], self.offset[:, 1], self.held_mass, self.held_inertia]
        )

    def holding(self, mass: np.ndarray, inertia: np.ndarray) -> "Inertials":
        """Return the same robot with something of mass (arms,) [kg] and inertia (arms,) [kg m^2] in its grippers."""
        return replace(self, held_mass=mass, held_inertia=inertia)


def described(spec: RobotSpec) -> Inertials:
    """Return what a robot weighs by its description, with nothing in its grippers."""
    bodies: list[Base | Link] = [spec.base, *(link for arm in spec.arms.values() for link in arm.links)]
    return Inertials(
        mass=np.array([body.mass for body in bodies]),
        inertia=np.array([body.inertia for body in bodies]),
        offset=np.zeros((len(bodies), 2)),
        held_mass=np.zeros(len(spec.arms)),
        held_inertia=np.zeros(len(spec.arms)),
    )


def body_names(spec: RobotSpec) -> tuple[str, ...]:
    """Return the names of the bodies in the order of `Inertials`: `base`, `arm_1.1`, ..."""
    links = (f"{name}.{number}" for name, arm in spec.arms.items() for number in range(1, len(arm.links) + 1))
    return ("base", *links)


@dataclass(frozen=True, eq=False)
class WeighedRobot:
    """Equations of motion with the vector w of `Inertials` as an argument. Functions take and give columns.

    Attributes:
        size: Length of w.
        H: Q, w -> (n, n) [kg, kg m, kg m^2]. Paper eq. (3).
        inverse_dynamics: Q, Qdot, Qddot, w -> F (n,) [N, N m]. Paper eqs. (3), (7).
        forward_dynamics: Q, Qdot, F, w -> Qddot (n,) [m/s^2, rad/s^2]. Paper eq. (3).
        kept: x, w -> momentum (3,) [N s], [N m s] and kinetic energy [J].
    """

    size: int
    H: ca.Function
    inverse_dynamics: ca.Function
    forward_dynamics: ca.Function
    kept: ca.Function


def weigh(spec: RobotSpec) -> WeighedRobot:
    """Build the functions of a planar robot."""
    n, w = sum(spec.parts.values()), ca.SX.sym("w", len(described(spec).vector))
    Q, Qdot, Qddot, F = (ca.SX.sym(name, n) for name in ("Q", "Qdot", "Qddot", "F"))
    motion: Dynamics = derive(_bodies(spec, Q, w), Q, Qdot, Qddot, F)
    return WeighedRobot(
        size=w.numel(),
        H=ca.Function("H", [Q, w], ca.cse([motion.H])),
        inverse_dynamics=ca.Function("inverse_dynamics", [Q, Qdot, Qddot, w], ca.cse([motion.inverse])),
        forward_dynamics=ca.Function("forward_dynamics", [Q, Qdot, F, w], ca.cse([motion.forward])),
        kept=ca.Function("kept", [ca.vertcat(Q, Qdot), w], ca.cse([motion.momentum, motion.kinetic_energy])),
    )


def _bodies(spec: RobotSpec, Q: ca.SX, w: ca.SX) -> list[Body]:
    """Return the bodies at Q (n,), weighed by w, and those in the grippers."""
    placed, arms = place_planar(spec, Q), len(spec.arms)
    count = len(placed.bodies)
    mass, inertia, along, across, held_mass, held_inertia = ca.vertsplit(
        w, list(np.cumsum([0, count, count, count, count, arms, arms]))
    )
    bodies = []
    for i, body in enumerate(placed.bodies):
        bodies.append(Body(mass[i], inertia[i], _planar(body.frame).moved(along[i], across[i])))
    for i, name in enumerate(spec.arms):
        bodies.append(Body(held_mass[i], held_inertia[i], placed.frames[name]))
    return bodies


def _planar(frame: Frame) -> PlanarFrame:
    """Return the frame of a planar robot as one that can be moved."""
    pose = frame.pose()
    return PlanarFrame(pose[:2], pose[2])
