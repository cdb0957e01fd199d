"""The Gauss-Newton model of a window in the velocity form: what a step of sequential quadratic programming minimizes.

The cost of the states is the square of a residual that carries `sqrt(omega_s tau_s / N_s / scale_s)`, so that the
durations enter it, and has the Gauss-Newton Hessian. The cost of the control, `|dQdot|^2 N_s / tau_s`, is convex in
velocities and duration together and has its exact one; the pending cost is linear. So the Hessian is positive
semidefinite.
"""

from dataclasses import dataclass

import numpy as np

from psmpc_cli.ocp.layout import Layout
from psmpc_cli.ocp.parameters import Parameters
from psmpc_cli.ocp.velocity_form import Point, Residuals, VelocityForm


@dataclass(frozen=True, eq=False)
class Linearization:
    """Quadratic model at a point; derivatives by x_k and the free durations.

    Attributes:
        at: Objective and constraints there.
        gradient, gradient_tau: (K + 1, 2n), (S,).
        positions: Upper triangle of the Hessian by Q_k, (K + 1, n, n).
        velocities: Its diagonal by Qdot_k, (K + 1, n).
        coupling: Its diagonal by (Qdot_k, Qdot_k+1), (K, n).
        arrow: By x_k and tau, (K + 1, 2n, S).
        durations: By tau, (S, S).
        gap_velocity: Of the gaps by Qdot_k and Qdot_k+1, one number an interval, (K, 2).
        gap_tau: By tau, (K, n, S).
        end_derivatives: Nonzeros of the end rows' Jacobians by x.
    """

    at: Residuals
    gradient: np.ndarray
    gradient_tau: np.ndarray
    positions: np.ndarray
    velocities: np.ndarray
    coupling: np.ndarray
    arrow: np.ndarray
    durations: np.ndarray
    gap_velocity: np.ndarray
    gap_tau: np.ndarray
    end_derivatives: dict[int, np.ndarray]


def linearize(form: VelocityForm, point: Point, p: Parameters[np.ndarray]) -> Linearization:
    """Return the quadratic model at a point."""
    horizon, layout, D = float(p.horizon), form.layout, form.stage_durations
    model = _Model(layout, form.durations(point, horizon))
    stages = range(len(form.nodes))
    costs = np.array(
        [_add_state_cost(model, form, s, point, p) + _add_control_cost(model, form, s, point, p) for s in stages]
    )
    terminal = _add_terminal_cost(model, form, point, p) if p.terminal else 0.0
    ends, (before, after) = form.ends(point, p), form.weights
    Qdot, of = point.X[:, layout.n :], layout.stage_of
    by_stage = -(before * Qdot[:-1] + after * Qdot[1:]) / form.nodes[of, None]
    return Linearization(
        at=Residuals(
            objective=form.objective(point, p, costs, terminal),
            costs=costs,
            terminal=terminal,
            gaps=form.gaps(point, horizon),
            ends={s: rows for s, (rows, _) in ends.items()},
        ),
        gradient=model.gradient,
        gradient_tau=D.T @ model.by_tau + p.pending * form.waiting,
        positions=model.positions,
        velocities=model.velocities,
        coupling=model.coupling,
        arrow=model.arrow @ D,
        durations=D.T @ (model.durations[:, None] * D),
        gap_velocity=-form.steps(point, horizon) * np.array(form.weights),
        gap_tau=by_stage[:, :, None] * D[of][:, None, :],
        end_derivatives={s: derivatives for s, (_, derivatives) in ends.items()},
    )


class _Model:
    """The sums of a linearization while it is put together; derivatives by the durations of all stages."""

    def __init__(self, layout: Layout, tau: np.ndarray) -> None:
        K, n, S = layout.K, layout.n, layout.switches
        self.tau = tau
        self.gradient = np.zeros((K + 1, 2 * n))
        self.positions = np.zeros((K + 1, n, n))
        self.velocities = np.zeros((K + 1, n))
        self.coupling = np.zeros((K, n))
        self.arrow = np.zeros((K + 1, 2 * n, S + 1))
        self.durations = np.zeros(S + 1)
        self.by_tau = np.zeros(S + 1)


def _add_state_cost(model: _Model, form: VelocityForm, s: int, point: Point, p: Parameters[np.ndarray]) -> float:
    """Add omega_s sum_i (e'We - offset) tau_s / N_s / scale_s; return it without omega_s."""
    tau, n, N, at = model.tau[s], form.layout.n, form.layout.nodes[s], form.intervals(s)
    reference, slope = form.reference(s, p, tau)
    c = p.omega[s] / p.scale[s] / N
    L, r, q, g, m, H = form.cost[s](point.X[at, :n], p.weights[s], reference[:, :N].T, slope[:, :N].T, rows=N)
    rows, columns = form.terms[s].hessian
    model.gradient[at, :n] += 2 * c * tau * g
    model.positions[at, rows, columns] += 2 * c * tau * H
    model.arrow[at, :n, s] += c * (2 * tau * m + g)
    model.durations[s] += c * (2 * tau * q + 2 * r + L / (2 * tau)).sum()
    model.by_tau[s] += c * (L - p.offset[s] + 2 * tau * r).sum()
    return float(tau * (L - p.offset[s]).sum() / p.scale[s] / N)


def _add_control_cost(model: _Model, form: VelocityForm, s: int, point: Point, p: Parameters[np.ndarray]) -> float:
    """Add omega_s sum_i |dQdot|^2_Wr N_s / tau_s / scale_s, the same as |u|^2_Wr tau_s / N_s.

    Returns it without omega_s.
    """
    n, tau, at = form.layout.n, model.tau[s], form.intervals(s)
    after = slice(at.start + 1, at.stop + 1)
    dv = point.X[after, n:] - point.X[at, n:]
    b = 2 * p.omega[s] / p.scale[s] * form.nodes[s] / tau * p.control_weights[s]
    cost = float((dv**2 @ p.control_weights[s]).sum()) * form.nodes[s] / tau / p.scale[s]
    effort = p.omega[s] * cost
    model.gradient[after, n:] += b * dv
    model.gradient[at, n:] -= b * dv
    model.velocities[after] += b
    model.velocities[at] += b
    model.coupling[at] -= b
    model.arrow[after, n:, s] -= b * dv / tau
    model.arrow[at, n:, s] += b * dv / tau
    model.durations[s] += 2 * effort / tau**2
    model.by_tau[s] -= effort / tau
    return float(cost)


def _add_terminal_cost(model: _Model, form: VelocityForm, point: Point, p: Parameters[np.ndarray]) -> float:
    """Add kappa omega_S (e'We - offset) / scale_S at the last node; return it without omega_S."""
    s, n = form.layout.switches, form.layout.n
    reference, slope = form.reference(s, p, model.tau[s])
    c = p.terminal * p.omega[s] / p.scale[s]
    found = form.cost[s](point.X[-1, :n], p.weights[s], reference[:, -1], slope[:, -1])
    L, r, q, g, m, H = (values[0] for values in found)
    rows, columns = form.terms[s].hessian
    model.gradient[-1, :n] += 2 * c * g
    model.positions[-1, rows, columns] += 2 * c * H
    model.arrow[-1, :n, s] += 2 * c * m
    model.durations[s] += 2 * c * q[0]
    model.by_tau[s] += 2 * c * r[0]
    return float(p.terminal * (L[0] - p.offset[s]) / p.scale[s])
