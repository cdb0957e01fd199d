"""The exported problem is solved by the lines its own text gives, without this package."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from psmpc_cli.errors import InputError
from psmpc_cli.simulation.problem_file import write_problem
from psmpc_cli.simulation.replay import replay

from .logged import there_and_back

WITHOUT_PSMPC = "import sys; sys.modules['psmpc_cli'] = None\n"
PAGE = Path(__file__).resolve().parents[2] / "docs" / "reliability.md"


def text_of(path: Path) -> str:
    with np.load(path) as data:
        return str(data["README.txt"].decode())


def script_of(path: Path) -> str:
    lines = text_of(path).splitlines()
    return "\n".join(line.removeprefix("    ") for line in lines if line.startswith("    "))


def solved_without_psmpc(path: Path) -> tuple[float, float, float]:
    """Return J, J in the log and the largest difference, as the lines in the file print them."""
    lines = [sys.executable, "-c", WITHOUT_PSMPC + script_of(path)]
    ran = subprocess.run(lines, cwd=path.parent, capture_output=True, text=True, check=True)
    objectives, apart = (line.split() for line in ran.stdout.splitlines()[-2:])
    return float(objectives[1]), float(objectives[-1]), float(apart[-1])


@pytest.mark.parametrize("solver", ["fatrop", "ipopt"])
def test_the_lines_in_the_file_solve_it_to_the_logged_point(tmp_path: Path, solver: str) -> None:
    log, path = there_and_back(tmp_path, f"solver.kind={solver}", samples=5), tmp_path / "problem.npz"
    write_problem(replay(log, 4), log, 4, path)
    with np.load(path) as data:
        assert len(data["x0"]) == len(data["lbx"]) == len(data["x_logged"])
    objective, logged, apart = solved_without_psmpc(path)
    assert logged == log["solver/objective"][4]
    assert objective == pytest.approx(logged, abs=1e-6)
    assert apart <= 1e-6
    assert f"The run's solver was {solver}, and so is this one" in text_of(path)


def test_for_a_solver_of_our_own_ipopt_stands_in_and_the_text_says_so(tmp_path: Path) -> None:
    """Priorities other than 1 divide the objective of the NLP; what is printed is J, as in the log."""
    log = there_and_back(tmp_path, "solver.kind=sqp", "stages.go.priority=50", samples=5)
    path = tmp_path / "problem.npz"
    write_problem(replay(log, 4), log, 4, path)
    with np.load(path) as data:
        assert json.loads(data["solver.json"])["plugin"] == "ipopt"
        assert data["largest_priority"] == 50
    objective, logged, apart = solved_without_psmpc(path)
    by_ipopt = replay(log, 4, "ipopt")
    assert logged == log["solver/objective"][4]
    assert objective == pytest.approx(50 * by_ipopt.solution.objective, rel=1e-9)
    assert apart == pytest.approx(np.abs(by_ipopt.solution.z - by_ipopt.logged.z).max(), rel=1e-6)
    assert apart > 0
    said = " ".join(text_of(path).split())
    assert "The run's solver was sqp, which is psmpc's own and no plug-in of CasADi: ipopt stands in for it" in said
    assert "it is asked for solver.iterations: 1;" in said


def test_another_plug_in_than_the_runs_is_named(tmp_path: Path) -> None:
    log, path = there_and_back(tmp_path, samples=1), tmp_path / "problem.npz"
    write_problem(replay(log, 0, "sqp"), log, 0, path)
    assert "The run's solver was fatrop, this one is ipopt." in text_of(path)


def test_the_page_shows_the_lines_in_the_file(tmp_path: Path) -> None:
    log, path = there_and_back(tmp_path, samples=1), tmp_path / "bug.npz"
    write_problem(replay(log, 0), log, 0, path)
    assert f"```python\n{script_of(path)}\n```" in PAGE.read_text(encoding="utf-8")


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    log, path = there_and_back(tmp_path, samples=1), tmp_path / "problem.npz"
    path.write_text("mine")
    again = replay(log, 0)
    with pytest.raises(InputError, match="exists already"):
        write_problem(again, log, 0, path)
    assert path.read_text() == "mine"
    with pytest.raises(InputError, match="is no directory"):
        write_problem(again, log, 0, path / "problem.npz")
