"""IPOPT: the general interior-point method in the CasADi wheel, warm started with multipliers where there are any."""

from psmpc_cli.solvers.base import Outcome, StructuredNlp
from psmpc_cli.solvers.casadi_nlp import CasadiSolver
from psmpc_cli.specs.task import SolverSpec

OUTCOMES: dict[object, Outcome] = {
    "Infeasible_Problem_Detected": Outcome.INFEASIBLE,
    "Restoration_Failed": Outcome.INFEASIBLE,
    "Maximum_Iterations_Exceeded": Outcome.ITERATION_LIMIT,
    "Solved_To_Acceptable_Level": Outcome.ITERATION_LIMIT,
    "Maximum_WallTime_Exceeded": Outcome.DEADLINE,
}

WARM = {
    "warm_start_init_point": "yes",
    "mu_init": 1e-5,
    "warm_start_bound_push": 1e-9,
    "warm_start_bound_frac": 1e-9,
    "warm_start_slack_bound_push": 1e-9,
    "warm_start_slack_bound_frac": 1e-9,
    "warm_start_mult_bound_push": 1e-9,
}
"""Options of a solve that starts from multipliers: a low barrier, and the guess is not pushed off its bounds."""


def build(nlp: StructuredNlp, spec: SolverSpec) -> CasadiSolver:
    """Return IPOPT on this NLP."""
    options: dict[str, object] = {
        "print_level": 0,
        "sb": "yes",
        "tol": spec.tolerance,
        "max_iter": spec.max_iterations,
        "mu_init": 1e-2,
        "acceptable_iter": 0,
    }
    if spec.deadline is not None:
        options["max_wall_time"] = spec.deadline
    return CasadiSolver("ipopt", nlp, {"ipopt": options}, OUTCOMES, {"ipopt": {**options, **WARM}})
