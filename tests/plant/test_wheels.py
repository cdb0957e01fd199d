"""Reaction wheels in plants: momentum that is kept, the physics of wheels that are bodies, motors within limits."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from psmpc_cli.plant import Disturbance, ForceLimits, JointFriction, Plant, Setpoints, Ticks, build_plant
from psmpc_cli.plant.grasp import build_capture
from psmpc_cli.plant.mujoco import MujocoPlant
from psmpc_cli.plant.rk4 import Rk4Plant
from psmpc_cli.plant.wheels import WheelDrive, drive_of
from psmpc_cli.robot.actuators.wheels import Wheels
from psmpc_cli.robot.model import RobotModel, load_robot
from psmpc_cli.robot.mujoco_model import mujoco_spec, set_wheel_inertias, wheel_names
from psmpc_cli.specs.load import load_task
from psmpc_cli.specs.robots.robot import stack

from ..wheeled import PYRAMID, TWO_WHEELS, robot_in

Array = np.ndarray

TICK = 1e-3
M = 100
PLANTS = pytest.mark.parametrize("plant", [Rk4Plant, MujocoPlant])
WHERE = pytest.mark.parametrize("where", ["plane", "space"])
MOBILITIES = {"attitude": (0.0, 1.0), "free-floating": (0.0, 0.0), "free-flying": (1.0, 1.0)}


def model_in(folder: Path, where: str, **of_wheels: float) -> RobotModel:
    built_in, wheels = ("planar_dual_arm", TWO_WHEELS) if where == "plane" else ("free_flyer_arm", PYRAMID)
    return load_robot(robot_in(folder, built_in, tuple({**wheel, **of_wheels} for wheel in wheels)))


def driven(model: RobotModel, mobility: str, ticks: int = M) -> Array:
    linear, angular = MOBILITIES[mobility]
    of_base = [linear] * model.dimension + [angular] * (model.space.n_twist - model.dimension)
    return np.tile(of_base, (ticks, 1))


def samples(model: RobotModel, plant: Plant, mobility: str, u: Array, disturbed: Array | None = None) -> list[Ticks]:
    """What a plant does over the samples of u from a state in motion, pushed by external forces (len(u), n)."""
    random = np.random.default_rng(3)
    x = np.r_[model.space.path(model.neutral, 0.3 * random.standard_normal((1, model.n)))[-1], np.zeros(model.n)]
    x[model.nq :] = 0.1 * random.standard_normal(model.n)
    made = list[Ticks]()
    for k in range(0, len(u), M):
        disturbance = None
        if disturbed is not None:
            none = Disturbance.none(model.nominal, M, model.n)
            disturbance = replace(none, external_force=disturbed[k : k + M])
        made.append(plant.advance(k * TICK, x, Setpoints(u[k : k + M], driven=driven(model, mobility)), disturbance))
        x = made[-1].states[-1]
    return made


def accelerations(model: RobotModel, ticks: int) -> Array:
    phase = np.outer(TICK * np.arange(ticks), 2 + np.arange(model.n)) + np.arange(model.n)
    return 0.1 * np.sin(phase)


def total(model: RobotModel, wheels: Wheels, X: Array, h: Array) -> Array:
    """Momentum and energy of bodies and wheels in states X (K, nq + n)."""
    Q, v = np.split(X, [model.nq], axis=1)
    return np.asarray(model.balance(Q, v) + wheels.momentum_and_energy(Q, h))


@PLANTS
@WHERE
@pytest.mark.parametrize("mobility", MOBILITIES)
@pytest.mark.parametrize("limited", [False, True])
def test_momentum_and_energy_balance(
    tmp_path: Path, where: str, plant: Callable[..., Plant], mobility: str, limited: bool
) -> None:
    """Over a run of three samples, with a push in it, against impulses and work; wheels alone have no impulse."""
    model = model_in(tmp_path, where, unloading=0.01)
    wheels = Wheels.of(model.spec)
    drive = WheelDrive(wheels, TICK)
    limits = ForceLimits(np.full(model.n, -0.5), np.full(model.n, 0.5)) if limited else None
    built = plant(model, TICK, friction=JointFriction.none(model.n), force_limits=limits, drive=drive)
    push = np.zeros((3 * M, model.n))
    push[M : M + 50, : model.dimension] = 0.7
    made = samples(model, built, mobility, accelerations(model, 3 * M), push)
    X = np.array([made[0].states[0], made[-1].states[-1]])
    assert made[0].wheels is not None and made[-1].wheels is not None
    h = np.array([made[0].wheels.momentum[0], made[-1].wheels.momentum[-1]])
    np.testing.assert_array_equal(h[0], wheels.initial)
    before, after = total(model, wheels, X, h)
    impulse_and_work = np.sum([sample.impulse_and_work for sample in made], axis=0)
    np.testing.assert_allclose(after - before, impulse_and_work, rtol=0, atol=1e-9)
    if mobility != "free-flying":
        np.testing.assert_allclose(impulse_and_work[: model.dimension], 0.7 * 50 * TICK, rtol=0, atol=1e-12)
    else:
        assert (np.abs(h[1] - wheels.initial) <= 1e-12).all() or where == "space"


@WHERE
@pytest.mark.parametrize("mobility", MOBILITIES)
def test_both_plants_agree(tmp_path: Path, where: str, mobility: str) -> None:
    model = model_in(tmp_path, where, unloading=0.01)
    u = accelerations(model, 5 * M)
    made = [
        samples(model, plant(model, TICK, drive=WheelDrive(Wheels.of(model.spec), TICK)), mobility, u)
        for plant in (Rk4Plant, MujocoPlant)
    ]
    for own, other in zip(*made, strict=True):
        assert own.wheels is not None and other.wheels is not None
        np.testing.assert_allclose(own.states, other.states, rtol=0, atol=1e-11)
        np.testing.assert_allclose(own.wheels.momentum, other.wheels.momentum, rtol=0, atol=1e-12)


@WHERE
def test_wheels_that_are_bodies_move_alike(tmp_path: Path, where: str) -> None:
    """A second of MuJoCo on its own: bodies on hinges that spin with the rest, motors on them, and arms that move.

    Nothing is put back in between: the difference is that of both integrators over 1,000 steps.
    """
    model = model_in(tmp_path, where)
    wheels = Wheels.of(model.spec)
    drive = WheelDrive(wheels, TICK)
    made = samples(model, Rk4Plant(model, TICK, drive=drive), "attitude", accelerations(model, 10 * M))
    spec = mujoco_spec(model.spec)
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    spec.option.timestep = TICK
    engine = spec.compile()
    set_wheel_inertias(engine, model.spec)
    data = mujoco.MjData(engine)
    joints = [engine.joint(name).id for name in [body.name for body in model.spec.bodies][1:]]
    hinges = [engine.joint(name).id for name in wheel_names(model.spec)]
    space = model.space
    q = np.r_[: space.n_pose, engine.jnt_qposadr[joints]]
    v = np.r_[: space.n_twist, engine.jnt_dofadr[joints]]
    spins = engine.jnt_dofadr[hinges]
    data.qpos[q], data.qvel[v] = np.split(made[0].states[0], [model.nq])
    data.qvel[spins] = wheels.spins(wheels.initial, made[0].states[0, model.nq :])
    for sample in made:
        assert sample.wheels is not None
        for F, torque in zip(sample.F, sample.wheels.torque, strict=True):
            data.qfrc_applied[v] = F
            data.qfrc_applied[v[space.base]] = 0.0  # nothing but the wheels is at the base
            data.qfrc_applied[spins] = torque
            mujoco.mj_step(engine, data)
        reached = np.r_[data.qpos[q], data.qvel[v]]
        np.testing.assert_allclose(reached, sample.states[-1], rtol=0, atol=1e-9)
        np.testing.assert_allclose(
            wheels.momenta(data.qvel[spins], data.qvel[v]), sample.wheels.momentum[-1], atol=1e-10
        )
    assert np.abs(np.diff(made[-1].states[[0, -1]], axis=0)).max() > 1e-3


@PLANTS
@WHERE
def test_motors_give_no_more_than_they_can(tmp_path: Path, where: str, plant: Callable[..., Plant]) -> None:
    """At every tick, under accelerations that ask for far more: torques, and what is stored, to rounding."""
    tight = {"torque": 0.02, "momentum": 0.802} if where == "plane" else {"torque": 0.01, "momentum": 0.101}
    model = model_in(tmp_path, where, **tight)
    wheels = Wheels.of(model.spec)
    built = plant(model, TICK, drive=WheelDrive(wheels, TICK))
    made = samples(model, built, "attitude", 20 * accelerations(model, 8 * M))
    h = np.concatenate([sample.wheels.momentum for sample in made if sample.wheels is not None])
    torque = np.concatenate([sample.wheels.torque for sample in made if sample.wheels is not None])
    assert (np.abs(torque) <= wheels.torque).all()
    assert (np.abs(h) <= wheels.momentum * (1 + 1e-14)).all()
    assert (np.abs(torque) == wheels.torque).mean() > 0.5
    assert (np.abs(h) >= wheels.momentum * (1 - 1e-12)).any()


def test_thrusters_balance_what_unloads_wheels(tmp_path: Path) -> None:
    """Wheels come back to their first momenta, and the base moves as without wheels that unload.

    The law holds its force over a tick, in which the gyroscopic moment changes: that makes 1e-5 rad/s in 0.8 s, and a
    quarter of it with ticks of a quarter.
    """
    model = model_in(tmp_path, "space", unloading=0.02)
    wheels = Wheels.of(model.spec)
    u = accelerations(model, 8 * M)
    made = []
    for moved in (0.0, 0.01):
        drive = WheelDrive(wheels, TICK)
        drive.momentum = wheels.initial + moved
        made.append(samples(model, Rk4Plant(model, TICK, drive=drive), "free-flying", u)[-1])
        np.testing.assert_allclose(drive.momentum, wheels.initial, atol=1e-15)
    np.testing.assert_allclose(made[0].states, made[1].states, rtol=0, atol=1e-5)


@pytest.mark.parametrize("name", ["catch_drifting", "catch_tumbling"])
def test_both_plants_agree_while_grippers_hold_an_object(tmp_path: Path, name: str) -> None:
    """Momentum of bodies, wheels and object stays in each, with a law that knows what it holds."""
    wheels = TWO_WHEELS if name == "catch_drifting" else tuple({**wheel, "torque": 5.0} for wheel in PYRAMID)
    named = load_task(name).spec.robot
    built_in = robot_in(tmp_path, named, wheels)
    task = load_task(name, {"robot": str(built_in), **held_from_the_start(name)})
    model = RobotModel(task.robot)
    x = np.r_[stack(task.spec.initial, task.robot, "joint"), np.zeros(model.n)]
    u = 0.05 * np.sin(np.outer(np.arange(M) / 20, 1 + np.arange(model.n)))
    made = []
    for kind in ("rk4", "mujoco"):
        capture = build_capture(task.spec, model)
        assert capture is not None
        drive = drive_of(task.spec, model)
        assert drive is not None
        spec = task.spec.plant.model_copy(update={"kind": kind})
        plant = build_plant(spec, model, False, None, capture, drive=drive)
        before = total(model, drive.wheels, x[None], drive.momentum[None])[0] + capture.momentum_and_energy
        ticks = plant.advance(0.0, x, Setpoints(u, closed=np.ones(M, bool), driven=driven(model, "attitude")))
        after = total(model, drive.wheels, ticks.states[-1:], drive.momentum[None])[0] + capture.momentum_and_energy
        assert capture.closed.all()
        np.testing.assert_allclose((after - before)[:-1], ticks.impulse_and_work[:-1], rtol=0, atol=1e-9)
        np.testing.assert_array_equal(ticks.impulse_and_work[:-1], 0)
        made.append(ticks)
    one, other = made
    assert one.wheels is not None and other.wheels is not None
    np.testing.assert_allclose(one.states, other.states, rtol=0, atol=1e-9)
    np.testing.assert_allclose(one.wheels.momentum, other.wheels.momentum, rtol=0, atol=1e-9)
    assert np.ptp(one.wheels.momentum, axis=0).max() > 1e-4


def held_from_the_start(name: str) -> dict[str, object]:
    """Changes of a task with which its object, at rest, is within reach of the grippers where the robot begins."""
    bent = {"initial.arm_1": [0.8, 0.9, 0.5], "initial.arm_2": [-0.8, -0.9, -0.5]} if name == "catch_drifting" else {}
    task = load_task(name, bent)
    model = RobotModel(task.robot)
    tools = model.poses(stack(task.spec.initial, task.robot, "joint"))[1:]
    poses = dict(zip(task.robot.tools, tools, strict=True))
    space = model.space
    (first, *_) = grips = [arm for arm in task.robot.tools if task.spec.object and arm in task.spec.object.grasp.at]
    centre = poses[first].copy()
    centre[: space.dimension] += 0.2
    at = {arm: space.relative(poses[arm], centre) for arm in grips}
    written = {arm: pose_of(space.dimension, pose) for arm, pose in at.items()}
    wide = {"position": 0.1, "angle": 1.0, "velocity": 1.0, "angular_velocity": 1.0}
    return {
        **bent,
        "object.pose": pose_of(space.dimension, centre),
        "object.motion": {"linear": [0] * space.dimension, "angular": 0.0 if space.dimension == 2 else [0, 0, 0]},
        "object.grasp.at": written,
        "object.grasp.envelope": wide,
        "object.grasp.strength": None,
    }


def pose_of(dimension: int, pose: Array) -> object:
    """A pose as a task file has it."""
    if dimension == 2:
        return [*pose[:2].tolist(), float(np.arctan2(np.sin(pose[2]), np.cos(pose[2])))]
    return {"position": pose[:3].tolist(), "attitude": {"quaternion": (pose[3:] / np.linalg.norm(pose[3:])).tolist()}}
