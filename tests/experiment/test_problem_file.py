"""The exported problem is solved by the lines its own text gives, without this package."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from psmpc_cli.errors import InputError
from psmpc_cli.experiment.problem_file import write_problem
from psmpc_cli.experiment.replay import replay

from .logged import there_and_back

WITHOUT_PSMPC = "import sys; sys.modules['psmpc_cli'] = None\n"


@pytest.mark.parametrize("solver", ["fatrop", "ipopt"])
def test_the_lines_in_the_file_solve_it_to_the_logged_point(tmp_path: Path, solver: str) -> None:
    log, path = there_and_back(tmp_path, f"solver.kind={solver}", samples=5), tmp_path / "problem.npz"
    write_problem(replay(log, 4), log, 4, path)
    with np.load(path) as data:
        text = data["README.txt"].decode()
        assert len(data["x0"]) == len(data["lbx"]) == len(data["x_logged"])
        assert data["f_logged"] == log["solver/objective"][4]
    lines = "\n".join(line.removeprefix("    ") for line in text.splitlines() if line.startswith("    "))
    ran = subprocess.run(
        [sys.executable, "-c", WITHOUT_PSMPC + lines], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    objective, apart = map(float, ran.stdout.splitlines()[-1].split())
    assert objective == pytest.approx(log["solver/objective"][4], abs=1e-6)
    assert apart <= 1e-6


def test_a_solver_of_our_own_leaves_the_problem_to_ipopt(tmp_path: Path) -> None:
    log, path = there_and_back(tmp_path, "solver.kind=sqp", samples=2), tmp_path / "problem.npz"
    write_problem(replay(log, 1), log, 1, path)
    with np.load(path) as data:
        assert b'"plugin": "ipopt"' in data["solver.json"]


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    log, path = there_and_back(tmp_path, samples=1), tmp_path / "problem.npz"
    path.write_text("mine")
    again = replay(log, 0)
    with pytest.raises(InputError, match="exists already"):
        write_problem(again, log, 0, path)
    assert path.read_text() == "mine"
    with pytest.raises(InputError, match="is no directory"):
        write_problem(again, log, 0, path / "problem.npz")
