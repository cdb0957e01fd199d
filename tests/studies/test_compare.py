from copy import copy
from pathlib import Path

import numpy as np
import pytest

from psmpc_cli.errors import InputError
from psmpc_cli.logs.run import read_comparison, read_run
from psmpc_cli.logs.summary import Summary
from psmpc_cli.simulation.run import simulate
from psmpc_cli.specs.load import Task
from psmpc_cli.studies.compare import (
    CONTROLLERS,
    compare,
    compared_tasks,
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
        controller = task.spec.controller.model_copy(update={"kind": "psmpc"})
        alike.append(task.spec.model_copy(update={"controller": controller}))
    assert all(spec == alike[0] for spec in alike)
    assert (alike[0].controller.nodes, alike[0].plant.kind) == (7, "rk4")


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
