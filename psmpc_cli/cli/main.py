"""The command `psmpc`: runs the application and turns errors and signals into one message and an exit code."""

import errno
import os
import signal
import sys
from io import TextIOWrapper
from types import FrameType

from psmpc_cli.errors import SIGNALS, PsmpcError, RunError, SpecError

NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
"""Errors of writing; files that cannot be written are reported by name, so without a name it is standard output."""


def print_error(message: str) -> None:
    """Write a message to standard error, with escapes for characters that could control the terminal."""
    import typer

    from psmpc_cli.specs.document import printable

    shown = "\n".join("\t".join(map(printable, line.split("\t"))) for line in message.split("\n"))
    typer.echo(shown, err=True)


def exit_at_once(number: int, frame: FrameType | None) -> None:
    """Handle a signal: one message and the exit code of the signal, wherever the program is.

    An exception would be raised in any code, also in a destructor, where Python prints and drops it. What writes logs
    and results or starts processes defers signals, so that nothing is lost.
    """
    os.write(2, f"psmpc: {SIGNALS[signal.Signals(number)]}\n".encode())
    os._exit(128 + number)


def main() -> None:
    """Run the command line; exit codes: 0 done, 1 a check asked for fails, 2 bad input, 3 the run could not go on."""
    for number in SIGNALS:
        signal.signal(number, exit_at_once)
    import logging

    from psmpc_cli.cli.app import EchoHandler, app

    logging.basicConfig(handlers=[EchoHandler()], level=logging.WARNING)
    logging.getLogger("psmpc_cli.specs.covers").setLevel(logging.INFO)  # what takes seconds is said as it begins
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # names of files need not be text
    try:
        try:
            app(prog_name="psmpc")
        finally:
            sys.stdout.flush()
    except PsmpcError as error:
        located = isinstance(error, SpecError)  # begins with file:line:column, which terminals and editors can follow
        print_error(str(error) if located else f"psmpc: {error}")
        sys.exit(error.exit_code)
    except OSError as error:
        if error.filename is not None:
            print_error(f"psmpc: {error.filename}: {error.strerror}")
            sys.exit(PsmpcError.exit_code)
        if error.errno not in NO_ROOM:
            raise
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # for what Python still writes when it ends
        print_error(f"psmpc: standard output cannot be written: {error.strerror}")
        sys.exit(RunError.exit_code)
