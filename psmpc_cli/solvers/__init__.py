"""Solvers: a window and a guessed plan in, a solution out."""

from psmpc_cli.ocp.problem import Problem
from psmpc_cli.solvers.adjoint import AdjointSolver
from psmpc_cli.solvers.base import FEASIBLE, Outcome, Solution, Solver
from psmpc_cli.solvers.nlp import NlpSolver, Report
from psmpc_cli.solvers.sqp import SqpSolver
from psmpc_cli.specs.controller import SolverSpec

__all__ = ["FEASIBLE", "NlpSolver", "Outcome", "Report", "Solution", "Solver", "build_nlp_solver", "build_solver"]


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
    return SqpSolver(problem, spec, report) if spec.traits.real_time else build_nlp_solver(problem, spec, report)


def build_nlp_solver(problem: Problem, spec: SolverSpec, report: Report | None = None) -> NlpSolver:
    """Build a back-end that solves each window to its optimum; arguments are those of `build_solver`."""
    return (AdjointSolver if spec.traits.by_costates else NlpSolver)(problem, spec, report)
