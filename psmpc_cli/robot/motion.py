"""The motion model: how states follow from controls, and what of it a window, a plan and a fallback need.

In its chart a robot has n coordinates Q whose second derivative is the control, Qddot = u: with x = [Q; Qdot] it is the
double integrator of paper eq. (8), exact for a control that is constant over a step of length h,

    Q+ = Q + h Qdot + h^2 / 2 u,    Qdot+ = Qdot + h u.

On the coordinates themselves the velocities do the same, vdot = u, and Q follows from their steps.
"""

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from psmpc_cli.robot.configuration import ConfigurationSpace

Array = NDArray[np.float64]

BRAKING_ITERATIONS = 20
"""Iterations of Newton's method for an acceleration between two ramps; it converges quadratically."""


def rate(x: Any, u: Any) -> Any:
    """Return xdot = [Qdot; u] of a state x (2n,) as an expression. Paper eq. (8)."""
    n = u.numel()
    return ca.vertcat(x[n:], u)


def step(discretization: str) -> Callable[[Any, Any, Any], Any]:
    """Return x, u, h -> x+ as expressions: the exact step, or explicit Euler as printed (20)."""
    return _euler_step if discretization == "euler" else _exact_step


def _exact_step(x: Any, u: Any, h: Any) -> Any:
    n = u.numel()
    return ca.vertcat(x[:n] + h * x[n:] + h**2 / 2 * u, x[n:] + h * u)


def _euler_step(x: Any, u: Any, h: Any) -> Any:
    return x + h * rate(x, u)


def velocity_shares(discretization: str) -> tuple[float, float]:
    """Return the shares a, b of the velocities at both ends of a step in Q+ - Q = h (a Qdot + b Qdot+).

    With u = (Qdot+ - Qdot) / h the exact step has a = b = 1/2, explicit Euler a = 1, b = 0.
    """
    return (1.0, 0.0) if discretization == "euler" else (0.5, 0.5)


def advanced(X: Array, u: Array, since: Array | float) -> Array:
    """Return states X (K, 2n) after times (K, 1) or () [s] under accelerations u (K, n)."""
    n = u.shape[1]
    after = X.copy()
    Q = after[:, :n]
    Qdot = after[:, n:]
    gained = since * u
    Q += since * (Qdot + gained / 2)
    Qdot += gained
    return after


def rollout(x: Array, u: Array, steps: Array) -> Array:
    """Return the states (K + 1, 2n) from x (2n,) on under accelerations u (K, n), held for steps (K,) [s]."""
    n = u.shape[1]
    h = steps[:, None]
    Qdot = np.cumsum(np.vstack([x[n:], h * u]), axis=0)
    Q = np.cumsum(np.vstack([x[:n], h * Qdot[:-1] + h**2 / 2 * u]), axis=0)
    return np.hstack([Q, Qdot])


def braking(x: Array, duration: float, brakes: Array) -> tuple[Array, Array]:
    """Return the constant acceleration (n,) that brings a state x (2n,) to rest within a duration [s].

    And the state then (2n,). From Qdot + duration u = 0. Coordinates that cannot brake (n,), those of a base without
    thrusters, drift on.
    """
    n = len(x) // 2
    Q = x[:n]
    Qdot = x[n:]
    u = np.where(brakes, -Qdot / duration, 0.0)
    mean_rate = np.where(brakes, Qdot / 2, Qdot)
    last_rate = np.where(brakes, 0.0, Qdot)
    return u, np.concatenate([Q + duration * mean_rate, last_rate])


def braking_under_jerk(v: Array, duration: float, before: Array, low: Array, high: Array) -> Array:
    """Return the acceleration that brings a robot to rest within a given time under limits of jerk.

    Accelerations cannot jump under such limits: this one is reached, and left again, by ramps. From what is applied
    before, a, the acceleration goes to u and, after the duration T, to 0, as fast as limits of jerk allow, r(u - a) and
    r(-u). So the velocity changes by

        u T + (a - u) |a - u| / (2 r(u - a)) + u |u| / (2 r(-u)) = -v,

    which Newton's method solves. Its derivative by u is at least T / 2 where T is at least twice the time of the ramp
    from a to 0. Coordinates without a limit have u = -v / T.

    Args:
        v: Velocities (n,).
        duration: T [s].
        before: a, accelerations that are applied now (n,).
        low: Lower limits of jerk (n,), negative.
        high: Upper limits (n,).

    Returns:
        The accelerations u (n,).
    """
    u = -v / duration
    for _ in range(BRAKING_ITERATIONS):
        jerk_to_u = np.where(u > before, high, -low)  # r(u - a)
        jerk_to_0 = np.where(u < 0, high, -low)  # r(-u)
        change = u * duration + (before - u) * np.abs(before - u) / (2 * jerk_to_u) + u * np.abs(u) / (2 * jerk_to_0)
        slope = duration - np.abs(before - u) / jerk_to_u + np.abs(u) / jerk_to_0
        u = u - (change + v) / slope
    return np.where(np.isfinite(low) & np.isfinite(high), u, -v / duration)


def mean_control(u: Array, times: Array, edges: Array) -> Array:
    """Return the mean of piecewise constant accelerations between consecutive edges (M + 1,) [s], (M, n).

    Nodes and ticks do not align; the mean keeps the velocities at the ticks equal to the plan's.

    Args:
        u: Accelerations (K, n) between the times.
        times: Nodes (K + 1,) [s]. Outside of them there is no control.
        edges: Ends of the ticks [s], ascending.
    """
    if len(u) == 1 and times[0] <= edges[0] and edges[-1] <= times[1]:  # one acceleration over all of them
        return u.repeat(len(edges) - 1, axis=0)
    reached = np.minimum(np.maximum(edges[:, None], times[:-1]), times[1:])
    return np.asarray((reached[1:] - reached[:-1]) @ u / (edges[1:] - edges[:-1])[:, None])


def ramped_control(u: Array, times: Array, edges: Array, before: Array) -> Array:
    """Turn the piecewise constant accelerations of a plan into continuous ones, for robots with limits of jerk.

    They are linear from the middle of each interval of the plan to that of the next, and begin at what is applied now.
    The slopes are the changes of acceleration that windows weigh and limit. Velocities differ from those of the plan by
    h^2 / 4 times the largest slope at most, with the length h of an interval.

    Args:
        u: Accelerations (K, n) between the times.
        times: Nodes (K + 1,) [s]. Past the last there is no control.
        edges: Ends of the ticks (M + 1,) [s], ascending, all of one length.
        before: Acceleration over the tick before the first (n,).

    Returns:
        The accelerations at the middles of the ticks (M, n).
    """
    tick = edges[1] - edges[0]
    middles = (times[:-1] + times[1:]) / 2
    first = int(middles.searchsorted(edges[0]))
    end = times[-1:] + (times[-1] - times[-2]) / 2  # past the plan accelerations have fallen to 0
    knots = np.concatenate([[edges[0] - tick / 2], middles[first:], end])
    values = np.concatenate([before[None], u[first:], np.zeros((1, u.shape[1]))])
    tick_middles = (edges[:-1] + edges[1:]) / 2
    return np.stack([np.interp(tick_middles, knots, of_coordinate) for of_coordinate in values.T], axis=1)


def averaged_control(u: Array, times: Array, edges: Array, before: Array, width: Array | float) -> Array:
    """Smooth the piecewise constant accelerations of a plan: take the mean over a time of some width about each tick.

    Robots that hold a load elastically need this: jumps of the load's force would make it swing. Velocities are then
    moving averages of those that the piecewise constant accelerations lead to, without jumps of acceleration, and keep
    every convex limit that these keep. Where the first acceleration u_0 is not the one before, they differ from that by
    (before - u_0) width / 8, since the robot cannot have begun to change earlier.

    Args:
        u: Accelerations (K, n) between the times.
        times: Nodes (K + 1,) [s]. Past the last there is no control.
        edges: Ends of the ticks (M + 1,) [s], ascending.
        before: Acceleration before the first node (n,).
        width: By how much the time of a mean is longer than its tick [s], the same for all or for each tick (M,).

    Returns:
        The accelerations over the ticks (M, n).
    """
    begins = edges[:-1] - width / 2
    ends = edges[1:] + width / 2
    first = min(times[0], begins.min())  # until the first node what was applied before goes on
    durations = np.concatenate([[times[0] - first], np.diff(times)])
    velocities = np.cumsum(durations[:, None] * np.vstack([before, u]), axis=0)
    knots = np.concatenate([[first], times])
    # a mean acceleration is the difference of the velocities that are gained until both ends
    gained = np.vstack([np.zeros((1, u.shape[1])), velocities])

    def velocity(time: Array) -> Array:
        return np.stack([np.interp(time, knots, of_coordinate) for of_coordinate in gained.T], axis=1)

    return np.asarray((velocity(ends) - velocity(begins)) / (ends - begins)[:, None])


def slew_limited(u: Array, before: Array, low: Array, high: Array) -> Array:
    """Limit by how much accelerations change from tick to tick, which is what a limit of jerk means for commands.

    Each comes as near to the given one as that allows; those that keep the limits are returned as they are.

    Args:
        u: Wanted accelerations over the ticks (M, n).
        before: Acceleration over the tick before the first (n,).
        low: Lower bounds of the changes (M, n), 0 at most.
        high: Upper bounds (M, n), 0 at least.

    Returns:
        The limited accelerations (M, n).
    """
    changes = np.diff(u, axis=0, prepend=before[None])
    if ((low <= changes) & (changes <= high)).all():
        return u
    limited = np.empty_like(u)
    last = before
    for tick in range(len(u)):
        last = np.clip(u[tick], last + low[tick], last + high[tick])
        limited[tick] = last
    return limited


def over_ticks(space: ConfigurationSpace, Q: Array, v: Array, vdot: Array, tick: float) -> tuple[Array, Array]:
    """Return coordinates (M + 1, nq) and velocities (M + 1, n) while rates of v (M, n) hold for a tick [s] each."""
    velocities = np.vstack([v, v + tick * np.cumsum(vdot, axis=0)])
    steps = tick * velocities[:-1] + tick**2 / 2 * vdot
    steps = steps + space.magnus_correction(velocities[:-1], velocities[1:], tick)
    return space.path(Q, steps), velocities
