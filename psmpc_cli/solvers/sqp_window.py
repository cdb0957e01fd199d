"""A window in the velocity form as its quadratic programs need it: bounds, violations, penalties, steps."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum
from functools import cached_property

import numpy as np

from psmpc_cli.ocp.gauss_newton import Linearization, Point, Residuals, VelocityForm
from psmpc_cli.ocp.window import (
    SHORTEST,
    Parameters,
    Window,
    end_tolerance,
    node_limits,
    scaled_violations,
    shares_of_time,
    shortest_durations,
)

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
class WindowBounds:
    """The bounds of one window.

    Attributes:
        X_low, X_high: Of x_1 .. x_K, (K, 2n).
        tau_low, tau_high: Of the free durations, (S,) [s].
        together: The longest that all free durations may last together [s].
        until: Given sums of durations by stage.
        ends: Low and high of the end rows by stage.
        input_low, input_high: Of the accelerations, (K, n).
        bounded_inputs: Accelerations (of K n, flat) with a lower and with an upper bound.
        soft: The bounds of states may be violated at a cost.
        first: Low and high of x_0 where bounds are soft, (2n,) each.
    """

    X_low: np.ndarray
    X_high: np.ndarray
    tau_low: np.ndarray
    tau_high: np.ndarray
    together: float
    until: Mapping[int, float]
    ends: Mapping[int, tuple[np.ndarray, np.ndarray]]
    input_low: np.ndarray
    input_high: np.ndarray
    bounded_inputs: tuple[tuple[int, ...], tuple[int, ...]]
    soft: bool = False
    first: tuple[np.ndarray, np.ndarray] | None = None

    @cached_property
    def shape(self) -> QpShape:
        """Which rows they make."""
        return QpShape(
            tied=tuple(self.until),
            fixed=tuple(int(s) for s in np.flatnonzero(self.tau_low == self.tau_high)),
            input_low=self.bounded_inputs[0],
            input_high=self.bounded_inputs[1],
            soft=self.soft,
        )


def fixed_limits(form: VelocityForm, window: Window) -> WindowBounds:
    """Return the bounds that all windows over the same stages and nodes share, those of durations left out."""
    layout, stages = form.grid, window.stages
    low, high = node_limits(layout, stages)
    first = (low[0], high[0]) if window.soft else None
    low, high = moved_apart(low[1:], high[1:], NARROWEST_SOFT if window.soft else NARROWEST)
    ends = {s: end_tolerance(stages[s]) for s, stage in enumerate(form.stages) if stage.end_rows}
    inputs = [
        np.array([getattr(stage.limits, f"acceleration_{side}") for stage in stages])[layout.stage_of]
        for side in ("low", "high")
    ]
    low_inputs, high_inputs = (tuple(np.flatnonzero(np.isfinite(bound)).tolist()) for bound in inputs)
    none = np.zeros(0)
    return WindowBounds(
        X_low=low,
        X_high=high,
        tau_low=none,
        tau_high=none,
        together=np.inf,
        until={},
        ends={s: (-tolerance, tolerance) for s, tolerance in ends.items()},
        input_low=inputs[0],
        input_high=inputs[1],
        bounded_inputs=(low_inputs, high_inputs),
        soft=window.soft,
        first=first,
    )


def window_limits(shared: WindowBounds, window: Window, tau: np.ndarray, within: float) -> WindowBounds:
    """Return the bounds of a window, durations within so many seconds of guessed ones (S,) [s]."""
    S = len(tau)
    return replace(
        shared,
        tau_low=np.maximum(shortest_durations(window)[:-1], tau - within),
        tau_high=tau + within,
        together=window.horizon - SHORTEST if S else np.inf,
        until={s: stage.at - window.start for s, stage in enumerate(window.stages[:-1]) if stage.at is not None},
    )


def moved_apart(low: np.ndarray, high: np.ndarray, narrowest: float) -> tuple[np.ndarray, np.ndarray]:
    """Return bounds with at least so much between them."""
    apart = np.maximum(narrowest - (high - low), 0.0) / 2
    return low - apart, high + apart


@dataclass(frozen=True)
class Violation:
    """By how much a point violates its constraints, at worst and in sum.

    Natural units: m, rad, m/s, rad/s, s. A limit on an acceleration counts by the velocity it costs in its interval.
    """

    worst: float
    total: float


def violation(form: VelocityForm, limits: WindowBounds, point: Point, at: Residuals, horizon: float) -> Violation:
    """Return by how much a point violates gaps, end conditions and hard limits."""
    past = [np.abs(at.gaps)]
    if not limits.soft:
        past += [limits.X_low - point.X[1:], point.X[1:] - limits.X_high]
    past += [limits.tau_low - point.tau, point.tau - limits.tau_high, np.array([point.tau.sum() - limits.together])]
    for s, rows in at.ends.items():
        past += [limits.ends[s][0] - rows, rows - limits.ends[s][1]]
    for s, until in limits.until.items():
        past.append(np.abs(point.tau[: s + 1].sum(keepdims=True) - until))
    if any(limits.bounded_inputs):
        h = form.steps(point, horizon)
        dv = np.diff(point.X[:, form.grid.n :], axis=0)
        past += [h * limits.input_low - dv, dv - h * limits.input_high]
    every = np.concatenate([np.ravel(piece) for piece in past])
    return Violation(float(max(every.max(), 0.0)), float(np.maximum(every, 0.0).sum()))


def beyond(limits: WindowBounds, point: Point) -> np.ndarray:
    """Return rho times the violations of soft limits at a point, (K + 1, 2n); (K + 1, 0) where limits are hard."""
    if not limits.soft or limits.first is None:
        return np.zeros((len(point.X), 0))
    low, high = np.vstack([limits.first[0], limits.X_low]), np.vstack([limits.first[1], limits.X_high])
    return scaled_violations(point.X, low, high)


def penalized(form: VelocityForm, limits: WindowBounds, point: Point, at: Residuals, horizon: float) -> Residuals:
    """Return the residuals at a point, the penalty of its violations counted in the objective."""
    if not limits.soft:
        return at
    penalty = (shares_of_time(form.steps(point, horizon)) * beyond(limits, point)).sum()
    return replace(at, objective=at.objective + float(penalty))


def linearize_penalized(
    form: VelocityForm, limits: WindowBounds, point: Point, p: Parameters[np.ndarray]
) -> Linearization:
    """Return the model at a point, its violations counted with the durations they last.

    What a step changes of the violations is left to the program, which knows it exactly.
    """
    model = form.linearize(point, p)
    if not limits.soft:
        return model
    by_tau = beyond(limits, point).sum(axis=1) @ shares_of_time(form.interval_steps)
    at = penalized(form, limits, point, model.at, float(p.horizon))
    return replace(model, at=at, gradient_tau=model.gradient_tau + by_tau)


def change_of_violations(form: VelocityForm, limits: WindowBounds, point: Point, step: Point, horizon: float) -> float:
    """Return what a step changes of the penalty, as long as durations stay."""
    if not limits.soft:
        return 0.0
    change = beyond(limits, point.moved(step, 1.0)) - beyond(limits, point)
    return float((shares_of_time(form.steps(point, horizon)) * change).sum())


class QpStatus(Enum):
    """How a quadratic program ended."""

    SOLVED = "solved"
    INFEASIBLE = "no step meets the linearized constraints"
    FAILED = "not solved"


@dataclass(frozen=True, eq=False)
class QpSolution:
    """A program's step and multipliers.

    Attributes:
        status: How it ended.
        shape: Which rows it has.
        step: The step; that of x_0 is 0.
        gaps: Multipliers of the gaps, (K, n).
        until: Of given sums of durations, in the order of `QpShape.tied`.
        fixed: Of given durations, in the order of `QpShape.fixed`.
        together: Of the last stage's shortest duration.
        ends: Of the end rows by stage.
        inputs: Of the limits on acceleration, as multipliers of `Qdot+ - Qdot - h u`, (K, n).
        X: Of the limits of x_1 .. x_K, (K, 2n).
        tau: Of those of the durations, (S,).
        iterations: Interior-point iterations.
    """

    status: QpStatus
    shape: QpShape
    step: Point
    gaps: np.ndarray
    until: np.ndarray
    fixed: np.ndarray
    together: float
    ends: dict[int, np.ndarray]
    inputs: np.ndarray
    X: np.ndarray
    tau: np.ndarray
    iterations: int

    @property
    def largest(self) -> float:
        """The largest multiplier of what must hold; soft limits need not."""
        pieces = [self.gaps, self.until, self.fixed, np.array([self.together]), *self.ends.values()]
        pieces += [self.inputs, self.tau] if self.shape.soft else [self.inputs, self.tau, self.X]
        return float(max(np.abs(piece).max(initial=0.0) for piece in pieces))
