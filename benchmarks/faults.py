"""Faults injected into runs from outside: solver, plant and sensors are wrapped."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from psmpc_cli.control.controller import State
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.ocp.window import Window
from psmpc_cli.plant import Disturbance, Plant, Ticks
from psmpc_cli.simulation.run import Experiment
from psmpc_cli.solvers import Outcome, Solution, Solver

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
