"""How many nodes each stage of a window needs: `nodes: auto`. See docs/formulation.md, section 5.

The discretization is exact, so what a mesh changes is the quadrature of the costs. The rectangle rule of (20) over N_s
intervals is off by tau_s / (2 N_s) times the change of the stage's cost over its part of the horizon, and twice as many
nodes halve that.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from psmpc_cli.ocp.costs import StageCosts
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.ocp.window import Window, durations

COUNTS = (4, 6, 8, 11, 16, 23, 32, 45, 64, 90, 128, 180, 200)
"""Numbers of intervals a stage may have: few, so that what is built for a window serves again."""

SPARE = 2
"""A stage keeps its number of intervals until it needs more, or so many times fewer."""


@dataclass(frozen=True, eq=False)
class Along:
    """A predicted plan, and how costs are read off it.

    Attributes:
        plan: The plan.
        costs: The errors of the robot.
        step: Longest time between two states that are looked at [s].
    """

    plan: Plan
    costs: StageCosts
    step: float


def node_counts(
    window: Window, instants: np.ndarray, along: Along, tolerance: float, before: Mapping[int, int]
) -> tuple[int, ...]:
    """Return the counts with the smallest sum with which twice as many would change J by the tolerance at most.

    No interval is longer than a step of the prediction, the sample: a plan's first control is to be that of the sample.

    Args:
        window: The window; its own nodes do not matter.
        instants: Predicted switching instants (S,) [s].
        along: The prediction.
        tolerance: Of J, relative.
        before: Number of intervals each stage had in the window before, by stage index.
    """
    tau = durations(instants, window.start, window.horizon)
    changes, J = _quadrature(window, instants, tau, along)
    root = np.sqrt(changes)
    needed = np.maximum(root * root.sum() / (2 * tolerance * J), tau / along.step)
    return tuple(_count(need, before.get(stage.index)) for need, stage in zip(needed, window.stages, strict=True))


def first_counts(window: Window, instants: np.ndarray, tolerance: float, step: float) -> tuple[int, ...]:
    """Return the counts of a window without a plan before it: its costs may fall from their largest to nothing."""
    tau = durations(instants, window.start, window.horizon)
    return tuple(_count(need, None) for need in np.maximum(1 / (2 * tolerance) * tau / window.horizon, tau / step))


def _quadrature(window: Window, instants: np.ndarray, tau: np.ndarray, along: Along) -> tuple[np.ndarray, float]:
    """Return N_s times the error of each stage's quadrature (S + 1,), and J, along the prediction without its control.

    A cost that falls and rises again counts with both, as if the errors of its parts did not cancel.
    """
    omega, begins = window.omega / window.omega.max(), np.r_[window.start, instants]
    changes, J = np.zeros(len(tau)), window.pending_cost * float((instants - window.start).sum())
    for s, stage in enumerate(window.stages):
        times = np.linspace(begins[s], begins[s] + tau[s], max(2, int(np.ceil(tau[s] / along.step)) + 1))
        since = times - begins[s] + (window.elapsed if s == 0 else 0.0)
        L = along.costs.errors(stage, along.plan.states_at(times), since) ** 2 @ stage.weights
        over = omega[s] * tau[s] / window.scale[s]
        changes[s] = over / 2 * float(np.abs(np.diff(L)).sum())
        J += over * abs(float((L[:-1] + L[1:]).mean()) / 2 - window.offset[s])
    return changes, max(J, np.finfo(float).tiny)


def _count(needed: float, before: int | None) -> int:
    """Return the number of intervals for a need."""
    if before is not None and needed <= before <= SPARE * needed:
        return before
    return next((count for count in COUNTS if count >= needed), COUNTS[-1])
