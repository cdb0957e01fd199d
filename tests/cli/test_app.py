"""What a start of the command line imports: `psmpc --help` has to answer at once."""

import ast
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest
from typer.main import get_command

import psmpc_cli
from psmpc_cli.cli.app import GROUPS, app

HEAVY = {"casadi", "dask", "distributed", "h5py", "loky", "matplotlib", "mujoco", "numpy", "pydantic", "rich", "yaml"}

REPORT = """
import json, sys
from psmpc_cli.cli.main import main
codes = []
for words in json.loads(sys.argv[1]):
    sys.argv[1:] = words
    try:
        main()
    except SystemExit as left:
        codes.append(left.code or 0)
print("\\n" + json.dumps([codes, sorted({name.partition(".")[0] for name in sys.modules})]))
"""
"""Runs command lines one after another; its last line has their exit codes, and the packages imported by then."""


def imported_by(*commands: Sequence[str], code: int = 0) -> set[str]:
    """Return the packages that command lines import, all in one new process and each with this exit code."""
    command = [sys.executable, "-W", "error", "-c", REPORT, json.dumps(commands)]
    ran = subprocess.run(command, capture_output=True, text=True, check=True)
    codes, imported = json.loads(ran.stdout.splitlines()[-1])
    assert codes == [code] * len(commands)
    return set(imported)


@pytest.mark.parametrize("commands", [[], [["--help"]], [["--version"]]], ids=["import", "--help", "--version"])
def test_a_start_imports_nothing_heavy(commands: list[list[str]]) -> None:
    imported = imported_by(*commands)
    assert "psmpc_cli" in imported
    assert imported & HEAVY == set()


STARTS = (("check",), ("simulate",), ("compare",), ("sweep-weights", "3x3"), ("monte-carlo", "--runs", "2"), ("bench",))
"""Commands on a task, without the task."""


@pytest.mark.parametrize("task", ["bad.yaml", "missing.yaml"])
def test_a_task_is_rejected_before_what_is_heavy_is_imported(task: str, tmp_path: Path) -> None:
    """CasADi, SciPy, h5py, Matplotlib and loky take more than half of what a command takes to start."""
    (tmp_path / "bad.yaml").write_text("robot: planar_dual_arm\ncontroller: {horizont: 4}\n")
    needed = {"numpy", "pydantic", "yaml", "lxml"}
    commands = [(*words, str(tmp_path / task)) for words in STARTS]
    assert imported_by(*commands, code=2) & (HEAVY | {"scipy"}) <= needed


def test_a_task_of_a_front_is_rejected_before_what_computes_is_imported(tmp_path: Path) -> None:
    """Whether it is a log is seen by h5py."""
    (tmp_path / "bad.yaml").write_text("robot: planar_dual_arm\n")
    computes = {"casadi", "loky", "matplotlib", "scipy"}
    assert imported_by(("pareto", str(tmp_path / "bad.yaml")), code=2) & computes == set()


def test_the_help_of_a_command_imports_nothing_heavy() -> None:
    typers_own = {"pydantic"}  # Typer reads the parameters of a command with it
    assert imported_by(*((command, "--help") for command in get_command(app).commands)) & (HEAVY - typers_own) == set()


def test_the_command_line_finds_commands_of_other_layers_and_needs_none_of_them(tmp_path: Path) -> None:
    """Without the reproduction of the paper psmpc has all other commands, and another layer may bring some."""
    source = Path(psmpc_cli.__file__).parent
    ignored = shutil.ignore_patterns("paper", "__pycache__", "report")
    shutil.copytree(source, tmp_path / "psmpc_cli", ignore=ignored)
    more = tmp_path / "psmpc_cli" / "more"
    more.mkdir()
    (more / "commands.py").write_text(
        'def greet() -> None:\n    """Say hello."""\n    print("hello")\n\n\nCOMMANDS = {"Look": (greet,)}\n'
    )
    code = "from psmpc_cli.cli.app import GROUPS, app; print({t: [f.__name__ for f in fs] for t, fs in GROUPS.items()})"
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    command = [sys.executable, "-c", f"{code}; app(['greet'])"]
    ran = subprocess.run(command, capture_output=True, text=True, env=environment, cwd=tmp_path, check=True)
    groups, said = ran.stdout.splitlines()
    names = {title: [function.__name__ for function in functions] for title, functions in GROUPS.items()}
    assert names["Study"].pop() == "reproduce"
    assert ast.literal_eval(groups) == {**names, "Look": [*names["Look"], "greet"]}
    assert said == "hello"


@pytest.mark.slow
def test_what_prints_imports_no_statistics() -> None:
    """SciPy's statistics take as long to import as all the rest that a command needs to print a summary."""
    code = "import sys, psmpc_cli.cli.tables; sys.exit('scipy.stats' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
