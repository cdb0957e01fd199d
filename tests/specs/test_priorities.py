import pytest

from psmpc_cli.errors import SpecError
from psmpc_cli.specs.load import Task, load_robot, load_task, parse_task
from psmpc_cli.specs.task import TaskSpec

ROBOT = load_robot("planar_dual_arm").robot_yaml
NUMBERS = load_task("transport").task_yaml
UNRATED = "\n".join(line for line in NUMBERS.splitlines() if not line.startswith("    priority:")) + "\n"


def compared(*comparisons: str) -> Task:
    text = UNRATED + f"priorities: {{compare: [{', '.join(comparisons)}]}}\n"
    return parse_task(text, ROBOT, "transport")


def omegas(spec: TaskSpec) -> list[float]:
    return [stage.priority for stage in spec.stages]


PAPER = ("[capture, approach, 100]", "[transport, approach, 1]", "[transport, release, 100]")


def test_comparisons_become_the_stages_priorities() -> None:
    assert omegas(compared(*PAPER).spec) == [1, 100, 1, 0.01]


def test_task_is_the_one_with_the_numbers_but_for_where_they_are_from() -> None:
    spec = compared(*PAPER).spec
    assert spec.model_copy(update={"priorities": None}) == load_task("transport").spec


def test_the_first_stage_has_priority_1_whichever_stages_are_compared() -> None:
    found = omegas(compared("[capture, transport, 50]", "[release, transport, 0.1]", "[transport, approach, 2]").spec)
    assert found == pytest.approx([1, 100, 2, 0.2])


def test_redundant_comparisons_are_balanced() -> None:
    found = omegas(compared(*PAPER, "[capture, transport, 200]").spec)
    assert found == pytest.approx([1, 100 * 2 ** (1 / 3), 0.5 ** (1 / 3), 0.01 * 0.5 ** (1 / 3)])


def test_effective_text_and_plain_data_hold_the_comparisons_and_the_same_task() -> None:
    task = compared(*PAPER)
    again = parse_task(task.task_yaml, task.robot_yaml, task.spec.name)
    assert (again.spec, again.digest) == (task.spec, task.digest)
    assert TaskSpec.model_validate(task.spec.model_dump()) == task.spec
    assert TaskSpec.model_validate_json(task.spec.model_dump_json()) == task.spec


def test_overrides_change_comparisons_and_the_text_that_ran_says_so() -> None:
    task = load_task("tracking", ["priorities.compare[1]=[unfold, stow, 4]"])
    assert omegas(task.spec) == [1, 100, 0.25]
    assert parse_task(task.task_yaml, task.robot_yaml, task.spec.name).spec == task.spec


def test_numbers_take_the_place_of_comparisons_that_are_taken_away() -> None:
    task = load_task("tracking", ["priorities=", "stages.trace.priority=7"])
    assert omegas(task.spec) == [1, 7, 1]
    assert parse_task(task.task_yaml, task.robot_yaml, task.spec.name).spec == task.spec


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("stages.trace.priority=7", 'stages[1].priority: found "priority" at a stage and "priorities" in the task'),
        ("priorities.compare[0][2]=0", "priorities.compare[0][2]: found 0, expected a number greater than 0"),
        ("priorities.compare[0]=[trace, unfolt, 9]", "priorities.compare[0][1]: found no such stage (did you mean"),
        (
            "priorities.compare=[[trace, unfold, 2], [stow, trace, 2], [stow, unfold, 100]]",
            'priorities.compare[2][2]: found "stow" to be 100 times as important as "unfold", expected about 4, '
            "which the other comparisons imply (consistency ratio 1.11, acceptable up to 0.1)",
        ),
        (
            "priorities.compare=[[trace, unfold, 2]]",
            "priorities.compare: found nothing that compares unfold, trace with stow, expected comparisons that",
        ),
    ],
)
def test_wrong_comparisons_are_refused_as_they_were_given(override: str, message: str) -> None:
    with pytest.raises(SpecError) as raised:
        load_task("tracking", [override])
    assert str(raised.value).startswith(f"--set {override}: {message}")


def test_stages_that_share_a_name_are_not_weighed() -> None:
    text = UNRATED.replace("name: capture", "name: approach") + "priorities: {compare: [[approach, transport, 2]]}\n"
    with pytest.raises(SpecError, match="expected a name of its own") as raised:
        parse_task(text, ROBOT, "transport")
    assert "priorities" not in str(raised.value)
