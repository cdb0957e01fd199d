"""Soft limits in sequential quadratic programming: what their violations add to objective and model."""

from dataclasses import replace

import numpy as np

from psmpc_cli.ocp.gauss_newton import Linearization, linearize
from psmpc_cli.ocp.parameters import Parameters
from psmpc_cli.ocp.soft_limits import scaled_violations, shares_of_time
from psmpc_cli.ocp.velocity_form import Point, Residuals, VelocityForm
from psmpc_cli.solvers.sqp_limits import Limits


def beyond(limits: Limits, point: Point) -> np.ndarray:
    """Return rho times the violations of soft limits at a point, (K + 1, 2n); (K + 1, 0) where limits are hard."""
    if not limits.soft or limits.first is None:
        return np.zeros((len(point.X), 0))
    low, high = np.vstack([limits.first[0], limits.X_low]), np.vstack([limits.first[1], limits.X_high])
    return scaled_violations(point.X, low, high)


def penalized(form: VelocityForm, limits: Limits, point: Point, at: Residuals, horizon: float) -> Residuals:
    """Return what holds at a point, its violations counted in the objective."""
    penalty = (shares_of_time(form.steps(point, horizon)) * beyond(limits, point)).sum()
    return replace(at, objective=at.objective + float(penalty))


def linearize_penalized(form: VelocityForm, limits: Limits, point: Point, p: Parameters[np.ndarray]) -> Linearization:
    """Return the model at a point, its violations counted with the durations they last.

    What a step changes of the violations is left to the program, which knows it exactly.
    """
    model, share = linearize(form, point, p), form.stage_durations / form.nodes[:, None]
    by_tau = beyond(limits, point).sum(axis=1) @ shares_of_time(share[form.layout.stage_of])
    at = penalized(form, limits, point, model.at, float(p.horizon))
    return replace(model, at=at, gradient_tau=model.gradient_tau + by_tau)


def change_of_violations(form: VelocityForm, limits: Limits, point: Point, step: Point, horizon: float) -> float:
    """Return what a step changes of the penalty, as long as durations stay."""
    change = beyond(limits, point.moved(step, 1.0)) - beyond(limits, point)
    return float((shares_of_time(form.steps(point, horizon)) * change).sum())
