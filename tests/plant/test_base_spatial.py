"""The plants of spatial robots: each by the laws of physics, and by each other."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from psmpc_cli.ocp.plan import Plan
from psmpc_cli.plant import Disturbance, JointFriction, Plant, Setpoints, Ticks
from psmpc_cli.plant.adaptive import AdaptiveDynamics
from psmpc_cli.plant.ideal import IdealPlant
from psmpc_cli.plant.mujoco import MujocoPlant
from psmpc_cli.plant.rk4 import Rk4Plant
from psmpc_cli.plant.uncertainty import release, take_up
from psmpc_cli.robot.dynamics import InertialParameters
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.load import load_robot

Array = np.ndarray
TICK, M = 1e-3, 200
PLANTS = (Rk4Plant, MujocoPlant)


@pytest.fixture(scope="module")
def robot() -> RobotModel:
    """The small free-flyer with rotors; an arm branches off amid the first, so MuJoCo has another order of joints."""
    spec = load_robot("free_flyer_arm")
    arm = spec.arms["arm"]
    first = arm.model_copy(update={"mount": "arm.1"})
    sliding = arm.links[2].model_copy(update={"joint": arm.links[2].joint.model_copy(update={"kind": "prismatic"})})
    branch = first.model_copy(update={"links": (arm.links[1], sliding)})
    rotors = {"arm": (0.02, 0.05, 0.01), "branch": (0.03, 0.4)}
    return RobotModel(spec.model_copy(update={"arms": {"arm": arm, "branch": branch}, "armature": rotors}))


@pytest.fixture
def x(robot: RobotModel) -> Array:
    """A state in motion."""
    random = np.random.default_rng(3)
    attitude = random.standard_normal(4)
    joints, v = 0.4 * random.standard_normal(robot.n - 6), 0.2 * random.standard_normal(robot.n)
    return np.r_[0.3, -0.2, 0.5, attitude / np.linalg.norm(attitude), joints, v]


@pytest.fixture
def u(robot: RobotModel) -> Array:
    """Accelerations rich in frequencies."""
    return 0.5 * np.sin(np.outer(TICK * np.arange(M), np.arange(1, robot.n + 1)) * 5 + np.arange(robot.n))


@pytest.fixture
def everything(robot: RobotModel) -> Disturbance:
    """Other bodies, a payload, noise, and a push."""
    random, known, bodies = np.random.default_rng(9), robot.nominal, len(robot.spec.bodies)
    true = InertialParameters(
        known.mass * random.uniform(0.8, 1.2, bodies),
        known.inertia * random.uniform(0.8, 1.2, (bodies, 1)),
        random.uniform(-0.02, 0.02, (bodies, 3)),
        np.array([0.5, 0.2]),
        np.array([0.03, 0.01]),
    )
    external_force = np.zeros((M, robot.n))
    external_force[20, :6] = [50.0, -30.0, 10.0, 3.0, -2.0, 5.0]
    return Disturbance(true, known, 1e-3 * random.standard_normal((M, 2 * robot.n)), external_force)


def kept(robot: RobotModel, x: Array, parameters: InertialParameters | None = None) -> Array:
    """Momentum and energy (7,)."""
    Q, v = np.split(x, [robot.nq])
    return np.r_[robot.momentum(Q, v, parameters), robot.kinetic_energy(Q, v, parameters)]


def apart(robot: RobotModel, one: Array, other: Array) -> float:
    """Largest difference of two motions (K, nq + n)."""
    return float(np.abs(one - other).max())


@pytest.mark.parametrize("plant", PLANTS)
def test_momentum_changes_by_the_impulse_and_energy_by_the_work(
    robot: RobotModel, x: Array, u: Array, plant: type
) -> None:
    ticks: Ticks = plant(robot, TICK).advance(0.0, x, Setpoints(u))
    np.testing.assert_allclose(kept(robot, ticks.states[-1]) - kept(robot, x), ticks.impulse_and_work, atol=1e-10)


@pytest.mark.parametrize("plant", PLANTS)
def test_so_it_is_with_everything_that_disturbs(
    robot: RobotModel, x: Array, u: Array, everything: Disturbance, plant: type
) -> None:
    n = robot.n
    rough = JointFriction(np.r_[np.zeros(6), np.full(n - 6, 0.02)], np.zeros(n), 0.02)
    ticks: Ticks = plant(robot, TICK, 2, friction=rough).advance(0.0, x, Setpoints(u), everything)
    before, after = (kept(robot, ticks.states[k], everything.robot) for k in (0, -1))
    np.testing.assert_allclose(after - before, ticks.impulse_and_work, atol=2e-9)


def test_the_engines_agree(robot: RobotModel, x: Array, u: Array, everything: Disturbance) -> None:
    free, replayed = JointFriction.none(robot.n), Rk4Plant(robot, TICK).advance(0.0, x, Setpoints(u))
    built: list[Plant] = [plant(robot, TICK, 1, friction=free) for plant in PLANTS]
    one, other = (plant.advance(0.0, x, Setpoints(u), everything).states for plant in built)
    assert apart(robot, one, other) < 1e-10
    assert apart(robot, one, replayed.states) > 1e-3
    assert apart(robot, MujocoPlant(robot, TICK).replay(x, replayed.F), replayed.states) < 1e-10


def test_a_push_is_a_blow_to_the_base_in_space(robot: RobotModel, x: Array, everything: Disturbance) -> None:
    """Force along inertial axes, torque about the body's: the momentum it gives is that of the impulse."""
    blow = replace(everything, robot=robot.nominal, noise=np.zeros((M, 2 * robot.n)))
    free = Rk4Plant(robot, TICK, friction=JointFriction.none(robot.n))
    x = np.r_[x[: robot.nq], np.zeros(robot.n)]
    ticks = free.advance(0.0, x, Setpoints(np.zeros((M, robot.n))), blow)
    force, torque = TICK * blow.external_force[20, :3], TICK * blow.external_force[20, 3:6]
    turned = Rotation.from_quat(x[3:7], scalar_first=True).apply(torque)
    np.testing.assert_allclose(
        ticks.impulse_and_work[:-1], [*force, *(turned + np.cross(x[:3], force))], rtol=1e-2, atol=1e-4
    )


def test_the_quaternion_stays_a_unit_one_for_a_minute(robot: RobotModel, x: Array) -> None:
    plant, u = Rk4Plant(robot, 1e-2), np.zeros((6000, robot.n))
    u[:, 3:6] = 0.3 * np.sin(np.outer(1e-2 * np.arange(6000), [0.2, 0.3, 0.5]))
    quaternions = plant.advance(0.0, x, Setpoints(u)).states[:, 3:7]
    np.testing.assert_allclose(np.linalg.norm(quaternions, axis=1), 1, rtol=0, atol=1e-12)


def test_computed_torque_makes_the_robot_follow_the_ideal_plant(robot: RobotModel, x: Array) -> None:
    """The force is held over a tick, so the error shrinks with the tick."""
    errors = []
    for rate in (250, 1000):
        u = np.tile(np.linspace(-0.5, 0.5, robot.n), (rate // 5, 1))
        ideal, full = (
            plant(robot, 1 / rate).advance(0.0, x, Setpoints(u)).states[-1] for plant in (IdealPlant, Rk4Plant)
        )
        errors.append(np.abs(ideal - full).max())
    assert errors[1] < 2e-4
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.1)


def test_under_the_law_the_motion_is_the_plans(robot: RobotModel, x: Array) -> None:
    """In the chart the plan is the double integrator; the physics knows no chart."""
    n, K = robot.n, 8
    chart, random = robot.space.chart_at(x[: robot.nq]), np.random.default_rng(1)
    u, times = random.normal(0, 0.3, (K, n)), 3.0 + 0.3 * np.arange(K + 1)
    X = [chart.to_chart(x[None, : robot.nq], x[None, robot.nq :])[0]]
    for each in u:
        X.append(np.r_[X[-1][:n] + 0.3 * X[-1][n:] + 0.045 * each, X[-1][n:] + 0.3 * each])
    plan = Plan(times, np.array(X), u, np.zeros(0), chart)
    inputs = np.hstack([u, np.tile(chart.anchor, (K, 1))])
    flow = AdaptiveDynamics(robot).integrate("law", x, times, inputs)
    np.testing.assert_allclose(flow.between_pieces, np.hstack(chart.from_chart(plan.X)), atol=1e-9)


def test_a_held_force_is_the_plants(robot: RobotModel, x: Array, u: Array) -> None:
    ticks, physics = Rk4Plant(robot, TICK).advance(3.0, x, Setpoints(u[:20])), AdaptiveDynamics(robot)
    np.testing.assert_allclose(
        physics.integrate("ticks", x, ticks.time, u[:20]).between_pieces, ticks.states, atol=1e-9
    )


def test_taking_up_keeps_momentum_and_letting_go_velocities(robot: RobotModel, x: Array) -> None:
    holding = robot.nominal.holding(np.array([3.0, 2.0]), np.array([0.4, 0.3]))
    taken, left = take_up(robot, x, robot.nominal, holding), release(robot, x, robot.nominal, holding)
    np.testing.assert_allclose(kept(robot, taken.state, holding)[:6], kept(robot, x)[:6], atol=1e-12)
    assert taken.momentum_and_energy[-1] == pytest.approx(kept(robot, taken.state, holding)[6] - kept(robot, x)[6])
    assert taken.momentum_and_energy[-1] < 0
    np.testing.assert_array_equal(left.state, x)
    np.testing.assert_allclose(kept(robot, x, holding) + left.momentum_and_energy, kept(robot, x), atol=1e-12)
