"""Injects faults into the transport task and prints what each does: tables of docs/reliability.md.

    python benchmarks/reliability.py faults      some 3 minutes
    python benchmarks/reliability.py signals     some 2 minutes

N_s = 25, solver sqp, unless a row says otherwise. The exit code is 1 if a run is not as it should be: a rate or force
beyond `RATES` or `FORCE`, a log that cannot be read or lacks a sample it told of, a second run that overwrites.
"""

import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import redirect_stderr
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Thread
from typing import NamedTuple
from unittest.mock import patch

import numpy as np
from faults import Fault, Seen, during, inject, meaningless, not_converging, pushed, raising, unmeasured
from pages import PSMPC, markdown

from psmpc_cli.cli.main import main as psmpc
from psmpc_cli.logs.run import Run, read_run
from psmpc_cli.simulation import run as running

TASK = ("controller.nodes=25", "log.shares=false")
SQP = (*TASK, "solver.kind=sqp")
WEAK = (*SQP, "limits={base: {acceleration: [0.1, 0.1, 0.1]}}")

RATES, FORCE = 0.6, 5000.0
"""Above every rate [m/s, rad/s] and force [N, N m] of a safe run: limits are 0.2 and 0.15, and blows go to 0.5."""

INSTANTS = 20
"""How many runs are ended by each signal."""

UNWRITTEN = 1.0
"""A log is written twice a second: no sample is unwritten for so long [s]."""

EVER = 1000

Line = tuple[tuple[str, ...], bool]
"""A row of a table, and whether what it tells is as it should be."""

FAULTS: dict[str, tuple[Fault, Sequence[str]]] = {
    "none": (Fault(), SQP),
    "NaN for the whole state, 1 sample": (unmeasured(during(2, 1)), SQP),
    "NaN for the whole state, 5 samples": (unmeasured(during(2, 5)), SQP),
    "NaN for the whole state, 20 samples, across a switch": (unmeasured(during(9, 20)), SQP),
    "NaN for the whole state, for ever": (unmeasured(during(2, EVER)), SQP),
    "NaN for one coordinate, 5 samples": (unmeasured(during(2, 5), 0), SQP),
    "NaN for one coordinate, for ever": (unmeasured(during(2, EVER), 0), SQP),
    "the solver does not converge, 1 sample": (not_converging(during(2, 1)), SQP),
    "the solver does not converge, 5 samples": (not_converging(during(2, 5)), SQP),
    "the solver does not converge, 50 samples": (not_converging(during(2, 50)), SQP),
    "the solver does not converge, 20 samples, across a switch": (not_converging(during(9, 20)), SQP),
    "the solver raises, 5 samples": (raising(during(2, 5)), SQP),
    "the solver raises, for ever": (raising(during(2, EVER)), SQP),
    "the solver says it converged, to NaN, 5 samples": (meaningless(during(2, 5)), SQP),
    "a deadline of 10 us, sqp": (Fault(), (*SQP, "solver.deadline=1e-5")),
    "a deadline of 10 us, ipopt": (Fault(), (*TASK, "solver.kind=ipopt", "solver.deadline=1e-5")),
    "a blow of (0.3, -0.3) m/s": (pushed(9, x=0.3, y=-0.3), SQP),
    "the same, base acceleration at most 0.1 m/s^2, so that the end of Approach is out of reach": (
        pushed(9, x=0.3, y=-0.3),
        WEAK,
    ),
    "the same, fatrop": (pushed(9, x=0.3, y=-0.3), (*WEAK, "solver.kind=fatrop")),
    "a blow beyond the velocity limit, to 0.4 m/s": (pushed(8, x=-0.2, y=0.2), WEAK),
    "a blow of 0.5 rad/s": (pushed(8, theta=0.5), WEAK),
}
"""What goes wrong from which sample on, and the keys that are changed."""


def simulate(log: Path, fault: Fault, changes: Sequence[str]) -> tuple[int, Seen]:
    """Run `psmpc simulate transport` in this process with a fault; return the exit code and what the robot did."""
    build, seen = running.build_experiment, Seen()
    words = [*arguments(log, changes), "--quiet"]
    with (
        patch.object(running, "build_experiment", lambda task: inject(build(task), fault, seen)),
        patch.object(sys, "argv", ["psmpc", *words]),
        redirect_stderr(StringIO()),
    ):
        try:
            psmpc()
        except SystemExit as left:
            return int(left.code or 0), seen
    return 0, seen


def arguments(log: Path, changes: Sequence[str]) -> list[str]:
    """Return the words that run the transport task into a log, after `psmpc`."""
    return ["simulate", "transport", "--no-figures", "-o", str(log), *(w for key in changes for w in ("--set", key))]


def is_kept(log: Path) -> bool:
    """Run into a log once more; tell whether that is rejected and leaves it as it is."""
    before = log.read_bytes()
    return simulate(log, Fault(), SQP)[0] == 2 and log.read_bytes() == before


def in_the_loop(name: str, log: Path, fault: Fault, changes: Sequence[str]) -> Line:
    """Run the transport task with a fault, and once more, which must be rejected."""
    code, seen = simulate(log, fault, changes)
    found, rate, force = read_run(log), float(seen.rates.max()), float(seen.forces.max())
    reason = str(found.attributes["end_reason"])
    safe = rate <= RATES and force <= FORCE and is_kept(log) and code == (3 if "braked to rest" in reason else 0)
    return (name, reason, flags(found), stages_done(found), f"{rate:.2f}, {force:.0f}", str(code)), safe


def flags(log: Run) -> str:
    """Return which samples the log has flagged, and how many."""
    names = ("unmeasured", "solve_failed", "braking", "postponed")
    counts = {name: int(log[f"events/{name}"].sum()) for name in names}
    return ", ".join(f"{name} {count}" for name, count in counts.items() if count) or "none"


def stages_done(log: Run) -> str:
    """Return how many stages have ended, and when the run did."""
    done = int(np.isfinite(log.stages["switch_time"]).sum())
    return f"{done} of {len(log.stage_names)}, {log.summary().duration:.1f} s"


def outputs(folder: Path) -> Iterator[Line]:
    """Give what comes of logs that cannot be written, or not to their end."""
    taken = folder / "taken.h5"
    taken.write_text("mine")
    yield written("the log exists already", taken)
    yield written("the log is /dev/full", Path("/dev/full"))
    yield written("a directory that takes no files", unwritable(folder) / "log.h5")
    yield written("the disk is full after 2 MB", folder / "full.h5", limit=2_000_000)
    (folder / "gone").mkdir()
    yield removed("the directory is removed during the run", folder / "gone" / "log.h5")


def unwritable(folder: Path) -> Path:
    """Return a directory in which nobody, root included, may make a file."""
    closed = folder / "closed"
    closed.mkdir(mode=0o555)
    return Path("/sys") if os.access(closed, os.W_OK) else closed


def written(name: str, log: Path, limit: int = resource.RLIM_INFINITY) -> Line:
    """Run the transport task into a log, which may grow no larger than the limit [bytes]."""
    before = log.read_bytes() if log.is_file() else b""
    done = subprocess.run(
        [*PSMPC, *arguments(log, SQP), "--quiet"],
        stderr=subprocess.PIPE,
        text=True,
        check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)),
    )
    return afterwards(name, log, done.stderr, done.returncode, before)


def removed(name: str, log: Path) -> Line:
    """Run the transport task into a log, whose directory is removed in the midst of it."""
    command = [*PSMPC, *arguments(log, SQP), "--quiet"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as child:
        while not log.exists() and child.poll() is None:
            pass
        time.sleep(0.5)
        log.unlink()
        log.parent.rmdir()
        _, err = child.communicate()
    return afterwards(name, log, err, child.returncode, b"")


def afterwards(name: str, log: Path, err: str, code: int, before: bytes) -> Line:
    """Return what a command left: what it said last, and its log."""
    said = err.splitlines()[-1].removeprefix("psmpc: ").replace(str(log), "LOG").replace(str(log.parent), "DIR")
    if code == 2:
        untouched = not log.is_file() or log.read_bytes() == before
        return (name, said, "", "nothing is written", "", "2"), untouched
    if not log.exists():
        return (name, said, "", "no log is left", "", str(code)), code == 3
    found = read_run(log)
    return (name, said, flags(found), stages_done(found), "", str(code)), code == 3 and len(found.time) > 0


TELLING = """
from psmpc_cli.cli.main import main
from psmpc_cli.simulation import run as running
simulate = running.simulate
def telling(task, path, watch, *rest, **named):
    def tell(sample):
        print("sample", flush=True)
        watch(sample)
    return simulate(task, path, tell, *rest, **named)
running.simulate = telling
print("started", flush=True)
main()
"""
"""The command psmpc, which tells that it has started, and of every sample once it is in the log."""


class Struck(NamedTuple):
    """What a run left that was ended by a signal.

    Attributes:
        code: Its exit code, as a shell gives it.
        before: Samples it had told of when the signal was sent.
        told: When it told of each sample [s].
        held: Samples in its log; None if there is no log.
        sent: When the signal was sent [s].
        took: Time from the signal to its end [s].
    """

    code: int
    before: int
    told: list[float]
    held: int | None
    sent: float
    took: float

    @property
    def lost(self) -> list[float]:
        """When it told of the samples that are not in its log [s]."""
        return self.told[self.held or 0 :]


def strike(number: signal.Signals, log: Path, changes: Sequence[str], samples: int, delay: float) -> Struck:
    """Run the transport task in a process of its own, and send it a signal so long [s] after so many samples."""
    command = [sys.executable, "-c", TELLING, *arguments(log, changes), "--quiet"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as child:
        assert child.stdout is not None
        child.stdout.readline()
        told = [time.monotonic() for _ in range(samples) if child.stdout.readline()]
        reader = Thread(target=lambda lines: told.extend(time.monotonic() for _ in lines), args=(child.stdout,))
        reader.start()
        time.sleep(delay)
        before, sent = len(told), time.monotonic()
        child.send_signal(number)
        code = child.wait()
        took = time.monotonic() - sent
        reader.join()
    held = len(read_run(log).time) if log.exists() else None
    return Struck(code if code >= 0 else 128 - code, before, told, held, sent, took)


def signals(folder: Path, number: signal.Signals, name: str, changes: Sequence[str], count: int) -> Line:
    """Return the row of runs that a signal ends at random instants, and whether all were safe.

    A signal that a run cannot catch may take what came after the log was last written.
    """
    rng = np.random.default_rng(0)
    instants = [(int(samples), float(rng.uniform(0, 0.2))) for samples in rng.integers(0, 120, count)]
    logs = [folder / f"{name}-{i}.h5" for i in range(count)]
    with ThreadPoolExecutor(max_workers=2) as both:
        ended = list(both.map(lambda log, at: strike(number, log, changes, *at), logs, instants))
    started = [(log, one) for log, one in zip(logs, ended, strict=True) if one.held is not None]
    oldest = max(one.sent - min(one.lost, default=one.sent) for one in ended)
    safe = all(one.code == 128 + number for one in ended) and all(is_kept(log) for log, _ in started)
    safe &= oldest < UNWRITTEN if number == signal.SIGKILL else not any(one.lost for one in ended)
    columns = (
        name,
        f"{count}",
        f"{min(one.before for _, one in started)} to {max(one.before for _, one in started)}",
        f"{max(len(one.told) - one.before for one in ended)}",
        f"{max(one.took for one in ended):.1f} s",
        f"{max(len(one.lost) for one in ended)}",
        f"{oldest:.1f} s",
        f"{len(started)} of {len(started)}" if safe else "NOT ALL",
        ", ".join(sorted({str(one.code) for one in ended})),
    )
    return columns, safe


def closed_loop(folder: Path) -> Iterator[Line]:
    """Yield the rows of faults in the loop and in the output."""
    for i, (name, what) in enumerate(FAULTS.items()):
        yield in_the_loop(name, folder / f"{i}.h5", *what)
    yield from outputs(folder)


def ended_by_signals(folder: Path) -> Iterator[Line]:
    """Yield the rows of signals."""
    rows = [(number, number.name, SQP, INSTANTS) for number in (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)]
    slow = [(signal.SIGINT, f"SIGINT, {kind}", (*TASK, f"solver.kind={kind}"), 5) for kind in ("fatrop", "ipopt")]
    for number, name, changes, count in [*rows, *slow]:
        yield signals(folder, number, name, changes, count)


TABLES: dict[str, tuple[Callable[[Path], Iterator[Line]], tuple[str, ...]]] = {
    "faults": (
        closed_loop,
        ("fault", "what happens", "flags in the log", "stages done, end", "largest rate, force", "exit code"),
    ),
    "signals": (
        ended_by_signals,
        (
            "signal",
            "runs",
            "sent after samples",
            "samples after it, at most",
            "ended within",
            "samples lost, at most",
            "of the last",
            "whole logs, not overwritten",
            "exit code",
        ),
    ),
}
"""The rows and headings of each table."""


def main(name: str) -> int:
    """Print a table; return how many rows were not as they should be."""
    rows, headings = TABLES[name]
    lines = []
    with TemporaryDirectory() as folder:
        for columns, safe in rows(Path(folder)):
            sys.stderr.write(f"{'' if safe else 'NOT AS IT SHOULD BE: '}{columns[0]}\n")
            lines.append((columns, safe))
    print("\n".join(markdown(headings, (columns for columns, _ in lines))))
    return sum(not safe for _, safe in lines)


if __name__ == "__main__":
    raise SystemExit(min(main(sys.argv[1]), 1))
