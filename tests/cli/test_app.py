"""What a start of the command line imports: `psmpc --help` has to answer at once."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from typer.main import get_command

from psmpc_cli.cli.app import app

HEAVY = {"casadi", "dask", "distributed", "h5py", "joblib", "matplotlib", "mujoco", "numpy", "pydantic", "rich", "yaml"}

REPORT = """
import json, sys
from psmpc_cli.cli.main import main
try:
    if sys.argv[1:]:
        main()
finally:
    print("\\n" + json.dumps(sorted({name.partition(".")[0] for name in sys.modules})))
"""
"""Runs the command line; its last line names the packages imported by then."""


def imported_by(*arguments: str, code: int = 0) -> set[str]:
    command = [sys.executable, "-W", "error", "-c", REPORT, *arguments]
    ran = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ran.returncode == code
    return set(json.loads(ran.stdout.splitlines()[-1]))


@pytest.mark.parametrize("arguments", [[], ["--help"], ["--version"]], ids=["import", "--help", "--version"])
def test_a_start_imports_nothing_heavy(arguments: list[str]) -> None:
    imported = imported_by(*arguments)
    assert "psmpc_cli" in imported
    assert imported & HEAVY == set()


@pytest.mark.parametrize(
    "words",
    [("check",), ("simulate",), ("compare",), ("sweep-weights", "3x3"), ("monte-carlo", "--runs", "2"), ("bench",)],
    ids=lambda words: words[0],
)
@pytest.mark.parametrize("task", ["bad.yaml", "missing.yaml"])
def test_a_task_is_rejected_before_what_is_heavy_is_imported(words: tuple[str, ...], task: str, tmp_path: Path) -> None:
    """CasADi, SciPy, h5py, Matplotlib and joblib take more than half of what a command takes to start."""
    (tmp_path / "bad.yaml").write_text("robot: planar_dual_arm\ncontroller: {horizont: 4}\n")
    needed = {"numpy", "pydantic", "yaml", "lxml"}
    assert imported_by(*words, str(tmp_path / task), code=2) & (HEAVY | {"scipy"}) <= needed


def test_a_task_of_a_front_is_rejected_before_what_computes_is_imported(tmp_path: Path) -> None:
    """Whether it is a log is seen by h5py."""
    (tmp_path / "bad.yaml").write_text("robot: planar_dual_arm\n")
    computes = {"casadi", "joblib", "matplotlib", "scipy"}
    assert imported_by("pareto", str(tmp_path / "bad.yaml"), code=2) & computes == set()


@pytest.mark.parametrize("command", get_command(app).commands)
def test_the_help_of_a_command_imports_nothing_heavy(command: str) -> None:
    typers_own = {"pydantic"}  # Typer reads the parameters of a command with it
    assert imported_by(command, "--help") & (HEAVY - typers_own) == set()


def test_what_prints_imports_no_statistics() -> None:
    """SciPy's statistics take as long to import as all the rest that a command needs to print a summary."""
    code = "import sys, psmpc_cli.cli.tables; sys.exit('scipy.stats' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
