"""Faults injected into runs from outside: solver, plant and sensors are wrapped, and signals sent to processes."""

import contextlib
import io
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from unittest.mock import patch

import numpy as np

from psmpc_cli.cli.main import main
from psmpc_cli.control.controller import State
from psmpc_cli.logs.run import read_run
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.ocp.window import Window
from psmpc_cli.plant import Disturbance, Plant, Ticks
from psmpc_cli.simulation import run as running
from psmpc_cli.simulation.run import Experiment
from psmpc_cli.solvers import Outcome, Solution, Solver
from psmpc_cli.specs.load import Task

Spoil = Callable[[float, Callable[[], Solution]], Solution]
"""Given the time of a window [s] and its solve, returns what the controller gets instead."""

Show = Callable[[float, np.ndarray], np.ndarray]
"""Given a time [s] and the state then (2n,), returns another one."""


@dataclass(frozen=True)
class Fault:
    """What goes wrong.

    Attributes:
        spoil: What becomes of a solve.
        blind: What is measured instead of the state.
        push: What the state jumps to.
    """

    spoil: Spoil = lambda now, solve: solve()
    blind: Show = lambda now, x: x
    push: Show = lambda now, x: x


@dataclass
class Seen:
    """What the robot really did: the largest rates (n,) and forces (n,) at any tick, and its last true state (2n,)."""

    rates: np.ndarray = field(default_factory=lambda: np.zeros(1))
    forces: np.ndarray = field(default_factory=lambda: np.zeros(1))
    x: np.ndarray | None = None


class FaultySolver(Solver):
    """A solver whose solutions are spoilt."""

    def __init__(self, solver: Solver, spoil: Spoil) -> None:
        self.solver, self.spoil = solver, spoil

    def _solve(self, window: Window, guess: Plan, previous: Solution | None, within: float) -> Solution:
        return self.spoil(window.start, lambda: self.solver.solve(window, guess, previous, within))


class FaultyPlant:
    """A plant that is pushed."""

    def __init__(self, plant: Plant, push: Show, seen: Seen) -> None:
        self.plant, self.push, self.seen = plant, push, seen

    def advance(
        self,
        start: float,
        x: np.ndarray,
        u: np.ndarray,
        disturbance: Disturbance | None = None,
        closed: np.ndarray | None = None,
    ) -> Ticks:
        """Advance, and be pushed at the end of it."""
        ticks, seen = self.plant.advance(start, x, u, disturbance, closed), self.seen
        X = ticks.X.copy()
        X[-1] = seen.x = self.push(float(ticks.time[-1]), X[-1])
        seen.rates = np.maximum(seen.rates, np.abs(X[:, len(x) // 2 :]).max(axis=0))
        seen.forces = np.maximum(seen.forces, np.abs(ticks.F).max(axis=0))
        return replace(ticks, X=X)


def inject(experiment: Experiment, fault: Fault, seen: Seen) -> Experiment:
    """Return an experiment in which something goes wrong."""
    step = experiment.controller.step
    experiment.controller.step = lambda time, state, object_pose: step(
        time, State.of(fault.blind(time, state.x)), object_pose
    )
    experiment.controller.solver = FaultySolver(experiment.controller.solver, fault.spoil)
    return replace(experiment, plant=FaultyPlant(experiment.plant, fault.push, seen))


@dataclass(frozen=True)
class Ran:
    """What came of a command: its exit code, what it wrote, and what the robot really did."""

    code: int
    out: str
    err: str
    seen: Seen


def psmpc(fault: Fault, *arguments: str) -> Ran:
    """Run a command of psmpc, in this process, on an experiment with a fault."""
    build, seen = running.build_experiment, Seen()

    def faulty(loaded: Task) -> Experiment:
        return inject(build(loaded), fault, seen)

    out, err, code = io.StringIO(), io.StringIO(), 0
    with (
        patch.object(running, "build_experiment", faulty),
        patch.object(sys, "argv", ["psmpc", *arguments]),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        try:
            main()
        except SystemExit as left:
            code = int(left.code or 0)
    return Ran(code, out.getvalue(), err.getvalue(), seen)


def simulate(fault: Fault, log: Path, task: str, *changes: str) -> Ran:
    """Run `psmpc simulate` on a task with keys changed, into a log, without figures."""
    settings = [word for change in changes for word in ("--set", change)]
    return psmpc(fault, "simulate", task, "--no-figures", "-o", str(log), *settings)


def during(first: float, samples: float, sample_time: float = 0.1) -> Callable[[float], bool]:
    """Return whether a time [s] is one of so many samples from the first on."""
    return lambda now: first - 1e-6 < now < first + (samples - 0.5) * sample_time


def not_converging(wrong: Callable[[float], bool]) -> Fault:
    """Return the fault of a solver that does not converge at the wrong times."""
    return Fault(lambda now, solve: replace(solve(), outcome=Outcome.ITERATION_LIMIT) if wrong(now) else solve())


def raising(wrong: Callable[[float], bool]) -> Fault:
    """Return the fault of a solver that raises at the wrong times."""

    def spoil(now: float, solve: Callable[[], Solution]) -> Solution:
        if wrong(now):
            raise RuntimeError("Error in Function::call for 'window': evaluation failed")
        return solve()

    return Fault(spoil)


def meaningless(wrong: Callable[[float], bool]) -> Fault:
    """Return the fault of a solver that says it has converged, to no numbers, at the wrong times."""

    def spoil(now: float, solve: Callable[[], Solution]) -> Solution:
        solution = solve()
        plan = replace(solution.plan, X=np.full_like(solution.plan.X, np.nan))
        return replace(solution, plan=plan) if wrong(now) else solution

    return Fault(spoil)


def unmeasured(wrong: Callable[[float], bool], *entries: int) -> Fault:
    """Return the fault of a measurement that is NaN at the wrong times, in these entries of x or in all of them."""

    def blind(now: float, x: np.ndarray) -> np.ndarray:
        if not wrong(now):
            return x
        return np.where(np.isin(np.arange(len(x)), entries) | (not entries), np.nan, x)

    return Fault(blind=blind)


def pushed(at: float, **rates: float) -> Fault:
    """Return the fault of a blow that changes the base's rates x, y [m/s] and theta [rad/s] at a time [s]."""
    change = [rates.get(name, 0.0) for name in ("x", "y", "theta")]

    def push(now: float, x: np.ndarray) -> np.ndarray:
        if not during(at, 1)(now):
            return x
        n = len(x) // 2
        return np.r_[x[:n], x[n : n + 3] + change, x[n + 3 :]]

    return Fault(push=push)


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
    held = len(read_run(log).time) if log.exists() else None
    return Struck(code if code >= 0 else 128 - code, before, len(told), held, err, took)
