"""Tables of docs/reliability.md: other physics, and the transport task under faults, full disks and signals.

    python benchmarks/reliability.py physics [NODES]   the plant rk4 against MuJoCo; some 4 minutes
    python benchmarks/reliability.py faults            some 3 minutes
    python benchmarks/reliability.py signals           some 2 minutes

Faults and signals: N_s = 25, solver sqp, unless a row says otherwise. The exit code is 1 if a run is not as it should
be: a rate or force beyond `RATES` or `FORCE`, a log that cannot be read or lacks a sample it told of, a second run that
overwrites.
"""

import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import redirect_stderr
from functools import partial
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Thread
from typing import NamedTuple
from unittest.mock import patch

import mujoco
import numpy as np
from pages import PSMPC, ROOT, command_line, markdown

sys.path.append(str(ROOT / "tests" / "simulation"))
from faults import Fault, during, injected, meaningless, not_converging, pushed, raising, unmeasured

import psmpc_cli as psmpc
from psmpc_cli.cli.main import main
from psmpc_cli.ocp.skills import skill_in
from psmpc_cli.plant.mujoco import MujocoPlant

WINDOW = 5.0
"""Length of an open-loop replay [s]."""

EULER, RK4 = mujoco.mjtIntegrator.mjINT_EULER, mujoco.mjtIntegrator.mjINT_RK4
REPLAYS = {
    f"{WINDOW:g} s: Runge-Kutta, a step a tick": (RK4, 1, WINDOW),
    f"{WINDOW:g} s: Runge-Kutta, four steps a tick": (RK4, 4, WINDOW),
    f"{WINDOW:g} s: semi-implicit Euler, MuJoCo's default": (EULER, 1, WINDOW),
    "the whole run: Runge-Kutta, a step a tick": (RK4, 1, np.inf),
}
"""Integrator, steps a tick and length [s] of the replays."""

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

Line = tuple[dict[str, str], bool]
"""A row of a table, and whether what it tells is as it should be."""

FAULTS: dict[str, dict[str, tuple[Fault, Sequence[str]]]] = {
    "Measurements": {
        "none": (Fault(), SQP),
        "NaN for the whole state, 1 sample": (unmeasured(during(2, 1)), SQP),
        "NaN for the whole state, 5 samples": (unmeasured(during(2, 5)), SQP),
        "NaN for the whole state, 20 samples, across a switch": (unmeasured(during(9, 20)), SQP),
        "NaN for the whole state, for ever": (unmeasured(during(2, EVER)), SQP),
        "NaN for one coordinate, 5 samples": (unmeasured(during(2, 5), 0), SQP),
        "NaN for one coordinate, for ever": (unmeasured(during(2, EVER), 0), SQP),
    },
    "The solver": {
        "the solver does not converge, 1 sample": (not_converging(during(2, 1)), SQP),
        "the solver does not converge, 5 samples": (not_converging(during(2, 5)), SQP),
        "the solver does not converge, 50 samples": (not_converging(during(2, 50)), SQP),
        "the solver does not converge, 20 samples, across a switch": (not_converging(during(9, 20)), SQP),
        "the solver raises, 5 samples": (raising(during(2, 5)), SQP),
        "the solver raises, for ever": (raising(during(2, EVER)), SQP),
        "the solver says it converged, to NaN, 5 samples": (meaningless(during(2, 5)), SQP),
        "a deadline of 10 us, sqp": (Fault(), (*SQP, "solver.deadline=1e-5")),
        "a deadline of 10 us, ipopt": (Fault(), (*TASK, "solver.kind=ipopt", "solver.deadline=1e-5")),
    },
    "Blows to the base": {
        "a blow of (0.3, -0.3) m/s": (pushed(9, x=0.3, y=-0.3), SQP),
        "the same, base acceleration at most 0.1 m/s^2, so that the end of Approach is out of reach": (
            pushed(9, x=0.3, y=-0.3),
            WEAK,
        ),
        "the same, fatrop": (pushed(9, x=0.3, y=-0.3), (*WEAK, "solver.kind=fatrop")),
        "a blow beyond the velocity limit, to 0.4 m/s": (pushed(8, x=-0.2, y=0.2), WEAK),
        "a blow of 0.5 rad/s": (pushed(8, theta=0.5), WEAK),
    },
}
"""What goes wrong from which sample on, and the keys that are changed, by kind."""


def physics(nodes: str = "100") -> Iterator[str]:
    """Yield the table of how far the plants rk4 and mujoco are apart on the transport task."""
    log = {"ticks": True, "plans": False, "shares": False}
    changes = {"controller.nodes": int(nodes), "log": log}
    tasks = (psmpc.load_task("transport", {**changes, "plant.kind": kind}) for kind in ("rk4", "mujoco"))
    runs = ours, theirs = [psmpc.simulate(task) for task in tasks]
    rows = {f"open loop, {name}": f"{replayed_apart(ours, *how):.1e}" for name, how in REPLAYS.items()}
    pose, angles = np.abs(ours.final["xi"] - theirs.final["xi"]), skill_in("task").angles(ours.problem.model)
    rows["closed loop: final pose"] = f"{np.delete(pose, angles).max():.1e} m, {pose[angles].max():.1e} rad"
    for name, key in {"switch times": "switch_time", "actual starts": "actual_start"}.items():
        rows[f"closed loop: {name}"] = f"{np.abs(ours.stages[key] - theirs.stages[key]).max():.1e} s"
    for name, run in zip(("rk4", "MuJoCo"), runs, strict=True):
        summary = run.summary()
        drift = f"{summary.momentum_error:.1e} N s, {summary.energy_error:.1e} J"
        rows[f"balance of momentum and energy, {name}"] = drift
    return markdown(rows.items(), f"rk4 against MuJoCo {mujoco.__version__}, N_s = {nodes}", "largest difference")


def replayed_apart(run: psmpc.Run, integrator: mujoco.mjtIntegrator, substeps: int, length: float) -> float:
    """Replay forces in MuJoCo, anew every so long [s]; return the largest difference of a coordinate or rate."""
    time, F, X = run.ticks["time"], run.ticks["F"], np.hstack([run.ticks["Q"], run.ticks["v"]])
    tick = float(time[1] - time[0])
    plant, count = MujocoPlant(run.problem.model, tick, substeps), round(min(length, time[-1]) / tick)
    plant.engine.opt.integrator = integrator
    starts = range(0, len(X) - 1, count)
    replayed = ((X[k : k + count + 1], plant.replay(X[k], F[k : k + count])) for k in starts)
    return max(float(np.abs(new[: len(logged)] - logged).max()) for logged, new in replayed)


def simulate(log: Path, changes: Sequence[str]) -> int:
    """Run `psmpc simulate transport` into a log in this process; return the exit code."""
    with patch.object(sys, "argv", ["psmpc", *arguments(log, changes)]), redirect_stderr(StringIO()):
        try:
            main()
        except SystemExit as left:
            return int(left.code or 0)
    return 0


def arguments(log: Path, changes: Sequence[str]) -> list[str]:
    """Return the words that run the transport task into a log, after `psmpc`."""
    settings = [word for change in changes for word in ("--set", change)]
    return ["simulate", "transport", "--quiet", "--no-figures", "-o", str(log), *settings]


def is_kept(log: Path) -> bool:
    """Run into a log once more; tell whether that is rejected and leaves it as it is."""
    before = log.read_bytes()
    return simulate(log, SQP) == 2 and log.read_bytes() == before


def in_the_loop(name: str, log: Path, fault: Fault, changes: Sequence[str]) -> Line:
    """Run the transport task with a fault, and once more, which must be rejected."""
    with injected(fault) as seen:
        code = simulate(log, changes)
    run, rate, force = psmpc.read_run(log), float(seen.rates.max()), float(seen.forces.max())
    what = run.summary().reason
    safe = rate <= RATES and force <= FORCE and is_kept(log) and code == (3 if "braked to rest" in what else 0)
    return {**row(name, what, code, run), "largest rate, force": f"{rate:.2f}, {force:.0f}"}, safe


def row(name: str, what: str, code: int, run: psmpc.Run | None) -> dict[str, str]:
    """Return what a run came to: samples by flag, stages that ended, and when it did."""
    flags, end = "", "no log is left" if code == 3 else "nothing is written"
    if run is not None:
        names = ("unmeasured", "solve_failed", "braking", "postponed")
        counts = {name: int(run[f"events/{name}"].sum()) for name in names}
        flags = ", ".join(f"{name} {count}" for name, count in counts.items() if count) or "none"
        done = int(np.isfinite(run.stages["switch_time"]).sum())
        end = f"{done} of {len(run.stage_names)}, {run.summary().duration:.1f} s"
    cells = {"fault": name, "what happens": what, "flags in the log": flags, "stages done, end": end}
    return {**cells, "largest rate, force": "", "exit code": str(code)}


def outputs(folder: Path) -> Iterator[Line]:
    """Yield what comes of logs that cannot be written, or not to their end."""
    taken, closed, gone = folder / "taken.h5", folder / "closed", folder / "gone"
    taken.write_text("mine")
    closed.mkdir(mode=0o555)
    gone.mkdir()
    unwritable = Path("/sys") if os.access(closed, os.W_OK) else closed  # where root, too, can make no file
    yield written("the log exists already", taken)
    yield written("the log is a device, /dev/full, with --force", Path("/dev/full"), options=("--force",))
    yield written("a directory that takes no files", unwritable / "log.h5")
    yield written("the disk is full after 3.5 MB", folder / "full.h5", limit=3_500_000)
    yield written("the directory is removed during the run", gone / "log.h5", removed=True)


def written(
    name: str, log: Path, limit: int = resource.RLIM_INFINITY, removed: bool = False, options: Sequence[str] = ()
) -> Line:
    """Run the transport task into a log that may grow no larger [bytes], or whose directory is removed meanwhile."""
    before = log.read_bytes() if log.is_file() else b""
    command = [*PSMPC, *arguments(log, SQP), *options]
    limited = partial(resource.setrlimit, resource.RLIMIT_FSIZE, (limit, limit))
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, preexec_fn=limited) as child:
        if removed:
            while not log.exists() and child.poll() is None:
                pass
            time.sleep(0.5)
            log.unlink()
            log.parent.rmdir()
        _, err = child.communicate()
    code = child.returncode
    said = err.splitlines()[-1].removeprefix("psmpc: ").replace(str(log), "LOG").replace(str(log.parent), "DIR")
    if code == 2:
        return row(name, said, code, None), not log.is_file() or log.read_bytes() == before
    run = psmpc.read_run(log) if log.exists() else None
    return row(name, said, code, run), code == 3 and (run is None or len(run.time) > 0)


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
        before, after: Samples it told of before the signal was sent, and after that.
        logged: Whether it has begun its log.
        lost: How long before the signal it told of each sample that is not in its log [s].
        took: Time from the signal to its end [s].
    """

    code: int
    before: int
    after: int
    logged: bool
    lost: list[float]
    took: float


def strike(number: signal.Signals, log: Path, changes: Sequence[str], samples: int, delay: float) -> Struck:
    """Run the transport task in a process of its own, and send it a signal so long [s] after so many samples."""
    command = [sys.executable, "-c", TELLING, *arguments(log, changes)]
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
    held = len(psmpc.read_run(log).time) if log.exists() else 0
    lost = [sent - at for at in told[held:]]
    return Struck(code if code >= 0 else 128 - code, before, len(told) - before, log.exists(), lost, took)


def struck(folder: Path, number: signal.Signals, name: str, changes: Sequence[str], count: int) -> Line:
    """Return the row of runs that a signal ends at random instants, and whether all were safe.

    A signal that a run cannot catch may take what came after the log was last written.
    """
    rng = np.random.default_rng(0)
    instants = [(int(samples), float(rng.uniform(0, 0.2))) for samples in rng.integers(0, 120, count)]
    logs = [folder / f"{name}-{i}.h5" for i in range(count)]
    with ThreadPoolExecutor(max_workers=2) as both:
        ended = list(both.map(lambda log, at: strike(number, log, changes, *at), logs, instants))
    before, lost = [one.before for one in ended if one.logged], [one.lost for one in ended]
    oldest = max(max(ages, default=0.0) for ages in lost)
    safe = all(one.code == 128 + number for one in ended) and all(is_kept(log) for log in logs if log.exists())
    safe &= oldest < UNWRITTEN if number == signal.SIGKILL else not any(lost)
    cells = {
        "signal": name,
        "runs": f"{count}",
        "sent after samples": f"{min(before)} to {max(before)}",
        "samples after it, at most": f"{max(one.after for one in ended)}",
        "ended within": f"{max(one.took for one in ended):.1f} s",
        "samples lost, at most": f"{max(map(len, lost))}",
        "computed in the last": f"{oldest:.1f} s",
        "whole logs, not overwritten": f"{len(before)} of {len(before)}" if safe else "NOT ALL",
        "exit code": ", ".join(sorted({str(one.code) for one in ended})),
    }
    return cells, safe


def checked(lines: Iterable[Line]) -> Iterator[str]:
    """Yield a table; then exit with 1 if a row is not as it should be."""
    return checked_by_kind({"": lines})


def checked_by_kind(tables: Mapping[str, Iterable[Line]]) -> Iterator[str]:
    """Yield tables with their titles; then exit with 1 if a row is not as it should be."""
    unsafe = []

    def rows(lines: Iterable[Line]) -> Iterator[dict[str, str]]:
        for cells, safe in lines:
            if not safe:
                unsafe.append(cells)
                sys.stderr.write(f"NOT AS IT SHOULD BE: {cells}\n")
            yield cells

    for title, lines in tables.items():
        yield from ("", f"{title}:", "") if title else ()
        yield from markdown(rows(lines))
    if unsafe:
        raise SystemExit(1)


def faults() -> Iterator[str]:
    """Yield the tables of faults in the loop, by kind, and in the output."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        tables: dict[str, Iterable[Line]] = {}
        for kind, named in FAULTS.items():
            logs = {fault: folder / f"{kind} {number}.h5" for number, fault in enumerate(named)}
            tables[kind] = [in_the_loop(fault, logs[fault], *how) for fault, how in named.items()]
        yield from checked_by_kind({**tables, "The output": outputs(folder)})


def signals() -> Iterator[str]:
    """Yield the table of runs that are ended by signals."""
    rows = [(number, number.name, SQP, INSTANTS) for number in (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)]
    rows += [(signal.SIGINT, f"SIGINT, {kind}", (*TASK, f"solver.kind={kind}"), 5) for kind in ("fatrop", "ipopt")]
    with TemporaryDirectory() as folder:
        yield from checked(struck(Path(folder), *row) for row in rows)


if __name__ == "__main__":
    command_line(physics, faults, signals)
