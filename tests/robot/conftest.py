import math

import pytest

from psmpc_cli.robot.model import RobotModel, build_model
from psmpc_cli.specs.robot import Arm, Base, Link, Mount, PartLimits, RobotSpec, Tool


@pytest.fixture(scope="session")
def planar_dual_arm() -> RobotSpec:
    """Paper Table I."""
    upper = Link(mass=4.2, inertia=0.35, a=0.25, b=0.25)
    links = (upper, upper, Link(mass=2.0, inertia=0.0267, a=0.1, b=0.1))
    half_turn = (-math.pi, math.pi)
    return RobotSpec(
        name="planar_dual_arm",
        base=Base(mass=30, inertia=1.35),
        arms={
            "arm_1": Arm(mount=Mount(position=(0.3, 0.0), angle=0.0), links=links),
            "arm_2": Arm(mount=Mount(position=(-0.3, 0.0), angle=math.pi), links=links, tool=Tool(angle=-math.pi)),
        },
        limits={"arms": PartLimits(position=((-math.pi / 2, math.pi / 2), half_turn, half_turn))},
    )


@pytest.fixture(scope="session")
def model(planar_dual_arm: RobotSpec) -> RobotModel:
    return build_model(planar_dual_arm)
