"""Spatial robots against MuJoCo and Pinocchio: random trees, and robots that packages ship."""

from importlib.metadata import files
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given

from psmpc_cli.errors import SpecError
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.robot.mujoco_model import mujoco_spec
from psmpc_cli.robot.rotations import matrix
from psmpc_cli.specs.load import load_robot
from psmpc_cli.specs.robot import Attachment, Body, SpatialRobot
from psmpc_cli.specs.urdf import read_urdf

from .strategies import Array, State, laws, moving_spatial_robots

CLOSE = 1e-10


def close(found: Array, expected: Array) -> None:
    """Equal to 1e-10 of the largest entry, or absolutely."""
    np.testing.assert_allclose(found, expected, rtol=0, atol=CLOSE * max(1.0, float(np.abs(expected).max())))


def in_pinocchio(spec: SpatialRobot) -> pin.Model:
    """The same bodies as a Pinocchio model, joint by joint."""
    model, numbers = pin.Model(), [1]
    model.gravity.setZero()
    model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
    model.appendBodyToJoint(1, inertia(spec.bodies[0]), pin.SE3.Identity())
    for body, joint in zip(spec.bodies[1:], spec.joints, strict=True):
        kind = pin.JointModelPrismaticUnaligned if joint.prismatic else pin.JointModelRevoluteUnaligned
        numbers.append(model.addJoint(numbers[joint.at.body], kind(np.array(joint.axis)), frame(joint.at), body.name))
        model.appendBodyToJoint(numbers[-1], inertia(body), pin.SE3.Identity())
    return model


def frame(at: Attachment) -> pin.SE3:
    return pin.SE3(pin.exp3(np.array(at.rotation)), np.array(at.position))


def inertia(body: Body) -> pin.Inertia:
    xx, yy, zz, xy, xz, yz = body.inertia
    return pin.Inertia(body.mass, np.array(body.centre), np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))


def pinocchio_state(Q: Array, v: Array, vdot: Array) -> tuple[Array, Array, Array]:
    """Its coordinates: the quaternion's real part last, the base's velocity and acceleration in the body's frame."""
    R = np.array(matrix(Q[3:7]))
    twist, omega = R.T @ v[:3], v[3:6]
    q = np.r_[Q[:3], Q[4:7], Q[3], Q[7:]]
    return q, np.r_[twist, v[3:]], np.r_[R.T @ vdot[:3] - np.cross(omega, twist), vdot[3:]]


def assert_equal_in_pinocchio(model: RobotModel, engine: pin.Model, Q: Array, v: Array, vdot: Array) -> None:
    """Force, by recursion and by the mass matrix, momentum and energy, with the joints of both in the same order."""
    data, R = engine.createData(), np.array(matrix(Q[3:7]))
    q, rates, changes = pinocchio_state(Q, v, vdot)
    F = pin.rnea(engine, data, q, rates, changes)
    close(model.inverse_dynamics(Q, v, vdot), np.r_[R @ F[:3], F[3:]])
    close(model.mass_matrix(Q) @ vdot + model.bias(Q, v), np.r_[R @ F[:3], F[3:]])
    pin.computeCentroidalMomentum(engine, data, q, rates)
    centre = pin.centerOfMass(engine, data, q, rates)
    close(model.momentum(Q, v), np.r_[data.hg.linear, data.hg.angular + np.cross(centre, data.hg.linear)])
    assert model.kinetic_energy(Q, v) == pytest.approx(pin.computeKineticEnergy(engine, data, q, rates), rel=1e-12)
    close(model.forward_dynamics(Q, v, model.inverse_dynamics(Q, v, vdot)), vdot)


@given(moving_spatial_robots())
@laws
def test_dynamics_of_random_trees_are_pinocchios(state: State) -> None:
    model, Q, v, vdot = state
    assert isinstance(model.spec, SpatialRobot)
    assert_equal_in_pinocchio(model, in_pinocchio(model.spec), Q, v, vdot)


@given(moving_spatial_robots())
@laws
def test_dynamics_and_poses_of_random_trees_are_mujocos(state: State) -> None:
    model, Q, v, vdot = state
    engine = mujoco_spec(model.spec).compile()
    data = mujoco.MjData(engine)
    order = [*range(6), *(int(engine.joint(body.name).dofadr[0]) for body in model.spec.bodies[1:])]
    places = [*range(7), *(place + 1 for place in order[6:])]
    data.qpos[places], data.qvel[order], data.qacc[order] = Q, v, vdot
    engine.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    mujoco.mj_inverse(engine, data)
    close(model.inverse_dynamics(Q, v, vdot), data.qfrc_inverse[order])
    for pose, name in zip(model.poses(Q), model.pose_rows, strict=True):
        site = data.site(name)
        close(pose[:3], site.xpos)
        close(np.array(matrix(pose[3:])), site.xmat.reshape(3, 3))
    for frame, body in zip(model.body_frames(Q), model.spec.bodies, strict=True):
        close(frame[:3, 3], data.body(body.name).xpos)
        close(frame[:3, :3], data.body(body.name).xmat.reshape(3, 3))


@given(moving_spatial_robots())
@laws
def test_velocities_of_the_frames_are_the_rates_of_their_poses(state: State) -> None:
    """Central differences along the motion."""
    model, Q, v, _ = state
    found = (model.J_C(Q).full() @ v).reshape(-1, 6)
    step = 1e-5
    before, after = (model.poses(moved(Q, sign * step * v)) for sign in (-1, 1))
    rates = (after - before)[:, :3] / (2 * step)
    np.testing.assert_allclose(found[:, :3], rates, atol=1e-6 * (1 + np.abs(rates).max()))
    R = np.array(matrix(Q[3:7]))
    np.testing.assert_allclose(found[0, 3:], R @ v[3:6], atol=1e-12)


def moved(Q: Array, by: Array) -> Array:
    """Coordinates after a small displacement, that of attitude in the body's frame."""
    turn = np.r_[1.0, by[3:6] / 2]
    w, x, y, z = Q[3:7]
    left = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
    q = left @ (turn / np.linalg.norm(turn))
    return np.r_[Q[:3] + by[:3], q, Q[7:] + by[6:]]


def shipped(robot: str) -> Path:
    """A robot of the package example-robot-data."""
    found = next(path for path in files("example-robot-data") or [] if str(path).endswith(robot))
    return Path(str(found.locate()))


@pytest.mark.parametrize(
    "robot", ["ur5_robot.urdf", "panda.urdf", "solo12.urdf", "anymal_b_simple_description/robots/anymal.urdf"]
)
def test_robots_that_packages_ship_move_as_in_pinocchio(robot: str) -> None:
    """Their arms as they come: from the root to every leaf."""
    path = shipped(robot)
    urdf, model = read_urdf(path), RobotModel(load_robot(path))
    engine = pin.buildModelFromUrdf(str(path), pin.JointModelFreeFlyer())
    engine.gravity.setZero()
    random = np.random.default_rng(0)
    attitude = random.standard_normal(4)
    Q = np.r_[random.standard_normal(3), attitude / np.linalg.norm(attitude), random.uniform(-1, 1, model.n - 6)]
    v, vdot = random.standard_normal((2, model.n))
    chains = (joint for arm in model.spec.arms for joint in urdf.chain(arm))
    joints = dict.fromkeys(joint.name for joint in chains if joint.written_type in ("revolute", "prismatic"))
    order = [engine.joints[engine.getJointId(joint)].idx_v for joint in joints]
    q, rates, changes = pinocchio_state(Q, v, vdot)
    theirs = [np.r_[part[: -len(order)], in_order(part[-len(order) :], order)] for part in (q, rates, changes)]
    data = engine.createData()
    F = pin.rnea(engine, data, *theirs)
    close(model.inverse_dynamics(Q, v, vdot), np.r_[np.array(matrix(Q[3:7])) @ F[:3], F[3:6], F[order]])
    pin.framesForwardKinematics(engine, data, theirs[0])
    for tip, pose in zip(model.spec.arms, model.poses(Q)[1:], strict=True):
        close(pose[:3], data.oMf[engine.getFrameId(tip)].translation)
        close(np.array(matrix(pose[3:])), data.oMf[engine.getFrameId(tip)].rotation)


def in_order(joints: Array, places: list[int]) -> Array:
    """Numbers of our joints at the places Pinocchio has them."""
    found = np.zeros(len(joints))
    found[np.array(places) - 6] = joints
    return found


PARTS = {
    "base": '<link name="base"><inertial><mass value="9"/><inertia ixx="1" iyy="1" izz="1"/></inertial></link>',
    "link": '<link name="arm"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1"/></inertial></link>',
    "joint": '<joint name="j" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>'
    '<limit lower="-1" upper="1"/></joint>',
}


def part(name: str, right: str, wrong: str) -> dict[str, str]:
    """One part with something replaced."""
    assert right in PARTS[name]
    return {name: PARTS[name].replace(right, wrong)}


def of_links(number: int) -> str:
    """A robot of so many links without joints."""
    return "<robot name='r'>" + "".join(f"<link name='l{i}'/>" for i in range(number)) + "</robot>"


CIRCLE = '<joint name="k" type="fixed"><parent link="arm"/><child link="base"/></joint>'


def written(folder: Path, **changed: str) -> Path:
    """A robot of two links in a file, some parts of it replaced."""
    path = folder / "robot.urdf"
    path.write_text(
        "<robot name='r'>\n" + "\n".join(part for part in {**PARTS, **changed}.values() if part) + "\n</robot>\n"
    )
    return path


@pytest.mark.parametrize(
    ("changed", "line", "words"),
    [
        ({"joint": PARTS["joint"].replace('"arm"', '"arn"')}, 4, ("unknown link", "arn", "arm")),
        ({"joint": PARTS["joint"].replace("revolute", "ball")}, 4, ("ball", "revolute", "fixed")),
        ({"joint": PARTS["joint"].replace("0 0 1", "0 0 0")}, 4, ("axis", "length 0")),
        ({"joint": PARTS["joint"].replace("0 0 1", "0 1")}, 4, ("0 1", "3 numbers")),
        ({"joint": PARTS["joint"].replace('lower="-1"', 'lower="2"')}, 4, ("limits", "lower one first")),
        ({"joint": PARTS["joint"].replace('<parent link="base"/>', "")}, 4, ("no parent",)),
        ({"joint": ""}, 1, ("2 links that no joint carries", "base, arm")),
        ({"more": PARTS["joint"].replace('"j"', '"k"')}, 5, ("carried by two joints", "j", "k")),
        ({"more": CIRCLE}, 1, ("circle",)),
        ({"link": PARTS["link"].replace('value="1"', 'value="0"')}, 3, ("no mass", "arm")),
        ({"link": PARTS["link"].replace('value="1"', 'value="-1"')}, 3, ("mass of -1",)),
        ({"link": PARTS["link"].replace('value="1"', 'value="one"')}, 3, ("one", "number")),
        ({"link": PARTS["link"].replace('ixx="1"', 'ixx="-1"')}, 3, ("principal moments", "-1")),
        ({"link": PARTS["link"].replace('ixx="1"', "")}, 3, ("ixx",)),
        ({"link": PARTS["base"]}, 3, ("second link", "base", "line 2")),
        ({"link": PARTS["link"].replace('name="arm"', "")}, 3, ("without a name",)),
        ({"base": ""}, 3, ("unknown link", "base", "arm")),
        (
            part("joint", "<limit", '<axis xyz="1 0 0"/><limit'),
            4,
            ("second <axis>", '"j"', "line 4"),
        ),
        (part("joint", "<parent", '<parent link="arm"/><parent'), 4, ("second <parent>", '"j"')),
        (part("joint", "<limit", "<limit/><limit"), 4, ("second <limit>", '"j"', "one at most")),
        (part("link", "<mass", '<mass value="2"/><mass'), 3, ("second <mass>", '"arm"')),
        (part("link", "</link>", "<inertial/></link>"), 3, ("second <inertial>", '"arm"')),
        (part("link", 'value="1"', 'value="1_0"'), 3, ("1_0", 'link "arm"', "number")),
        (part("link", 'value="1"', 'value="\uff11"'), 3, ("mass value", "number")),
        (part("link", 'value="1"', 'value="1e13"'), 3, ("1e13", 'link "arm"', "at most 1e+12")),
        (part("joint", "0 0 1", "0 1e300 1e300"), 4, ("axis", "1e300", 'joint "j"', "at most 1e+12")),
        (
            part("joint", "<axis", '<origin xyz="1e300 0 0"/><axis'),
            4,
            ("origin xyz", "at most 1e+12"),
        ),
        (
            part("joint", "<axis", '<origin rpy="0 1e300 0"/><axis'),
            4,
            ("origin rpy", "at most 1e+12"),
        ),
        (part("joint", 'lower="-1"', 'lower="1"'), 4, ("limits 1, 1", '"j"', 'type="fixed"')),
        (
            part("joint", 'upper="1"', 'upper="1e16"'),
            4,
            ("limits -1, 1e+16", '"j"', "within 1e+12"),
        ),
        (part("joint", 'upper="1"', 'upper="inf"'), 4, ("limit upper", "inf", "number")),
        # what only the robot as a whole shows
        (part("link", 'ixx="1"', 'ixx="5"'), 3, ('link "arm"', "inertia", "sum of the others")),
        (part("link", 'value="1"', 'value="1e-13"'), 3, ('link "arm"', "mass", "1e-12")),
        (part("base", 'ixx="1"', 'ixx="5"'), 2, ('link "base"', "inertia", "sum of the others")),
        (
            part("joint", "<limit", '<limit velocity="-1"'),
            4,
            ('joint "j"', "velocity", "at least 0"),
        ),
        (
            {key: part.replace('"arm"', '"arm.0"') for key, part in PARTS.items()},
            3,
            ('link "arm.0"', "expected a name"),
        ),
        (
            {key: part.replace('"arm"', '"arms"') for key, part in PARTS.items()},
            3,
            ('link "arms"', "reserved name"),
        ),
    ],
)
def test_a_bad_urdf_names_line_and_what_would_be_right(
    tmp_path: Path, changed: dict[str, str], line: int, words: tuple[str, ...]
) -> None:
    with pytest.raises(SpecError) as caught:
        load_robot(written(tmp_path, **changed))
    assert f"robot.urdf:{line}:" in str(caught.value)
    assert all(word in str(caught.value) for word in words), str(caught.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("<robot name='r'><link", ("no XML", "1:")),
        ("<sdf version='1.7'/>", ("<sdf>", "<robot>")),
        (
            "<robot name='r' xmlns:xacro='http://www.ros.org/wiki/xacro'><xacro:include filename='x'/></robot>",
            ("xacro",),
        ),
        *(
            (f"<robot name='r' xmlns:{prefix}='{space}'><{prefix}:include filename='x'/></robot>", ("run xacro",))
            for prefix, space in (
                ("xacro", "http://ros.org/wiki/xacro"),
                ("xacro", "http://wiki.ros.org/xacro"),
                ("xacro", "http://example.org"),
                ("x", "http://ros.org/wiki/xacro"),
            )
        ),
        ("<robot name='r'><xacro:include filename='x'/></robot>", ("run xacro",)),
        ("<robot name='$(arg name)'><link name='base'/></robot>", ("run xacro",)),
        ("<robot name='r'>\n<link name='${prefix}base'/></robot>", ("robot.urdf:2:", "run xacro")),
        (
            of_links(8001),
            ("8001 links", "at most 1000"),
        ),
        (
            of_links(900),
            ("900 links", "l0, l1", "..."),
        ),
        ("<robot name='r'/>", ("without links",)),
        ("not xml", ("no XML",)),
    ],
)
def test_a_file_that_is_no_robot_is_one_error(tmp_path: Path, text: str, words: tuple[str, ...]) -> None:
    (tmp_path / "robot.urdf").write_text(text)
    with pytest.raises(SpecError) as caught:
        read_urdf(tmp_path / "robot.urdf")
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 500
    assert all(word in str(caught.value) for word in words), str(caught.value)


def test_a_file_with_many_errors_names_the_first(tmp_path: Path) -> None:
    joints = (f'<joint name="k{i}" type="fixed"><parent link="m"/><child link="m"/></joint>' for i in range(900))
    with pytest.raises(SpecError, match='unknown link "m" of joint "k0"') as caught:
        read_urdf(written(tmp_path, more="\n".join(joints)))
    assert "more problems" in str(caught.value)
    assert len(str(caught.value).splitlines()) < 100


def test_a_file_of_xacro_is_told_by_its_name_too(tmp_path: Path) -> None:
    path = written(tmp_path, link=PARTS["link"].replace('value="1"', 'value="${mass}"'))
    with pytest.raises(SpecError, match=r"robot.urdf.xacro:3: .*run xacro"):
        load_robot(path.rename(tmp_path / "robot.urdf.xacro"))


def test_a_file_that_xacro_wrote_may_still_name_its_namespace(tmp_path: Path) -> None:
    path = written(tmp_path)
    path.write_text(path.read_text().replace("<robot ", "<robot xmlns:xacro='http://www.ros.org/wiki/xacro' "))
    assert load_robot(path).parts == {"base": 6, "arm": 1}


FILE = """urdf: robot.urdf
arms: {left: {tip: arm}}
limits: {left: {velocity: [-1]}}
"""


def test_errors_of_arms_that_a_file_names_are_at_their_link(tmp_path: Path) -> None:
    written(tmp_path, **part("link", 'ixx="1"', 'ixx="5"'))
    (tmp_path / "robot.yaml").write_text("urdf: robot.urdf\narms: {left: {tip: arm}}\n")
    with pytest.raises(SpecError, match=r'robot.urdf:3: link "arm": arms.left.links\[0\].inertia: found'):
        load_robot(tmp_path / "robot.yaml")


@pytest.mark.parametrize(
    ("written_limit", "position", "velocity", "words"),
    [
        ('lower="-1" upper="1" velocity="0"', ((-1, 1),), None, ("velocity", "is 0", "without a limit")),
        ('lower="-1" upper="1"', ((-1, 1),), None, ("velocity", "not given", "without a limit")),
        ('lower="-1" upper="1" velocity="1e16"', ((-1, 1),), None, ("velocity", "beyond 1e+12", "without a limit")),
        ('lower="0" upper="0" velocity="2"', None, ((-2, 2),), ("limits", "both 0", "without limits")),
        ('velocity="2"', None, ((-2, 2),), ("limits", "not given", "without limits")),
        ('lower="-1e16" upper="1e16" velocity="2"', None, ((-2, 2),), ("limits", "beyond 1e+12", "without limits")),
    ],
)
def test_limits_that_say_nothing_are_assumed_to_be_none(
    tmp_path: Path, written_limit: str, position: object, velocity: object, words: tuple[str, ...]
) -> None:
    """Exporters write 0 for what they do not know, or 1e16."""
    robot = load_robot(written(tmp_path, joint=PARTS["joint"].replace('lower="-1" upper="1"', written_limit)))
    assert any(all(word in note for word in ('joint "j"', *words)) for note in robot.assumed), robot.assumed
    assert (robot.limits["arm"].position, robot.limits["arm"].velocity) == (position, velocity)


def test_a_long_axis_is_scaled(tmp_path: Path) -> None:
    robot = load_robot(written(tmp_path, joint=PARTS["joint"].replace("0 0 1", "0 3e11 4e11")))
    np.testing.assert_allclose(robot.joints[0].axis, (0, 0.6, 0.8))
    assert any("length 5e+11: scaled to 1" in note for note in robot.assumed)


def test_what_is_assumed_is_noted(tmp_path: Path) -> None:
    joint = PARTS["joint"].replace('<limit lower="-1" upper="1"/>', "").replace("0 0 1", "0 0 2")
    fixed = '<joint name="k" type="fixed"><parent link="arm"/><child link="tip"/></joint>'
    tip = '<link name="tip"><odd/><visual><geometry><mesh filename="no.stl"/></geometry></visual></link>'
    urdf = read_urdf(written(tmp_path, joint=joint, tip=tip, k=fixed))
    notes = "\n".join(urdf.notes)
    for word in ("no <limit>", "length 2", "no <inertial>", "<odd>", "meshes"):
        assert word in notes
    fast = PARTS["joint"].replace("<limit", '<origin rpy="90 0 0"/><limit velocity="120"')
    notes = "\n".join(read_urdf(written(tmp_path, joint=fast)).notes)
    assert "120 rad/s" in notes
    assert 'rpy="90 0 0"' in notes
    floating = load_robot(written(tmp_path, joint=PARTS["joint"].replace("revolute", "floating")))
    assert any("floating: taken as fixed" in note for note in floating.assumed)
    turned = PARTS["joint"].replace('lower="-1" upper="1"', 'lower="-90" upper="90"')
    robot = load_robot(written(tmp_path, joint=turned))
    assert any("limits -90, 90 rad" in note and "degrees" in note for note in robot.assumed)
    assert robot.limits["arm"].position == ((-90, 90),)


def test_locked_and_fixed_joints_leave_their_bodies_mass(tmp_path: Path) -> None:
    """A locked joint turns what it carries: the base's centre of mass is where the arm's is."""
    arm = PARTS["link"].replace("<mass", '<origin xyz="0.5 0 0"/><mass')
    written(tmp_path, link=arm)
    (tmp_path / "robot.yaml").write_text("urdf: robot.urdf\nlocked: {j: 90 deg}\n")
    robot = load_robot(tmp_path / "robot.yaml")
    assert robot.base.mass == 10
    np.testing.assert_allclose(robot.base.centre_of_mass, [0, 0.05, 0], atol=1e-15)
    assert any("locked" in note for note in robot.assumed)
