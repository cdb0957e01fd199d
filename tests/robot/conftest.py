import pytest

from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.robots.robot import RobotSpec


@pytest.fixture(scope="session")
def planar_dual_arm(model: RobotModel) -> RobotSpec:
    """Paper Table I."""
    return model.spec
