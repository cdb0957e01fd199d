"""Spatial robots against MuJoCo and Pinocchio: random trees, and robots that packages ship."""

from importlib.metadata import files
from pathlib import Path

import casadi as ca
import mujoco
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from psmpc_cli.ocp.loads import LoadKind
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.robot.mujoco_model import mujoco_spec
from psmpc_cli.robot.rotations import matrix
from psmpc_cli.specs.load import load_robot
from psmpc_cli.specs.robots.robot import Attachment, Body, SpatialRobot
from psmpc_cli.specs.robots.urdf import read_urdf

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
    model.armature = np.array([0.0] * 6 + [joint.armature for joint in spec.joints])
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
    """Mass matrix, force, momentum and energy, with the joints of both in the same order."""
    data, R = engine.createData(), np.array(matrix(Q[3:7]))
    q, rates, changes = pinocchio_state(Q, v, vdot)
    turned = np.eye(model.n)
    turned[:3, :3] = R  # its base's velocity is in the body's frame
    # column by column: crba of Pinocchio 4.1 leaves blocks out where the joints of a subtree are not in a row
    H = np.column_stack([pin.rnea(engine, data, q, 0 * rates, column) for column in np.eye(model.n)])
    close(model.mass_matrix(Q), turned @ H @ turned.T)
    # computeKineticEnergy of Pinocchio 4.1 leaves out the armature of joints about an axis of their own
    assert model.kinetic_energy(Q, v) == pytest.approx(rates @ H @ rates / 2, rel=1e-12)
    F = pin.rnea(engine, data, q, rates, changes)
    close(model.inverse_dynamics(Q, v, vdot), np.r_[R @ F[:3], F[3:]])
    close(model.mass_matrix(Q) @ vdot + model.bias(Q, v), np.r_[R @ F[:3], F[3:]])
    pin.computeCentroidalMomentum(engine, data, q, rates)
    centre = pin.centerOfMass(engine, data, q, rates)
    close(model.momentum(Q, v), np.r_[data.hg.linear, data.hg.angular + np.cross(centre, data.hg.linear)])
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
    H = np.zeros((model.n, model.n))
    for column, unit in zip(H, np.eye(model.n), strict=True):
        mujoco.mj_mulM(engine, data, column, unit)
    close(model.mass_matrix(Q), H[np.ix_(order, order)])
    mujoco.mj_energyVel(engine, data)
    assert model.kinetic_energy(Q, v) == pytest.approx(data.energy[1], rel=1e-10)
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


@pytest.mark.slow
@given(seed=st.integers(0, 10**6))
@settings(max_examples=5)
@pytest.mark.parametrize("robot", ["dual_arm_servicer", "free_flyer_arm"])
def test_momentum_and_generalized_jacobians_are_pinocchios(robot: str, seed: int) -> None:
    """Of the base, and of the end-effectors: at phi = 0 of a chart, where the rates of its coordinates are v.

    With the momentum h = P_b v_b + P_j v_j the base moves by T = -P_b^-1 P_j, an end-effector by J_b T + J_j. P is that
    about the inertial origin, Pinocchio's that about the centre of mass c: the angular rows differ by c x linear.
    """
    spec = load_robot(robot)
    assert isinstance(spec, SpatialRobot)
    model = RobotModel(spec)
    base, joints = model.space.base, model.space.joint_rates
    random = np.random.default_rng(seed)
    attitude = random.standard_normal(4)
    Q = np.r_[3 * random.standard_normal(3), attitude / np.linalg.norm(attitude), random.uniform(-2, 2, model.n - 6)]
    v = random.standard_normal(model.n)

    engine = in_pinocchio(spec)
    tools = [
        engine.addFrame(pin.Frame(arm, 1 + at.body, frame(at), pin.FrameType.OP_FRAME))
        for arm, at in spec.tools.items()
    ]
    data = engine.createData()
    q, rates, _ = pinocchio_state(Q, v, np.zeros(model.n))
    in_body = np.eye(model.n)
    in_body[:3, :3] = np.array(matrix(Q[3:7])).T
    centroidal = pin.computeCentroidalMap(engine, data, q)
    about_origin = np.eye(6)
    about_origin[3:, :3] = pin.skew(data.com[0])
    theirs = about_origin @ centroidal @ in_body

    x = model.space.chart_at(Q).to_chart(Q[None], v[None])[0]
    symbol = ca.SX.sym("x", len(x))
    momentum = LoadKind(carries=False, grippers=()).momentum(model)
    by_rates = ca.jacobian(momentum(symbol, Q[3:7], []), symbol[model.n :])
    P = ca.Function("P", [symbol], [by_rates])(x).full()
    close(P, theirs)
    close(momentum(x, Q[3:7], []).full().ravel(), about_origin @ centroidal @ rates)

    T = -np.linalg.solve(P[:, base], P[:, joints])
    their_T = -np.linalg.solve(theirs[:, base], theirs[:, joints])
    close(T, their_T)
    J = model.J_C(Q).full().reshape(-1, 6, model.n)[1:]  # without that of the base
    for own, tool in zip(J, tools, strict=True):
        jacobian = pin.computeFrameJacobian(engine, data, q, tool, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED) @ in_body
        close(own[:, base] @ T + own[:, joints], jacobian[:, base] @ their_T + jacobian[:, joints])


def shipped(robot: str) -> Path:
    """A robot of the package example-robot-data."""
    found = next(path for path in files("example-robot-data") or [] if str(path).endswith(robot))
    return Path(str(found.locate()))


@pytest.mark.slow
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


FILE = """urdf: robot.urdf
arms: {left: {tip: arm}}
limits: {left: {velocity: [-1]}}
"""
