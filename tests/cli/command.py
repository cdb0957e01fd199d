"""What a command of psmpc leaves behind in tests."""

import signal
import sys
from collections.abc import Callable
from typing import NamedTuple

import pytest

from psmpc_cli.cli.main import main


class Ran(NamedTuple):
    """The exit code of a command, and what it wrote."""

    code: int
    stdout: str
    stderr: str


PROGRAM = [sys.executable, "-c", "from psmpc_cli.cli.main import main; main()"]
"""The command line as a process of its own."""

Psmpc = Callable[..., Ran]
"""The command line: words in, what came of them out."""


def command_line(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Psmpc:
    """Return the command line in this process, which keeps its own handlers of signals."""

    def run(*arguments: str) -> Ran:
        monkeypatch.setattr(sys, "argv", ["psmpc", *arguments])
        capsys.readouterr()
        before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
        with pytest.raises(SystemExit) as left:
            main()
        for number, handler in before.items():
            signal.signal(number, handler)
        return Ran(int(left.value.code or 0), *capsys.readouterr())

    return run
