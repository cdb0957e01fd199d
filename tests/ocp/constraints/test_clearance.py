"""Rows that keep bodies apart: their distances, when they are in windows, and what solvers make of them."""

import numpy as np
import pytest

from psmpc_cli.logs.run import Run
from psmpc_cli.ocp.constraints.clearance import GROUP_ACTIVATION, Pairs, distance_rows, groups, nearest_points
from psmpc_cli.ocp.problem import build_problem
from psmpc_cli.ocp.window import window_numbers
from psmpc_cli.simulation.replay import replay
from psmpc_cli.simulation.run import simulate
from psmpc_cli.solvers import Outcome
from psmpc_cli.specs.load import load_task

from .windows_past_a_post import POST, active_rows, near_post, passing, sampled, solved, window_of


@pytest.fixture(scope="module")
def flown() -> Run:
    """A run past the post."""
    return simulate(passing())


def test_a_run_keeps_clear_where_a_free_one_would_hit(flown: Run) -> None:
    """Half a millimetre is what lies between nodes; the distance that is logged is that of every tick."""
    of_post = [str(each).endswith(" - post") for each in flown["clearance/pair"]]
    free = simulate(passing({"clearance": None}))
    assert flown.summary().succeeded
    assert np.nanmin(flown["clearance/margin"]) > -1e-3
    assert np.nanmin(flown["clearance/distance"][:, of_post]) == pytest.approx(0.02, abs=1e-3)
    pairs = groups(flown.problem.spec, flown.problem.model, 0)["post"].pairs
    X = np.hstack([free["state/Q"], free["state/Qdot"]])
    apart = distance_rows(flown.problem.model, pairs).value(X, np.r_[0, POST["pose"]], rows=len(X))[0]
    assert apart.min() < -0.01


def test_nearest_points_are_as_far_apart_as_the_distance(flown: Run) -> None:
    points = flown["clearance/points"].reshape(len(flown.time), -1, 2, 3)
    distances = flown["clearance/distance"]
    apart = np.linalg.norm(points[:, :, 0] - points[:, :, 1], axis=-1)
    assert apart == pytest.approx(np.abs(distances), abs=1e-9)


def test_windows_are_replayed(flown: Run) -> None:
    sample = int(np.nanargmin(flown["clearance/distance"].min(axis=1)))
    assert replay(flown, sample).largest == 0.0


def test_without_clearance_nothing_is_kept_or_logged() -> None:
    run = simulate(passing({"clearance": None, "time_limit": 1}))
    assert "clearance/distance" not in run
    assert not any(name.startswith("clearance") for name in run.problem.stages[0].constraints)


@pytest.mark.parametrize("task", ["catch_drifting", "servicing"])
def test_jacobian_agrees_with_differences(task: str) -> None:
    changes = {
        "clearance": {},
        "obstacles": [{"name": "post", "shape": {"capsule": [0.1, 0.3]}, "pose": pose} for pose in [POSES[task]]],
    }
    problem = build_problem(load_task(task, changes))
    model = problem.model
    rng = np.random.default_rng(3)
    h = 1e-6
    for group in groups(problem.spec, model, 2).values():
        pairs = Pairs(group.pairs.pairs[:12], group.pairs.gripper)
        rows = distance_rows(model, pairs)
        x = np.r_[rng.uniform(-0.5, 0.5, model.n), np.zeros(model.n)]
        anchor = model.space.chart_at(model.neutral).anchor
        poses = [model.space.from_3d(rng.uniform(-1, 1, 3) * model.shape.reach, np.array([1.0, 0, 0, 0]))] * 2
        size = rows.value.function.size1_in(1)
        a = np.r_[anchor, 0, np.concatenate(poses)][:size]
        by_x = rows.gradients(np.tile(x, (rows.count, 1)), a, np.arange(rows.count))[:, : model.n]
        steps = h * np.eye(2 * model.n)[: model.n]
        differences = [(rows.value(x + step, a)[0] - rows.value(x - step, a)[0]).ravel() / (2 * h) for step in steps]
        assert by_x == pytest.approx(np.array(differences).T, abs=1e-7)


POSES = {"catch_drifting": [1, 1, 0], "servicing": {"position": [1, 1, 0]}}


def test_a_group_is_in_windows_while_the_plan_comes_near() -> None:
    problem = build_problem(passing())
    Q = np.r_[np.zeros(3), np.radians([60, 60, 0, -60, -60, 0])]
    near = np.r_[0.3, np.zeros(8)]
    beyond = np.r_[-2, np.zeros(8)]
    for step, is_near in ((near, True), (beyond, False)):
        X = np.hstack([np.array([Q + step, Q + step]), np.zeros((2, 9))])
        found = sampled(problem, 0, Q + step, prediction=(np.array([0.0, 4.0]), X))
        assert np.isfinite(found["clearance post"]).all() == is_near
    assert GROUP_ACTIVATION > 0.1


def test_an_obstacle_that_moves_is_at_every_node_where_it_is_then() -> None:
    task = passing({"obstacles": [{**POST, "velocity": [-0.1, 0.05]}]})
    problem = build_problem(task)
    Q = np.r_[np.zeros(3), np.radians([60, 60, 0, -60, -60, 0])]
    window = window_of(problem, Q, np.zeros(9))
    taken = window_numbers(window, np.array([1.0])).constraints[1]["clearance post"]
    since = 1.0 + 3.0 * np.arange(1, 26) / 25
    assert taken[:, 1:] == pytest.approx(np.array(POST["pose"]) + np.outer(since, [-0.1, 0.05, 0]))


@pytest.mark.slow
@pytest.mark.parametrize("hard", [False, True])
def test_a_start_inside_the_margin_leaves_it(hard: bool) -> None:
    inside = {"obstacles": [{**POST, "pose": [0.71, 0.433, 0]}], "clearance": {"margin": 0.05, "hard": hard}}
    stays = {"stages.fly.target.base": [0, 0, 0], "stages.fly.ends_when.hold": "4 s"}
    run = simulate(passing({**inside, **stays, "time_limit": 4}))
    margin = np.nanmin(run["clearance/margin"], axis=1)
    assert margin[0] < -1e-2
    assert np.all(np.diff(margin[:3]) > 0)
    assert margin[3:].min() > -1e-3


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 4])
def test_sqp_ends_where_ipopt_does_with_active_rows(seed: int) -> None:
    problem, window = near_post(seed)
    sqp = solved(problem, window, "sqp")
    assert sqp.outcome is Outcome.OPTIMAL and active_rows(problem, window, sqp.plan)
    ipopt = solved(problem, window, "ipopt", sqp.plan)
    assert ipopt.objective == pytest.approx(sqp.objective, rel=1e-5)


def test_parts_that_are_excepted_are_no_pairs() -> None:
    kept = build_problem(passing({"clearance": {"except": [["arm_1", "post"], ["base", "arm_2.3"]]}}))
    structures = [numbers.structure for numbers in kept.stages[0].constraints.values()]
    pairs = {name for structure in structures if isinstance(structure, Pairs) for name in structure.names}
    assert not any(first.startswith("arm_1") and second == "post" for first, second in pairs)
    assert ("base", "arm_2.3") not in pairs and ("base", "arm_1.3") in pairs


def test_points_of_a_pair_are_those_of_its_shapes() -> None:
    problem = build_problem(passing())
    (pairs,) = (group.pairs for name, group in groups(problem.spec, problem.model, 0).items() if name == "post")
    x = np.r_[np.zeros(3), np.radians([60, 60, 0, -60, -60, 0]), np.zeros(9)]
    found = nearest_points(problem.model, pairs)(x, np.r_[0, 1.1, 0.95, 0])[0].reshape(-1, 2, 3)
    assert np.linalg.norm(found[:, 1, :2] - [1.1, 0.95], axis=1) == pytest.approx(0.1)
