"""Stages that follow a route: planned where the straight motion is blocked, followed by sight, then as ever."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from psmpc_cli.control.identification.tracking import NO_OBJECT
from psmpc_cli.control.interface import State
from psmpc_cli.control.routes.guidance import RouteGuide, RouteProgress
from psmpc_cli.errors import SpecError
from psmpc_cli.logs.run import Run
from psmpc_cli.ocp.feasibility.checks import remarks
from psmpc_cli.ocp.feasibility.forecast import forecast_stages
from psmpc_cli.ocp.feasibility.postures import reasons_unforeseen
from psmpc_cli.ocp.problem import Problem, build_problem
from psmpc_cli.simulation.replay import replay
from psmpc_cli.simulation.run import simulate
from psmpc_cli.specs.load import Task, load_task

FOLDED = {"arm_1": ["60 deg", "60 deg", 0], "arm_2": ["-60 deg", "-60 deg", 0]}
POST = {"name": "post", "shape": {"sphere": 0.15}, "pose": [0.9, 0.7, 0]}


def past_a_post(changes: Mapping[str, Any] | None = None) -> Task:
    """A planar robot flies past a post that is in its arm's way, then unfolds an arm."""
    ends = {"coordinates": ["all"], "tolerance": 0.01}
    unfolded = {**FOLDED, "arm_1": ["30 deg", "30 deg", 0]}
    task = {
        "robot": "planar_dual_arm",
        "initial": {"base": [0, 0, 0], **FOLDED},
        "controller": {"nodes": 15},
        "skills": {
            "move": {"space": "joint", "weights": {"base": [100, 100, 10], "arms": [10, 10, 1], "control": 0.1}}
        },
        "limits": {"base": {"acceleration": [0.2, 0.2, 0.5]}, "arms": {"acceleration": [1, 1, 1]}},
        "obstacles": [POST],
        "clearance": {"margin": 0.02},
        "routes": {"iterations": 500},
        "stages": [
            {"name": "fly", "skill": "move", "target": {"base": [1.8, 0, 0], **FOLDED}, "ends_when": ends},
            {"name": "unfold", "skill": "move", "target": {"base": [1.8, 0, 0], **unfolded}, "ends_when": ends},
        ],
        "time_limit": 30,
        "log": {"shares": False},
    }
    return load_task(task, changes or {})


@pytest.fixture(scope="module")
def problem() -> Problem:
    return build_problem(past_a_post())


@pytest.fixture(scope="module")
def guide(problem: Problem) -> RouteGuide:
    return RouteGuide(problem)


@pytest.fixture(scope="module")
def flown() -> Run:
    return simulate(past_a_post())


def test_a_blocked_stage_has_a_route_and_a_clear_one_has_none(guide: RouteGuide) -> None:
    assert list(guide.routes) == [0] and not guide.blocked
    waypoints = guide.routes[0].route.waypoints
    assert waypoints[0] == pytest.approx(np.r_[0, 0, 0, np.radians([60, 60, 0, -60, -60, 0])])
    assert waypoints[-1] == pytest.approx(np.r_[1.8, 0, 0, np.radians([60, 60, 0, -60, -60, 0])])


def test_a_robot_sees_further_along_its_route_as_it_flies(guide: RouteGuide) -> None:
    route = guide.routes[0].route
    before = RouteProgress()
    for share in (0.0, 0.3, 0.6, 0.9, 0.95):
        state = State(route.configurations_at(np.array([share]))[0], np.zeros(9))
        now = guide.updated_progress(before, 0, 1.0, state, NO_OBJECT)
        assert now.progress[0] >= max(before.progress.get(0, 0.0), share - 1e-9)
        assert (0 in now.waypoints) == (now.progress[0] < 1)
        before = now
    back = guide.updated_progress(before, 0, 2.0, State(route.waypoints[0], np.zeros(9)), NO_OBJECT)
    assert back.progress[0] == before.progress[0], "it never moves back"


@pytest.mark.slow
def test_a_mission_round_a_post_succeeds_and_touches_nothing(flown: Run) -> None:
    alone = simulate(past_a_post({"routes": None}))
    assert flown.summary().succeeded
    assert np.nanmin(flown["clearance/margin"]) > -2e-3
    assert not alone.summary().succeeded


def test_no_stage_enters_the_window_while_the_current_one_is_on_its_route(flown: Run) -> None:
    follows = on_route(flown)
    assert follows[0] and not follows[-1]
    np.testing.assert_array_equal(follows, flown["route/progress"] < 1)
    assert np.all(flown["window/count"][follows & (flown["window/first"] == 0)] == 1)


def on_route(run: Run) -> np.ndarray:
    """Whether the current stage follows its route, by sample: records of windows end with the points followed."""
    records = zip(run["plan/parameters"], run["plan/parameters_length"], strict=True)
    return np.array([bool(np.isfinite(record[length - 9 : length]).all()) for record, length in records])


def test_after_the_route_the_run_is_one_without_obstacles(flown: Run) -> None:
    first = int(np.flatnonzero(on_route(flown))[-1]) + 1
    state = {name: np.split(flown[f"state/{name}"][first], [3, 6]) for name in ("Q", "Qdot")}
    starts = {name: dict(zip(("base", "arm_1", "arm_2"), parts, strict=True)) for name, parts in state.items()}
    changes = {"initial": starts["Q"], "initial_velocity": starts["Qdot"]}
    plain = {key: {part: row.tolist() for part, row in parts.items()} for key, parts in changes.items()}
    rest = simulate(past_a_post({"routes": None, "clearance": None, "obstacles": [], **plain}))
    left = flown.stages["switch_time"] - flown.time[first]
    assert rest.stages["switch_time"] == pytest.approx(left, abs=0.05)


def test_windows_on_a_route_are_replayed(flown: Run) -> None:
    assert replay(flown, 3).largest == 0.0
    assert replay(flown, len(flown.time) - 3).largest == 0.0


def test_the_same_seed_gives_the_same_route(problem: Problem, guide: RouteGuide) -> None:
    again = RouteGuide(problem).routes[0].route.waypoints
    np.testing.assert_array_equal(again, guide.routes[0].route.waypoints)


def test_a_stage_without_a_way_is_named(caplog: pytest.LogCaptureFixture) -> None:
    wall = {"name": "wall", "shape": {"half_space": [-1, 0]}, "pose": [0.9, 0, 0]}
    found = RouteGuide(build_problem(past_a_post({"obstacles": [wall]})))
    assert found.blocked and not found.routes
    assert "found no route to the target of fly" in caplog.text


@pytest.mark.parametrize("velocity", [[0.0, 0.0], [0.02, 0.0]])
def test_a_stage_has_no_route_round_what_moves(caplog: pytest.LogCaptureFixture, velocity: list[float]) -> None:
    """Planned as if it stood still, a route would lead where nothing is known to be clear."""
    task = past_a_post({"obstacles": [{**POST, "velocity": velocity}]})
    found = RouteGuide(build_problem(task))
    moves = any(velocity)
    assert bool(found.routes) != moves
    assert ("no route to the target of fly: obstacle post moves" in caplog.text) == moves
    messages = [fault.message for fault in remarks(task, forecast_stages(task))]
    assert any('"fly", where obstacle post moves' in message for message in messages) == moves


def test_an_object_that_moves_leaves_routes_from_where_it_is_held_on() -> None:
    """Retract begins where the object was taken, wherever that is; of what follows all places are known."""
    task = load_task("catch_drifting", {"routes": {"iterations": 500}, "clearance": {}})
    stages = build_problem(task).stages
    names = [stages[index].name for index in reasons_unforeseen(task.spec, stages)]
    assert names == [stage.name for stage in stages[: task.spec.held_stages.start + 1]]
    assert reasons_unforeseen(load_task("transport_grasp").spec, stages) == {}


@pytest.mark.slow
def test_while_an_object_is_held_the_base_alone_is_routed() -> None:
    changes = {
        "controller.nodes": 12,
        "obstacles": [{"name": "debris", "shape": {"sphere": 0.2}, "pose": [-1.2, 1.8, 0]}],
        "clearance": {},
        "routes": {"iterations": 500},
    }
    found = RouteGuide(build_problem(load_task("transport_grasp", changes)))
    transport = found.routes[2].route.waypoints
    assert np.ptp(transport[:, :3], axis=0).max() > 0.1
    assert np.ptp(transport[:, 3:], axis=0).max() == 0


def test_a_floating_base_has_no_routes() -> None:
    with pytest.raises(SpecError, match="the base moves as the arms move it"):
        past_a_post({"mobility": "free-floating", "limits": {}})
