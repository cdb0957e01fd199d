"""Thrusters in plants: pulses whose impulse follows that of the law, with the same physics in each plant."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from psmpc_cli.plant import Disturbance, ForceLimits, JointFriction, Plant, Setpoints, Ticks, build_plant
from psmpc_cli.plant.grasp import build_capture
from psmpc_cli.plant.mujoco import MujocoPlant
from psmpc_cli.plant.rk4 import Rk4Plant
from psmpc_cli.plant.thrusters import ThrusterFiring, firing_of
from psmpc_cli.plant.uncertainty import force_limits_of
from psmpc_cli.plant.wheels import WheelDrive
from psmpc_cli.robot.actuators.thrusters import Thrusters
from psmpc_cli.robot.actuators.wheels import Wheels
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.load import load_robot, load_task
from psmpc_cli.specs.robots.actuators import PlanarThruster, SpatialThruster

from ..wheeled import PYRAMID, robot_in
from .drawn_grasps import drawn_grasp

Array = np.ndarray

TICK = 1e-3
M = 100
PLANTS = pytest.mark.parametrize("plant", [Rk4Plant, MujocoPlant])
WITHIN = ForceLimits(np.r_[-20, -20, -9.6, np.full(6, -5)], np.r_[20, 20, 9.6, np.full(6, 5)])


@pytest.fixture(scope="module")
def platform() -> RobotModel:
    return RobotModel(load_robot("thruster_platform"))


@pytest.fixture
def u() -> Array:
    """Accelerations that take half of the thrusters' force, over ten samples."""
    phase = np.outer(TICK * np.arange(10 * M), np.arange(1, 10)) + np.arange(9)
    return np.array([0.03, 0.03, 0.1, *np.full(6, 0.1)]) * np.sin(3 * phase)


def firing(model: RobotModel, period: int = M, pulsed: bool = True) -> ThrusterFiring:
    thrusters = Thrusters.of(model.spec.thrusters)
    thrusters = replace(thrusters, shortest_pulse=np.minimum(thrusters.shortest_pulse, period * TICK / 2))
    return ThrusterFiring(thrusters, period, TICK, pulsed)


def samples(plant: Plant, x: Array, u: Array, disturbance: Disturbance | None = None) -> list[Ticks]:
    """What a plant does over all samples of u."""
    made = list[Ticks]()
    for k in range(len(u) // M):
        made.append(plant.advance(k * M * TICK, x, Setpoints(u[k * M : (k + 1) * M]), disturbance))
        x = made[-1].states[-1]
    return made


def on_base(model: RobotModel, sample: Ticks, F: Array | None) -> Array:
    """The wrench on the base along its own axes, of forces at ticks."""
    assert F is not None
    Q = sample.states[:-1, : model.nq]
    return np.column_stack(model.space.along_base_axes(Q.T, F.T))[:, model.space.base]


@PLANTS
@pytest.mark.parametrize("period", [40, M, 150])
def test_the_force_on_the_base_is_that_of_the_thrusts(
    platform: RobotModel, x: Array, u: Array, plant: type, period: int
) -> None:
    """And its impulse that of the law, but for what is owed: less than half of a pulse of three thrusters."""
    built = plant(platform, TICK, force_limits=WITHIN, firing=firing(platform, period))
    wanted = given = refused = 0.0
    W = Thrusters.of(platform.spec.thrusters).wrenches
    for sample in samples(built, x, u):
        fired = sample.thrusters
        assert fired is not None
        np.testing.assert_allclose(on_base(platform, sample, sample.F), fired.thrusts @ W.T, atol=1e-11)
        assert set(np.unique(fired.thrusts)) <= {0.0, 10.0}
        wanted = wanted + TICK * np.clip(on_base(platform, sample, sample.commanded), *limits_of_base()).sum(axis=0)
        given = given + W @ fired.impulses
        refused = refused + fired.refused
        np.testing.assert_allclose(wanted - given - refused, fired.owed, atol=1e-9)
        # half of a pulse of each of some thrusters, and what the law wants in the rest of a period
        assert (np.abs(fired.owed[:2]) <= 1.5 * period / M).all()
    assert np.abs(given).max() > 1.0


def limits_of_base() -> tuple[Array, Array]:
    return WITHIN.low[:3], WITHIN.high[:3]


@pytest.mark.parametrize("disturbed", [False, True])
def test_the_plants_agree(platform: RobotModel, x: Array, u: Array, disturbed: bool) -> None:
    friction = JointFriction.none(9) if disturbed else None
    noise = 1e-5 * np.random.default_rng(2).standard_normal((M, 18))
    still = np.zeros((M, 9))
    given = Disturbance(platform.nominal, platform.nominal, noise, still) if disturbed else None
    one, other = (
        samples(plant(platform, TICK, 2, friction=friction, force_limits=WITHIN, firing=firing(platform)), x, u, given)
        for plant in (Rk4Plant, MujocoPlant)
    )
    for first, second in zip(one, other, strict=True):
        np.testing.assert_allclose(first.states, second.states, atol=1e-8)
        assert first.thrusters is not None and second.thrusters is not None
        np.testing.assert_array_equal(first.thrusters.thrusts, second.thrusters.thrusts)
        np.testing.assert_array_equal(first.thrusters.firings, second.thrusters.firings)


@PLANTS
def test_noise_and_pushes_reach_a_robot_with_thrusters(platform: RobotModel, x: Array, u: Array, plant: type) -> None:
    """The law reads a noisy state; what pushes the base is no thrust."""
    rng = np.random.default_rng(2)
    push = np.zeros((M, 9))
    push[50, 0] = 100.0
    disturbance = Disturbance(platform.nominal, platform.nominal, 1e-4 * rng.standard_normal((M, 18)), push)
    results = []
    for given in (disturbance, Disturbance.none(platform.nominal, M, 9)):
        friction = JointFriction.none(9)
        built = plant(platform, TICK, friction=friction, force_limits=WITHIN, firing=firing(platform))
        results.append(built.advance(0.0, x, Setpoints(u[:M]), given))
    pushed, quiet = results
    gained = pushed.states[-1, 9] - quiet.states[-1, 9]
    assert gained == pytest.approx(0.1 / platform.mass_matrix(x[:9])[0, 0], rel=0.5)
    assert pushed.thrusters is not None
    assert set(np.unique(pushed.thrusters.thrusts)) <= {0.0, 10.0}


@PLANTS
def test_without_pulses_thrusts_are_constant_over_a_period(
    platform: RobotModel, x: Array, u: Array, plant: type
) -> None:
    built = plant(platform, TICK, force_limits=WITHIN, firing=firing(platform, pulsed=False))
    for sample in samples(built, x, u):
        assert sample.thrusters is not None
        assert (sample.thrusters.thrusts == sample.thrusters.thrusts[0]).all()
        assert (np.abs(sample.thrusters.owed) < 0.05).all()


@PLANTS
def test_thrusters_are_off_while_nothing_pushes_the_base(platform: RobotModel, x: Array, u: Array, plant: type) -> None:
    """From the middle of a period on; wheels that then turn the base are not cut to what thrusters give."""
    limits = ForceLimits(np.full(9, -np.inf), np.full(9, np.inf))
    built = plant(platform, TICK, force_limits=limits, firing=firing(platform, 80))
    driven = np.ones((M, 3))
    driven[50:90] = 0, 0, 1
    u = u[:M] + np.r_[0, 0, 2.0, np.zeros(6)]
    ticks = built.advance(0.0, x, Setpoints(u, driven=driven))
    fired = ticks.thrusters
    assert not fired.thrusts[50:90].any()
    assert fired.thrusts[:50].any() and fired.thrusts[90:].any()
    own = on_base(platform, ticks, ticks.F)
    np.testing.assert_allclose(own[50:90, :2], 0.0, atol=1e-9)
    assert own[50:90, 2].min() > 9.6
    np.testing.assert_array_equal(ticks.F[50:90], ticks.commanded[50:90])
    W = Thrusters.of(platform.spec.thrusters).wrenches
    np.testing.assert_allclose(own[:50], fired.thrusts[:50] @ W.T, atol=1e-9)
    resting = built.advance(0.1, ticks.states[-1], Setpoints(u, driven=np.zeros((M, 3))))
    assert not resting.thrusters.thrusts.any()
    assert not resting.thrusters.owed.any()


def test_firings_are_counted_where_they_begin() -> None:
    """Also across samples: a pulse that goes on is one."""
    pushers = [PlanarThruster(position=(0, side), direction=(way, 0), force=10) for way in (1, -1) for side in (1, -1)]
    fires = ThrusterFiring(Thrusters.of(pushers), 10, 0.01)
    counts = []
    for push in (20.0, 20.0, 10.0, 0.0, 20.0):
        wanted = np.array([push, 0, 0])
        fires.begin_period(wanted)
        fires.record_ticks(np.tile(wanted, (10, 1)), is_pushed=True)
        counts.append(fires.end_sample().firings[:2].tolist())
    assert counts == [[1, 1], [0, 0], [1, 1], [0, 0], [1, 1]]


@pytest.mark.parametrize(
    ("changes", "robot", "ticks"),
    [
        ({}, {}, 100),
        ({"controller.sample_time": 0.05}, {}, 100),  # the shortest pulses last two samples
        ({"controller.sample_time": 0.04}, {}, 120),
        ({}, {"pulse_period": 0.25}, 250),
        ({"plant.low_level_rate": 500}, {"pulse_period": 0.101}, 51),
    ],
)
def test_the_period_of_pulses(changes: dict[str, object], robot: dict[str, object], ticks: int) -> None:
    task = load_task("thrust_and_reach", changes)
    model = RobotModel(task.robot.model_copy(update=robot))
    made = firing_of(task.spec, model)
    assert made is not None
    assert made.period == ticks


def test_which_tasks_have_thrusters_that_fire(platform: RobotModel) -> None:
    task = load_task("thrust_and_reach")
    assert firing_of(load_task("thrust_and_reach", {"plant": "ideal"}).spec, platform) is None
    assert firing_of(task.spec, RobotModel(load_robot("planar_dual_arm"))) is None
    limits = force_limits_of(task.spec, task.robot)
    assert limits is not None
    np.testing.assert_allclose(limits.high, np.r_[20, 20, 9.6, np.full(6, 5)])
    half = load_task("thrust_and_reach", {"limits": {"base": {"force": [4, 40, 2]}}})
    tighter = force_limits_of(half.spec, half.robot)
    assert tighter is not None
    np.testing.assert_allclose(tighter.high[:3], [4, 20, 2])


@pytest.mark.parametrize("kind", ["rk4", "mujoco"])
def test_thrusters_fire_while_the_robot_holds_an_object(tmp_path: Path, kind: str) -> None:
    """The grippers open in the middle of a period."""
    task, start = drawn_grasp(2, tmp_path)
    thrusters = load_robot("thruster_platform").thrusters
    model = RobotModel(task.robot.model_copy(update={"thrusters": thrusters}))
    u = np.tile(np.r_[0.1, -0.05, 0.1, np.zeros(model.n - 3)], (M, 1))
    closed = np.arange(M) < 70
    spec = task.spec.plant.model_copy(update={"kind": kind})
    capture = build_capture(task.spec, model)
    assert capture is not None
    limits = force_limits_of(task.spec, model.spec)
    plant = build_plant(spec, model, False, None, capture, limits, firing(model, 40))
    before = model.balance(start[None, : model.nq], start[None, model.nq :])[0] + capture.momentum_and_energy
    ticks = plant.advance(0.0, start, Setpoints(u, closed=closed))
    after = model.balance(ticks.states[-1:, : model.nq], ticks.states[-1:, model.nq :])[0] + capture.momentum_and_energy
    assert ticks.target_object is not None and ticks.thrusters is not None
    assert ticks.target_object.closed[:70].all() and not ticks.target_object.closed[70:].any()
    np.testing.assert_allclose(after - before, ticks.impulse_and_work, rtol=0, atol=1e-6)
    W = Thrusters.of(thrusters).wrenches
    np.testing.assert_allclose(on_base(model, ticks, ticks.F), ticks.thrusters.thrusts @ W.T, atol=1e-11)
    assert ticks.thrusters.impulses.sum() > 0.3


def pairs_along(axis: int) -> list[SpatialThruster]:
    """Four thrusters that push along an axis, both ways, in pairs that turn the base about the axis after the next."""
    made = []
    for way in (1, -1):
        for side in (0.16, -0.16):
            position, direction = np.zeros(3), np.zeros(3)
            position[(axis + 1) % 3] = side
            position[axis] = -0.16 * way
            direction[axis] = way
            made.append(SpatialThruster(position=position.tolist(), direction=direction.tolist(), force=0.3))
    return made


def test_a_spatial_base_is_pushed_about_its_own_axes() -> None:
    """In both plants alike, with an attitude; six pairs of facets."""
    thrusters = tuple(each for axis in range(3) for each in pairs_along(axis))
    robot = load_robot("free_flyer_arm")
    model = RobotModel(robot.model_copy(update={"thrusters": thrusters}))
    of_base = Thrusters.of(thrusters)
    assert len(of_base.half_spaces.normals) == 6
    np.testing.assert_allclose(of_base.extent[1], 3 * [0.6] + 3 * [0.096])
    rng = np.random.default_rng(4)
    Q = np.array(model.space.integrate(model.neutral, 0.7 * rng.standard_normal(model.n)))
    x = np.r_[Q, 0.1 * rng.standard_normal(model.n)]
    u = np.tile(0.02 * rng.standard_normal(model.n), (3 * M, 1))
    limits = ForceLimits(np.full(model.n, -np.inf), np.full(model.n, np.inf))
    made = []
    for plant in (Rk4Plant, MujocoPlant):
        built = plant(model, TICK, force_limits=limits, firing=ThrusterFiring(of_base, 50, TICK))
        made.append(samples(built, x, u))
    for first, second in zip(*made, strict=True):
        assert first.thrusters is not None and second.thrusters is not None
        np.testing.assert_allclose(first.states, second.states, atol=1e-7)
        np.testing.assert_array_equal(first.thrusters.thrusts, second.thrusters.thrusts)
        wrenches = first.thrusters.thrusts @ of_base.wrenches.T
        np.testing.assert_allclose(on_base(model, first, first.F), wrenches, atol=1e-12)
        assert (np.abs(first.thrusters.owed) < 2e-3).all()


@pytest.mark.parametrize("plant", [Rk4Plant, MujocoPlant])
@pytest.mark.parametrize("pulsed", [True, False])
def test_joints_follow_their_commands_under_thrusts(
    platform: RobotModel, x: Array, u: Array, plant: type, pulsed: bool
) -> None:
    """But for what the law, once a tick, does not see of it; pulses throw the base about."""
    states = samples(plant(platform, TICK, force_limits=WITHIN, firing=firing(platform, pulsed=pulsed)), x, u)
    v = np.vstack([x[9:], *(sample.states[1:, 9:] for sample in states)])
    off = np.abs(np.diff(v, axis=0) / TICK - u)
    assert off[:, 3:].max() < 1e-3
    assert off[:, :3].max() > (0.1 if pulsed else 1e-3)


@PLANTS
def test_joints_of_a_spatial_robot_follow_under_pulses_while_wheels_are_unloaded(tmp_path: Path, plant: type) -> None:
    """What motors take from the wheels acts on the base besides the thrusters."""
    wheels = tuple({**wheel, "initial": 0.0, "unloading": 0.01} for wheel in PYRAMID)
    robot = load_robot(robot_in(tmp_path, "free_flyer_arm", wheels))
    thrusters = tuple(each for axis in range(3) for each in pairs_along(axis))
    model = RobotModel(robot.model_copy(update={"thrusters": thrusters}))
    drive = WheelDrive(Wheels.of(model.spec), TICK)
    drive.momentum = stored = np.array([0.1, -0.05, 0.02, 0.08])
    rng = np.random.default_rng(4)
    Q = np.array(model.space.integrate(model.neutral, 0.7 * rng.standard_normal(model.n)))
    x = np.r_[Q, 0.1 * rng.standard_normal(model.n)]
    u = np.tile(0.02 * rng.standard_normal(model.n), (3 * M, 1))
    limits = ForceLimits(np.full(model.n, -np.inf), np.full(model.n, np.inf))
    fires = ThrusterFiring(Thrusters.of(thrusters), 50, TICK)
    made = samples(plant(model, TICK, force_limits=limits, firing=fires, drive=drive), x, u)
    v = np.vstack([x[model.nq :], *(sample.states[1:, model.nq :] for sample in made)])
    off = np.abs(np.diff(v, axis=0) / TICK - u)
    assert off[:, model.space.joint_rates].max() < 2e-3
    assert off[:, model.space.base].max() > 0.02
    assert made[-1].wheels is not None
    np.testing.assert_allclose(np.abs(stored) - np.abs(made[-1].wheels.momentum[-1]), 3 * M * TICK * 0.01)


def test_a_period_begins_where_the_law_begins_to_count_with_a_load() -> None:
    """Pulses that have begun go on to their ends, and count; the periods after stay in step with the samples."""
    pushers = [
        PlanarThruster(position=(0, side), direction=(way, 0), force=10, shortest_pulse=0.2)
        for way in (1, -1)
        for side in (1, -1)
    ]
    fires = ThrusterFiring(Thrusters.of(pushers), 100, 0.01)
    half, whole = np.array([10.0, 0, 0]), np.array([20.0, 0, 0])
    fires.begin_period(half)  # pulses from tick 25 to 75
    fires.record_ticks(np.tile(half, (40, 1)), is_pushed=True)
    fires.end_period_if_load_changed(False)
    assert fires.ticks_left == 60
    fires.end_period_if_load_changed(True)
    span = fires.next_span(None, 40, 200)
    assert span.begins and (span.first, span.last) == (40, 100)
    fires.begin_period(whole)
    fires.record_ticks(np.tile(whole, (60, 1)), is_pushed=True)
    sample = fires.end_sample()
    assert sample.thrusts[40:75, :2].all()
    np.testing.assert_allclose(sample.owed + sample.refused + sample.impulses @ fires.thrusters.wrenches.T, [16, 0, 0])
    assert fires.next_span(None, 0, 200).ticks == slice(0, 100)
    # too little is left for a shortest pulse
    fires.begin_period(half)
    fires.record_ticks(np.tile(half, (90, 1)), is_pushed=True)
    fires.end_period_if_load_changed(False)
    assert fires.next_span(None, 90, 300).ticks == slice(90, 200)


def test_pulses_do_not_jerk_the_joints_of_hands_that_hold_a_load() -> None:
    """The hands close in the middle of a period, where a new one begins; at rest relative to the base ever after."""
    changes = {"object.pose": [0, 0.978, 0], "object.grasp.known": True}
    thrusters = tuple(
        each.model_copy(update={"shortest_pulse": 0.02}) for each in load_robot("thruster_platform").thrusters
    )
    u = np.tile(np.r_[0.08, -0.05, 0.1, np.zeros(6)], (8 * M, 1))
    closed = np.arange(8 * M) >= 20
    made = []
    for kind in ("rk4", "mujoco"):
        task = load_task("transport_grasp", {**changes, "plant.kind": kind})
        model = RobotModel(task.robot.model_copy(update={"thrusters": thrusters}))
        fires = ThrusterFiring(Thrusters.of(thrusters), M, TICK)
        capture = build_capture(task.spec, model)
        assert capture is not None
        limits = force_limits_of(task.spec, model.spec)
        plant = build_plant(task.spec.plant, model, False, None, capture, limits, fires)
        x = np.r_[np.zeros(3), np.radians([45, 30, 60, -45, -30, -60]), np.zeros(9)]
        kept = model.balance(x[:9], x[9:]) + capture.momentum_and_energy
        states = []
        thrusts = []
        for k in range(0, 8 * M, M):
            ticks = plant.advance(k * TICK, x, Setpoints(u[k : k + M], closed=closed[k : k + M]))
            assert ticks.target_object is not None and ticks.thrusters is not None
            np.testing.assert_array_equal(ticks.target_object.closed.all(axis=1), closed[k : k + M])
            x = ticks.states[-1]
            now = model.balance(x[:9], x[9:]) + capture.momentum_and_energy
            np.testing.assert_allclose(now - kept, ticks.impulse_and_work, rtol=0, atol=1e-8)
            kept = now
            states.append(ticks.states[1:])
            thrusts.append(ticks.thrusters.thrusts)
        made.append((np.vstack(states), np.vstack(thrusts)))
        rates = np.abs(made[-1][0][2 * M :, 12:])
        assert rates.max() < 0.01  # half of a pulse lets the grasps deflect as far
        assert np.abs(made[-1][0][-1, 9:11]).max() > 0.03
    (states, thrusts), (others, of_others) = made
    np.testing.assert_array_equal(thrusts, of_others)
    np.testing.assert_allclose(states, others, rtol=0, atol=1e-6)
    # about the middle of the period from tick 20 on, not of that from tick 0 on
    fires, _ = np.nonzero(thrusts[:M])
    assert fires.mean() == pytest.approx(59.5, abs=1)
