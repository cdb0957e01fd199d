"""Shared by the tests of dynamics task space and others."""

from functools import lru_cache

import numpy as np

from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.robots.robot import (
    Arm,
    Base,
    Link,
    Mount,
    PlanarRobot,
    SpatialArm,
    SpatialBase,
    SpatialJoint,
    SpatialLink,
    SpatialRobot,
)


@lru_cache
def spatial_robot(joints: int, seed: int) -> RobotModel:
    """A base with one arm of so many joints, alternately about three axes, and another of six."""
    random = np.random.default_rng(seed)
    axes = ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0))

    def link(i: int) -> SpatialLink:
        position = tuple(random.uniform(0.1, 0.5, 3).tolist())
        joint = SpatialJoint(kind="revolute", axis=axes[i % 3], position=position, rpy=(0.0, 0.0, 0.0))
        moments = (*random.uniform(0.2, 0.25, 3).tolist(), 0.01, 0.02, -0.01)
        return SpatialLink(joint=joint, mass=random.uniform(1, 10), centre_of_mass=position, inertia=moments)

    arms = {f"arm_{k}": SpatialArm(links=tuple(map(link, range(k)))) for k in {joints, 6}}
    base = SpatialBase(mass=80.0, inertia=(9.0, 8.0, 7.0, 0.1, 0.2, 0.3), centre_of_mass=(0.1, 0.0, -0.1))
    return RobotModel(SpatialRobot(name="drawn", base=base, arms=arms))


@lru_cache
def planar_robot(joints: int, seed: int) -> RobotModel:
    """A base with one arm of so many joints and another of three."""
    random = np.random.default_rng(seed)

    def link(i: int) -> Link:
        mass, inertia, a, b = random.uniform((1, 0.1, 0.2, 0.2), (10, 1, 0.5, 0.5)).tolist()
        return Link(mass=mass, inertia=inertia, a=a, b=b)

    def arm(joints: int, angle: float) -> Arm:
        return Arm(mount=Mount(position=(0.2, 0.1), angle=angle), links=tuple(map(link, range(joints))))

    arms = {"left": arm(joints, 1.0), "right": arm(3, -2.0)}
    return RobotModel(PlanarRobot(name="drawn", base=Base(mass=40.0, inertia=4.0), arms=arms))
