from pathlib import Path

import numpy as np
import pytest

from psmpc_cli.errors import InputError
from psmpc_cli.logs.run import read_comparison, read_run
from psmpc_cli.simulation.run import simulate
from psmpc_cli.specs.load import Task
from psmpc_cli.studies.compare import (
    CONTROLLERS,
    compare,
    compared_tasks,
    run_tasks,
)

from ..short_runs import TASK


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
