"""The command line, and a log to start from, for every command's tests."""

import sys
from pathlib import Path

import pytest

from psmpc_cli.cli.main import main

from ..simulation.logged import there_and_back
from .command import Psmpc, Ran


@pytest.fixture
def psmpc(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Psmpc:
    """The command line in this process, in a folder of the test's own."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments: str) -> Ran:
        monkeypatch.setattr(sys, "argv", ["psmpc", *arguments])
        capsys.readouterr()
        with pytest.raises(SystemExit) as left:
            main()
        return Ran(int(left.value.code or 0), *capsys.readouterr())

    return run


@pytest.fixture
def part(tmp_path: Path) -> Path:
    """The log of a run that was interrupted after six samples."""
    return there_and_back(tmp_path, samples=6, name="part").path
