"""What a command of psmpc leaves behind in tests."""

import math
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from typing import Literal, NamedTuple

import pytest

from psmpc_cli.cli import common
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
    """Return the command line in this process, which keeps its own handlers of signals.

    However busy the machine is, work that is mostly short is not shown.
    """
    monkeypatch.setattr(common, "SHORT", math.inf)

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


def on_terminal(*arguments: str, stream: Literal["stdout", "stderr"], **environment: str) -> str:
    """Run the command line with one of its outputs on a terminal of 120 columns; return what that is sent."""
    ours, theirs = os.openpty()
    pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, stream: theirs}
    variables = {**os.environ, "TERM": "xterm", "COLUMNS": "120", **environment}
    with subprocess.Popen([*PROGRAM, *arguments], env=variables, **pipes) as child:
        os.close(theirs)
        sent = b""
        with suppress(OSError):  # the end of a terminal
            while part := os.read(ours, 4096):
                sent += part
    os.close(ours)
    assert child.returncode == 0
    return sent.decode()


def plain_text(sent: str) -> str:
    """Return the text that a terminal is sent, without what controls it."""
    return re.sub(r"\x1b\[[?\d;]*[a-zA-Z]", "", sent)
