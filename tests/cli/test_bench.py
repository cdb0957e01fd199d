"""The command itself; what it measures is tested with the studies."""

import json
from pathlib import Path

import pytest

from psmpc_cli.cli.bench import bench
from psmpc_cli.errors import InputError, PsmpcError, SpecError

from ..there_and_back import TASK
from .test_pareto import called

FARTHER = ("--set", "stages[0].target.base=[0.3, 0, 0]")
SMALL = (*FARTHER, "--nodes", "5", "--solvers", "sqp", "--repeat", "1")


@pytest.fixture(scope="module")
def task(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("task") / "small.yaml"
    path.write_text(TASK)
    return path


@pytest.fixture(scope="module")
def measured(task: Path) -> tuple[Path, str]:
    """A bench of the task, with what the command said."""
    files = ("--json", task.parent / "bench.json")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("OMP_NUM_THREADS", "1")  # which the command sets, and which is to be as before afterwards
        return task.parent, called(bench, task, *SMALL, *files)


def test_a_row_a_mesh_and_way(measured: tuple[Path, str]) -> None:
    _, said = measured
    heading, *rows = said.splitlines()
    for word in ("nodes", "median [ms]", "p99", "times faster", "iterations", "violation", "failed"):
        assert word in heading
    assert [row.split()[:3] for row in rows[:3]] == [["5", *way] for way in WAYS]
    assert all(row.endswith("0 of 3") for row in rows[:3])


WAYS = (["sqp", "warm"], ["sqp", "cold"], ["reference", "cold"])


def test_results_are_there(measured: tuple[Path, str]) -> None:
    directory, said = measured
    found = json.loads((directory / "bench.json").read_text())
    assert found["task"]["name"] == "small"
    assert len(found["windows"]) == 3
    assert f"written: {directory / 'bench.json'}" in said


def test_nothing_is_overwritten_unasked(measured: tuple[Path, str], task: Path) -> None:
    directory, _ = measured
    before = (directory / "bench.json").read_bytes()
    with pytest.raises(InputError, match="already"):
        called(bench, task, *SMALL, "--json", directory / "bench.json")
    assert (directory / "bench.json").read_bytes() == before


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        (("--nodes", "5,few"), InputError, "--nodes: found 'few'"),
        (("--nodes", "1"), SpecError, "controller.nodes"),
        (("--solvers", "snopt"), InputError, "--solvers: found 'snopt'"),
        (("--set", "controller.horizon=-1"), SpecError, "horizon"),
        (("--set", "solver.kind=fatrop"), InputError, "choose back-ends with --solvers"),
        (("--json", "."), InputError, "is a directory"),
    ],
)
def test_bad_input_is_named_before_anything_runs(
    task: Path, arguments: tuple[str, ...], error: type[PsmpcError], message: str
) -> None:
    with pytest.raises(error) as raised:
        called(bench, task, *arguments)
    assert message in str(raised.value)
    assert raised.value.exit_code == 2


def test_a_task_that_does_not_exist_is_refused() -> None:
    with pytest.raises(SpecError, match="nowhere"):
        called(bench, "nowhere.yaml")
