"""Spatial robots from files: through a URDF, in our own keys, and what is wrong with either."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from psmpc_cli.errors import SpecError
from psmpc_cli.specs.geometry import PlacedShape, ShapeSpec
from psmpc_cli.specs.load import load_robot, load_task
from psmpc_cli.specs.parts import QUANTITIES
from psmpc_cli.specs.robots.robot import (
    Limits,
    PartLimits,
    RobotSpec,
    SpatialRobot,
    inertia_without_wheels,
    resolve_limits,
)

SERVICER = (Path(__file__).parents[3] / "robots" / "dual_arm_servicer.urdf").read_text()


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


def test_armatures_go_to_the_joints_they_are_given_for(tmp_path: Path) -> None:
    """An arm's own take precedence over those of every arm; the URDF says nothing of them."""
    arms = (
        FILE.replace("arms: {left", "arms: {right: {tip: right_tool}, left") + "armature: {left: [1, 2, 3, 4, 5, 6, 7]"
    )
    robot = load_robot(saved(tmp_path, arms + ", arms: [0, 0, 0, 0, 0, 0, 0.1]}\n"))
    assert [joint.armature for joint in robot.joints] == [0] * 6 + [0.1, 1, 2, 3, 4, 5, 6, 7]
    planar = load_robot("planar_dual_arm")
    assert {joint.armature for joint in planar.joints} == {0}


LIMIT = '<limit lower="-2" upper="2" velocity="0.5" effort="20"/>'


def one_joint(folder: Path, more: str = "", limit: str = LIMIT, kind: str = "revolute") -> Path:
    """A robot file of a base and an arm of one joint, from a URDF beside it."""
    inertial = '<inertial><mass value="9"/><inertia ixx="1" iyy="1" izz="1"/></inertial>'
    joint = f'<joint name="j" type="{kind}"><parent link="b"/><child link="l"/><axis xyz="0 0 1"/>{limit}</joint>'
    links = "".join(f'<link name="{name}">{inertial}</link>' for name in ("b", "l"))
    (folder / "r.urdf").write_text(f'<robot name="r">{links}{joint}</robot>')
    (folder / "r.yaml").write_text(f"urdf: r.urdf\narms: {{arm: {{tip: l}}}}\n{more}")
    return folder / "r.yaml"


def bounds(robot: RobotSpec, *more: Mapping[str, PartLimits]) -> dict[str, tuple[float, float]]:
    """The limits in force of the joint of `one_joint`, by quantity."""
    found = resolve_limits(robot, *more)
    return {each: (getattr(found, f"{each}_low")[6], getattr(found, f"{each}_high")[6]) for each in QUANTITIES}


NO_LIMIT = (-np.inf, np.inf)
OF_URDF = {
    "position": (-2, 2),
    "velocity": (-0.5, 0.5),
    "acceleration": NO_LIMIT,
    "jerk": NO_LIMIT,
    "force": (-20, 20),
}


@pytest.mark.parametrize("quantity", QUANTITIES)
@pytest.mark.parametrize("key", ["arm", "arms"])
@pytest.mark.parametrize("high", [0.25, 40.0])
def test_a_limit_of_the_file_replaces_the_urdf_s_and_a_task_tightens_both(
    tmp_path: Path, quantity: str, key: str, high: float
) -> None:
    """Whichever quantity it is, by an arm's name or for every arm, tighter or wider; the others stay the URDF's."""
    given = f"{{{key}: {{{quantity}: [[-0.1, {high}{' rad' * (quantity != 'force')}]]}}}}"
    robot = load_robot(one_joint(tmp_path, f"limits: {given}\n"))
    assert bounds(robot) == {**OF_URDF, quantity: (-0.1, high)}
    for name in ("arm", "arms"):
        of_task = {name: PartLimits.model_validate({quantity: [[-0.01, 0.02]]})}
        assert bounds(robot, of_task) == {**OF_URDF, quantity: (-0.01, 0.02)}
        assert bounds(load_robot(one_joint(tmp_path)), of_task)[quantity] == (-0.01, 0.02)


@pytest.mark.parametrize("quantity", QUANTITIES)
def test_an_arm_s_own_limit_comes_before_that_of_every_arm(tmp_path: Path, quantity: str) -> None:
    text = f"limits: {{arms: {{{quantity}: [[-0.1, 0.1]]}}, arm: {{{quantity}: [[-0.2, 0.3]]}}}}\n"
    assert bounds(load_robot(one_joint(tmp_path, text)))[quantity] == (-0.2, 0.3)
    none = f"limits: {{arms: {{{quantity}: [null]}}}}\n"
    assert bounds(load_robot(one_joint(tmp_path, none)))[quantity] == (-np.inf, np.inf)
    left_out = f"limits: {{arms: {{{quantity}: null}}}}\n"
    assert bounds(load_robot(one_joint(tmp_path, left_out))) == OF_URDF


@pytest.mark.parametrize(
    ("limit", "more"),
    [
        (
            '<limit lower="2" upper="-2" velocity="-1" effort="-3"/>',
            "limits: {arms: {position: [[-1, 1]], velocity: [1], force: [1]}}\n",
        ),
        (
            '<limit lower="x" upper="y"/><axis xyz="0 0 0"/>',
            "limits: {arm: {position: [[-1, 1]], velocity: [1], force: [1]}}\n",
        ),
        ('<limit lower="2" upper="-2"/>', "locked: {j: 0.5}\n"),
        ('<limit lower="-90" upper="90" velocity="200"/>', "locked: {j: 0.5}\n"),
    ],
)
def test_what_a_robot_does_not_use_of_its_urdf_is_not_checked(tmp_path: Path, limit: str, more: str) -> None:
    """Limits that the file replaces, and those of joints that do not move."""
    path = one_joint(tmp_path, more, limit.partition("<axis")[0])
    if "locked" in more:
        path.write_text(f"urdf: r.urdf\n{more}")
    robot = load_robot(path)
    assert isinstance(robot, SpatialRobot)
    assert not any("limit" in note or "degrees" in note for note in robot.assumed), robot.assumed


@pytest.mark.parametrize("kind", ["continuous"])
def test_limits_of_a_joint_without_end_are_among_what_is_assumed(tmp_path: Path, kind: str) -> None:
    robot = load_robot(one_joint(tmp_path, kind=kind))
    assert bounds(robot) == {**OF_URDF, "position": (-np.inf, np.inf)}
    assert isinstance(robot, SpatialRobot)
    (note,) = robot.assumed
    assert all(word in note for word in ('lower="-2"', 'upper="2"', 'joint "j"', "continuous", "without limits")), note


def test_what_else_a_joint_of_a_urdf_says_is_noted_once(tmp_path: Path) -> None:
    """Friction is a task's, soft limits are nobody's."""
    more = '<dynamics damping="0.5" friction="0"/><safety_controller k_velocity="1" soft_lower_limit="-1"/>'
    robot = load_robot(one_joint(tmp_path, limit=LIMIT + more))
    assert isinstance(robot, SpatialRobot)
    friction, soft = robot.assumed
    assert "1 joint (j)" in friction and "uncertainty.friction" in friction
    assert "1 joint (j)" in soft and "soft limits" in soft
    without = LIMIT + '<dynamics damping="0.0" friction="0"/>'
    robot = load_robot(one_joint(tmp_path, limit=without))
    assert isinstance(robot, SpatialRobot)
    assert robot.assumed == ()


SPHERE = "geometry: {left.3: [{shape: {sphere: 0.1}, pose: {position: [1, 2, 3]}}]}\n"


def test_geometry_is_kept_in_files_with_a_urdf_too(tmp_path: Path) -> None:
    robot = load_robot(saved(tmp_path, FILE + SPHERE))
    (placed,) = robot.geometry["left.3"]
    assert placed.shape.sphere == 0.1
    assert placed.pose == (1, 2, 3, 1, 0, 0, 0)
    with pytest.raises(SpecError, match=r"r\.yaml:6:12: geometry\.left\.8: .*no such body.*left\.7"):
        load_robot(saved(tmp_path, FILE + SPHERE.replace("left.3", "left.8")))
    with pytest.raises(SpecError, match=r"r\.yaml:6:.*shape\.box: .*3 entries"):
        load_robot(saved(tmp_path, FILE + SPHERE.replace("sphere: 0.1", "box: [1, 1]")))


def test_geometry_is_in_digests_only_where_it_is_given() -> None:
    robot = load_robot("planar_dual_arm")
    assert "geometry" not in robot.model_dump(mode="json")
    shaped = robot.model_copy(update={"geometry": {"base": (PlacedShape(shape=ShapeSpec(sphere=1.0)),)}})
    assert shaped.model_dump(mode="json")["geometry"]["base"][0]["shape"]["sphere"] == 1.0


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
        ("limits:", "armature: {arn: [0.1]}\nlimits:", "r.yaml:8:12: armature.arn:", ("no such part", '"arm"')),
        ("limits:", "armature: {base: [0.1]}\nlimits:", "r.yaml:8:12: armature.base:", ("no such part", "arm")),
        ("limits:", "armature: {arm: [0.1, 0]}\nlimits:", "r.yaml:8:17: armature.arm:", ("1 entry for arm",)),
        ("limits:", "armature: {arms: [-1]}\nlimits:", "r.yaml:8:19: armature.arms[0]:", ("at least 0",)),
        ("limits:", "armature: {arm: 0.1}\nlimits:", "r.yaml:8:17: armature.arm:", ("a list",)),
        ("limits:", "geometry: {arn.1: []}\nlimits:", "r.yaml:8:12: geometry.arn.1:", ("no such body", "arm.1")),
        ("limits:", "geometry: {arms: []}\nlimits:", "r.yaml:8:12: geometry.arms:", ("no such body", "base, arm.1")),
        ("limits:", "geometry: {base: {sphere: 1}}\nlimits:", "r.yaml:8:18: geometry.base:", ("a list",)),
        (
            "limits:",
            "geometry: {base: [{shape: {sphere: 1, box: [1, 1, 1]}}]}\nlimits:",
            "r.yaml:8:20: geometry.base[0].shape:",
            ("sphere, box", "one of sphere, capsule, box"),
        ),
        ("limits:", "geometry: {base: [{shape: {}}]}\nlimits:", "r.yaml:8:20: ", ("none", "one of sphere")),
        (
            "limits:",
            "geometry: {base: [{shape: {box: [1, 1]}}]}\nlimits:",
            "r.yaml:8:33: geometry.base[0].shape.box:",
            ("3 entries",),
        ),
        (
            "limits:",
            "geometry: {base: [{shape: {half_space: [1, 0, 0]}}]}\nlimits:",
            "r.yaml:8:28: geometry.base[0].shape.half_space:",
            ("sphere, capsule or box",),
        ),
        (
            "limits:",
            "geometry: {base: [{shape: {sphere: 1}, pose: [0, 0, 0]}]}\nlimits:",
            "r.yaml:8:46: geometry.base[0].pose:",
            ("7 entries",),
        ),
        (
            "limits:",
            "geometry: {base: [{shape: {sphere: 1}, pose: [0, 0, 0, 0, 0, 0, 0]}]}\nlimits:",
            "r.yaml:8:46: geometry.base[0].pose:",
            ("quaternion", "not 0"),
        ),
        ("limits:", "geometry: {base: [{shape: {sphere: 0}}]}\nlimits:", "r.yaml:8:36: ", ("greater than 0",)),
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
        ("limits:", "armature: {left: [1]}\nlimits:", ("r.yaml:5:18: armature.left:", "7 entries")),
        ("limits:", "armature: {right: [1]}\nlimits:", ("armature.right:", "no such part of the robot", "left, arms")),
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
    ("kind", "at", "wanted"),
    [
        ("revolute", "0.1 m", "expected an angle"),
        ("revolute", "8", "did you mean"),
        ("prismatic", "30 deg", "expected a length"),
        ("prismatic", "8 m", ""),
        ("prismatic", "8", ""),
        ("revolute", "30 deg", ""),
    ],
)
def test_locked_joints_are_in_their_own_units(tmp_path: Path, kind: str, at: str, wanted: str) -> None:
    path = one_joint(tmp_path, kind=kind)
    path.write_text(f"urdf: r.urdf\nlocked: {{j: {at}}}\n")
    if wanted:
        with pytest.raises(SpecError, match=wanted):
            load_robot(path)
        return
    robot = load_robot(path)
    assert isinstance(robot, SpatialRobot)
    assert any(f"locked at {'8 m' if kind == 'prismatic' else '0.523599 rad'}" in note for note in robot.assumed)


TURNED_ALONG_ONE_AXIS = """
name: one_wheel
space: spatial
base: {mass: 10, inertia: [0.2, 0.2, 0.2]}
arms:
  arm:
    links:
      - {joint: {axis: [0, 0, 1]}, mass: 1, inertia: [0.01, 0.01, 0.01]}
wheels: [{axis: [0, 0, 2], inertia: 0.01, torque: 0.2, momentum: 4}]
"""


@pytest.mark.parametrize("where", ["mobility", "skills.move.mobility", "stages.0.mobility"])
def test_wheels_that_turn_the_base_in_some_stage_span_space(tmp_path: Path, where: str) -> None:
    """Whether task, skill or stage says that they do; else they may be as they are."""
    path = tmp_path / "one_wheel.yaml"
    path.write_text(TURNED_ALONG_ONE_AXIS)
    task = {
        "robot": str(path),
        "initial": {"base": {"position": [0, 0, 0]}, "arm": [0]},
        "skills": {"move": {"space": "joint", "weights": {"base": [1, 1, 1, 1, 1, 1], "arm": [1]}}},
        "stages": [
            {
                "name": "go",
                "skill": "move",
                "target": {"base": {"position": [0, 0, 0]}, "arm": [0]},
                "ends_when": {"coordinates": ["arm"]},
            }
        ],
    }
    load_task(task)
    with pytest.raises(SpecError, match=r"one_wheel\.yaml:9:9: wheels: found axes in one plane; expected wheels about"):
        load_task(task, {where: "attitude"})


def test_the_inertia_of_a_base_without_its_wheels(tmp_path: Path) -> None:
    """I - J a a', for an axis of any length."""
    path = tmp_path / "one_wheel.yaml"
    path.write_text(TURNED_ALONG_ONE_AXIS.replace("[0, 0, 2]", "[1, 1, 0]"))
    expected = (0.195, 0.195, 0.2, -0.005, 0.0, 0.0)
    assert inertia_without_wheels(load_robot(path)) == pytest.approx(expected, abs=1e-15)


@given(
    wanted=st.floats(0.0, 1.0),
    v=st.floats(-0.15, 0.15),
    limit=st.sampled_from([0.15, np.inf]),
    acceleration=st.sampled_from([0.5, np.inf]),
)
def test_a_robot_that_brakes_gently_keeps_limits_with_a_reserve_of_speed(
    wanted: float, v: float, limit: float, acceleration: float
) -> None:
    limits = limits_of_speed(limit, acceleration)
    reserve = limits.available_speed_reserve(np.full(9, wanted), np.full(9, v), sample_time=0.1)
    assert ((reserve >= 0) & (reserve <= min(wanted, 0.2 * limit))).all()
    tightened = limits.with_speed_reserve(reserve)
    braked = v - np.clip(v, -0.05 * acceleration * 0.1, 0.05 * acceleration * 0.1)
    assert (tightened.velocity_low <= braked + 1e-15).all()
    assert (braked - 1e-15 <= tightened.velocity_high).all()


def test_a_speed_that_was_not_measured_or_is_beyond_its_limit_leaves_no_reserve() -> None:
    limits = limits_of_speed(0.15, 0.5)
    v = np.r_[np.nan, 0.2, -0.2, np.zeros(6)]
    raised, lowered = limits.available_speed_reserve(np.full(9, 0.01), v, sample_time=0.1)
    np.testing.assert_array_equal(raised[:3], [0.0, 0.01, 0.0])
    np.testing.assert_array_equal(lowered[:3], [0.0, 0.0, 0.01])


def limits_of_speed(limit: float, acceleration: float) -> Limits:
    """Return limits of nine coordinates of which speed and acceleration are limited so."""
    bounds = {"velocity": limit, "acceleration": acceleration}
    return replace(
        resolve_limits(load_task("transport").robot),
        **{f"{quantity}_low": np.full(9, -high) for quantity, high in bounds.items()},
        **{f"{quantity}_high": np.full(9, high) for quantity, high in bounds.items()},
    )
