from copy import copy
from pathlib import Path

import numpy as np
import pytest

from psmpc_cli.errors import InputError
from psmpc_cli.logs.run import read_comparison, read_run
from psmpc_cli.logs.summary import Summary
from psmpc_cli.simulation.run import simulate
from psmpc_cli.specs.load import Task, load_task
from psmpc_cli.studies.compare import (
    CONTROLLERS,
    compare,
    compared_tasks,
    describe_terms,
    recommend_controller,
    run_tasks,
)

from ..short_runs import TASK, there_and_back


@pytest.fixture
def reference(tmp_path: Path) -> str:
    path = tmp_path / "task.yaml"
    path.write_text(TASK)
    return str(path)


@pytest.fixture
def tasks(reference: str) -> dict[str, Task]:
    return compared_tasks(reference, ("smpc", "hard"), ["log.plans=false"])


def test_tasks_differ_in_the_controller_alone(reference: str) -> None:
    tasks = compared_tasks(reference, CONTROLLERS, ["controller.nodes=7", "plant.kind=rk4"])
    assert [task.spec.controller.kind for task in tasks.values()] == list(CONTROLLERS)
    alike = []
    for task in tasks.values():
        controller = task.spec.controller.model_copy(update={"kind": "psmpc", "one_stage": "as_published"})
        alike.append(task.spec.model_copy(update={"controller": controller}))
    assert all(spec == alike[0] for spec in alike)
    assert (alike[0].controller.nodes, alike[0].plant.kind) == (7, "rk4")


OWN = """\
by_controller:
  hard: {skills.move.weights.control: 0.05, "stages[0].ends_when.tolerance": 0.01, solver.max_iterations: 150}
  htmpc:
    stages.go.ends_when.tolerance: 0.01
    limits.base.velocity: [0.15, 0.15, 0.1]
    controller.one_stage: as_published
  smpc: {stages.go.priority: 3}
"""


@pytest.fixture
def with_own_settings(tmp_path: Path) -> str:
    path = tmp_path / "own.yaml"
    path.write_text(TASK + OWN)
    return str(path)


def test_controllers_are_compared_on_equal_terms(with_own_settings: str) -> None:
    """Weights, tolerances and limits are those of the task; how a controller and its solver work stays its own."""
    tasks = {name: task.spec for name, task in compared_tasks(with_own_settings, CONTROLLERS).items()}
    asked_for = [
        [getattr(spec, name) for name in ("skills", "stages", "limits", "monitors", "object", "plant")]
        for spec in tasks.values()
    ]
    assert all(each == asked_for[0] for each in asked_for)
    ends = {name: spec.controller.one_stage for name, spec in tasks.items() if spec.controller.traits.one_stage}
    assert ends == {"hard": "free_end", "htmpc": "as_published"}  # the task says so of htmpc
    assert (tasks["hard"].solver.max_iterations, tasks["htmpc"].solver.max_iterations) == (150, 200)
    published = compared_tasks(with_own_settings, CONTROLLERS, ["controller.one_stage=as_published"])
    assert published["hard"].spec.controller.one_stage == "as_published"


def test_own_settings_are_those_of_a_run_alone(with_own_settings: str) -> None:
    for name, task in compared_tasks(with_own_settings, CONTROLLERS, own_settings=True).items():
        assert task.digest == load_task(with_own_settings, {"controller.kind": name}).digest


def test_the_built_in_transport_is_compared_on_equal_terms() -> None:
    tasks = compared_tasks("transport", CONTROLLERS)
    control = {name: task.spec.skills["move"].weights.control for name, task in tasks.items()}
    assert control == dict.fromkeys(CONTROLLERS, load_task("transport").spec.skills["move"].weights.control)
    assert (
        tasks["psmpc"].spec.model_copy(update={"by_controller": {}})
        == load_task("transport", {"by_controller": {}}).spec
    )


@pytest.mark.parametrize(
    ("own_settings", "sentence"),
    [
        (False, "terms: the same weights, tolerances and limits; hard with a free end; htmpc without a planned end"),
        (True, "terms: not equal: limits and skills and stages of the controllers differ (by_controller of the task)"),
    ],
    ids=["equal", "own"],
)
def test_a_comparison_says_on_which_terms_it_is(with_own_settings: str, own_settings: bool, sentence: str) -> None:
    tasks = compared_tasks(with_own_settings, ("psmpc", "hard", "htmpc"), ["time_limit=0.2"], own_settings)
    assert describe_terms({name: simulate(task) for name, task in tasks.items()}) == sentence


@pytest.mark.slow
def test_runs_in_parallel_are_the_runs_alone(tmp_path: Path, tasks: dict[str, Task]) -> None:
    done: list[str] = []
    path = tmp_path / "new" / "comparison.h5"
    runs = run_tasks(tasks, path, jobs=2, watch=lambda progress: done.append(progress.last))
    found = read_comparison(path)
    assert list(runs) == list(found) == ["smpc", "hard"]
    assert sorted(set(done) - {""}) == ["hard", "smpc"]
    assert list(path.parent.iterdir()) == [path]  # the logs it was made from are gone
    for name, task in tasks.items():
        simulate(task, tmp_path / "alone.h5", force=True)
        alone = read_run(tmp_path / "alone.h5")
        assert alone.arrays.keys() == found[name].arrays.keys()
        for column in ("state/Q", "control/u", "window/instants", "window/share"):
            np.testing.assert_array_equal(found[name][column], alone[column])


@pytest.mark.slow
def test_the_python_call_returns_the_runs(reference: str) -> None:
    runs = compare(reference, ["smpc", "hard"], jobs=2)
    assert {name: str(run.attributes["controller"]) for name, run in runs.items()} == {"smpc": "smpc", "hard": "hard"}
    with pytest.raises(InputError, match="found 'mpc', expected one or more of psmpc"):
        compare(reference, ["mpc"])


def summary_of(whole: Summary, duration: float, effort: float, succeeded: bool = True) -> Summary:
    """Return the summary of a run with another end and effort."""
    found = copy(whole)
    found.duration = duration
    found.control_effort = effort
    found.succeeded = succeeded
    return found


@pytest.mark.parametrize(
    ("runs", "sentence"),
    [
        (
            {"psmpc": (30.9, 4.2, True), "hard": (34.0, 7.0, True), "smpc": (20.0, 1.0, False)},
            "recommended: psmpc, whose mission succeeds first, in 30.9 s, 3.1 s before the next",
        ),
        (
            {"psmpc": (30.9, 4.2, True), "smpc": (31.0, 2.6, True), "hard": (31.1, 1.0, True)},
            "recommended: smpc, whose mission succeeds in 31.0 s, "
            "with the least control effort of those within a sample (psmpc, smpc)",
        ),
        (
            {"psmpc": (30.9, 4.2, False), "hard": (34.0, 7.0, True)},
            "recommended: hard, whose mission succeeds in 34.0 s, as the only one of 2",
        ),
        (
            {"psmpc": (30.9, 4.2, False), "hard": (34.0, 7.0, False)},
            "no controller is recommended: the mission succeeded with none of 2",
        ),
    ],
    ids=["first", "least effort", "only one", "none"],
)
def test_the_controller_that_succeeds_first_at_the_least_effort_is_recommended(
    tmp_path: Path, runs: dict[str, tuple[float, float, bool]], sentence: str
) -> None:
    whole = there_and_back(tmp_path).summary()
    found = recommend_controller({name: summary_of(whole, *values) for name, values in runs.items()})
    assert found.sentence == sentence
    assert found.name == (sentence.split()[1].rstrip(",") if sentence.startswith("recommended") else None)
