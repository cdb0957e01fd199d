"""Spatial robots from files: through a URDF, in our own keys, and what is wrong with either."""

from pathlib import Path

import numpy as np
import pytest

from psmpc_cli.errors import SpecError
from psmpc_cli.specs.fields import Pose
from psmpc_cli.specs.load import load_robot, load_task
from psmpc_cli.specs.robot import SpatialRobot

SERVICER = (Path(__file__).parents[2] / "robots" / "dual_arm_servicer.urdf").read_text()

YAML = """name: r
space: spatial
base: {mass: 10, inertia: [0.2, 0.2, 0.2]}
arms:
  arm:
    links:
      - {joint: {axis: [0, 0, 1]}, mass: 1, inertia: [0.01, 0.02, 0.02]}
limits: {base: {velocity: [0.1, 0.1, 0.1, 0.2, 0.2, 0.2]}}
"""

FILE = """name: r
urdf: servicer.urdf
base: servicer
arms: {left: {tip: left_tool}}
limits: {left: {velocity: [0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1]}}
"""


def saved(folder: Path, text: str, urdf: str = SERVICER) -> Path:
    (folder / "servicer.urdf").write_text(urdf)
    (folder / "r.yaml").write_text(text)
    return folder / "r.yaml"


def test_a_urdf_gives_bodies_and_limits_and_the_file_tightens_them(tmp_path: Path) -> None:
    """The arm that is not named is locked: its 16 kg count with the base."""
    robot = load_robot(saved(tmp_path, FILE))
    assert robot.parts == {"base": 6, "left": 7}
    assert robot.bodies[0].mass == pytest.approx(150 + 16)
    assert robot.limits["left"].velocity == ((-0.1, 0.1),) * 7
    position = robot.limits["left"].position
    assert position is not None
    assert position[1] == pytest.approx((-2.0944, 2.0944))


def test_a_urdf_alone_has_an_arm_for_each_leaf(tmp_path: Path) -> None:
    saved(tmp_path, FILE)
    robot = load_robot(tmp_path / "servicer.urdf")
    assert list(robot.parts) == ["base", "left_tool", "right_tool"]
    assert isinstance(robot, SpatialRobot)
    assert any("left_tool" in note and "no <inertial>" in note for note in robot.assumed)


def test_our_own_keys_give_the_same_robot_as_the_urdf(tmp_path: Path) -> None:
    robot = load_robot(saved(tmp_path, YAML))
    assert robot.parts == {"base": 6, "arm": 1}
    assert robot.limits["base"].velocity is not None


@pytest.mark.parametrize(
    ("right", "wrong", "where", "words"),
    [
        ("[0, 0, 1]", "[0, 0, 2]", "r.yaml:7:24:", ("length 1", "2")),
        ("[0, 0, 1]", "[0, 1]", "r.yaml:7:24:", ("3 entries",)),
        ("[0.01, 0.02, 0.02]", "[0.01, 0.02, 0.05]", "r.yaml:7:", ("sum of the others",)),
        ("[0.01, 0.02, 0.02]", "[-0.01, 0.02, 0.02]", "r.yaml:7:", ("positive principal moments",)),
        ("[0.01, 0.02, 0.02]", "[0.01]", "r.yaml:7:", ("3 principal moments", "6 numbers")),
        ("mass: 1,", "mass: 0,", "r.yaml:7:", ("greater than 0",)),
        ("{axis: [0, 0, 1]}", "{axis: [0, 0, 1], kind: ball}", "r.yaml:7:", ("revolute", "prismatic")),
        ("[0.1, 0.1, 0.1, 0.2, 0.2, 0.2]", "[0.1, 0.1, 0.1]", "r.yaml:8:", ("6 entries", "rx")),
        ("spatial", "spacial", "r.yaml:2:", ("spatial",)),
        (
            "velocity: [0.1",
            "position: [null, null, null, [-1, 1], null, null], velocity: [0.1",
            "r.yaml:8:",
            ("attitude", "null"),
        ),
        ("[0, 0, 1]}", "[0, 0, 1], rpy: [90, 0, 0]}", "r.yaml:7:", ("90 rad", "90 deg")),
        ("mass: 10, ", "", "r.yaml:3:", ('no key "mass"',)),
        ("{base: {velocity", "{arm: {position: [[-120, 120]]}, base: {velocity", "r.yaml:8:", ("-120 deg",)),
        ("    links:", "    mount: arn.1\n    links:", "r.yaml:6:", ("arn.1", "base")),
    ],
)
def test_bad_keys_are_named_where_they_are(
    tmp_path: Path, right: str, wrong: str, where: str, words: tuple[str, ...]
) -> None:
    assert right in YAML
    with pytest.raises(SpecError) as caught:
        load_robot(saved(tmp_path, YAML.replace(right, wrong)))
    assert where in str(caught.value), str(caught.value)
    assert all(word in str(caught.value) for word in words), str(caught.value)


@pytest.mark.parametrize(
    ("right", "wrong", "words"),
    [
        ("servicer.urdf", "gone.urdf", ("gone.urdf", "no readable file", "URDF")),
        ("base: servicer", "base: serviser", ("r.yaml:3:7: base:", "serviser", "servicer")),
        ("left_tool", "left_tol", ("r.yaml:4:20: arms.left.tip:", "left_tol", "left_tool")),
        ("{tip: left_tool}", "{tip: servicer}", ("no joint of its own", "servicer")),
        ("{tip: left_tool}", "{top: left_tool}", ("top", "tip")),
        ("limits:", "locked: {right_joint_9: 1}\nlimits:", ("right_joint_9", "right_joint_1")),
        ("velocity: [0.1, ", "velocity: [", ("7 entries", "limits: {left: {velocity: [0.1, 0.1")),
    ],
)
def test_a_urdf_that_does_not_have_what_the_file_names(
    tmp_path: Path, right: str, wrong: str, words: tuple[str, ...]
) -> None:
    with pytest.raises(SpecError) as caught:
        load_robot(saved(tmp_path, FILE.replace(right, wrong, 1)))
    assert all(word in str(caught.value) for word in words), str(caught.value)


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
