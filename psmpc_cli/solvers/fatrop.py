"""fatrop: a structure-exploiting interior-point method in the CasADi wheel. It takes no multipliers to start from."""

from psmpc_cli.solvers.base import Outcome, StructuredNlp
from psmpc_cli.solvers.casadi_nlp import CasadiSolver
from psmpc_cli.specs.task import SolverSpec

OUTCOMES: dict[object, Outcome] = {1: Outcome.ITERATION_LIMIT}

BARRIER_START = 1e-4
"""The first barrier parameter: the shifted plan is a good guess, and 1e-2 costs a third more iterations."""


def build(nlp: StructuredNlp, spec: SolverSpec) -> CasadiSolver:
    """Return fatrop on this NLP, its stage structure given explicitly."""
    structure = {"structure_detection": "manual", "N": len(nlp.nu) - 1, "nx": nlp.nx, "nu": nlp.nu, "ng": nlp.ng}
    fatrop = {"print_level": 0, "tol": spec.tolerance, "max_iter": spec.max_iterations, "mu_init": BARRIER_START}
    return CasadiSolver("fatrop", nlp, {**structure, "fatrop": fatrop}, OUTCOMES)
