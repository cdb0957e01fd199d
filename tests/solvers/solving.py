"""Recorded windows, some of their stages changed, solved again by other back-ends."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np

from psmpc_cli.ocp.problem import Problem
from psmpc_cli.ocp.stage import Stage
from psmpc_cli.ocp.window import Window
from psmpc_cli.solvers import Outcome, Solution, Solver, build_solver
from psmpc_cli.specs.controller import SolverSpec

from .recorded import RecordedSolve, recorded

ONE = SolverSpec(kind="sqp")
CONVERGED = SolverSpec(kind="sqp", iterations=50)
FATROP = SolverSpec(kind="fatrop")
IPOPT = SolverSpec(kind="ipopt")
ADJOINT = SolverSpec(kind="adjoint")


MIDDLE = {1: 161, 2: 122, 3: 97}
"""By the number of its stages, a window of the transport mission: in the middle of those with so many."""


def middle_window_over(count: int) -> RecordedSolve:
    """Return a solve of the transport mission whose window holds so many stages."""
    return recorded("transport")[MIDDLE[count]]


@cache
def solver_for(problem: Problem, spec: SolverSpec) -> Solver:
    """Return the solver of a problem; the same one every time, since it builds its functions at its first window."""
    return build_solver(problem, spec)


def again(solver: Solver, solve: RecordedSolve, warm: bool = True, within: float = np.inf) -> Solution:
    """Solve a window from where the mission's solve began; warm, from its multipliers too."""
    before = Solution(
        outcome=Outcome.OPTIMAL,
        plan=solve.guess,
        objective=np.nan,
        iterations=0,
        wall_time=0.0,
        window=solve.window,
        guess=solve.guess,
        duals=solve.duals,
    )
    return solver.solve(solve.window, solve.guess, before if warm else None, within)


def changed(solve: RecordedSolve, change: Callable[[Stage], Stage], *stages: int) -> RecordedSolve:
    """Return the same solve of a window some of whose stages are changed."""
    window: Window = solve.window
    every = tuple(change(stage) if s in stages else stage for s, stage in enumerate(window.stages))
    return replace(solve, window=replace(window, stages=every))


def far_away(stage: Stage) -> Stage:
    """Return the stage with its target 10 m away: no window has a solution that ends it."""
    return stage.with_target(stage.target + np.r_[10.0, np.zeros(8)])
