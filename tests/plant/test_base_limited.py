"""Plants whose forces are limited: cut along the base's own axes, applied never beyond, by the laws of physics."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from psmpc_cli.plant import Disturbance, ForceLimits, JointFriction, Setpoints, Ticks, build_plant
from psmpc_cli.plant.grasp import build_capture
from psmpc_cli.plant.mujoco import MujocoPlant
from psmpc_cli.plant.rk4 import Rk4Plant
from psmpc_cli.robot.dynamics import InertialParameters
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.load import load_robot

from .drawn_grasps import drawn_grasp

Array = np.ndarray

TICK = 1e-3
M = 60
PLANTS = pytest.mark.parametrize("plant", [Rk4Plant, MujocoPlant])
BOTH = pytest.mark.parametrize("robot", ["planar_dual_arm", "free_flyer_arm"], indirect=True)

ROUNDING = 1e-12
"""Of a force that is turned, as a part of the commanded one."""


@pytest.fixture(scope="module")
def robot(request: pytest.FixtureRequest) -> RobotModel:
    return RobotModel(load_robot(request.param))


@pytest.fixture
def x(robot: RobotModel) -> Array:
    """A state in motion, the base turned by some angle about no axis of its own."""
    random = np.random.default_rng(3)
    Q = robot.space.integrate(robot.neutral, 0.7 * random.standard_normal(robot.n))
    return np.r_[Q, 0.1 * random.standard_normal(robot.n)]


@pytest.fixture
def u(robot: RobotModel) -> Array:
    return 0.5 * np.sin(np.outer(20 * TICK * np.arange(M), np.arange(1, robot.n + 1)) + np.arange(robot.n))


@pytest.fixture
def disturbance(robot: RobotModel) -> Disturbance:
    """Other bodies, noise, and a push."""
    random = np.random.default_rng(9)
    known = robot.nominal
    bodies = len(robot.spec.bodies)
    true = InertialParameters(
        mass=known.mass * random.uniform(0.8, 1.2, bodies),
        inertia=known.inertia * random.uniform(0.8, 1.2, (bodies, 1)),
        offset=random.uniform(-0.02, 0.02, (bodies, robot.dimension)),
        held_mass=known.held_mass,
        held_inertia=known.held_inertia,
    )
    external_force = np.zeros((M, robot.n))
    external_force[20, : robot.dimension] = 50.0
    return Disturbance(true, known, 1e-3 * random.standard_normal((M, 2 * robot.n)), external_force)


def limits_within(robot: RobotModel, x: Array, u: Array) -> ForceLimits:
    """Limits, another one each way, at half of the largest forces that are commanded."""
    free = Rk4Plant(robot, TICK).advance(0.0, x, Setpoints(u))
    largest = np.abs(along_own_axes(robot, free.states[:-1], free.F)).max(axis=0)
    return ForceLimits(-0.4 * largest, 0.6 * largest)


def along_own_axes(robot: RobotModel, X: Array, F: Array) -> Array:
    """Turn the forces (M, n) on the base at states (M, nq + n) into its axes."""
    d = robot.dimension
    if d == 2:
        turned = Rotation.from_rotvec([[0, 0, angle] for angle in X[:, 2]])
    else:
        turned = Rotation.from_quat(X[:, 3:7], scalar_first=True)
    force = np.hstack([F[:, :d], np.zeros((len(F), 3 - d))])
    return np.hstack([turned.inv().apply(force)[:, :d], F[:, d:]])


def kept(robot: RobotModel, x: Array, parameters: InertialParameters | None = None) -> Array:
    """Momentum and energy."""
    Q, v = np.split(x, [robot.nq])
    return np.r_[robot.momentum(Q, v, parameters), robot.kinetic_energy(Q, v, parameters)]


@pytest.mark.parametrize("disturbed", [False, True], ids=["undisturbed", "disturbed"])
@PLANTS
@BOTH
def test_forces_are_cut_along_the_axes_of_the_base(
    robot: RobotModel, x: Array, u: Array, disturbance: Disturbance, plant: type, disturbed: bool
) -> None:
    limits = limits_within(robot, x, u)
    friction = JointFriction.none(robot.n) if disturbed else None
    built = plant(robot, TICK, friction=friction, force_limits=limits)
    ticks: Ticks = built.advance(0.0, x, Setpoints(u), disturbance if disturbed else None)

    commanded = along_own_axes(robot, ticks.states[:-1], ticks.commanded)
    applied = along_own_axes(robot, ticks.states[:-1], ticks.F)
    rounding = ROUNDING * np.abs(ticks.commanded).max()
    np.testing.assert_allclose(applied, np.clip(commanded, limits.low, limits.high), rtol=0, atol=rounding)
    d = robot.dimension
    assert (ticks.F[:, d:] >= limits.low[d:]).all() and (ticks.F[:, d:] <= limits.high[d:]).all()
    beyond = (commanded < limits.low) | (commanded > limits.high)
    assert beyond.any(axis=0).all() and not beyond.all(axis=1).all()
    within = ~beyond.any(axis=1)
    np.testing.assert_array_equal(ticks.F[within], ticks.commanded[within])
    seen = x if not disturbed else np.r_[_moved(robot, x, disturbance), x[robot.nq :] + disturbance.noise[0, robot.n :]]
    expected = robot.inverse_dynamics(seen[: robot.nq], seen[robot.nq :], u[0])
    np.testing.assert_allclose(ticks.commanded[0], expected, atol=1e-11)


def _moved(robot: RobotModel, x: Array, disturbance: Disturbance) -> Array:
    """The position that the law reads at the first tick."""
    return np.array(robot.space.integrate(x[: robot.nq], disturbance.noise[0, : robot.n]))


@BOTH
def test_utilization_is_the_commanded_force_over_the_limit_on_its_side(robot: RobotModel, x: Array, u: Array) -> None:
    """What is applied is at most all of a limit, and what is cut is what was more; without a limit there is none."""
    limits = limits_within(robot, x, u)
    last = np.arange(robot.n) == robot.n - 1
    limits = ForceLimits(np.where(last, -np.inf, limits.low), np.where(last, np.inf, limits.high))
    ticks = Rk4Plant(robot, TICK, force_limits=limits).advance(0.0, x, Setpoints(u))
    Q = ticks.states[:-1, : robot.nq]
    commanded = limits.utilization(robot.space, Q, ticks.commanded)
    applied = limits.utilization(robot.space, Q, ticks.F)
    np.testing.assert_allclose(applied, np.minimum(commanded, 1.0), rtol=0, atol=1e-9)
    own = along_own_axes(robot, ticks.states[:-1], ticks.commanded)[:, :-1]
    expected = np.maximum(own / limits.high[:-1], own / limits.low[:-1])
    np.testing.assert_allclose(commanded[:, :-1], expected, rtol=0, atol=1e-9)
    assert np.isnan(commanded[:, -1]).all() and (commanded[:, :-1] > 1).any() and (commanded[:, :-1] < 1).any()


def test_a_force_in_a_direction_in_which_none_is_possible_is_beyond_any_limit() -> None:
    robot = RobotModel(load_robot("planar_dual_arm"))
    pushes = ForceLimits(np.full(robot.n, 0.0), np.full(robot.n, 2.0))
    F = np.r_[1.0, -1.0, np.zeros(robot.n - 2)]
    found = pushes.utilization(robot.space, robot.neutral, F)
    np.testing.assert_array_equal(found, np.r_[0.5, np.inf, np.zeros(robot.n - 2)])


@PLANTS
@BOTH
def test_momentum_changes_by_the_impulse_and_energy_by_the_work_of_what_is_applied(
    robot: RobotModel, x: Array, u: Array, disturbance: Disturbance, plant: type
) -> None:
    limits = limits_within(robot, x, u)
    rough = JointFriction(np.r_[np.zeros(6), np.full(robot.n - 6, 0.02)], np.zeros(robot.n), 0.02)
    for friction, given in ((None, None), (rough, disturbance)):
        ticks = plant(robot, TICK, 2, friction=friction, force_limits=limits).advance(0.0, x, Setpoints(u), given)
        assert not np.array_equal(ticks.F, ticks.commanded)
        true = None if given is None else given.robot
        change = kept(robot, ticks.states[-1], true) - kept(robot, x, true)
        np.testing.assert_allclose(change, ticks.impulse_and_work, rtol=0, atol=1e-8)


@BOTH
def test_the_engines_agree(robot: RobotModel, x: Array, u: Array) -> None:
    limits = limits_within(robot, x, u)
    one, other = (
        plant(robot, TICK, force_limits=limits).advance(0.0, x, Setpoints(u)) for plant in (Rk4Plant, MujocoPlant)
    )
    np.testing.assert_allclose(one.states, other.states, rtol=0, atol=1e-10)
    assert np.abs(one.states - Rk4Plant(robot, TICK).advance(0.0, x, Setpoints(u)).states).max() > 1e-5


@BOTH
def test_compiled_is_interpreted_to_the_bit(robot: RobotModel, x: Array, u: Array, disturbance: Disturbance) -> None:
    limits = limits_within(robot, x, u)
    for friction, given in ((None, None), (JointFriction.none(robot.n), disturbance)):
        one, other = (
            Rk4Plant(robot, TICK, 1, native, friction, limits).advance(0.0, x, Setpoints(u), given)
            for native in (False, True)
        )
        for name in ("states", "F", "commanded"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


@PLANTS
@BOTH
def test_infinite_limits_are_none(robot: RobotModel, x: Array, u: Array, plant: type) -> None:
    """To the bit: a force that is not cut is not turned back and forth either."""
    infinite = np.full(robot.n, np.inf)
    limited = plant(robot, TICK, force_limits=ForceLimits(-infinite, infinite)).advance(0.0, x, Setpoints(u))
    free = plant(robot, TICK).advance(0.0, x, Setpoints(u))
    np.testing.assert_array_equal(limited.states, free.states)
    np.testing.assert_array_equal(limited.F, free.F)
    np.testing.assert_array_equal(limited.commanded, free.F)
    assert free.commanded is None


@PLANTS
@pytest.mark.parametrize("mobility", ["free-floating", "fixed"])
@pytest.mark.parametrize("robot", ["planar_dual_arm"], indirect=True)
def test_a_base_without_thrusters_gets_exactly_no_force(
    robot: RobotModel, x: Array, u: Array, plant: type, mobility: str
) -> None:
    model = RobotModel(robot.spec.model_copy(update={"mobility": mobility}))
    v = x[robot.nq :] * (np.arange(robot.n) >= 3 if mobility == "fixed" else 1)
    largest = np.r_[np.full(3, np.inf), np.full(6, 0.05)]
    limited = plant(model, TICK, force_limits=ForceLimits(-largest, largest))
    ticks = limited.advance(0.0, np.r_[x[: robot.nq], v], Setpoints(u))
    np.testing.assert_array_equal(ticks.F[:, :3], 0.0)
    assert (np.abs(ticks.F[:, 3:]) <= 0.05).all() and (np.abs(ticks.F[:, 3:]) == 0.05).any()


@pytest.mark.parametrize("kind", ["rk4", "mujoco"])
def test_forces_are_cut_while_the_robot_holds_an_object(tmp_path: Path, kind: str) -> None:
    task, start = drawn_grasp(2, tmp_path)
    model = RobotModel(task.robot)
    u = 0.2 * np.sin(np.arange(model.n)) * np.ones((50, 1))
    spec = task.spec.plant.model_copy(update={"kind": kind})
    made = []
    for limits in (None, ForceLimits(np.full(model.n, -0.02), np.full(model.n, 0.01))):
        capture = build_capture(task.spec, model)
        assert capture is not None
        before = np.r_[kept(model, start)] + capture.momentum_and_energy
        ticks = build_plant(spec, model, False, None, capture, limits).advance(
            0.0, start, Setpoints(u, closed=np.ones(50, bool))
        )
        assert ticks.target_object is not None and ticks.target_object.closed.all()
        after = kept(model, ticks.states[-1]) + capture.momentum_and_energy
        np.testing.assert_allclose(after - before, ticks.impulse_and_work, rtol=0, atol=1e-6)
        made.append(ticks)
    free, limited = made
    assert free.commanded is None
    own = along_own_axes(model, limited.states[:-1], limited.commanded)
    expected = np.clip(own, -0.02, 0.01)
    rounding = ROUNDING * np.abs(limited.commanded).max()
    np.testing.assert_allclose(along_own_axes(model, limited.states[:-1], limited.F), expected, rtol=0, atol=rounding)
    assert (own != expected).any()
