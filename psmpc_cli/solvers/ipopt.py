"""IPOPT: the general interior-point method, from the CasADi wheel, warm started with multipliers where there are any."""

from psmpc_cli.ocp.transcription import Nlp
from psmpc_cli.solvers.base import Outcome
from psmpc_cli.solvers.casadi_nlp import CasadiSolver
from psmpc_cli.specs.task import SolverSpec

OUTCOMES: dict[object, Outcome] = {
    "Infeasible_Problem_Detected": Outcome.INFEASIBLE,
    "Restoration_Failed": Outcome.INFEASIBLE,
    "Maximum_Iterations_Exceeded": Outcome.ITERATION_LIMIT,
    "Solved_To_Acceptable_Level": Outcome.ITERATION_LIMIT,
}


def build(nlp: Nlp, spec: SolverSpec) -> CasadiSolver:
    """Return IPOPT on this NLP."""
    options = {
        "print_level": 0,
        "sb": "yes",
        "tol": spec.tolerance,
        "max_iter": spec.max_iterations,
        "mu_init": 1e-2,
        "acceptable_iter": 0,
    }
    return CasadiSolver("ipopt", nlp, {"ipopt": options}, OUTCOMES)
