"""The interface of every back-end: a window and a guessed plan in, a solution out that says how the solve ended."""

import logging
import time
from abc import ABC, abstractmethod
from copy import copy
from dataclasses import dataclass, field, replace
from enum import Enum
from math import isfinite

import numpy as np

from psmpc_cli.ocp.plan import Plan
from psmpc_cli.ocp.window import Window, on_mesh

logger = logging.getLogger(__name__)

FEASIBLE = 1e-4
"""By how much an iterate that is not converged may violate a constraint and still count [m, rad, m/s, rad/s, s]."""


class Outcome(Enum):
    """How a solve ended; the value is advice to the user."""

    OPTIMAL = "converged"
    FEASIBLE = "not iterated to convergence, but within 1e-4 of every constraint: the plan counts"
    INFEASIBLE = (
        "no point meets all constraints: lengthen the horizon, loosen the end condition's tolerance or the limits"
    )
    ITERATION_LIMIT = (
        "not converged: raise solver.max_iterations, loosen solver.tolerance, or look for conflicting limits"
    )
    DEADLINE = (
        "constraints were still violated by more than 1e-4 at the deadline: raise solver.deadline, or lower "
        "controller.nodes"
    )
    FAILED = "the solver broke down numerically: look for weights or priorities many orders of magnitude apart"
    TIMEOUT = (
        "the solver did not return, and was ended after 30 s of processor time: choose another solver.kind, or "
        "look for weights or priorities many orders of magnitude apart"
    )

    @property
    def usable(self) -> bool:
        """Whether the point may be applied."""
        return self in (Outcome.OPTIMAL, Outcome.FEASIBLE)


@dataclass(frozen=True, eq=False)
class Solution:
    """What a solve of a window returned.

    Attributes:
        outcome: How it ended.
        plan: The plan on the window's mesh; the last iterate where the outcome is not usable.
        objective: J over the window's largest priority.
        iterations: Iterations used.
        wall_time: Time of the solve alone [s].
        window: The window.
        guess: The plan it started from, on the window's mesh.
        warm: It started from the solution of the same stages at the sample before.
        costs: Normalized cost integral of each stage, without priorities, (S + 1,), those of kept stages before. Paper
            eq. (16).
        terminal: Normalized terminal cost of the last stage, times kappa.
        violations: By how much nodes violate soft limits at worst, (2n,) [m, rad, m/s, rad/s]; (0,) if hard.
        duals: Multipliers that can start the next solve, in the back-end's own order; (0,) if it has none. Another
            back-end ignores them.
        guess_duals: Those that this one started from.
        bound_multiplier: Multiplier of the window's `cost_bound`; NaN without one.
        basin: Which guess of the switch times won, 0 the shifted plan's own; -1 where there was no other; see
            `multistart`.
    """

    outcome: Outcome
    plan: Plan
    objective: float
    iterations: int
    wall_time: float
    window: Window
    guess: Plan
    warm: bool = False
    costs: np.ndarray = field(default_factory=lambda: np.zeros(0))
    terminal: float = 0.0
    violations: np.ndarray = field(default_factory=lambda: np.zeros(0))
    duals: np.ndarray = field(default_factory=lambda: np.zeros(0))
    guess_duals: np.ndarray = field(default_factory=lambda: np.zeros(0))
    bound_multiplier: float = np.nan
    basin: int = -1

    def __repr__(self) -> str:
        stages = ", ".join(stage.name for stage in self.window.stages)
        outcome = self.outcome.name.lower().replace("_", " ")
        return f"<Solution of {stages}: {outcome} after {self.iterations} iterations, J {self.J:g}>"

    @property
    def costs_of_stages(self) -> np.ndarray:
        """The costs with those of one stage before and after a switch as one."""
        if not len(self.costs):
            return self.costs
        indices = self.window.indices
        kept = len(self.costs) - len(indices)
        first = [place for place, index in enumerate(indices) if index not in indices[:place]]
        return np.add.reduceat(self.costs, [*range(kept), *(kept + place for place in first)])

    @property
    def J(self) -> float:
        """The objective in the task's own priorities."""
        return self.objective * float(self.window.omega.max())


class Solver(ABC):
    """A back-end for the windows of one problem.

    Attributes:
        deadline: Time after which a solve stops [s]; infinite by default.
    """

    deadline = np.inf
    _stop_at: float | None = None
    _most_iterations: int | None = None

    def stopping(self, stop_at: float, most_iterations: int | None = None) -> "Solver":
        """Return this solver with one end for all its solves, by time or, where it is `sqp`, by iterations.

        Args:
            stop_at: When they have to stop, an instant of `time.perf_counter` [s].
            most_iterations: Of each solve; by default as the solver's settings say.
        """
        shared = copy(self)
        shared._stop_at = stop_at
        shared._most_iterations = most_iterations
        return shared

    def stop_time(self, began: float) -> float:
        """Return when a solve that began at an instant has to stop; both are of `time.perf_counter` [s]."""
        return began + self.deadline if self._stop_at is None else self._stop_at

    def solve(self, window: Window, guess: Plan, previous: Solution | None = None, within: float = np.inf) -> Solution:
        """Solve the optimal control problem of one prediction horizon (a window), started from a guessed plan.

        What the back-end raises is logged and not raised, since the robot moves meanwhile and goes on with its plan: a
        solve that raised, did not return, or has a plan that is not finite is returned as a failed one.

        Args:
            window: The window: stages, measured state, bounds and all other numbers.
            guess: The guessed plan, read at the nodes of the window; its switch times (S,) [s] are those of the window.
            previous: The solution of the sample before. It starts the solve too (a warm start: multipliers, fewer
                iterations) where it is usable and its stages are the same, or the last of them.
            within: Durations of stages stay within so many seconds of the guessed ones; 0 holds the switch times.

        Returns:
            The solution. Whether its plan may be applied is `solution.outcome.usable`.
        """
        guess = on_mesh(guess, window)
        warm_start = previous if previous is not None and _can_start(previous, window) else None
        began = time.perf_counter()
        try:
            solution = self._solve(window, guess, warm_start, within)
        except (ArithmeticError, RuntimeError, ValueError, TimeoutError) as error:
            logger.warning("the solver raised %s: %s", type(error).__name__, str(error).partition("\n")[0])
            outcome = Outcome.TIMEOUT if isinstance(error, TimeoutError) else Outcome.FAILED
            return Solution(outcome, guess, np.nan, 0, time.perf_counter() - began, window, guess)
        X = solution.plan.X
        u = solution.plan.u
        is_finite = isfinite(np.vdot(X, X) + np.vdot(u, u))  # one entry that is not makes the sum so
        if solution.outcome.usable and not is_finite:
            return replace(solution, outcome=Outcome.FAILED)
        return solution

    @abstractmethod
    def _solve(self, window: Window, guess: Plan, previous: Solution | None, within: float) -> Solution:
        """Solve a window from a guess on its mesh; `previous`, if any, is a solution that can start it."""


def _can_start(previous: Solution, window: Window) -> bool:
    """Tell whether a solution can start the solve of a window: of the same stages, or of more that are over now."""
    stages = window.indices
    return previous.window.indices[-len(stages) :] == stages and previous.outcome.usable
