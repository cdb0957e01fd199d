"""The interface every back-end has: solve a window's NLP, return a value that says how it went."""

from dataclasses import dataclass
from enum import Enum
from typing import Protocol

import casadi as ca
import numpy as np

from psmpc_cli.ocp.window import Bounds

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

    @property
    def usable(self) -> bool:
        """Whether the point may be applied."""
        return self in (Outcome.OPTIMAL, Outcome.FEASIBLE)


@dataclass(frozen=True, eq=False)
class Guess:
    """Where a solve starts.

    Attributes:
        z: Primal point.
        lam_x, lam_g: Multipliers of the bounds and of g, where there are any.
        warm: It is the last solution of the same stages, moved along by the time that has passed.
    """

    z: np.ndarray
    lam_x: np.ndarray | None = None
    lam_g: np.ndarray | None = None
    warm: bool = False


@dataclass(frozen=True, eq=False)
class Solution:
    """What a solve returned.

    Attributes:
        outcome: How it ended.
        z: Primal point.
        lam_x, lam_g: Multipliers of the bounds and of g; empty where the back-end has none.
        objective: J over the window's largest priority.
        iterations: Iterations used.
        wall_time: Time of the solve alone [s].
    """

    outcome: Outcome
    z: np.ndarray
    lam_x: np.ndarray
    lam_g: np.ndarray
    objective: float
    iterations: int
    wall_time: float


class StructuredNlp(Protocol):
    """What a back-end needs of an NLP: the problem, and the sizes of state, input and path rows at each node."""

    @property
    def problem(self) -> dict[str, ca.SX]:
        """The NLP as CasADi's solvers take it."""
        ...

    @property
    def nx(self) -> tuple[int, ...]:
        """Size of the state at each node."""
        ...

    @property
    def nu(self) -> tuple[int, ...]:
        """Size of the input at each node; 0 at the last."""
        ...

    @property
    def ng(self) -> tuple[int, ...]:
        """Number of path rows at each node."""
        ...


class Solver(Protocol):
    """A compiled NLP."""

    def solve(self, guess: Guess, p: np.ndarray, bounds: Bounds) -> Solution:
        """Solve for the parameters p from the guess."""
        ...
