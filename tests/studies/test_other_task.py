from pathlib import Path

import pytest

from psmpc_cli.logs.results import Results
from psmpc_cli.specs.load import Task, load_task
from psmpc_cli.studies.other_task import difference

CHANGES = ("controller.nodes=25", "controller.kind=smpc", "seed=3", "stages.capture.priority=5", "uncertainty.mass=0.1")


def results_of(task: Task, **attributes: str) -> Results:
    texts = {"task_name": task.spec.name, "task_yaml": task.task_yaml, "robot_yaml": task.robot_yaml}
    return Results(Path("study.h5"), {**texts, **attributes}, {})


def said(*changes: str, **attributes: str) -> str:
    """What is said of the file of the transport task if that task is meant with changes."""
    return difference(results_of(load_task("transport"), **attributes), load_task("transport", changes))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("controller.nodes=25", "found controller.nodes 100, this one has 25"),
        ("controller.kind=smpc", 'found controller.kind "psmpc", this one has "smpc"'),
        ("stages.capture.priority=5", "found stages[1].priority 100.0, this one has 5.0"),
        ("monitors=[]", "found monitors a list of 1 entry, this one has []"),
        ("controller.soft_limits=true", "found controller.soft_limits nothing, this one has true"),
    ],
)
def test_a_key_is_named_with_both_values(change: str, words: str) -> None:
    assert said(change).startswith(words)


def test_a_task_of_another_name_is_named() -> None:
    task = load_task("approach_capture")
    words = 'found the task "transport", this one is "approach_capture"'
    assert difference(results_of(load_task("transport")), task) == words


def test_of_many_keys_a_few_are_named_and_the_others_counted() -> None:
    words = said(*CHANGES)
    assert words.count("this one has") == 3
    assert words.endswith("; and 2 more keys differ")
    assert said(*CHANGES[:4]).endswith("; and 1 more key differs")


def test_keys_of_the_robot_are_named() -> None:
    task = load_task("transport")
    heavier = task.robot_yaml.replace("mass: 30, inertia", "mass: 31, inertia", 1)
    assert heavier != task.robot_yaml
    words = difference(results_of(task, robot_yaml=heavier), task)
    assert words == "found robot.base.mass 31.0, this one has 30.0"


def test_a_task_that_no_longer_holds_is_said_to_be_one() -> None:
    assert said(task_yaml="nonsense: 1") == 'found a task "transport" that does not hold in this version'
