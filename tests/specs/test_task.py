"""What a task file may say, and the shorter ways to say it."""

from pathlib import Path
from typing import Any

import pytest

from psmpc_cli.errors import SpecError
from psmpc_cli.specs.load import load_task, parse_task
from psmpc_cli.specs.task import AS_PRINTED, ControllerSpec, EndCondition, SkillWeights, TaskSpec

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


def test_as_printed_sets_the_keys_of_the_controllers_departures() -> None:
    changes = {"controller": {"as_printed": True, "horizon": 3.0}}
    spec = load_task("transport", changes).spec.controller
    assert {key: getattr(spec, key) for key in AS_PRINTED} == {
        "normalization": "range",
        "normalization_at": "nodes",
        "pending_cost": 0.0,
        "discretization": "euler",
        "detection_margin": 1.0,
    }
    assert spec.horizon == 3.0
    assert ControllerSpec.model_validate(spec.model_dump()) == spec
    one_by_one = load_task("transport", {"controller": {**AS_PRINTED, "horizon": 3.0}}).spec.controller
    assert one_by_one.model_copy(update={"as_printed": True}) == spec
    assert load_task("transport", {"controller.as_printed": False}).digest == load_task("transport").digest


@pytest.mark.parametrize("value", ["own", "as_printed"])
@pytest.mark.parametrize("key", AS_PRINTED)
def test_a_key_that_as_printed_sets_is_not_given_beside_it(key: str, value: str) -> None:
    given = AS_PRINTED[key] if value == "as_printed" else getattr(ControllerSpec(), key)
    controller: dict[str, Any] = {"as_printed": True, key: given}
    with pytest.raises(SpecError) as caught:
        load_task("transport", {"controller": controller})
    message = str(caught.value)
    assert f'controller.{key}: found "{key}" beside as_printed: true' in message
    assert f"as_printed sets {key} to {AS_PRINTED[key]}" in message
    assert len(message.splitlines()) == 1


@pytest.mark.parametrize("kind", ["psmpc", "htmpc"])
def test_by_controller_gives_no_key_beside_as_printed_either(kind: str) -> None:
    with pytest.raises(SpecError, match=r"by_controller.*found \"pending_cost\" beside as_printed: true"):
        load_task("transport_as_printed", {"by_controller": {kind: {"controller.pending_cost": 1}}})


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
