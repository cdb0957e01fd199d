import pytest

from psmpc_cli.specs.load import load_robot, load_task, parse_task
from psmpc_cli.specs.task import SkillWeights, SolverSpec, StageSpec, TaskSpec

TASK = load_task("transport").task_yaml
ROBOT = load_robot("planar_dual_arm").robot_yaml


def edited(old: str, new: str) -> TaskSpec:
    assert old in TASK
    return parse_task(TASK.replace(old, new), ROBOT, "transport").spec


def test_kind_alone_stands_for_a_mapping() -> None:
    assert SolverSpec.model_validate("ipopt") == SolverSpec(kind="ipopt")
    assert edited("solver: {kind: sqp}", "solver: ipopt").solver == SolverSpec(kind="ipopt")


def test_weights_stand_beside_control() -> None:
    flat = {"base": [1, 2, 3], "arms": [4, 5], "control": {"base": [1, 1, 1], "arms": [2, 2]}}
    weights = SkillWeights.model_validate(flat)
    assert weights.parts == {"base": (1, 2, 3), "arms": (4, 5)}
    assert weights.control == {"base": (1, 1, 1), "arms": (2, 2)}
    assert SkillWeights.model_validate({"base": [1, 2, 3]}).control == 1.0


def test_task_is_the_same_after_a_round_trip_through_plain_data() -> None:
    spec = load_task("transport").spec
    assert TaskSpec.model_validate(spec.model_dump()) == spec
    assert TaskSpec.model_validate_json(spec.model_dump_json()) == spec


def test_one_name_alone_is_a_list() -> None:
    assert edited("coordinates: [base]", "coordinates: base") == load_task("transport").spec
    assert load_task("transport").spec.stages[0].onset == ("base",)


def test_tolerance_may_be_given_by_part() -> None:
    spec = edited("tolerance: 0.05", "tolerance: {base: 0.05, arms: [0.05, 0.05, 3 deg]}")
    ends_when = spec.stages[3].ends_when
    assert ends_when is not None
    assert isinstance(ends_when.tolerance, dict)
    assert ends_when.tolerance["base"] == (0.05,)
    assert ends_when.tolerance["arms"] == pytest.approx((0.05, 0.05, 0.05235987755982989))


def test_words_of_yaml_1_1_stay_texts() -> None:
    assert edited("description: On-orbit transport with four stages", "description: no").description == "no"


@pytest.mark.parametrize("name", ["object held", "capture", "Ziel_1", "抓取", "a-b (c)"])
def test_names_may_have_spaces_and_any_letters(name: str) -> None:
    assert StageSpec.model_validate({"name": name, "skill": "s", "target": {}}).name == name
