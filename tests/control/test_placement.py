"""Where a sample places the targets of stages: on an object that moves."""

from dataclasses import replace

import numpy as np
import pytest

from psmpc_cli.control import Controller, State
from psmpc_cli.ocp.end import ByState
from psmpc_cli.ocp.problem import build_problem
from psmpc_cli.ocp.stage import PlaceOnObject
from psmpc_cli.robot.configuration import SPACE
from psmpc_cli.robot.free_body import FreeBody
from psmpc_cli.specs.load import load_task
from psmpc_cli.specs.robots.robot import stack

from ..ocp.transport_windows import sequence_of

DRIFTING = load_task("catch_drifting", {"controller.nodes": 12})


OBJECT = DRIFTING.spec.body


def test_targets_follow_the_object() -> None:
    """Before their stage is seen they are where the object will be at the end of the horizon."""
    everywhere = ByState(rows=tuple(range(9)), tolerance=np.ones(9), rate_tolerance=np.ones(9))
    problem = build_problem(DRIFTING)
    approach, capture, *later = problem.stages
    problem = replace(problem, stages=(approach, replace(capture, end=everywhere), *later))
    controller = Controller(problem)
    Q = stack(DRIFTING.spec.initial, DRIFTING.robot, "joint")
    pose = np.array([-2.4, 2.8, 0.5])
    stages = controller.step(0.0, State(Q, np.zeros(9)), pose).stages
    angle = 0.5 + (np.radians(30) - 0.5) / 2 + np.radians(2) * 4  # half of what is measured corrects the angle
    found = stages[1].target[problem.model.pose_rows["arm_1"]]
    assert found[2] == pytest.approx(angle + np.radians(135))
    grip = 0.6415 * np.array([np.cos(angle), np.sin(angle)])
    assert found[:2] == pytest.approx(grip + np.array([(-2.4 - 2.489) / 2 + 0.08, (2.8 + 2.847) / 2]))
    drift = stages[1].end.target_rates
    assert drift[3:6] == pytest.approx([0.02 - np.radians(2) * grip[1], np.radians(2) * grip[0], np.radians(2)])
    x = np.concatenate([Q, np.zeros(9)])
    at_rest = replace(stages[1], end=everywhere)
    apart = problem.costs.ends(at_rest, x[None]) - problem.costs.ends(stages[1], x[None])
    assert apart[0] == pytest.approx([*np.zeros(9), *drift])


BESIDE = {"object": [0, -0.978, 0]}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("stage", "keys"),
    [(0, {"controller.kind": "hard"}), (0, {"controller.kind": "htmpc"}), (3, {"stages.release.target.base": BESIDE})],
)
def test_cost_follows_the_object_where_no_end_is_planned(stage: int, keys: dict[str, object]) -> None:
    task = load_task("catch_drifting", {"controller.nodes": 12, **keys})
    controller, pose_rows = Controller(task), build_problem(task).model.pose_rows
    controller.memory = replace(controller.memory, sequence=sequence_of(stage, entered=-1.5))
    state = State(stack(task.spec.initial, task.robot, "joint"), np.zeros(9))
    stages = controller.step(0.0, state, np.array(OBJECT.pose)).stages
    since = np.array([0.0, 2.03, 4.0])
    found = stages[stage].wanted(1.5 + since)[:, pose_rows["base"]]
    angle = np.radians(30 + 2 * since)
    beside = np.stack([0.02 * since - 2.489 + 0.978 * np.sin(angle), 2.847 - 0.978 * np.cos(angle)], axis=1)
    assert found == pytest.approx(np.c_[beside, angle], abs=1e-5)
    assert stages[stage].target[pose_rows["base"]] == pytest.approx(found[0])


def test_a_target_is_where_the_object_will_be_at_the_planned_end_of_a_stage_that_continues() -> None:
    task = load_task(
        "catch_drifting", {"controller.nodes": 12, "controller.kind": "hard", "controller.one_stage": "free_end"}
    )
    controller = Controller(task)
    pose_rows = build_problem(task).model.pose_rows
    state = State(stack(task.spec.initial, task.robot, "joint"), np.zeros(9))
    for sequence, ahead in (
        (sequence_of(0, entered=-1.5), 4.0),
        (replace(sequence_of(0, [2.0], -1.5), segments=(0, 0)), 2.0),
    ):
        controller.memory = replace(controller.law.first, sequence=sequence)
        stage = controller.step(0.0, state, np.array(OBJECT.pose)).stages[0]
        angle = np.radians(30 + 2 * ahead)
        beside = [0.02 * ahead - 2.489 + 0.978 * np.sin(angle), 2.847 - 0.978 * np.cos(angle), angle]
        assert not stage.reference.moves
        assert stage.target[pose_rows["base"]] == pytest.approx(beside, abs=1e-5)


def test_cost_follows_an_object_that_tumbles() -> None:
    problem, inside = build_problem(load_task("servicing")), np.array([0.6, 0.1, 0.2, 0.5, 0.5, -0.5, 0.5])
    body, state = FreeBody(20.0, [2.0, 3.0, 4.0]), np.array([1, 2, 3, 1, 0, 0, 0, 0.02, 0, 0.01, 0.1, -0.05, 0.2])
    stage = replace(problem.stages[1], on_object={"left": PlaceOnObject(body, inside)})
    found = stage.unplaced_copy().following(body, state, 1.5, 4.0)
    wanted = SPACE.composed(body.predicted(state[:7], state[7:], 2.53)[0], inside)
    assert found.wanted(np.array([4.03]))[0, problem.model.pose_rows["left"]] == pytest.approx(wanted, abs=1e-4)
    assert (found.target == stage.unplaced_copy().at_object(state[:7], state[7:]).target).all()


def test_a_stage_that_is_seen_to_end_soon_has_its_target_where_the_object_is_then() -> None:
    """The robot rests where the object will be at the end of the horizon, which is not where it is by now."""
    changes = {"object.pose": [0.5, 2.0, 0], "object.motion": {"linear": [0.02, 0], "angular": 0}}
    task = load_task("catch_drifting", {"controller.nodes": 12, "initial.base": [0.58, 2.0 - 0.978, 0], **changes})
    problem = build_problem(task)
    state = State(stack(task.spec.initial, task.robot, "joint"), np.zeros(9))
    stages = Controller(problem).step(0.0, state, np.array([0.5, 2.0, 0.0])).stages
    assert stages[0].target[problem.model.pose_rows["base"]] == pytest.approx([0.5, 1.022, 0], abs=2e-3)
