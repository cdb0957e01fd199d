"""Limits on the states at a window's nodes, and what a violation costs where they are soft.

See docs/formulation.md, section 4.
"""

from collections.abc import Sequence

import numpy as np

from psmpc_cli.ocp.layout import Layout
from psmpc_cli.ocp.stages import Stage

PENALTY = 1e4
"""rho: what a second beyond a limit costs, in J over the largest priority per m, rad, m/s or rad/s.

The violations are integrated over time by the trapezoidal rule: counted node by node, one and the same motion would
cost less with a later instant, whose intervals are longer. Where no multiplier of a limit reaches rho times its node's
share of time, the soft optimum is the hard one; docs/decisions.md has the multipliers of whole runs.
"""


def node_limits(layout: Layout, stages: Sequence[Stage]) -> tuple[np.ndarray, np.ndarray]:
    """Return low and high of [Q; Qdot] at the nodes, (K + 1, 2n) each; at a switch the limits of both stages hold."""
    low, high = np.full((layout.K + 1, 2 * layout.n), -np.inf), np.full((layout.K + 1, 2 * layout.n), np.inf)
    for s, stage in enumerate(stages):
        at, limits = slice(layout.first_node[s], layout.first_node[s + 1] + 1), stage.limits
        low[at] = np.maximum(low[at], np.concatenate([limits.position_low, limits.velocity_low]))
        high[at] = np.minimum(high[at], np.concatenate([limits.position_high, limits.velocity_high]))
    return low, high


def scaled_violations(X: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return rho times that by which states (..., 2n) lie beyond low or high, 0 where they do not."""
    return np.asarray(PENALTY * np.maximum(np.maximum(low - X, X - high), 0.0))


def shares_of_time(steps: np.ndarray) -> np.ndarray:
    """Return what the nodes stand for, (K + 1, columns), of intervals (K, columns): half of either neighbour."""
    none = np.zeros((1, steps.shape[1]))
    return np.asarray(np.vstack([none, steps]) + np.vstack([steps, none])) / 2


def worst_violations(layout: Layout, z: np.ndarray) -> np.ndarray:
    """Return by how much a decision vector violates soft limits at worst after its first node, (2n,); (0,) if hard."""
    return np.asarray(z[layout.violation_index[1:]].max(axis=0) / PENALTY)


def own_violations(x0: np.ndarray, stages: Sequence[Stage]) -> np.ndarray:
    """Return by how much a measured state (2n,) violates the limits of a window's first stage itself, (2n,)."""
    limits = stages[0].limits
    low = np.concatenate([limits.position_low, limits.velocity_low])
    high = np.concatenate([limits.position_high, limits.velocity_high])
    return scaled_violations(x0, low, high) / PENALTY
