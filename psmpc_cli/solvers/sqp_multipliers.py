"""The multipliers of a window's NLP from those of its velocity form: for logs, and for other back-ends."""

import numpy as np

from psmpc_cli.ocp.parameters import Parameters
from psmpc_cli.ocp.transcription import Nlp
from psmpc_cli.ocp.velocity_form import Point, VelocityForm
from psmpc_cli.solvers.qp_multistage import QpSolution


def multipliers(
    nlp: Nlp, form: VelocityForm, point: Point, p: Parameters[np.ndarray], qp: QpSolution | None
) -> tuple[np.ndarray, np.ndarray]:
    """Return the multipliers of the bounds and of g at a point; zeros without a solved program.

    The rows that the velocity form does without follow from the Lagrangian being stationary in the inputs, in the
    measured state and in the durations at each node.
    """
    layout, n = nlp.layout, nlp.layout.n
    lam_x, lam_g = np.zeros(layout.size), np.zeros(len(nlp.equality))
    if qp is None:
        return lam_x, lam_g
    of, N, exact = layout.stage_of, form.nodes, form.weights[1] > 0
    h, u = form.steps(point, float(p.horizon)), form.inputs(point, float(p.horizon))
    share = (p.omega / p.scale / N)[of]
    W_r = np.array(p.control_weights)[of]
    velocity = 2 * (share * N[of])[:, None] * W_r * u + qp.inputs - (h / 2 if exact else 0.0) * qp.gaps
    lam_x[layout.state_index[1:]] = qp.X
    for s in range(len(N)):
        at = form.intervals(s)
        lam_x[layout.input_index(s)] = h[at] * qp.inputs[at]
    lam_g[nlp.gap_rows[:, :n]], lam_g[nlp.gap_rows[:, n : 2 * n]] = qp.gaps, velocity
    for s, rows in nlp.end_rows.items():
        lam_g[rows] = qp.ends[s]
    costs = form.node_costs(point, p)
    lam_g[nlp.x0_rows] = np.r_[qp.gaps[0] - costs.by_first_position, h[0] * qp.gaps[0] + velocity[0]]
    if layout.switches:
        drift = point.X[:-1, n:] + (h * u if exact else 0.0)
        local = share * (costs.L - p.offset[of] + (u**2 * W_r).sum(axis=1)) + costs.by_duration
        local -= ((qp.gaps * drift).sum(axis=1) + (velocity * u).sum(axis=1)) / N[of]
        later = np.vstack([local[:, None] * form.stage_durations[of], costs.terminal * form.stage_durations[-1]])
        lam_g[nlp.gap_rows[:, 2 * n :]] = -np.cumsum(later[::-1], axis=0)[::-1][1:]
        _set_durations(nlp, qp, lam_x, lam_g)
    return lam_x, lam_g


def _set_durations(nlp: Nlp, qp: QpSolution, lam_x: np.ndarray, lam_g: np.ndarray) -> None:
    """Set the multipliers of the bounds on the durations, and of sums of them."""
    bound = qp.tau.copy()
    bound[list(qp.shape.fixed)] = qp.fixed
    lam_x[nlp.layout.duration_index[0]] = bound
    if nlp.last_duration_row is not None:
        lam_g[nlp.last_duration_row] = -qp.together
    for s, value in zip(qp.shape.tied, qp.until, strict=True):
        lam_g[nlp.instant_rows[s]] = value
