"""A window's bounds in the velocity form: what they leave of a step, and by how much a point violates them."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from psmpc_cli.ocp.transcription import Nlp
from psmpc_cli.ocp.velocity_form import Point, Residuals, VelocityForm
from psmpc_cli.ocp.window import Bounds

NARROWEST = 2e-9
"""Bounds nearer to each other than this [m, rad, m/s, rad/s] are moved apart to it: no interior point has none."""

NARROWEST_SOFT = 1e-4
"""The same of soft ones: nothing but the width tells their two multipliers apart, and at 1e-5 some programs fail."""


@dataclass(frozen=True)
class QpShape:
    """What of the bounds decides which rows a quadratic program has.

    Attributes:
        tied: Stages at whose end the sum of the durations is given.
        fixed: Stages whose duration is given.
        input_low, input_high: Accelerations (of K n, flat) with a bound.
        soft: The bounds of states may be violated at a cost.
    """

    tied: tuple[int, ...]
    fixed: tuple[int, ...]
    input_low: tuple[int, ...]
    input_high: tuple[int, ...]
    soft: bool = False


@dataclass(frozen=True, eq=False)
class Limits:
    """The bounds of one window.

    Attributes:
        X_low, X_high: Of x_1 .. x_K, (K, 2n).
        tau_low, tau_high: Of the free durations, (S,) [s].
        together: The longest that all free durations may last together [s].
        until: Given sums of durations by stage.
        ends: Low and high of the end rows by stage.
        input_low, input_high: Of the accelerations, (K, n).
        soft: The bounds of states may be violated at a cost.
        first: Low and high of x_0 where bounds are soft, (2n,) each.
    """

    X_low: np.ndarray
    X_high: np.ndarray
    tau_low: np.ndarray
    tau_high: np.ndarray
    together: float
    until: dict[int, float]
    ends: dict[int, tuple[np.ndarray, np.ndarray]]
    input_low: np.ndarray
    input_high: np.ndarray
    soft: bool = False
    first: tuple[np.ndarray, np.ndarray] | None = None

    @cached_property
    def shape(self) -> QpShape:
        """Return which rows they make."""
        return QpShape(
            tied=tuple(self.until),
            fixed=tuple(int(s) for s in np.flatnonzero(self.tau_low == self.tau_high)),
            input_low=_finite(self.input_low),
            input_high=_finite(self.input_high),
            soft=self.soft,
        )


@dataclass(frozen=True)
class Violation:
    """By how much a point violates its constraints, at worst and in sum.

    Natural units: m, rad, m/s, rad/s, s. A limit on an acceleration counts by the velocity it costs in its interval.
    """

    worst: float
    total: float


def limits(nlp: Nlp, bounds: Bounds, horizon: float) -> Limits:
    """Return a window's bounds in the velocity form."""
    layout = nlp.layout
    low, high = bounds.lbx[layout.state_index][1:], bounds.ubx[layout.state_index][1:]
    first = None
    if layout.soft:
        low, high = bounds.lbg[nlp.limit_rows[0]], bounds.ubg[nlp.limit_rows[1]]
        first, low, high = (low[0], high[0]), low[1:], high[1:]
    low, high = moved_apart(low, high, NARROWEST_SOFT if layout.soft else NARROWEST)
    inputs = [layout.input_index(s) for s in range(len(layout.nodes))]
    row = nlp.last_duration_row
    return Limits(
        X_low=low,
        X_high=high,
        tau_low=bounds.lbx[layout.duration_index[0]],
        tau_high=bounds.ubx[layout.duration_index[0]],
        together=np.inf if row is None else float(horizon - bounds.lbg[row]),
        until={s: float(bounds.lbg[row]) for s, row in nlp.instant_rows.items()},
        ends={s: (bounds.lbg[rows], bounds.ubg[rows]) for s, rows in nlp.end_rows.items()},
        input_low=np.concatenate([bounds.lbx[index] for index in inputs]),
        input_high=np.concatenate([bounds.ubx[index] for index in inputs]),
        soft=layout.soft,
        first=first,
    )


def moved_apart(low: np.ndarray, high: np.ndarray, narrowest: float) -> tuple[np.ndarray, np.ndarray]:
    """Return bounds with at least so much between them."""
    apart = np.maximum(narrowest - (high - low), 0.0) / 2
    return low - apart, high + apart


def violation(form: VelocityForm, limits: Limits, point: Point, at: Residuals, horizon: float) -> Violation:
    """Return by how much a point violates gaps, end conditions and hard limits."""
    past = [np.abs(at.gaps)]
    if not limits.soft:
        past += [limits.X_low - point.X[1:], point.X[1:] - limits.X_high]
    past += [limits.tau_low - point.tau, point.tau - limits.tau_high, np.array([point.tau.sum() - limits.together])]
    for s, rows in at.ends.items():
        past += [limits.ends[s][0] - rows, rows - limits.ends[s][1]]
    for s, until in limits.until.items():
        past.append(np.abs(point.tau[: s + 1].sum(keepdims=True) - until))
    shape = limits.shape
    if shape.input_low or shape.input_high:
        h = form.steps(point, horizon)
        dv = np.diff(point.X[:, form.layout.n :], axis=0)
        past += [h * limits.input_low - dv, dv - h * limits.input_high]
    every = np.concatenate([np.ravel(piece) for piece in past])
    return Violation(float(max(every.max(), 0.0)), float(np.maximum(every, 0.0).sum()))


def _finite(bound: np.ndarray) -> tuple[int, ...]:
    return tuple(int(i) for i in np.flatnonzero(np.isfinite(bound)))
