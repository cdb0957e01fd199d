"""The curvature of end conditions, which the Gauss-Newton model of a window lacks where they are about poses.

Of the Lagrangian's second derivatives it is the part that matters: the multipliers of an end condition are as large as
what a second of waiting costs, whatever the stage itself weighs. Without it steps overshoot in the motion that is
flat in the costs, more than twofold in places, and one iteration a sample chatters.
"""

from collections.abc import Mapping
from dataclasses import replace

import casadi as ca
import numpy as np

from psmpc_cli.native.functions import ArrayFunction
from psmpc_cli.ocp.gauss_newton import Linearization
from psmpc_cli.ocp.parameters import Parameters
from psmpc_cli.ocp.stage_terms import StageTerms
from psmpc_cli.ocp.velocity_form import Point, VelocityForm


class EndCurvature:
    """The end conditions of the windows of one shape."""

    def __init__(self, form: VelocityForm) -> None:
        self._first_node = form.layout.first_node
        functions = {s: _second_derivatives(terms, form.layout.n) for s, terms in enumerate(form.terms)}
        self._of = {s: ArrayFunction(function) for s, function in functions.items() if function is not None}

    @property
    def stages(self) -> tuple[int, ...]:
        """Stages of the window whose end condition is curved."""
        return tuple(self._of)

    def added_to(
        self, model: Linearization, point: Point, p: Parameters[np.ndarray], multipliers: Mapping[int, np.ndarray]
    ) -> Linearization:
        """Return the model with the second derivatives by Q of the end rows, each times its multiplier by stage."""
        positions = model.positions.copy()
        for s, of_rows in multipliers.items():
            if s in self._of:
                node = self._first_node[s + 1]
                positions[node] += self._of[s](point.X[node], p.targets[s], of_rows)[0].T
        return replace(model, positions=positions)


def _second_derivatives(terms: StageTerms, n: int) -> ca.Function | None:
    """Return x, target, multipliers -> upper triangle of the derivatives by Q (n, n); None where they are 0."""
    if not terms.end_rows:
        return None
    x, target = ca.SX.sym("x", 2 * n), ca.SX.sym("target", terms.end.size1_in(1))
    multipliers = ca.SX.sym("multipliers", terms.end_rows)
    rows, _ = terms.end(x, target)
    hessian, _ = ca.hessian(ca.dot(multipliers, rows), x)
    upper = ca.triu(hessian[:n, :n])
    if not upper.nnz():
        return None
    return ca.Function("end_curvature", [x, target, multipliers], ca.cse([ca.densify(upper)]))
