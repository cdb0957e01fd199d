"""A solve in closed loop: whatever the back-end does, an outcome comes out."""

import logging
import time
from dataclasses import replace

import numpy as np

from psmpc_cli.ocp.window import Bounds
from psmpc_cli.solvers.base import Guess, Outcome, Solution, Solver

logger = logging.getLogger(__name__)


def attempt(solver: Solver, guess: Guess, p: np.ndarray, bounds: Bounds) -> Solution:
    """Return what a solver makes of the parameters p from the guess.

    A solver that raises, or whose point is not finite, has failed: the robot moves meanwhile, and the plan in force is
    still there. What it raised is reported.
    """
    began = time.perf_counter()
    try:
        solution = solver.solve(guess, p, bounds)
    except (ArithmeticError, RuntimeError, ValueError) as error:
        logger.warning("the solver raised %s: %s", type(error).__name__, str(error).partition("\n")[0])
        none = np.zeros(0)
        return Solution(Outcome.FAILED, guess.z, none, none, np.nan, 0, time.perf_counter() - began)
    if solution.outcome.usable and not np.isfinite(solution.z).all():
        return replace(solution, outcome=Outcome.FAILED)
    return solution
