"""What a start of the command line imports: `psmpc --help` has to answer at once."""

import json
import subprocess
import sys

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


def imported_by(*arguments: str) -> set[str]:
    command = [sys.executable, "-W", "error", "-c", REPORT, *arguments]
    ran = subprocess.run(command, capture_output=True, text=True, check=True)
    return set(json.loads(ran.stdout.splitlines()[-1]))


@pytest.mark.parametrize("arguments", [[], ["--help"], ["--version"]], ids=["import", "--help", "--version"])
def test_a_start_imports_nothing_heavy(arguments: list[str]) -> None:
    imported = imported_by(*arguments)
    assert "psmpc_cli" in imported
    assert imported & HEAVY == set()


@pytest.mark.parametrize("command", get_command(app).commands)
def test_the_help_of_a_command_imports_nothing_heavy(command: str) -> None:
    typers_own = {"pydantic"}  # Typer reads the parameters of a command with it
    assert imported_by(command, "--help") & (HEAVY - typers_own) == set()
