"""A window in the velocity form as its quadratic programs need it: bounds, violations, penalties.

What has a bound is a row: states at nodes 1 .. K, durations, their sum, end conditions, accelerations as velocities,
`Qdot+ - Qdot - h u_low` and `Qdot+ - Qdot - h u_high`. Violations, the programs and their multipliers share the order.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from psmpc_cli.ocp.gauss_newton import Linearization, Point, Residuals, VelocityForm
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.ocp.window import (
    SHORTEST,
    Parameters,
    Window,
    node_limits,
    scaled_violations,
    shares_of_time,
    shortest_durations,
)

NARROWEST = 2e-9
"""Bounds nearer to each other than this [m, rad, m/s, rad/s] are moved apart to it: no interior point has none."""

NARROWEST_SOFT = 1e-4
"""The same of soft ones: nothing but the width tells their two multipliers apart, and at 1e-5 some programs fail."""


@dataclass(frozen=True, eq=False)
class WindowBounds:
    """The bounds of one window.

    Attributes:
        low, high: Of the rows, (R,).
        given_rows, given: Sums of durations that are given, as rows of durations (G, S) and as times (G,) [s].
        input_low, input_high: Of the accelerations, (K, n), 0 where there is none; (0, n) where none has one.
        soft: The bounds of states may be violated at a cost.
        first: Low and high of x_0, which count where bounds are soft, (2, 2n).
    """

    low: np.ndarray
    high: np.ndarray
    given_rows: np.ndarray
    given: np.ndarray
    input_low: np.ndarray
    input_high: np.ndarray
    soft: bool
    first: np.ndarray


def fixed_bounds(form: VelocityForm, window: Window) -> WindowBounds:
    """Return the bounds that windows of one shape, limits and tolerances share, those of durations left open."""
    grid, stages, S = form.grid, window.stages, form.grid.switches
    low, high = node_limits(grid, stages)
    first = np.array([low[0], high[0]])
    low, high = moved_apart(low[1:], high[1:], NARROWEST_SOFT if window.soft else NARROWEST)
    ends = [stage.end_tolerance for stage, of_form in zip(stages, form.stages, strict=True) if of_form.end_rows]
    tolerance, open_rows = np.concatenate([np.zeros(0), *ends]), np.full(S + 1, np.inf)
    lows, highs = [low.ravel(), -open_rows, -tolerance], [high.ravel(), open_rows, tolerance]
    inputs = [
        np.array([getattr(stage.limits, f"acceleration_{side}") for stage in stages])[grid.stage_of]
        for side in ("low", "high")
    ]
    finite = [np.isfinite(bound) for bound in inputs]
    if np.any(finite):
        none = np.full(grid.K * grid.n, np.inf)
        lows += [np.where(finite[0], 0.0, -np.inf).ravel(), -none]
        highs += [none, np.where(finite[1], 0.0, np.inf).ravel()]
        inputs = [np.where(has, bound, 0.0) for has, bound in zip(finite, inputs, strict=True)]
    else:
        inputs = [np.zeros((0, grid.n))] * 2
    return WindowBounds(
        low=np.concatenate(lows),
        high=np.concatenate(highs),
        given_rows=np.zeros((0, S)),
        given=np.zeros(0),
        input_low=inputs[0],
        input_high=inputs[1],
        soft=window.soft,
        first=first,
    )


def window_bounds(shared: WindowBounds, window: Window, guess: Plan, tau: np.ndarray, within: float) -> WindowBounds:
    """Return the bounds of a window about a guess, durations within so many seconds of guessed ones (S,) [s]."""
    S, first = len(tau), len(window.x0) * window.K  # the durations stand after the states
    low, high = shared.low.copy(), shared.high.copy()
    if window.chart.spatial:
        rates = np.hstack([np.zeros((window.K, len(window.x0) // 2)), window.shift_of_limits(guess)[1:]]).ravel()
        low[:first] += rates
        high[:first] += rates
    drift = np.concatenate([np.zeros(0), *(stage.end_drift for stage in window.stages[:-1])])
    ends = slice(first + S + 1, first + S + 1 + len(drift))
    low[ends] += drift
    high[ends] += drift
    shortest, longest = np.maximum(shortest_durations(window)[:-1], tau - within), tau + within
    fixed = shortest == longest
    low[first : first + S] = np.where(fixed, -np.inf, shortest)
    high[first : first + S] = np.where(fixed, np.inf, longest)
    high[first + S] = window.horizon - SHORTEST if S else np.inf
    tied = {s: stage.at - window.start for s, stage in enumerate(window.stages[:-1]) if stage.at is not None}
    if not tied and not fixed.any():
        return replace(shared, low=low, high=high)
    given_rows = np.vstack([np.tri(S)[list(tied)], np.eye(S)[fixed]])
    given = np.array([*tied.values(), *shortest[fixed]])
    return replace(shared, low=low, high=high, given_rows=given_rows, given=given)


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


@dataclass(frozen=True, eq=False)
class SqpWindow:
    """One window: its numbers and its bounds.

    Attributes:
        form: The window's velocity form.
        bounds: Its bounds.
        p: Its numbers.
    """

    form: VelocityForm
    bounds: WindowBounds
    p: Parameters[np.ndarray]

    @cached_property
    def horizon(self) -> float:
        """T_h [s]."""
        return float(self.p.horizon)

    @property
    def states(self) -> int:
        """Number of the rows of states, the first of all."""
        return 2 * self.form.grid.n * self.form.grid.K

    def rows(self, point: Point, at: Residuals) -> np.ndarray:
        """Return the rows at a point, (R,)."""
        rows = [point.X[1:].ravel(), point.tau, point.tau.sum(keepdims=True), at.ends]
        if len(self.bounds.input_low):
            h, dv = self.form.steps(point, self.horizon), np.diff(point.X[:, self.form.grid.n :], axis=0)
            rows += [(dv - h * bound).ravel() for bound in (self.bounds.input_low, self.bounds.input_high)]
        return np.concatenate(rows)

    def violation(self, point: Point, at: Residuals) -> Violation:
        """Return by how much a point violates gaps, end conditions and hard limits."""
        bounds, rows, hard = self.bounds, self.rows(point, at), slice(self.states if self.bounds.soft else 0, None)
        past = [at.gaps.ravel(), bounds.given - bounds.given_rows @ point.tau]
        past = [*map(np.abs, past), (bounds.low - rows)[hard], (rows - bounds.high)[hard]]
        every = np.concatenate(past)
        return Violation(float(max(every.max(), 0.0)), float(np.maximum(every, 0.0).sum()))

    def beyond(self, point: Point) -> np.ndarray:
        """Return rho times the violations of soft limits at a point, (K + 1, 2n); (K + 1, 0) where limits are hard."""
        if not self.bounds.soft:
            return np.zeros((len(point.X), 0))
        low, high = (
            np.concatenate([first, bound[: self.states]]).reshape(point.X.shape)
            for first, bound in zip(self.bounds.first, (self.bounds.low, self.bounds.high), strict=True)
        )
        return scaled_violations(point.X, low, high)

    def shares(self, point: Point) -> np.ndarray:
        """Return the share of time that each node stands for, (K + 1, 1) [s]."""
        return shares_of_time(self.form.steps(point, self.horizon))

    def residuals(self, point: Point) -> Residuals:
        """Return the residuals at a point, the penalty of its violations counted in the objective."""
        return self._penalized(point, self.form.residuals(point, self.p))

    def _penalized(self, point: Point, at: Residuals) -> Residuals:
        if not self.bounds.soft:
            return at
        return replace(at, objective=at.objective + float((self.shares(point) * self.beyond(point)).sum()))

    def linearize(self, point: Point) -> Linearization:
        """Return the model at a point, its violations counted with the durations they last.

        What a step changes of the violations is left to the program, which knows it exactly.
        """
        model = self.form.linearize(point, self.p)
        if not self.bounds.soft:
            return model
        by_tau = self.beyond(point).sum(axis=1) @ shares_of_time(self.form.interval_steps)
        at = self._penalized(point, model.at)
        return replace(model, at=at, gradient_tau=model.gradient_tau + by_tau)

    def change_of_penalty(self, point: Point, step: Point) -> float:
        """Return what a step changes of the penalty, as long as durations stay."""
        if not self.bounds.soft:
            return 0.0
        change = self.beyond(point.moved(step, 1.0)) - self.beyond(point)
        return float((self.shares(point) * change).sum())
