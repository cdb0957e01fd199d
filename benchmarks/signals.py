"""Signals sent to runs in processes of their own."""

import signal
import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path

from psmpc_cli.logs.read import read_log

TELLING = """
from psmpc_cli.cli.main import main
from psmpc_cli.simulation import run as running
write = running.write_records
def telling(experiment, writer, watch, *rest):
    def tell(progress):
        print("sample", flush=True)
        watch(progress)
    return write(experiment, writer, tell, *rest)
running.write_records = telling
print("started", flush=True)
main()
"""
"""The command psmpc, which tells that it has started, and of every sample once it is in the log."""


@dataclass(frozen=True)
class Struck:
    """What a run left that was ended by a signal.

    Attributes:
        code: Its exit code, as a shell gives it.
        before: Samples it had told of when the signal was sent.
        told: Samples it told of in all.
        held: Samples in its log; None if there is no log.
        err: What it wrote to standard error.
        took: Time from the signal to its end [s].
    """

    code: int
    before: int
    told: int
    held: int | None
    err: str
    took: float


def strike(number: signal.Signals, log: Path, task: str, *changes: str, samples: int = 0, delay: float = 0.0) -> Struck:
    """Run `psmpc simulate` in a process of its own, and send it a signal so long [s] after so many samples."""
    settings = [word for change in changes for word in ("--set", change)]
    command = [sys.executable, "-c", TELLING, "simulate", task, "--no-figures", "--quiet", "-o", str(log), *settings]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        child.stdout.readline()
        told = [child.stdout.readline() for _ in range(samples)]
        reader = threading.Thread(target=lambda lines: told.extend(lines), args=(child.stdout,))
        reader.start()
        time.sleep(delay)
        before, sent = len(told), time.monotonic()
        child.send_signal(number)
        code = child.wait()
        took = time.monotonic() - sent
        reader.join()
        assert child.stderr is not None
        err = child.stderr.read()
    held = len(read_log(log).time) if log.exists() else None
    return Struck(code if code >= 0 else 128 - code, before, len(told), held, err, took)
