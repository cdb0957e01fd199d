import pytest

from psmpc_cli.robot.model import build_model
from psmpc_cli.specs.load import load_robot
from psmpc_cli.specs.robot import RobotSpec
from psmpc_cli.studies.bench_robots import robot_with, task_with


@pytest.mark.parametrize(("arms", "joints"), [(1, 3), (2, 5), (3, 7)])
def test_a_robot_keeps_its_size_however_many_joints_it_has(arms: int, joints: int) -> None:
    robot = RobotSpec.model_validate(robot_with(arms, joints))
    pattern = load_robot("planar_dual_arm").spec
    assert build_model(robot).n == 3 + arms * joints
    (of_pattern, *_) = pattern.arms.values()
    for arm in robot.arms.values():
        assert sum(link.a + link.b for link in arm.links) == pytest.approx(1.2)
        assert sum(link.mass for link in arm.links) == pytest.approx(sum(link.mass for link in of_pattern.links))


def test_its_task_holds_and_stays_within_reach() -> None:
    loaded = task_with(3, 4, 8)
    assert [stage.name for stage in loaded.spec.stages] == ["go", "reach"]
    assert loaded.spec.controller.nodes == 8
    assert sum(loaded.robot.parts.values()) == 15
