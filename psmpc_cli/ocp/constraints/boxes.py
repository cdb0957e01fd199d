"""Limits on positions, velocities and accelerations: bounds of single numbers at nodes and over intervals.

They are diagonal in the quadratic programs, which is a path of its own in the kernel. Limits of velocities are of v:
in a chart about an attitude they are moved by Qdot - v as the guess has it. Limits of states may be soft.
"""

from collections.abc import Sequence

import numpy as np

from psmpc_cli.ocp.plan import Grid, Plan
from psmpc_cli.ocp.stage import Stage
from psmpc_cli.ocp.window import Window

PENALTY = 1e4
"""rho: what a second beyond a soft limit costs, in J over the largest priority per m, rad, m/s or rad/s.

The violations are integrated over time by the trapezoidal rule: counted node by node, one and the same motion would
cost less with a later instant, whose intervals are longer. Where no multiplier of a limit reaches rho times its node's
share of time, the soft optimum is the hard one; docs/decisions.md has the multipliers of whole runs.
"""

NARROWEST_SOFT = 1e-4
"""Soft bounds nearer to each other than this [m, rad, m/s, rad/s] are moved apart to it.

Nothing but the width tells their two multipliers apart, and at 1e-5 some programs fail.
"""


def node_limits(grid: Grid, stages: Sequence[Stage]) -> tuple[np.ndarray, np.ndarray]:
    """Return low and high of [Q; Qdot] at the nodes, (K + 1, 2n) each; at a switch the limits of both stages hold."""
    low = np.full((grid.K + 1, 2 * grid.n), -np.inf)
    high = np.full((grid.K + 1, 2 * grid.n), np.inf)
    for s, stage in enumerate(stages):
        at = slice(grid.first_node[s], grid.first_node[s + 1] + 1)
        limits = stage.limits
        low[at] = np.maximum(low[at], limits.state_low)
        high[at] = np.minimum(high[at], limits.state_high)
    return low, high


def shift_limits(window: Window, guess: Plan, *limits: np.ndarray) -> None:
    """Turn limits of [Q; v] at the last nodes (nodes, 2n) into those of [Q; Qdot] in the chart about a guess."""
    shift = window.shift_of_limits(guess)
    for bounds in limits:
        nodes, size = bounds.shape
        bounds[:, size // 2 :] += shift[-nodes:]


def acceleration_limits(grid: Grid, stages: Sequence[Stage]) -> tuple[np.ndarray, np.ndarray]:
    """Return low and high of the accelerations over the intervals, (K, n) each; infinite where there is no limit."""
    low = np.array([stage.limits.acceleration_low for stage in stages])
    high = np.array([stage.limits.acceleration_high for stage in stages])
    return low[grid.stage_of], high[grid.stage_of]


def scaled_violations(X: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return rho times the bound violation of states (..., 2n), 0 inside the bounds."""
    return np.asarray(PENALTY * np.maximum(np.maximum(low - X, X - high), 0.0))


def shares_of_time(steps: np.ndarray) -> np.ndarray:
    """Return what the nodes stand for, (K + 1, columns), of intervals (K, columns): half of either neighbour."""
    shares = np.zeros((len(steps) + 1, steps.shape[1]))
    shares[1:] += steps / 2
    shares[:-1] += steps / 2
    return shares


def initial_violations(x0: np.ndarray, stages: Sequence[Stage]) -> np.ndarray:
    """Return by how much a window's initial state (2n,) violates the limits of its first stage, (2n,)."""
    limits = stages[0].limits
    return scaled_violations(x0, limits.state_low, limits.state_high) / PENALTY


def widened(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return soft bounds widened about their middle to at least `NARROWEST_SOFT` between them."""
    apart = np.maximum(NARROWEST_SOFT - (high - low), 0.0) / 2
    return low - apart, high + apart
