"""The command line on the log of a short run, for the tests of commands that start from one."""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from psmpc_cli.cli.main import main

from ..experiment.logged import there_and_back


@dataclass(frozen=True)
class Ran:
    code: int
    stdout: str
    stderr: str


Psmpc = Callable[..., Ran]

COMPARISON = "part.h5: found a comparison of several runs, expected the log of one"


@pytest.fixture
def psmpc(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Psmpc:
    """The command line, in a folder of its own."""
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


def is_refused(ran: Ran, message: str) -> bool:
    """Return whether bad input was refused in one message, and nothing else was said."""
    return (ran.code, ran.stdout) == (2, "") and message in ran.stderr and "Traceback" not in ran.stderr
