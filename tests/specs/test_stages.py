"""What a task file may say of skills and stages, and the shorter ways to say it."""

from pathlib import Path

import pytest

from psmpc_cli.errors import SpecError
from psmpc_cli.specs.load import load_task, parse_task
from psmpc_cli.specs.stages import EndCondition, SkillWeights
from psmpc_cli.specs.task import TaskSpec

from ..plumed import FOLDED, before_a_panel

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


def test_tolerance_may_be_given_by_part() -> None:
    ends_when = edited("tolerance: 0.012", "tolerance: {base: 0.05, arms: [0.05, 0.05, 3 deg]}").stages[3].ends_when
    assert ends_when is not None and isinstance(ends_when.tolerance, dict)
    assert ends_when.tolerance["base"] == (0.05,)
    assert ends_when.tolerance["arms"] == pytest.approx((0.05, 0.05, 0.05235987755982989))


@pytest.mark.parametrize(("written", "seconds"), [("2 s", 2), ("0.5s", 0.5), (1.5, 1.5), (0, 0)])
def test_a_condition_may_have_to_hold(written: object, seconds: float) -> None:
    assert EndCondition.model_validate({"coordinates": "all", "hold": written}).hold == seconds


def test_plumes_of_a_stage_count_before_those_of_its_skill_and_of_the_task(tmp_path: Path) -> None:
    stage = {"skill": "move", "target": {"base": [0, 0, 0], **FOLDED}, "at": 1}
    last = {**stage, "name": "last", "ends_when": {"coordinates": "base"}, "at": None}
    weights = {"base": [1, 1, 1], "arms": [1, 1, 1]}
    skills = {"move": {"space": "joint", "weights": weights}}
    skills["free"] = {**skills["move"], "mobility": "free-floating"}
    skills["near"] = {**skills["move"], "plumes": "ignored"}
    stages = [
        {**stage, "name": "as the task"},
        {**stage, "name": "as the skill", "skill": "near", "at": 2},
        {**stage, "name": "by itself", "skill": "near", "plumes": "avoided", "at": 3},
        {**stage, "name": "off", "skill": "free", "at": 4},
        {**last, "plumes": "ignored"},
    ]
    stages[-1].pop("at")
    task = before_a_panel(tmp_path, skills=skills, stages=stages)
    avoided = [task.spec.avoids_plumes(index, task.robot) for index in range(5)]
    assert avoided == [True, False, True, False, False]


def test_plumes_are_avoided_where_there_is_something_to_keep_them_off(tmp_path: Path) -> None:
    with pytest.raises(
        SpecError, match="expected ignored, or an object with a mass, or obstacles: there is nothing"
    ) as raised:
        before_a_panel(tmp_path, obstacles=None)
    assert str(raised.value).count("expected") == 1
    assert before_a_panel(tmp_path, obstacles=None, plumes="ignored").spec.plumes == "ignored"
