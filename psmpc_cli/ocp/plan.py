"""A plan, how it is read at other times, and the mesh of its nodes."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from psmpc_cli.robot import motion
from psmpc_cli.robot.configuration import IDENTITY, Chart


@dataclass(frozen=True)
class Grid:
    """Intervals of the stages in a window.

    Attributes:
        n: Generalized coordinates.
        nodes: N_s, intervals of each stage, (S + 1,).
    """

    n: int
    nodes: tuple[int, ...]

    @property
    def switches(self) -> int:
        """Number of switch times in the window, S."""
        return len(self.nodes) - 1

    @cached_property
    def K(self) -> int:
        """Number of intervals."""
        return sum(self.nodes)

    @cached_property
    def stage_of(self) -> np.ndarray:
        """Stage (in the window) of each interval, (K,)."""
        return np.repeat(np.arange(len(self.nodes)), self.nodes)

    @cached_property
    def first_node(self) -> np.ndarray:
        """First node of each stage, and the last node of all, (S + 2,)."""
        return np.concatenate([[0], np.cumsum(self.nodes)])


def mesh(ends: np.ndarray, nodes: tuple[int, ...]) -> np.ndarray:
    """Return the node times (K + 1,) [s] of stages between the times `ends` (S + 2,) [s]. Paper eq. (19)."""
    return np.asarray(_shares(nodes) @ ends)


@lru_cache(maxsize=256)
def _shares(nodes: tuple[int, ...]) -> np.ndarray:
    """Return the share of each end in the time of each node, (K + 1, S + 2)."""
    at = np.cumsum((0, *nodes))
    return np.array([np.interp(np.arange(at[-1] + 1), at, one) for one in np.eye(len(at))]).T.copy()


@dataclass(frozen=True, eq=False)
class Plan:
    """Piecewise constant accelerations and the states they lead through.

    Attributes:
        times: Node times (K + 1,) [s], absolute, nondecreasing.
        X: States [Q; Qdot] at the nodes (K + 1, 2n).
        u: Accelerations Qddot over the intervals (K, n).
        switch_times: Switch times in the plan (S,) [s], absolute.
        chart: The chart that states and accelerations are in.
    """

    times: np.ndarray
    X: np.ndarray
    u: np.ndarray
    switch_times: np.ndarray
    chart: Chart = IDENTITY

    def __repr__(self) -> str:
        intervals, n = self.u.shape
        size = f"{intervals} intervals of {n} accelerations, {len(self.switch_times)} switches"
        return f"<Plan from {self.times[0]:g} s to {self.times[-1]:g} s: {size}>"

    def in_chart(self, chart: Chart) -> "Plan":
        """Return the plan in another chart: the same motion at its nodes, accelerations from its velocities."""
        if chart.is_same(self.chart):
            return self
        X = self.chart.moved(self.X, chart)
        n = self.u.shape[1]
        steps = np.maximum(np.diff(self.times), 1e-12)[:, None]
        return Plan(self.times, X, np.diff(X[:, n:], axis=0) / steps, self.switch_times, chart)

    @property
    def start(self) -> float:
        """First instant of the plan [s]."""
        return float(self.times[0])

    @property
    def end(self) -> float:
        """Last instant of the plan [s]."""
        return float(self.times[-1])

    @property
    def flat(self) -> np.ndarray:
        """Switch times, then states row by row, then accelerations row by row, as one vector."""
        return np.concatenate([self.switch_times, self.X.ravel(), self.u.ravel()])

    def states_at(self, times: np.ndarray) -> np.ndarray:
        """Return the states (len(times), 2n), exact between the nodes; past its end the robot coasts."""
        return self.at(times)[0]

    def at(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the states (len(times), 2n) and the accelerations just after each time (len(times), n)."""
        k = self.times[1:].searchsorted(times + 1e-12, side="right")
        u = self._u_and_none.take(k, 0)
        return motion.advanced(self.X.take(k, 0), u, (times - self.times.take(k))[:, None]), u

    @cached_property
    def _u_and_none(self) -> np.ndarray:
        """The accelerations, and none past the plan's end, (K + 1, n)."""
        return np.concatenate([self.u, np.zeros((1, self.u.shape[1]))])

    def mean_control(self, edges: np.ndarray) -> np.ndarray:
        """Return the mean acceleration between consecutive edges (len(edges) - 1, n); zero past the plan's end."""
        first, stop = self.times.searchsorted(edges[:: len(edges) - 1])
        first = max(first - 1, 0)
        return motion.mean_control(self.u[first:stop], self.times[first : stop + 1], edges)

    def velocity_rates(self, edges: np.ndarray) -> np.ndarray:
        """Return the mean rates of v between consecutive edges (len(edges) - 1, n): what a robot is commanded."""
        return self.chart.velocity_rates(self.states_at(edges), self.mean_control(edges), np.diff(edges)[:, None])

    def ramped_rates(self, edges: np.ndarray, before: np.ndarray, ramped: np.ndarray) -> np.ndarray:
        """Return rates of v over ticks as `velocity_rates` does, those of some coordinates ramped (M, n).

        In a chart the difference between both counts as one of v: over a sample the chart hardly turns.

        Args:
            edges: Ends of the ticks (M + 1,) [s].
            before: Acceleration over the tick before (n,).
            ramped: Which coordinates change between the middles of intervals, see `motion.ramped_control` (n,).
        """
        rates = self.velocity_rates(edges)
        ramps = motion.ramped_control(self.u, self.times, edges, before) - self.mean_control(edges)
        return np.where(ramped, rates + ramps, rates)

    def averaged_rates(self, edges: np.ndarray, before: np.ndarray, width: float) -> np.ndarray:
        """Return accelerations to command over ticks to follow the plan without jumps, averaged about each tick.

        The plan's accelerations are of coordinates in a chart, and commands are rates of the robot's velocities v. By
        how much averaging changes the former is added to the latter, since the chart hardly turns over a sample. Near a
        switch the average is taken over a shorter time, so that it has no accelerations of the stage beyond.

        Args:
            edges: Ends of the ticks, (M + 1,) [s].
            before: Acceleration over the tick before, (n,).
            width: Time over which is averaged [s], see `motion.averaged_control`.

        Returns:
            (M, n) [m/s^2, rad/s^2].
        """
        middles = (edges[:-1] + edges[1:]) / 2
        time_to_switch = np.abs(middles[:, None] - self.switch_times).min(axis=1, initial=np.inf)
        widths = np.minimum(width, 2 * time_to_switch)
        changes = motion.averaged_control(self.u, self.times, edges, before, widths) - self.mean_control(edges)
        return np.asarray(self.velocity_rates(edges) + changes)


def states_of(plans: Sequence[Plan], times: Sequence[float]) -> np.ndarray:
    """Return the state of each plan at a time of its own [s], (len(plans), 2n), as `Plan.states_at` does."""
    at = [
        (plan, plan.times[1:].searchsorted(time + 1e-12, side="right")) for plan, time in zip(plans, times, strict=True)
    ]
    since = np.array(times) - [plan.times[k] for plan, k in at]
    X = np.array([plan.X[k] for plan, k in at])
    u = np.array([plan._u_and_none[k] for plan, k in at])
    return motion.advanced(X, u, since[:, None])


def resting_plan(start: float, horizon: float, nodes: int, x: np.ndarray, chart: Chart = IDENTITY) -> Plan:
    """Return the plan that applies no control from x on: the first guess of a run."""
    times = start + horizon * np.arange(nodes + 1) / nodes
    u = np.zeros((nodes, len(x) // 2))
    return Plan(times, motion.rollout(x, u, np.diff(times)), u, np.zeros(0), chart)


def shift(plan: Plan, now: float, horizon: float, x: np.ndarray) -> Plan:
    """Return the plan from now on, begun at the measured state x (2n,) and extended to the horizon's new end.

    Its switch times are those of the plan that are still to come.
    """
    end = now + horizon
    first, stop = plan.times.searchsorted((now + 1e-9, end - 1e-9))
    u = plan._u_and_none[first - 1 : stop]
    last = motion.advanced(plan.X[stop - 1 : stop], u[-1:], end - plan.times[stop - 1])
    X = np.concatenate((x[None], plan.X[first:stop], last))
    times = np.concatenate(((now,), plan.times[first:stop], (end,)))
    return Plan(times, X, u, plan.switch_times[plan.switch_times > now], plan.chart)


def braking_plan(
    start: float,
    x: np.ndarray,
    duration: float,
    horizon: float = 0.0,
    chart: Chart = IDENTITY,
    brakes: np.ndarray | bool = True,
    u: np.ndarray | None = None,
) -> Plan:
    """Return the plan that brings the robot to rest at a constant deceleration, for when no other plan is in force.

    Args:
        start: When it begins [s].
        x: State there, (2n,).
        duration: Within which time the robot comes to rest [s].
        horizon: How long the plan is at least, resting at its end [s].
        chart: The chart of x.
        brakes: Which coordinates can brake, (n,); the others, such as a base without thrusters, drift on.
        u: Accelerations that the plan has for coordinates that brake, (n,), where the jerk is limited and ramps lead to
            and from them; by default the constant deceleration that the states follow.
    """
    constant_u, x_at_end = motion.braking(x, duration, np.asarray(brakes))
    u = constant_u if u is None else np.where(brakes, u, constant_u)
    braking = Plan(np.array([start, start + duration]), np.vstack([x, x_at_end]), u[None], np.zeros(0), chart)
    return shift(braking, start, horizon, x) if horizon > duration else braking
