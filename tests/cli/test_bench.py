"""The command itself; what it measures is tested with the studies."""

from pathlib import Path

import pytest

from ..there_and_back import TASK
from .command import Psmpc


@pytest.fixture
def task(tmp_path: Path) -> str:
    path = tmp_path / "small.yaml"
    path.write_text(TASK)
    return str(path)


def test_a_table_of_this_machine(psmpc: Psmpc, task: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "1")  # which the command sets
    small = ("--set", "stages[0].target.base=[0.3, 0, 0]", "--nodes", "5", "--solvers", "sqp,piqp", "--repeat", "1")
    ran = psmpc("bench", task, *small)
    assert ran.code == 0
    first = [line.split()[:3] for line in ran.stdout.splitlines()[1:6]]
    assert first == [["5", name, start] for name in ("sqp", "piqp") for start in ("warm", "cold")] + [
        ["5", "reference", "cold"]
    ]
    assert "nodes 5: 3 windows done" in ran.stderr


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--nodes", "many"), "--nodes: found 'many'"),
        (("--solvers", "snopt"), "--solvers: found 'snopt'"),
        (("--set", "solver.kind=ipopt"), "choose back-ends with --solvers"),
    ],
)
def test_what_does_not_fit_is_named(psmpc: Psmpc, task: str, arguments: tuple[str, ...], message: str) -> None:
    ran = psmpc("bench", task, *arguments)
    assert ran.code == 2
    assert message in ran.stderr
