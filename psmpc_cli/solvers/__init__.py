"""Solvers: a window and a guessed plan in, a solution out."""

from psmpc_cli.ocp.problem import Problem
from psmpc_cli.solvers.base import FEASIBLE, Outcome, Solution, Solver
from psmpc_cli.solvers.nlp import NlpSolver, Report
from psmpc_cli.solvers.sqp import SqpSolver
from psmpc_cli.specs.task import SolverSpec

__all__ = ["FEASIBLE", "NlpSolver", "Outcome", "Report", "Solution", "Solver", "build_solver"]


def build_solver(
    problem: Problem,
    spec: SolverSpec | None = None,
    report: Report | None = None,
) -> Solver:
    """Build the back-end that a problem's task names, or another one.

    Args:
        problem: The problem.
        spec: Back-end and settings; default those of the task.
        report: Takes the lines of the table of iterations.
    """
    spec = problem.spec.solver if spec is None else spec
    return SqpSolver(problem, spec, report) if spec.traits.real_time else NlpSolver(problem, spec, report)
