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
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from faults import (
    Fault,
    Struck,
    during,
    meaningless,
    not_converging,
    pushed,
    raising,
    simulate,
    strike,
    unmeasured,
)
from pages import markdown

from psmpc_cli.logs.run import Run, read_run

TASK = ("controller.nodes=25", "log.shares=false")
SQP = (*TASK, "solver.kind=sqp")
WEAK = (*SQP, "limits={base: {acceleration: [0.1, 0.1, 0.1]}}")

RATES, FORCE = 0.6, 5000.0
"""Above every rate [m/s, rad/s] and force [N, N m] of a safe run: limits are 0.2 and 0.15, and blows go to 0.5."""

INSTANTS = 20
"""How many runs are ended by each signal."""

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


@dataclass(frozen=True)
class Row:
    """What came of a fault; empty where there is nothing to say. `safe` says whether it was to be expected."""

    what: str
    flags: str
    end: str
    largest: str
    code: int
    safe: bool = True


def in_the_loop(log: Path, fault: Fault, changes: Sequence[str]) -> Row:
    """Run the transport task with a fault, and once more, which must be refused."""
    ran = simulate(fault, log, "transport", *changes)
    found, before = read_run(log), log.read_bytes()
    refused = simulate(Fault(), log, "transport", *changes).code == 2 and log.read_bytes() == before
    rate, force = float(ran.seen.rates.max()), float(ran.seen.forces.max())
    bounded = rate <= RATES and force <= FORCE
    return Row(
        what=str(found.attributes["end_reason"]),
        flags=flags(found),
        end=stages_done(found),
        largest=f"{rate:.2f}, {force:.0f}",
        code=ran.code,
        safe=bounded and refused and ran.code == (3 if "braked to rest" in str(found.attributes["end_reason"]) else 0),
    )


def flags(log: Run) -> str:
    """Return which samples the log has flagged, and how many."""
    names = ("unmeasured", "solve_failed", "braking", "postponed")
    counts = {name: int(log[f"events/{name}"].sum()) for name in names}
    return ", ".join(f"{name} {count}" for name, count in counts.items() if count) or "none"


def stages_done(log: Run) -> str:
    """Return how many stages have ended, and when the run did."""
    done = int(np.isfinite(log.stages["switch_time"]).sum())
    return f"{done} of {len(log.stage_names)}, {log.summary().duration:.1f} s"


def outputs(folder: Path) -> Iterator[tuple[str, Row]]:
    """Give what comes of logs that cannot be written, or not to their end."""
    taken = folder / "taken.h5"
    taken.write_text("mine")
    yield "the log exists already", written(taken)
    yield "the log is /dev/full", written(Path("/dev/full"))
    yield "a directory that takes no files", written(unwritable(folder) / "log.h5")
    yield "the disk is full after 1 MB", written(folder / "full.h5", limit=1_000_000)
    (folder / "gone").mkdir()
    yield "the directory is removed during the run", removed(folder / "gone" / "log.h5")


def unwritable(folder: Path) -> Path:
    """Return a directory in which nobody, root included, may make a file."""
    closed = folder / "closed"
    closed.mkdir(mode=0o555)
    return Path("/sys") if os.access(closed, os.W_OK) else closed


def command(log: Path) -> list[str]:
    """Return the command that runs the transport task into a log."""
    settings = [word for change in SQP for word in ("--set", change)]
    start = [sys.executable, "-c", "from psmpc_cli.cli.main import main; main()"]
    return [*start, "simulate", "transport", "--no-figures", "--quiet", "-o", str(log), *settings]


def written(log: Path, limit: int | None = None) -> Row:
    """Run the transport task into a log, which may grow no larger than the limit [bytes]."""

    def confine() -> None:
        if limit is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    before = log.read_bytes() if log.is_file() else b""
    done = subprocess.run(command(log), capture_output=True, text=True, check=False, preexec_fn=confine)
    return afterwards(log, done.stderr, done.returncode, before)


def removed(log: Path) -> Row:
    """Run the transport task into a log, whose directory is removed in the midst of it."""
    with subprocess.Popen(command(log), stderr=subprocess.PIPE, text=True) as child:
        while not log.exists() and child.poll() is None:
            pass
        time.sleep(0.5)
        log.unlink()
        log.parent.rmdir()
        _, err = child.communicate()
    return afterwards(log, err, child.returncode, b"")


def afterwards(log: Path, err: str, code: int, before: bytes) -> Row:
    """Return what a command left: what it said last, and its log."""
    said = err.splitlines()[-1].removeprefix("psmpc: ").replace(str(log), "LOG").replace(str(log.parent), "DIR")
    if code == 2:
        untouched = not log.is_file() or log.read_bytes() == before
        return Row(said, "", "nothing is written", "", code, untouched)
    if not log.exists():
        return Row(said, "", "no log is left", "", code, code == 3)
    found = read_run(log)
    return Row(said, flags(found), stages_done(found), "", code, code == 3 and len(found.time) > 0)


def signals(folder: Path, number: signal.Signals, name: str, changes: Sequence[str], count: int) -> Line:
    """Return the row of runs that a signal ends at random instants, and whether all were safe."""
    rng = np.random.default_rng(0)
    instants = [(int(samples), float(rng.uniform(0, 0.2))) for samples in rng.integers(0, 120, count)]

    def run(i: int) -> tuple[Path, Struck]:
        log, (samples, delay) = folder / f"{name}-{i}.h5", instants[i]
        return log, strike(number, log, "transport", *changes, samples=samples, delay=delay)

    with ThreadPoolExecutor(max_workers=2) as both:
        ended = list(both.map(run, range(count)))
    safe = all(one.code == 128 + number and complete(log, one) for log, one in ended)
    later = [one.told - one.before for _, one in ended]
    started = [one for _, one in ended if one.held is not None]
    lost = sum(max(0, one.told - (one.held or 0)) for one in started)
    columns = (
        name,
        f"{count}",
        f"{min(one.before for one in started)} to {max(one.before for one in started)}",
        f"{max(later)}",
        f"{max(one.took for _, one in ended):.1f} s",
        f"{lost}",
        f"{len(started)} of {len(started)}" if safe else "NOT ALL",
        ", ".join(sorted({str(one.code) for _, one in ended})),
    )
    return columns, safe


def complete(log: Path, struck: Struck) -> bool:
    """Return whether a log holds all that was told of, and a second run leaves it alone."""
    if struck.held is None:
        return struck.told == 0
    before = log.read_bytes()
    again = simulate(Fault(), log, "transport", *SQP)
    return struck.held >= struck.told and again.code == 2 and log.read_bytes() == before


def closed_loop(folder: Path) -> Iterator[Line]:
    """Yield the rows of faults in the loop and in the output."""
    results = ((name, in_the_loop(folder / f"{i}.h5", *what)) for i, (name, what) in enumerate(FAULTS.items()))
    for rows in (results, outputs(folder)):
        for name, row in rows:
            yield (name, row.what, row.flags, row.end, row.largest, str(row.code)), row.safe


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
            "samples lost",
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
    with tempfile.TemporaryDirectory() as folder:
        for columns, safe in rows(Path(folder)):
            sys.stderr.write(f"{'' if safe else 'NOT AS IT SHOULD BE: '}{columns[0]}\n")
            lines.append((columns, safe))
    print("\n".join(markdown(headings, (columns for columns, _ in lines))))
    return sum(not safe for _, safe in lines)


if __name__ == "__main__":
    raise SystemExit(min(main(sys.argv[1]), 1))
