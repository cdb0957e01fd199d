"""The command `psmpc`: runs the application and turns errors and signals into one message and an exit code."""

import errno
import os
import signal
import sys
from contextlib import suppress
from io import FileIO, TextIOWrapper
from types import FrameType

from psmpc_cli.errors import SIGNALS, PsmpcError, RunError, SpecError, silence_libraries

OUTPUT_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EBADF)
"""Errors of writing; files that cannot be written are reported by name, so without a name it is standard output."""


class LossyText(TextIOWrapper):
    """A stream of which is lost what cannot be written: what shows progress stops nothing."""

    def write(self, text: str, /) -> int:
        """Write a text, or lose it."""
        with suppress(OSError):
            return super().write(text)
        return len(text)

    def flush(self) -> None:
        """Write what waits, or lose it."""
        with suppress(OSError):
            super().flush()


def open_standard_streams() -> None:
    """Make standard output and standard error usable, whatever the caller made of them.

    A stream that the caller has closed is opened so that nothing can be written to it; otherwise the next file that is
    opened, such as a log, would take its number, and receive what is printed. Writing to standard output then fails,
    which `main` reports. Text that cannot be written to standard error is lost, since it must not end a run.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDONLY)  # takes the lowest number that is free: this one
    if sys.stdout is None:  # so Python leaves a stream that was closed when it began
        sys.stdout = TextIOWrapper(FileIO(1, "w", closefd=False), "utf-8")
    if sys.stderr is None or sys.stderr is sys.__stderr__:
        encoding = getattr(sys.stderr, "encoding", "utf-8")
        file = FileIO(2, "w", closefd=False)
        sys.stderr = LossyText(file, encoding, "backslashreplace", line_buffering=True, write_through=True)
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # names of files need not be text


def print_error(message: str) -> None:
    """Write a message to standard error."""
    from psmpc_cli.cli.common import echo

    echo(message, err=True)


def exit_at_once(number: int, frame: FrameType | None) -> None:
    """Handle a signal: one message and the exit code of the signal, wherever the program is.

    An exception would be raised in any code, also in a destructor, where Python prints and drops it. What writes logs
    and results or starts processes defers signals, so that nothing is lost.
    """
    with suppress(OSError):
        clears_line = "\r\x1b[K" if os.isatty(2) else ""  # of progress
        os.write(2, f"{clears_line}psmpc: {SIGNALS[signal.Signals(number)]}\n".encode())
    os._exit(128 + number)


def main() -> None:
    """Run the command line, and turn errors and signals into one message and an exit code.

    Exit codes: 0 done, 1 a check that was asked for fails, 2 bad input, 3 the run could not go on, 128 + number after
    a signal.
    """
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # before NumPy is loaded: its matrices are small, threads but wait
    open_standard_streams()
    for number in SIGNALS:
        signal.signal(number, exit_at_once)
    import logging

    from psmpc_cli.cli.app import EchoHandler, app
    from psmpc_cli.cli.options import TAKES_LONG

    silence_libraries()
    library_logger = logging.getLogger("psmpc_cli")
    handler = EchoHandler()
    library_logger.handlers = [handler]
    for takes_long in TAKES_LONG:
        logging.getLogger(takes_long).setLevel(logging.INFO)
    try:
        try:
            app(prog_name="psmpc")
        finally:
            handler.close()  # ends the line of progress
            sys.stdout.flush()  # here, where an error of writing is still reported
    except PsmpcError as error:
        located = isinstance(error, SpecError)  # begins with file:line:column, which terminals and editors can follow
        print_error(str(error) if located else f"psmpc: {error}")
        sys.exit(error.exit_code)
    except OSError as error:
        if error.filename is not None:  # without one it is an error of standard output
            print_error(f"psmpc: {error.filename}: {error.strerror}")
            sys.exit(PsmpcError.exit_code)
        if error.errno not in OUTPUT_ERRORS:
            raise
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # for what Python still writes when it ends
        reason = "it is closed" if error.errno == errno.EBADF else error.strerror
        print_error(f"psmpc: standard output cannot be written: {reason}")
        sys.exit(RunError.exit_code)
