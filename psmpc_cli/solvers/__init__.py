"""The NLP back-ends by their name in a task file."""

from collections.abc import Callable

from psmpc_cli.solvers import fatrop, ipopt, sqp
from psmpc_cli.solvers.attempt import attempt
from psmpc_cli.solvers.base import Guess, Outcome, Solution, Solver, StructuredNlp
from psmpc_cli.specs.task import SolverSpec

__all__ = ["Guess", "Outcome", "Solution", "Solver", "StructuredNlp", "attempt", "build_solver"]

_BUILD: dict[str, Callable[[StructuredNlp, SolverSpec], Solver]] = {
    "fatrop": fatrop.build,
    "ipopt": ipopt.build,
    "sqp": sqp.build,
}


def build_solver(nlp: StructuredNlp, spec: SolverSpec) -> Solver:
    """Return the back-end a task asks for, compiled for this NLP."""
    return _BUILD[spec.kind](nlp, spec)
