"""What a plan costs over time, whatever the mesh it was made on."""

import numpy as np

from psmpc_cli.ocp.costs import StageCosts
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.ocp.window import Window

SIMPSON = np.array([1.0, 4.0, 2.0, 4.0, 1.0]) / 12
"""Weights of a plan's interval read at five points."""


def cost_over_time(window: Window, plan: Plan, costs: StageCosts) -> float:
    """Return J over the window's largest priority with integrals in place of the sums of (20).

    The sums differ from mesh to mesh by more than the plans do. Between two nodes the control is constant and the
    states are known exactly, so that plans of different meshes can be held against each other.
    """
    omega, begins = window.omega / window.omega.max(), np.r_[window.start - window.elapsed, plan.instants]
    J = window.pending_cost * float((plan.instants - window.start).sum())
    nodes = np.r_[0, np.cumsum(window.nodes)]
    for s, stage in enumerate(window.stages):
        k = np.arange(nodes[s], nodes[s + 1])
        dt, n = np.diff(plan.times)[k], plan.u.shape[1]
        since = (np.linspace(0.0, 1.0, len(SIMPSON)) * dt[:, None]).ravel()
        X, u = np.repeat(plan.X[k], len(SIMPSON), axis=0), np.repeat(plan.u[k], len(SIMPSON), axis=0)
        X[:, :n] += since[:, None] * X[:, n:] + since[:, None] ** 2 / 2 * u
        X[:, n:] += since[:, None] * u
        Lbar = costs.at(stage, X, u, np.repeat(plan.times[k], len(SIMPSON)) + since - begins[s])
        L = (Lbar.reshape(len(k), -1) - window.offset[s]) / window.scale[s]
        J += float(omega[s] * (L @ SIMPSON * dt).sum())
    last = costs.at(window.stages[-1], plan.X[-1:], np.zeros((1, plan.u.shape[1])), plan.times[-1:] - begins[-1])
    terminal = (float(last[0]) - window.offset[-1]) / window.scale[-1]
    return float(J + window.terminal_cost * omega[-1] * terminal)
