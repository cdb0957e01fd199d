"""Faults injected into runs from outside: solver, plant and sensors are wrapped."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any
from unittest.mock import patch

import numpy as np

from psmpc_cli.control import State
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.ocp.window import Window
from psmpc_cli.plant import Ticks
from psmpc_cli.simulation import run as running
from psmpc_cli.simulation.run import Experiment
from psmpc_cli.solvers import Outcome, Solution, Solver

When = Callable[[float], bool]
"""Tells whether something goes wrong at a time [s]."""


@dataclass(frozen=True)
class Fault:
    """What goes wrong at a time [s].

    Attributes:
        solved: What the controller gets instead of a solution.
        measured: What is measured instead of the state (2n,).
        moved: What the state (2n,) jumps to.
    """

    solved: Callable[[float, Solution], Solution] = lambda now, solution: solution
    measured: Callable[[float, np.ndarray], np.ndarray] = lambda now, x: x
    moved: Callable[[float, np.ndarray], np.ndarray] = lambda now, x: x


@dataclass
class Seen:
    """What the robot really did: the largest rates (n,) and forces (n,) at any tick, and its last true state (2n,)."""

    rates: np.ndarray = field(default_factory=lambda: np.zeros(1))
    forces: np.ndarray = field(default_factory=lambda: np.zeros(1))
    state: np.ndarray | None = None


class FaultySolver(Solver):
    """A solver whose solutions are spoilt."""

    def __init__(self, solver: Solver, fault: Fault) -> None:
        self.solver, self.fault = solver, fault

    def _solve(self, window: Window, guess: Plan, previous: Solution | None, within: float) -> Solution:
        return self.fault.solved(window.start, self.solver.solve(window, guess, previous, within))


@contextmanager
def injected(fault: Fault) -> Iterator[Seen]:
    """Let something go wrong in the runs that begin meanwhile, and record what the robot really does."""
    build, seen = running.build_experiment, Seen()

    def build_faulty(task: Any) -> Experiment:
        experiment = build(task)
        controller, step, advance = experiment.controller, experiment.controller.step, experiment.plant.advance

        def faulty_step(time: float, state: State, *of_object: Any) -> Any:
            return step(time, State.of(fault.measured(time, state.vector)), *of_object)

        def faulty_advance(start: float, x: np.ndarray, *rest: Any) -> Ticks:
            ticks = advance(start, x, *rest)
            X = ticks.states.copy()
            X[-1] = seen.state = fault.moved(float(ticks.time[-1]), X[-1])
            seen.rates = np.maximum(seen.rates, np.abs(X[:, len(x) // 2 :]).max(axis=0))
            seen.forces = np.maximum(seen.forces, np.abs(ticks.F).max(axis=0))
            return replace(ticks, states=X)

        controller.law.solver = FaultySolver(controller.law.solver, fault)
        controller.step, experiment.plant.advance = faulty_step, faulty_advance
        return experiment

    with patch.object(running, "build_experiment", build_faulty):
        yield seen


def during(first: float, samples: float, sample_time: float = 0.1) -> When:
    """Return whether a time [s] is one of so many samples from the first on."""
    return lambda now: first - 1e-6 < now < first + (samples - 0.5) * sample_time


def _spoilt(wrong: When, spoil: Callable[[Solution], Solution]) -> Fault:
    return Fault(solved=lambda now, solution: spoil(solution) if wrong(now) else solution)


def not_converging(wrong: When) -> Fault:
    """Return the fault of a solver that does not converge at the wrong times."""
    return _spoilt(wrong, lambda solution: replace(solution, outcome=Outcome.ITERATION_LIMIT))


def meaningless(wrong: When) -> Fault:
    """Return the fault of a solver that says it has converged, to no numbers, at the wrong times."""

    def spoil(solution: Solution) -> Solution:
        return replace(solution, plan=replace(solution.plan, X=np.full_like(solution.plan.X, np.nan)))

    return _spoilt(wrong, spoil)


def raising(wrong: When) -> Fault:
    """Return the fault of a solver that raises at the wrong times."""

    def spoil(solution: Solution) -> Solution:
        raise RuntimeError("Error in Function::call for 'window': evaluation failed")

    return _spoilt(wrong, spoil)


def unmeasured(wrong: When, *entries: int) -> Fault:
    """Return the fault of a measurement that is NaN at the wrong times, in these entries of x or in all of them."""

    def measured(now: float, x: np.ndarray) -> np.ndarray:
        lost = np.isin(np.arange(len(x)), entries) if entries else True
        return np.where(wrong(now) and lost, np.nan, x)

    return Fault(measured=measured)


def pushed(at: float, **rates: float) -> Fault:
    """Return the fault of a blow that changes the base's rates x, y [m/s] and theta [rad/s] at a time [s]."""
    change, wrong = [rates.get(name, 0.0) for name in ("x", "y", "theta")], during(at, 1)

    def moved(now: float, x: np.ndarray) -> np.ndarray:
        n = len(x) // 2
        return np.r_[x[:n], x[n : n + 3] + change, x[n + 3 :]] if wrong(now) else x

    return Fault(moved=moved)
