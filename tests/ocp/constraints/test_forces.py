"""Limits of forces: the rows that state them, and plans that keep to them."""

from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
import yaml
from hypothesis import given

from psmpc_cli.control import Controller, State
from psmpc_cli.ocp.constraints.forces import ForceStructure, force_limits, force_rows, inertia
from psmpc_cli.ocp.gauss_newton import Unknowns, VelocityForm
from psmpc_cli.ocp.loads import Load, known_load
from psmpc_cli.ocp.objective import Intervals, force_residual
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.ocp.problem import Problem, build_problem
from psmpc_cli.ocp.window import window_numbers, window_shape
from psmpc_cli.plant.base import Setpoints
from psmpc_cli.plant.mujoco import MujocoPlant
from psmpc_cli.plant.rk4 import Rk4Plant
from psmpc_cli.robot.actuators.thrusters import Thrusters
from psmpc_cli.robot.free_body import body_of
from psmpc_cli.robot.held_load import HeldLoad
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.solvers import Outcome
from psmpc_cli.solvers.quadratic import PiqpQp, QpStatus, RiccatiQp, load_kernel
from psmpc_cli.solvers.sqp_window import SqpWindow, fixed_bounds, window_bounds
from psmpc_cli.specs.load import load_task
from psmpc_cli.specs.robots.robot import stack

from ...robot.strategies import State as Moving
from ...robot.strategies import (
    assert_close_to_differences,
    jacobian_by_differences,
    laws,
    moving_robots,
    moving_spatial_robots,
)
from .floating_windows import planar_task, solved, spatial_task, window_of


def nothing_held(model: RobotModel) -> Load:
    return Load((0.0,) * len(model.spec.arms), (0.0,) * len(model.spec.arms))


def own_axes(model: RobotModel, Q: np.ndarray, F: np.ndarray) -> np.ndarray:
    """A generalized force with the base's along its own axes."""
    return np.asarray(model.space.along_base_axes(Q.tolist(), F.tolist()), float)


def over_one(x: np.ndarray, x_next: np.ndarray, h: np.ndarray) -> Intervals:
    """One interval between two states (2n,) of a length (1,)."""
    return Intervals(np.array([x, x_next]), h[None], np.zeros(0), np.array([0]))


def assert_rows(model: RobotModel, load: Load, Q: np.ndarray, x: np.ndarray, x_next: np.ndarray) -> np.ndarray:
    """Compare derivatives with differences; return the forces of the rows, at the beginning and at the end, (2, n)."""
    rows = force_rows(model, ForceStructure(tuple(range(model.n)), load.kind))
    argument = np.r_[Q[model.space.attitude], load.numbers]
    z = np.r_[x, x_next, 0.04]

    def value(z: np.ndarray) -> np.ndarray:
        start, end, h = np.split(z, [2 * model.n, 4 * model.n])
        return rows.values(over_one(start, end, h), argument).ravel()

    jacobian = rows.jacobian(over_one(x, x_next, z[-1:]), argument)[0]
    assert_close_to_differences(jacobian, jacobian_by_differences(value, z))
    return value(z).reshape(2, -1) / z[-1] * inertia(model)


@pytest.mark.slow
@pytest.mark.parametrize("states", [moving_robots(), moving_spatial_robots()], ids=["plane", "space"])
def test_rows_are_the_forces_of_the_law(states: object) -> None:
    """On random trees, h times the force for a constant acceleration; their derivatives by central differences."""

    @given(states)
    @laws
    def check(state: Moving) -> None:
        model, Q, v, u = state
        chart = model.space.chart_at(Q)
        x = chart.to_chart(Q[None], v[None])[0]
        x_next = np.r_[x[: model.n] + 0.04 * x[model.n :], x[model.n :] + 0.04 * u]
        found = assert_rows(model, nothing_held(model), Q, x, x_next)
        X = np.array([x, x_next])
        places, velocities = chart.from_chart(X)
        for F, end, place, velocity in zip(found, X, places, velocities, strict=True):
            Qdot = end[model.n :]
            own = model.space.charted_acceleration(ca.SX(end[: model.n]), ca.SX(Qdot), ca.SX(u))
            vdot = np.asarray(ca.DM(own)).ravel()
            expected = own_axes(model, place, model.inverse_dynamics(place, velocity, vdot))
            np.testing.assert_allclose(F, expected, rtol=1e-9, atol=1e-9 * max(1.0, np.abs(expected).max()))

    check()


@pytest.mark.parametrize("name", ["transport_grasp", "servicing"])
def test_rows_of_a_held_object_are_the_forces_of_the_law_that_knows_it(name: str) -> None:
    """For all motions, those that would strain the object among them."""
    task = load_task(name, {"object.grasp.known": True})
    model = RobotModel(task.robot)
    capture = task.spec.body
    stage = task.spec.held_stages.start
    load = known_load(task.spec, model, stage)
    assert load.held is not None
    assert known_load(task.spec, model, stage - 1) == nothing_held(model)
    rng = np.random.default_rng(4)
    bent = 0.4 * rng.standard_normal(model.n)
    bent[model.space.joint_rates] += 0.8
    Q = model.space.path(model.neutral, bent[None])[-1]
    poses = dict(zip(model.pose_rows, model.poses(Q), strict=True))
    tips = [poses[gripper] for gripper in load.held.grippers]
    at = [np.asarray(model.space.relative(tip, tips[0])) for tip in tips]
    grasps = np.array([[*pose, *described[-2:]] for pose, described in zip(at, load.held.grasps, strict=True)])
    load = replace(load, held=replace(load.held, grasps=tuple(map(tuple, grasps.tolist()))))
    v, u = 0.1 * rng.standard_normal((2, model.n))
    x = model.space.chart_at(Q).to_chart(Q[None], v[None])[0]
    x_next = np.r_[x[: model.n], x[model.n :] + 0.04 * u]
    found = assert_rows(model, load, Q, x, x_next)
    vdot = model.space.charted_acceleration(ca.SX(x[: model.n]), ca.SX(x[model.n :]), ca.SX(u))
    body = body_of(capture)
    law = HeldLoad(model, body, capture.grasp)
    F = law.force(Q, v, np.asarray(ca.DM(vdot)).ravel(), model.nominal, grasps, body.vector)
    expected = own_axes(model, Q, F)
    np.testing.assert_allclose(found[0], expected, atol=1e-6 * np.abs(expected).max())
    assert np.abs(expected - own_axes(model, Q, model.inverse_dynamics(Q, v, u))).max() > 1e-2


@pytest.mark.parametrize(
    ("torque", "instant", "kinds"),
    [
        (4.0, 1.332, ["sqp"]),
        (1.5, 1.698, ["sqp"]),
        pytest.param(1.5, 1.698, ["sqp", "ipopt"], marks=pytest.mark.slow),
    ],
)
def test_a_window_has_the_optimum_of_the_problem_in_the_joint_rates(
    fast_arms: Path, torque: float, instant: float, kinds: list[str]
) -> None:
    """Its switch time by other equations of motion and IPOPT, without the base among the unknowns."""
    problem = build_problem(planar_task(fast_arms, {"limits": {"arms": {"force": [torque] * 3}}}))
    Q = stack(problem.spec.initial, problem.task.robot, "joint")
    window = window_of(problem, Q, np.zeros(problem.model.n))
    found = [solved(problem, window, kind) for kind in kinds]
    for solution in found:
        assert solution.outcome.usable
        assert solution.plan.switch_times == pytest.approx([instant], abs=2e-3)
        assert solution.objective == pytest.approx(found[0].objective, rel=1e-5)


FORCE_COSTS = {"skills.reach.weights.force": {"arms": [0.05] * 3}, "skills.home.weights.force": 0.02}


@pytest.mark.slow
def test_what_force_costs_is_in_the_optimum_of_both_solvers(fast_arms: Path) -> None:
    problem = build_problem(planar_task(fast_arms, FORCE_COSTS))
    window = window_of(problem, stack(problem.spec.initial, problem.task.robot, "joint"), np.zeros(problem.model.n))
    window = replace(window, terminal_cost=0.5)
    own = solved(problem, window, "sqp")
    other = solved(problem, window, "ipopt", own.plan)
    assert own.outcome is Outcome.OPTIMAL
    assert other.outcome is Outcome.OPTIMAL
    assert own.objective == pytest.approx(other.objective, rel=1e-5)
    assert own.plan.switch_times == pytest.approx(other.plan.switch_times, abs=1e-4)
    assert own.plan.switch_times > 1.3  # without it 1.287 s


@pytest.mark.parametrize("limits", [{}, {"limits": {"arms": {"force": [4.0] * 3}}}], ids=["free", "limited"])
def test_the_model_of_what_force_costs(fast_arms: Path, limits: dict[str, object]) -> None:
    """Gradient by differences, and the program as another method solves it."""
    problem = build_problem(planar_task(fast_arms, {**FORCE_COSTS, **limits}))
    model = problem.model
    window = window_of(problem, stack(problem.spec.initial, problem.task.robot, "joint"), np.zeros(model.n))
    form = VelocityForm(model, window_shape(window))
    rng = np.random.default_rng(2)
    p = window_numbers(window, np.array([2.5]))
    X = window.x0 + 0.05 * rng.standard_normal((form.grid.K + 1, 2 * model.n))
    X[0] = window.x0
    point = Unknowns(X, np.array([2.5]))
    direction = Unknowns(rng.standard_normal(X.shape), np.array([0.3]))
    direction.X[0] = 0.0
    linear = form.linearize(point, p)
    step = 1e-5
    ahead, behind = (form.residuals(point.moved(direction, each), p).objective for each in (step, -step))
    slope = (linear.gradient * direction.X).sum() + linear.gradient_tau @ direction.tau
    assert slope == pytest.approx((ahead - behind) / (2 * step), rel=1e-6)
    plan = solved(problem, window, "sqp").plan
    bounds = window_bounds(form, fixed_bounds(form, window), window, plan, plan.switch_times, np.inf)
    sqp_window = SqpWindow(form, bounds, p)
    start = sqp_window.with_dependent_rates(Unknowns(plan.X + 0.01 * (X - window.x0), plan.switch_times))
    here, program = sqp_window.linearize(start)
    kernel = load_kernel(model.n, 1)
    assert kernel is not None
    own = RiccatiQp(kernel, 1e-9).solve(sqp_window, program, here)
    other = PiqpQp(1e-9).solve(sqp_window, program, here)
    assert own.status is QpStatus.SOLVED
    assert other.status is QpStatus.SOLVED
    np.testing.assert_allclose(own.step.tau, other.step.tau, atol=1e-6)
    np.testing.assert_allclose(own.step.X, other.step.X, atol=1e-5)


@pytest.mark.parametrize("name", ["transport_grasp", "servicing"])
@pytest.mark.parametrize("hands", [0, 2], ids=["payload", "held"])
def test_what_force_costs_with_a_load(name: str, hands: int) -> None:
    """sqrt(h) F and its derivatives, of a payload and of a held object, whose numbers are arguments."""
    task = load_task(name, {"object.grasp.known": True})
    model = RobotModel(task.robot)
    held = known_load(task.spec, model, task.spec.held_stages.start).held
    assert held is not None
    arms = len(model.spec.arms)
    load = Load((0.0,) * arms, (0.0,) * arms, held) if hands else Load((2.0, 5.0), (0.1, 0.4))
    rows = force_residual(model, load.kind)
    rng = np.random.default_rng(6)
    x, x_next = 0.3 * rng.standard_normal((2, 2 * model.n))
    argument = np.r_[model.neutral[model.space.attitude], load.numbers]
    z = np.r_[x, x_next, 0.2]

    def value(z: np.ndarray) -> np.ndarray:
        start, end, h = np.split(z, [2 * model.n, 4 * model.n])
        return rows.values(over_one(start, end, h), argument).ravel()

    (jacobian,) = rows.jacobian(over_one(x, x_next, z[-1:]), argument)
    assert_close_to_differences(jacobian, jacobian_by_differences(value, z))
    limits = force_rows(model, ForceStructure(tuple(range(model.n)), load.kind))
    hF = limits.values(over_one(x, x_next, z[-1:]), argument)[0, : model.n] * inertia(model)
    np.testing.assert_allclose(value(z) * np.sqrt(0.2), hF, rtol=1e-10, atol=1e-10 * np.abs(hF).max())


@pytest.mark.slow
def test_sqp_and_ipopt_agree_in_space() -> None:
    """Started at the plan of sqp, with limits that bind."""
    limits = {"arm": {"force": [0.02, 0.02, 0.02]}}
    changes = {"mobility": "fixed", "controller.horizon": 6, "limits": limits}
    problem = build_problem(spatial_task(changes))
    model = problem.model
    window = window_of(problem, stack(problem.spec.initial, model.spec, "joint"), np.zeros(model.n))
    own = solved(problem, window, "sqp")
    other = solved(problem, window, "ipopt", own.plan)
    assert own.outcome is Outcome.OPTIMAL
    assert other.outcome is Outcome.OPTIMAL
    assert own.objective == pytest.approx(other.objective, rel=1e-5)
    free = build_problem(spatial_task({"mobility": "fixed", "controller.horizon": 6}))
    unlimited = window_of(free, stack(free.spec.initial, model.spec, "joint"), np.zeros(model.n))
    assert own.objective > 1.001 * solved(free, unlimited, "sqp").objective


@pytest.mark.parametrize("plant", [Rk4Plant, MujocoPlant])
def test_forces_that_are_commanded_keep_to_the_limits(fast_arms: Path, plant: type) -> None:
    """At every tick within 3 %, and near the limits in some."""
    torque = 1.5
    task = planar_task(fast_arms, {"limits": {"arms": {"force": [torque] * 3}}, "controller.horizon": 4})
    controller = Controller(task)
    model = controller.problem.model
    physics = plant(model, 1e-3)
    x = np.r_[stack(task.spec.initial, task.robot, "joint"), np.zeros(model.n)]
    time = 0.0
    largest = 0.0
    while not controller.done and time < 15:
        command = controller.step(time, State(x[: model.nq], x[model.nq :]))
        ticks = physics.advance(time, x, Setpoints(command.u))
        largest = max(largest, np.abs(ticks.F).max())
        x = ticks.states[-1]
        time = float(ticks.time[-1])
    assert controller.done
    assert 0.99 * torque < largest < 1.03 * torque


def weak_thrusters(robot: Path, folder: Path) -> Path:
    """Write a robot with six oblique thrusters, whose wrenches have no facet across an axis."""
    described = yaml.safe_load(robot.read_text())
    angles = np.radians([10, 130, 250])
    described["thrusters"] = [
        {
            "position": [0.3 * float(np.cos(angle)), 0.3 * float(np.sin(angle))],
            "direction": [float(np.cos(angle + way)), float(np.sin(angle + way))],
            "force": force,
        }
        for angle in angles
        for way, force in ((1.9, 2.0), (-1.9, 1.5))
    ]
    path = folder / "thrusters.yaml"
    path.write_text(yaml.safe_dump(described))
    return path


THRUST = {
    "mobility": "free-flying",
    **{f"skills.{name}.weights.base": [100, 100, 10] for name in ("reach", "home")},
    **{f"stages.{name}.target.base": [0.06, -0.04, 0.2] for name in ("reach", "home")},
}


def beyond_the_polytope(problem: Problem, plan: Plan) -> np.ndarray:
    """How far the wrenches at both ends of the intervals of a plan are beyond each half-space, of the largest value."""
    model = problem.model
    faces = Thrusters.of(model.spec.thrusters).half_spaces
    Q, v = plan.chart.from_chart(plan.X)
    wrenches = [
        own_axes(model, Q[k + end], model.inverse_dynamics(Q[k + end], v[k + end], plan.u[k]))[model.space.base]
        for k in range(len(plan.u))
        for end in (0, 1)
    ]
    values = np.array(wrenches) @ faces.normals.T
    return np.asarray(np.maximum(values / faces.high, values / faces.low).max(axis=0) - 1)


@pytest.mark.parametrize(
    "kinds", [["sqp"], pytest.param(["sqp", "ipopt", "fatrop"], marks=pytest.mark.slow)], ids=["sqp", "all"]
)
def test_plans_keep_to_what_thrusters_can_give(fast_arms: Path, tmp_path: Path, kinds: list[str]) -> None:
    """At both ends of every interval, at some facets to the limit; all solvers find the same optimum."""
    problem = build_problem(planar_task(weak_thrusters(fast_arms, tmp_path), THRUST))
    Q = stack(problem.spec.initial, problem.task.robot, "joint")
    window = window_of(problem, Q, np.zeros(problem.model.n))
    own = solved(problem, window, "sqp")
    assert own.outcome is Outcome.OPTIMAL
    beyond = beyond_the_polytope(problem, own.plan)
    assert beyond.max() < 1e-5
    assert (beyond > -1e-4).sum() >= 2
    for kind in kinds[1:]:
        other = solved(problem, window, kind, own.plan)
        assert other.outcome is Outcome.OPTIMAL
        # fatrop stays off active bounds: as far with limits of single components
        assert own.objective == pytest.approx(other.objective, rel=2e-4 if kind == "fatrop" else 1e-5)
        assert own.plan.switch_times == pytest.approx(other.plan.switch_times, abs=2e-3)
    free = build_problem(planar_task(fast_arms, THRUST))
    unlimited = solved(free, window_of(free, Q, np.zeros(problem.model.n)), "sqp")
    assert own.objective > 1.001 * unlimited.objective
    assert beyond_the_polytope(problem, unlimited.plan).max() > 0.1


def test_limits_and_thrusters_both_count(fast_arms: Path, tmp_path: Path) -> None:
    """A limit of a component of the base besides its thrusters, with those of joints: the rows in their order."""
    limits = {"limits": {"base": {"force": [1.0, 50, 50]}, "arms": {"force": [3.0] * 3}}}
    problem = build_problem(planar_task(weak_thrusters(fast_arms, tmp_path), {**THRUST, **limits}))
    model = problem.model
    found = force_limits(problem.spec, model, 0)
    assert found is not None
    assert len(found.low) == 2 * (9 + len(found.structure.combinations))
    rows = force_rows(model, found.structure)
    rng = np.random.default_rng(8)
    x = np.r_[rng.standard_normal(model.n), 0.1 * rng.standard_normal(model.n)]
    x_next = x + np.r_[np.zeros(model.n), 0.01 * rng.standard_normal(model.n)]
    h = np.array([0.04])
    (values,) = rows.values(over_one(x, x_next, h), found.argument)
    for end, of_end in zip((x, x_next), np.split(values, 2), strict=True):
        u = (x_next - x)[model.n :] / h
        F = own_axes(model, end[: model.n], model.inverse_dynamics(end[: model.n], end[model.n :], u))
        np.testing.assert_allclose(of_end[:9], h * F / inertia(model), rtol=1e-9)
        np.testing.assert_allclose(of_end[9:], h * np.array(found.structure.combinations) @ F[:3], rtol=1e-9)
    Q = stack(problem.spec.initial, problem.task.robot, "joint")
    plan = solved(problem, window_of(problem, Q, np.zeros(model.n)), "sqp").plan
    assert beyond_the_polytope(problem, plan).max() < 1e-5
    Q, v = plan.chart.from_chart(plan.X)
    F = [own_axes(model, Q[k], model.inverse_dynamics(Q[k], v[k], u)) for k, u in enumerate(plan.u)]
    assert np.abs(np.array(F)[:, 0]).max() == pytest.approx(1.0, rel=1e-4)
