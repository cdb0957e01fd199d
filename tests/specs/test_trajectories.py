import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from psmpc_cli.specs.coordinates import stack_rows
from psmpc_cli.specs.load import Task, load_robot, load_task, parse_task
from psmpc_cli.specs.task import StageSpec, TaskSpec, TrajectorySpec

ROBOT = load_robot("planar_dual_arm")
FOLLOW = """\
robot: planar_dual_arm
initial: {base: [0, 0, 0], arms: [0, 0, 0]}
skills: {move: {space: joint, weights: {base: [1, 1, 1], arms: [1, 1, 1]}}}
stages:
  - name: follow
    skill: move
    target:
      {times: [0, 4], base: [[0, 0, 0], [0.5, 0, 30 deg]], arm_1: [[0, 0, 0], [1, 2, 3]], arms: [[0, 0, 0], [4, 5, 6]]}
    ends_when: {coordinates: base}
"""


def follow(text: str = FOLLOW) -> Task:
    return parse_task(text, ROBOT.robot_yaml, "follow")


def test_parts_stand_beside_times() -> None:
    target = follow().spec.stages[0].target
    assert isinstance(target, TrajectorySpec)
    assert target.times == (0, 4)
    assert target.parts["base"] == ((0, 0, 0), (0.5, 0, math.radians(30)))


def test_rows_are_stacked_in_the_order_of_q_an_arms_own_before_those_of_all() -> None:
    target = follow().spec.stages[0].target
    assert isinstance(target, TrajectorySpec)
    rows = stack_rows(target, ROBOT.spec, "joint")
    np.testing.assert_allclose(rows, [np.zeros(9), [0.5, 0, math.radians(30), 1, 2, 3, 4, 5, 6]])


def test_task_is_the_same_after_a_round_trip_through_plain_data() -> None:
    spec = load_task("tracking").spec
    assert TaskSpec.model_validate(spec.model_dump()) == spec
    assert TaskSpec.model_validate_json(spec.model_dump_json()) == spec
    target = spec.stages[1].target
    assert StageSpec(name="again", skill="follow", target=target).target == target


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 16), st.sampled_from(["base", "arm_1", "arm_2"]), st.integers(0, 2), st.floats(-1e3, 1e3))
def test_one_number_is_overridden_and_the_effective_text_keeps_it(
    moment: int, part: str, axis: int, value: float
) -> None:
    task = load_task("tracking", [f"stages.trace.target.{part}[{moment}][{axis}]={value!r}"])
    target = task.spec.stages[1].target
    assert isinstance(target, TrajectorySpec)
    assert target.parts[part][moment][axis] == value
    again = parse_task(task.task_yaml, task.robot_yaml, task.spec.name)
    assert (again.spec, again.digest) == (task.spec, task.digest)


@pytest.mark.parametrize("dwell", ["", "\n    dwell: 3"])
def test_instant_must_come_after_the_trajectory(dwell: str) -> None:
    rest = "  - {name: rest, skill: move, target: {base: [0, 0, 0], arms: [0, 0, 0]}, ends_when: {coordinates: all}}\n"
    text = FOLLOW.replace("ends_when: {coordinates: base}", f"at: 5{dwell}") + rest
    assert follow(text).spec.stages[0].at == 5
    with pytest.raises(Exception, match=r"found 3.5 s, expected a time after 4 s \(trajectory after the start\)"):
        follow(text.replace("at: 5", "at: 3.5"))
