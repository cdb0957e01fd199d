from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from psmpc_cli.ocp.end import NEVER, ByState
from psmpc_cli.ocp.objective import StageCosts, stage_functions
from psmpc_cli.ocp.reference import Trajectory
from psmpc_cli.ocp.skills import skill_in
from psmpc_cli.ocp.stage import Stage, StageShape
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.parts import SKILL_KINDS, space_of

from ..robot.robots_in_task_space import spatial_robot
from .transport_windows import ending

X_U = tuple[np.ndarray, np.ndarray]

ANCHOR = np.array([0.8, 0.0, 0.6, 0.0])


def advance(model: RobotModel, kind: str, discretization: str, x: np.ndarray, u: np.ndarray, steps: int) -> np.ndarray:
    """The state 0.4 s later, in so many steps."""
    step = stage_functions(model, StageShape("joint", kind)).step(discretization)
    for _ in range(steps):
        x = np.asarray(step(x, u, 0.4 / steps, ANCHOR[: model.space.n_anchor])).ravel()
    return x


@pytest.fixture
def x_u() -> X_U:
    random = np.random.default_rng(1)
    x = np.r_[0, 0, 0, 0.5, 0.6, 0.4, -0.5, -0.6, -0.4, 0.1 * random.standard_normal(9)]
    return x, 0.3 * random.standard_normal(9)


def test_exact_step_does_not_depend_on_how_it_is_divided(model: RobotModel, x_u: X_U) -> None:
    once, seven = (advance(model, "joint", "exact", *x_u, steps) for steps in (1, 7))
    np.testing.assert_allclose(once, seven, atol=1e-13)


def test_euler_step_converges_to_the_exact_one_with_first_order(model: RobotModel, x_u: X_U) -> None:
    exact = advance(model, "joint", "exact", *x_u, 1)
    errors = [np.abs(advance(model, "joint", "euler", *x_u, steps) - exact).max() for steps in (10, 20)]
    assert errors[0] / errors[1] == pytest.approx(2, rel=1e-6)


def test_task_input_is_the_acceleration_of_the_poses(
    model: RobotModel, costs: StageCosts, stages: tuple[Stage, ...], x_u: X_U
) -> None:
    x, u = x_u
    acceleration = np.asarray(model.f_2(x, u, [])).ravel()[9:]
    found = costs.inputs(replace(stages[0], input="task"), x[None], acceleration[None])[0]
    np.testing.assert_allclose(found, u, rtol=0, atol=1e-12)


def test_under_task_input_poses_and_their_rates_are_a_double_integrator(model: RobotModel, x_u: X_U) -> None:
    """The paper's state [xi; xidot], to the fourth order of the step."""
    x, u = x_u
    xi = model.poses(x[:9]).ravel()
    rate = model.twists(x[:9], x[9:])
    errors = []
    for steps in (2, 4):
        after = advance(model, "task", "exact", x, u, steps)
        of_poses = model.poses(after[:9]).ravel() - (xi + 0.4 * rate + 0.4**2 / 2 * u)
        of_rates = model.twists(after[:9], after[9:]) - (rate + 0.4 * u)
        errors.append(np.abs([of_poses, of_rates]).max())
    assert errors[1] < 1e-5
    assert errors[0] / errors[1] == pytest.approx(16, rel=0.3)


def test_in_space_task_input_is_the_rates_of_twists_in_any_chart(stages: tuple[Stage, ...]) -> None:
    robot = spatial_robot(6, 0)
    random = np.random.default_rng(3)
    x, u = 0.5 * random.standard_normal(24), random.standard_normal(12)
    skill = skill_in("task")
    target = np.r_[random.standard_normal(skill.numbers(robot)), ANCHOR, np.zeros(6)]
    stage = replace(stages[0].with_target(target), space="task", input="task")
    acceleration = np.asarray(robot.f_2(x, u, ANCHOR)).ravel()[12:]
    found = StageCosts(robot).inputs(stage, x[None], acceleration[None])[0]
    np.testing.assert_allclose(found, u, rtol=0, atol=1e-11)


def test_in_space_twists_and_places_of_frames_are_double_integrators_too() -> None:
    robot = spatial_robot(6, 0)
    random = np.random.default_rng(1)
    bent = [0.3, 0.5, -0.9, 0.4, 0.8, 0.2]
    x = np.r_[0.4 * random.standard_normal(6), bent, 0.1 * random.standard_normal(12)]
    u = 0.1 * random.standard_normal(12)
    chart = robot.space.chart_at(np.r_[0, 0, 0, ANCHOR])
    Q, v = (rows[0] for rows in chart.from_chart(x[None]))
    rate = robot.twists(Q, v)
    speeds, thrusts = (each.reshape(2, 6)[:, :3] for each in (rate, u))
    errors = []
    for steps in (2, 4):
        Q_after, v_after = (rows[0] for rows in chart.from_chart(advance(robot, "task", "exact", x, u, steps)[None]))
        of_rates = robot.twists(Q_after, v_after) - (rate + 0.4 * u)
        moved = robot.poses(Q_after)[:, :3] - robot.poses(Q)[:, :3]
        errors.append(max(np.abs(of_rates).max(), np.abs(moved - (0.4 * speeds + 0.4**2 / 2 * thrusts)).max()))
    assert errors[1] < 1e-5
    assert errors[0] / errors[1] == pytest.approx(16, rel=0.3)


MIXED = (space_of("task", {"arm_1": "joint"}), space_of("point", {"arm_2": "free"}))


@pytest.fixture(scope="module", params=[*SKILL_KINDS, *MIXED], ids=str)
def stage(request: pytest.FixtureRequest, model: RobotModel, stages: tuple[Stage, ...]) -> Stage:
    """A stage of each skill."""
    skill, random = skill_in(request.param), np.random.default_rng(2)
    rows = skill.rows(model)
    return replace(
        stages[0].with_target(random.standard_normal(skill.numbers(model))),
        space=request.param,
        weights=random.uniform(0.5, 2.0, rows),
        end=ByState(rows=tuple(range(rows)), tolerance=np.full(rows, 0.1)),
    )


def test_the_cost_is_the_weighted_square_of_error_and_control(stage: Stage, costs: StageCosts) -> None:
    random = np.random.default_rng(0)
    X, u = random.standard_normal((5, 18)), random.standard_normal((5, 9))
    of_states, error = costs.of_states(stage, X), costs.errors(stage, X)
    np.testing.assert_allclose(of_states, error**2 @ stage.weights, rtol=1e-12)
    np.testing.assert_allclose(costs.at(stage, X, u), of_states + u**2 @ stage.control_weights, rtol=1e-12)


@settings(max_examples=20)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_rate_is_that_of_the_error(stage: Stage, costs: StageCosts, seed: int) -> None:
    x, h = np.random.default_rng(seed).uniform(-1, 1, 18), 1e-6
    X = np.array([x + sign * h * np.r_[x[9:], np.zeros(9)] for sign in (-1, 0, 1)])
    before, _, after = costs.errors(stage, X)
    rows = tuple(range(len(stage.weights)))
    rates = costs.ends(ending(stage, rows=rows, rate_tolerance=1.0), X[1:2])[0, len(rows) :]
    np.testing.assert_allclose(rates, (after - before) / (2 * h), rtol=1e-5, atol=1e-6)


def test_a_target_that_moves_through_one_value_costs_what_it_costs_at_rest(stage: Stage, costs: StageCosts) -> None:
    X, u = np.random.default_rng(0).standard_normal((4, 18)), np.ones((4, 9))
    still = replace(stage, reference=Trajectory(np.array([0.0, 5.0]), np.tile(stage.target, (2, 1))))
    np.testing.assert_allclose(costs.at(still, X, u, np.arange(4.0)), costs.at(stage, X, u))


def test_an_end_condition_is_met_within_tolerance_and_velocity(stage: Stage, model: RobotModel) -> None:
    costs, X = StageCosts(model), np.zeros((1, 18))
    here = ending(stage, tolerance=np.abs(costs.errors(stage, X)[0]))
    closer = ending(stage, tolerance=here.end.tolerance - 1e-3)
    assert [bool(costs.met(each, X)[0]) for each in (here, closer)] == [True, False]
    assert costs.met(closer, X, margin=1.5)[0] or here.end.tolerance.min() < 3e-3
    X[0, 9:] = 1.0
    assert costs.met(ending(here, rate_tolerance=10.0), X)[0]
    assert not costs.met(ending(here, rate_tolerance=0.5), X)[0]
    assert not costs.met(replace(here, end=NEVER), X)[0]


@pytest.mark.parametrize("tolerance", [1e-7, 1e-3, 0.1])
def test_an_end_condition_is_met_within_its_tolerance_however_small_it_is(
    costs: StageCosts, stages: tuple[Stage, ...], tolerance: float
) -> None:
    """Solvers stop at a tolerance: 1e-6, but never more than a thousandth of the condition's own, is let through."""
    stage = ending(stages[0], tolerance=np.full(len(stages[0].end.rows), tolerance))
    x = np.zeros(18)
    x[:9] = stage.target
    slack = min(1e-6, 1e-3 * tolerance)
    for beyond, met in ((0.9 * slack, True), (1.1 * slack, False)):
        x[0] = stage.target[0] + tolerance + beyond
        assert bool(costs.met(stage, x[None])[0]) is met
