"""What a task file may say, and the shorter ways to say it."""

import pytest

from psmpc_cli.specs.load import load_task, parse_task
from psmpc_cli.specs.task import EndCondition, SkillWeights, TaskSpec

TASK = load_task("transport").task_yaml


ROBOT = load_task("transport").robot_yaml


def edited(old: str, new: str) -> TaskSpec:
    assert old in TASK
    return parse_task(TASK.replace(old, new), ROBOT, "transport").spec


def test_weights_are_beside_control() -> None:
    flat = {"base": [1, 2, 3], "arms": [4, 5], "control": {"base": [1, 1, 1], "arms": [2, 2]}}
    weights = SkillWeights.model_validate(flat)
    assert weights.parts == {"base": (1, 2, 3), "arms": (4, 5)}
    assert weights.control == {"base": (1, 1, 1), "arms": (2, 2)}
    assert SkillWeights.model_validate({"base": [1, 2, 3]}).control == 1.0


def test_task_is_the_same_after_a_round_trip_through_plain_data() -> None:
    obstacles = [{"name": "post", "shape": {"box": [1, 2]}, "pose": [4, 4, "30 deg"], "velocity": [0.1, 0]}]
    clear = {"obstacles": obstacles, "clearance": {"except": [["arm_1", "post"]]}}
    for changes in ({}, clear):
        spec = load_task("transport", {"by_controller": {}, **changes}).spec
        assert TaskSpec.model_validate(spec.model_dump()) == spec
        assert TaskSpec.model_validate_json(spec.model_dump_json()) == spec


def test_tolerance_may_be_given_by_part() -> None:
    ends_when = edited("tolerance: 0.012", "tolerance: {base: 0.05, arms: [0.05, 0.05, 3 deg]}").stages[3].ends_when
    assert ends_when is not None and isinstance(ends_when.tolerance, dict)
    assert ends_when.tolerance["base"] == (0.05,)
    assert ends_when.tolerance["arms"] == pytest.approx((0.05, 0.05, 0.05235987755982989))


@pytest.mark.parametrize(("written", "seconds"), [("2 s", 2), ("0.5s", 0.5), (1.5, 1.5), (0, 0)])
def test_a_condition_may_have_to_hold(written: object, seconds: float) -> None:
    assert EndCondition.model_validate({"coordinates": "all", "hold": written}).hold == seconds
