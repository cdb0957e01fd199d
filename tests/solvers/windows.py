"""Windows of a run of the transport task, and how they are solved again."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from psmpc_cli.control import Command
from psmpc_cli.ocp.stage import Stage
from psmpc_cli.ocp.window import Window
from psmpc_cli.solvers import Outcome, Solution, Solver
from psmpc_cli.specs.task import SolverSpec

ONE = SolverSpec(kind="sqp")
CONVERGED = SolverSpec(kind="sqp", iterations=50)
FATROP = SolverSpec(kind="fatrop")
IPOPT = SolverSpec(kind="ipopt")


def chosen(decisions: list[Command], stages: int) -> Solution:
    """The solve in the middle of a series of windows over so many stages."""
    found = [command.solution for command in decisions if len(command.solution.window.stages) == stages]
    return found[len(found) // 2]


def again(solver: Solver, solved: Solution, warm: bool = True, within: float = np.inf) -> Solution:
    """Solve a window again from where the run started; warm, from the multipliers too."""
    start = replace(solved, outcome=Outcome.OPTIMAL, plan=solved.guess, duals=solved.guess_duals)
    return solver.solve(solved.window, solved.guess, start if warm else None, within)


def changed(solved: Solution, change: Callable[[Stage], Stage], *stages: int) -> Solution:
    """The same solve of a window some of whose stages are changed."""
    window: Window = solved.window
    every = tuple(change(stage) if s in stages else stage for s, stage in enumerate(window.stages))
    return replace(solved, window=replace(window, stages=every))


def far_away(stage: Stage) -> Stage:
    """The stage with its target 10 m away: no window has a solution that ends it."""
    return replace(stage, target=stage.target + np.r_[10.0, np.zeros(8)])
