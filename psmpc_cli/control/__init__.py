"""Controllers: the moving sequence, warm starts, and what each sample decides."""

from psmpc_cli.control.controller import SwitchingController
from psmpc_cli.control.htmpc import HierarchicalController
from psmpc_cli.ocp.problem import Problem
from psmpc_cli.solvers import LevelSolver, Solver


def build_controller(problem: Problem, solver: Solver) -> SwitchingController:
    """Return the controller a task asks for, its windows solved by a solver."""
    if problem.spec.controller.kind == "htmpc":
        return HierarchicalController(problem, solver, LevelSolver(problem, problem.spec.solver))
    return SwitchingController(problem, solver)
