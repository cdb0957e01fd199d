"""The NLP back-ends by their name in a task file."""

from collections.abc import Callable

from psmpc_cli.ocp.transcription import Nlp
from psmpc_cli.solvers import fatrop, ipopt
from psmpc_cli.solvers.base import Guess, Outcome, Solution, Solver
from psmpc_cli.specs.task import SolverSpec

__all__ = ["Guess", "Outcome", "Solution", "Solver", "build_solver"]

_BUILD: dict[str, Callable[[Nlp, SolverSpec], Solver]] = {"fatrop": fatrop.build, "ipopt": ipopt.build}


def build_solver(nlp: Nlp, spec: SolverSpec) -> Solver:
    """Return the back-end a task asks for, compiled for this NLP."""
    return _BUILD[spec.kind](nlp, spec)
