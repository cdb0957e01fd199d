"""End conditions of the momentum of robot and held load."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from psmpc_cli.ocp.objective import stage_functions
from psmpc_cli.ocp.problem import Problem, build_problem, in_own_chart
from psmpc_cli.ocp.stage import end_shape, stage_shape
from psmpc_cli.robot.actuators.wheels import Wheels
from psmpc_cli.robot.free_body import body_of
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.simulation.run import simulate
from psmpc_cli.solvers import Outcome
from psmpc_cli.specs.load import load_task
from psmpc_cli.specs.robots.robot import stack

from .constraints.floating_windows import fast_arms_in, planar_task, solved, spatial_task, window_of

MOMENTUM_ALONE = {"momentum": {"linear": 0.5, "angular": 0.05}}
WEIGHTS_OF_BASE = {"plane": [1, 1, 1], "space": [1, 1, 1, 1, 1, 1]}


def ended_by_momentum(task: str, stage: str, changes: Mapping[str, Any] | None = None) -> tuple[Problem, int]:
    """A problem one of whose stages ends by momentum alone, and the index of that stage."""
    by_momentum = {f"stages.{stage}.ends_when": MOMENTUM_ALONE}
    problem = build_problem(load_task(task, {**by_momentum, **(changes or {})}))
    return problem, [each.name for each in problem.stages].index(stage)


def moving(model: RobotModel, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A state of the robot."""
    random = np.random.default_rng(seed)
    Q = np.array(model.space.integrate(model.space.neutral, random.normal(scale=0.4, size=model.n)))
    return Q, random.normal(scale=0.2, size=model.n)


def angular(lever: np.ndarray, force: np.ndarray) -> np.ndarray:
    """The cross product of two vectors (2,) or (3,), as many components as a rotation has."""
    of_3d = np.cross([*lever, 0.0][:3], [*force, 0.0][:3])
    return np.asarray(of_3d[-1:] if len(lever) == 2 else of_3d)


@pytest.mark.parametrize(("task", "stage"), [("transport_grasp", "transport"), ("catch_tumbling", "carry")])
@pytest.mark.parametrize("is_known", [True, False])
def test_the_rows_are_momenta_of_robot_and_known_load_about_their_common_centre(
    task: str, stage: str, is_known: bool
) -> None:
    problem, index = ended_by_momentum(task, stage, {"object.grasp.known": is_known})
    model = problem.model
    space = model.space
    d = space.dimension
    robot_mass = sum(body.mass for body in model.spec.bodies)
    target_object = problem.body
    held_at = np.array(target_object.grasp.at[target_object.holder])
    inside = space.relative(space.neutral[: space.n_pose], held_at)
    for seed in range(4):
        Q, v = moving(model, seed)
        placed, x = in_own_chart(model, problem.stages[index], Q, v)

        def pose_at(time: float, Q: np.ndarray = Q, v: np.ndarray = v) -> np.ndarray:
            Q_then = np.array(space.integrate(Q, time * v))
            gripper = model.poses(Q_then)[list(model.pose_rows).index(target_object.holder)]
            return np.asarray(space.composed(gripper, inside))

        step = 1e-5
        twist = space.pose_error(pose_at(step), pose_at(-step)) / (2 * step)
        of_object = np.zeros(space.n_twist)
        mass = 0.0
        pose = pose_at(0.0)
        if is_known:
            mass = target_object.mass
            of_object = np.array(body_of(target_object).momentum(pose.tolist(), twist.tolist()))
        total = model.momentum(Q, v) + of_object
        centre = (robot_mass * model.centre_of_mass(Q) + mass * pose[:d]) / (robot_mass + mass)
        expected = [*total[:d], *(total[d:] - angular(centre, total[:d]))]
        np.testing.assert_allclose(problem.costs.ends(placed, x[None])[0], expected, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize(("task", "stage"), [("transport_grasp", "transport"), ("catch_tumbling", "carry")])
def test_the_derivatives_of_the_rows_are_those_of_central_differences(task: str, stage: str) -> None:
    problem, index = ended_by_momentum(task, stage, {"object.grasp.known": True})
    placed, x = in_own_chart(problem.model, problem.stages[index], *moving(problem.model, 0))
    end = stage_functions(problem.model, end_shape(stage_shape(placed))).end
    rows, jacobian = end.with_jacobian(x, placed.target)
    step = 1e-6
    moved = x + step * np.vstack([np.eye(len(x)), -np.eye(len(x))])
    (values,) = end.value(moved, placed.target, rows=len(moved))
    differences = (values[: len(x)] - values[len(x) :]) / (2 * step)
    np.testing.assert_allclose(jacobian.reshape(-1, len(x)), differences.T, atol=1e-6)
    assert rows.size == problem.model.space.n_twist


def test_what_wheels_store_is_none_of_it() -> None:
    """A robot at rest whose wheels spin is at rest."""
    problem, index = ended_by_momentum("turn_and_look", "look", {"stages.look.ends_when.momentum": {"angular": 1e-6}})
    model = problem.model
    assert np.linalg.norm(Wheels.of(model.spec).at_first) == 0.0
    Q, _ = moving(model, 0)
    placed, x = in_own_chart(model, problem.stages[index], Q, np.zeros(model.n))
    assert problem.costs.met(placed, x[None])[0]


def test_a_load_that_is_found_out_counts_as_found() -> None:
    problem, index = ended_by_momentum("transport_grasp", "transport", {"object.grasp.known": "estimated"})
    Q, v = moving(problem.model, 0)
    declared = problem.body
    linear = []
    for share in (1.0, 2.0):
        numbers = share * np.array([declared.mass, *declared.inertia])
        stage = problem.stages[index].unplaced_copy().with_load(numbers)
        placed, x = in_own_chart(problem.model, stage, Q, v)
        linear.append(problem.costs.ends(placed, x[None])[0][:2])
        recorded = problem.stages[index].end.recorded(stage.end.record)
        np.testing.assert_array_equal(recorded.arguments, stage.end.arguments)
    of_robot = problem.model.momentum(Q, v)[:2]
    np.testing.assert_allclose(linear[1] - of_robot, 2 * (linear[0] - of_robot), rtol=1e-9)


@pytest.mark.parametrize("where", ["plane", "space"])
def test_sqp_and_ipopt_agree_on_a_window_with_the_end(tmp_path: Path, where: str) -> None:
    """A robot that drifts and turns brings its momentum below the bounds, then folds its arms: J to 1e-5."""
    by_momentum = {
        "mobility": "free-flying",
        "skills.reach.weights.base": WEIGHTS_OF_BASE[where],
        "skills.home.weights.base": WEIGHTS_OF_BASE[where],
        "stages.reach.ends_when": {"momentum": {"linear": 0.2, "angular": 0.02}},
    }
    if where == "plane":
        poses = {f"stages.{stage}.target.base": [0.1, -0.1, 0.2] for stage in ("reach", "home")}
        problem = build_problem(planar_task(fast_arms_in(tmp_path), {**by_momentum, **poses}))
    else:
        poses = {f"stages.{stage}.target.base": {"position": [0.1, 0, -0.1]} for stage in ("reach", "home")}
        problem = build_problem(spatial_task({**by_momentum, **poses, "controller.horizon": 6}))
    model = problem.model
    Q = stack(problem.spec.initial, model.spec, "joint")
    v = np.zeros(model.n)
    v[model.space.base] = [0.05, -0.02, 0.1] if where == "plane" else [0.05, -0.02, 0.03, 0.1, 0.05, -0.1]
    window = window_of(problem, Q, v)
    first = solved(problem, window, "sqp")
    own = solved(problem, window, "sqp", first.plan)
    other = solved(problem, window, "ipopt", first.plan)
    assert own.outcome is other.outcome is Outcome.OPTIMAL
    assert own.objective == pytest.approx(other.objective, rel=1e-5)
    ends_at = own.plan.switch_times
    np.testing.assert_allclose(ends_at, other.plan.switch_times, atol=1e-3)
    (x,) = own.plan.states_at(ends_at)
    linear, turn = np.split(problem.costs.ends(window.stages[0], x[None])[0], [model.dimension])
    assert np.linalg.norm(linear) <= 0.2 * (1 + 1e-3)
    assert np.linalg.norm(turn) <= 0.02 * (1 + 1e-3)


def test_a_tumbling_robot_ends_its_stage_once_its_momentum_is_below_the_bounds(tmp_path: Path) -> None:
    """Of the true states, and not a sample later than it is; with it the base has to be near a place."""
    bounds = {"linear": 0.5, "angular": 0.05}
    task = planar_task(
        fast_arms_in(tmp_path),
        {
            "mobility": "free-flying",
            "initial_velocity": {"base": [0.05, 0, 0.1]},
            "skills.reach.weights.base": [1, 1, 1],
            "skills.home.weights.base": [1, 1, 1],
            "stages.reach.target.base": [0, 0, 0],
            "stages.home.target.base": [0, 0, 0],
            "limits": {"base": {"acceleration": [0.02, 0.02, 0.02]}},
            "stages.reach.ends_when": {"momentum": bounds, "coordinates": ["base"], "tolerance": 0.3},
            "controller.nodes": 12,
            "log": {"ticks": True, "shares": False},
            "time_limit": 15,
        },
    )
    run = simulate(task)
    (ended, _) = run.stages["switch_time"]
    assert np.isfinite(ended)
    model = run.problem.model
    momentum = model.momentum(run["ticks/Q"], run["ticks/Qdot"])
    centres = np.array([model.centre_of_mass(Q) for Q in run["ticks/Q"]])
    spin = momentum[:, 2] - (centres[:, 0] * momentum[:, 1] - centres[:, 1] * momentum[:, 0])
    shares = np.maximum(np.linalg.norm(momentum[:, :2], axis=1) / bounds["linear"], np.abs(spin) / bounds["angular"])
    times = run["ticks/time"]
    assert shares[0] > 5
    assert shares[np.searchsorted(times, ended)] <= 1.01
    assert shares[times < ended - 0.1].min() > 1
