"""Angles, attitudes and poses as files write them."""

from pathlib import Path

import numpy as np
import pytest

from psmpc_cli.errors import SpecError
from psmpc_cli.specs.fields import Pose
from psmpc_cli.specs.load import Task, load_task, parse_task


@pytest.mark.parametrize(
    ("path", "value", "kept"),
    [
        ("stages.approach.target.base[2]", "30", "30 rad"),
        ("stages.capture.target.arm_1[2]", "-45", "-45 rad"),
        ("initial.arm_1[1]", "90", "7 rad"),
        ("object.pose[2]", "30", "-30 rad"),
        ("limits", "{base: {position: [[-5, 5], [-5, 5], [-180, 180]]}}", None),
    ],
)
def test_angle_beyond_a_turn_needs_a_unit(path: str, value: str, kept: str | None) -> None:
    number = value if kept else "-180"
    with pytest.raises(SpecError, match=rf'{number} rad \(did you mean "{number} deg"\?\)'):
        load_task("transport", [f"{path}={value}"])
    if kept:
        load_task("transport", {path: kept})
    assert load_task("transport", ["stages.approach.target.base[0]=30"]).spec.stages[0].target["base"][0] == 30


def test_angle_of_a_robot_beyond_a_turn_needs_a_unit(transport: Task) -> None:
    with pytest.raises(SpecError, match=r'arms.arm_1.mount.angle: found 90 rad \(did you mean "90 deg"\?\)'):
        parse_task(transport.task_yaml, transport.robot_yaml.replace("angle: 0 deg", "angle: 90", 1), "transport")


@pytest.mark.parametrize(
    "attitude",
    [{"quaternion": [0, 0, 0, 2]}, {"rpy": [0, 0, "180 deg"]}, {"axis": [0, 0, 1], "angle": "180 deg"}],
)
def test_an_attitude_is_written_in_three_ways(attitude: dict[str, object]) -> None:
    pose = Pose.model_validate({"position": [1, 2, 3], "attitude": attitude})
    np.testing.assert_allclose(np.abs(pose.numbers), [1, 2, 3, 0, 0, 0, 1], atol=1e-15)


TASK = """robot: free_flyer_arm
initial: {base: {position: [0, 0, 0]}, arm: [0, 0, 0]}
skills:
  move: {space: joint, weights: {base: [1, 1, 1, 1, 1, 1], arm: [1, 1, 1], control: 0.1}}
stages:
  - name: fly
    skill: move
    target: {base: {position: [1, 0, 0], attitude: {rpy: [0, 0, 90 deg]}}, arm: [0, 0, 0]}
    ends_when: {coordinates: [base.rz], tolerance: 0.01}
"""


def test_a_pose_of_a_task_becomes_position_and_quaternion(tmp_path: Path) -> None:
    (tmp_path / "t.yaml").write_text(TASK)
    target = load_task(tmp_path / "t.yaml").spec.stages[0].target
    assert isinstance(target, dict)
    np.testing.assert_allclose(target["base"], [1, 0, 0, np.sqrt(0.5), 0, 0, np.sqrt(0.5)])


@pytest.mark.parametrize(
    ("right", "wrong", "where", "words"),
    [
        ("rpy: [0, 0, 90 deg]", "rpy: [0, 90 deg]", "t.yaml:8:", ("3 angles",)),
        ("rpy: [0, 0, 90 deg]", "rpy: [0, 0, 90]", "t.yaml:8:", ("90 rad", "90 deg")),
        ("rpy: [0, 0, 90 deg]", "angle: 90 deg", "t.yaml:8:", ("axis and angle",)),
        ("rpy: [0, 0, 90 deg]", "axis: [0, 0, 2], angle: 90 deg", "t.yaml:8:", ("length 1",)),
        ("rpy: [0, 0, 90 deg]", "rpy: [0, 0, 0], quaternion: [1, 0, 0, 0]", "t.yaml:8:", ("either rpy",)),
        ("rpy: [0, 0, 90 deg]", "quaternion: [0, 0, 0, 0]", "t.yaml:8:", ("not 0",)),
        ("position: [1, 0, 0]", "position: [1, 0]", "t.yaml:8:", ("3 entries",)),
        ("attitude:", "atitude:", "t.yaml:8:", ("atitude", "attitude")),
        (
            "base: {position: [1, 0, 0], attitude: {rpy: [0, 0, 90 deg]}}",
            "base: [1, 0, 0]",
            "t.yaml:8:",
            ("7 entries",),
        ),
        ("weights:", "input: task, weights:", "t.yaml:4:", ("joint",)),
        ("control: 0.1", "control: {base: [1, 1, 1], arm: [1, 1, 1]}", "t.yaml:4:", ("6 entries",)),
        ("base.rz", "base.theta", "t.yaml:9:", ("base.theta", "base.rz")),
    ],
)
def test_a_wrong_pose_is_named_where_it_is(
    tmp_path: Path, right: str, wrong: str, where: str, words: tuple[str, ...]
) -> None:
    assert right in TASK
    (tmp_path / "t.yaml").write_text(TASK.replace(right, wrong))
    with pytest.raises(SpecError) as caught:
        load_task(tmp_path / "t.yaml")
    assert where in str(caught.value), str(caught.value)
    assert all(word in str(caught.value) for word in words), str(caught.value)
