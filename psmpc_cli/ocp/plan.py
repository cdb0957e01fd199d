"""A plan, the chart its states are in, how it is read at other times, and the mesh of its nodes.

In its chart a robot has n coordinates whose second derivative is the control. A planar robot's coordinates are its own:
its chart changes nothing. A spatial robot's are Q = [position (3), phi (3), joints] with the base's attitude
R = A Exp(phi), A the attitude that was measured at the sample. So phi is 0 at the start of every plan and its rate is
the body's angular velocity, and the robot is the exact double integrator (8) in space too. docs/formulation.md,
section "attitude".
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from psmpc_cli.robot.rotations import body_rate, chart_rate, conjugate, exp, log, product

ATTITUDE = slice(3, 7)
TURN = slice(3, 6)
"""Rows of the quaternion in a spatial robot's Q (nq,), and of phi in the chart's (n,)."""


@dataclass(frozen=True, eq=False)
class Chart:
    """Coordinates about an attitude.

    Attributes:
        anchor: Unit quaternion A (4,); empty of a planar robot.
    """

    anchor: np.ndarray

    @classmethod
    def at(cls, Q: np.ndarray, n: int) -> "Chart":
        """Return the chart about the attitude in a state's coordinates Q (nq,) of a robot with n velocities."""
        return cls(Q[ATTITUDE] / np.linalg.norm(Q[ATTITUDE]) if len(Q) > n else np.zeros(0))

    @property
    def spatial(self) -> bool:
        """Whether it changes anything."""
        return len(self.anchor) > 0

    def enter(self, Q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the states x = [Q; Qdot] (K, 2n) in the chart at coordinates Q (K, nq) and velocities v (K, n)."""
        if not self.spatial:
            return np.hstack([Q, v])
        turned = product(conjugate(list(self.anchor)), list(Q[:, ATTITUDE].T))
        sign = np.where(turned[0] < 0, -1.0, 1.0)
        phi = log([sign * part for part in turned])
        rate = chart_rate(phi, list(v[:, TURN].T))
        return np.column_stack([Q[:, :3], *phi, Q[:, 7:], v[:, :3], *rate, v[:, 6:]])

    def entered(self, X: np.ndarray) -> np.ndarray:
        """Return the states in the chart (K, 2n) at states [Q; v] (K, nq + n)."""
        return self.enter(*np.split(X, [X.shape[1] - X.shape[1] // 2], axis=1)) if self.spatial else X

    def leave(self, X: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return coordinates Q (K, nq) and velocities v (K, n) at states X (K, 2n) in the chart."""
        n = X.shape[1] // 2
        if not self.spatial:
            return X[:, :n], X[:, n:]
        phi = list(X[:, TURN].T)
        rate = list(X[:, n + 3 : n + 6].T)
        attitude = np.column_stack(product(list(self.anchor), exp(phi)))
        attitude /= np.linalg.norm(attitude, axis=1, keepdims=True)
        omega = np.column_stack(body_rate(phi, rate))
        return np.hstack([X[:, :3], attitude, X[:, 6:n]]), np.hstack([X[:, n : n + 3], omega, X[:, n + 6 :]])

    def moved(self, X: np.ndarray, to: "Chart") -> np.ndarray:
        """Return states X (K, 2n) in another chart (K, 2n)."""
        return to.enter(*self.leave(X)) if self.spatial else X

    def rate_shift(self, X: np.ndarray) -> np.ndarray:
        """Return Qdot - v (K, n) at states X (K, 2n): by how much limits of v lie elsewhere in the chart's rates.

        It is (I - J_r(phi)) phidot in the rows of attitude, and 0 in all others.
        """
        n = X.shape[1] // 2
        return np.asarray(X[:, n:] - self.leave(X)[1])


PLANAR = Chart(np.zeros(0))
"""The chart of every planar robot."""


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
        """Number of switching instants in the window, S."""
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
        instants: Switching instants in the plan (S,) [s], absolute.
        chart: The chart that states and accelerations are in.
    """

    times: np.ndarray
    X: np.ndarray
    u: np.ndarray
    instants: np.ndarray
    chart: Chart = PLANAR

    def in_chart(self, chart: Chart) -> "Plan":
        """Return the plan in another chart: the same motion at its nodes, accelerations from its velocities."""
        if not chart.spatial:
            return self
        X = self.chart.moved(self.X, chart)
        n = self.u.shape[1]
        steps = np.maximum(np.diff(self.times), 1e-12)[:, None]
        return Plan(self.times, X, np.diff(X[:, n:], axis=0) / steps, self.instants, chart)

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
        """Switching instants, then states row by row, then accelerations row by row, as one vector."""
        return np.concatenate([self.instants, self.X.ravel(), self.u.ravel()])

    def states_at(self, times: np.ndarray) -> np.ndarray:
        """Return the states (len(times), 2n), exact between the nodes; past its end the robot coasts."""
        return self.at(times)[0]

    def at(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the states (len(times), 2n) and the accelerations just after each time (len(times), n)."""
        k = self.times[1:].searchsorted(times + 1e-12, side="right")
        u = self._u_and_none.take(k, 0)
        return _accelerated(self.X.take(k, 0), u, (times - self.times.take(k))[:, None]), u

    @cached_property
    def _u_and_none(self) -> np.ndarray:
        """The accelerations, and none past the plan's end, (K + 1, n)."""
        return np.concatenate([self.u, np.zeros((1, self.u.shape[1]))])

    def mean_control(self, edges: np.ndarray) -> np.ndarray:
        """Return the mean acceleration between consecutive edges (len(edges) - 1, n); zero past the plan's end.

        Nodes and ticks do not align; the mean keeps the velocities at the ticks equal to the plan's.
        """
        first, stop = self.times.searchsorted(edges[:: len(edges) - 1])
        first = max(first - 1, 0)
        times = self.times[first : stop + 1]
        u = self.u[first:stop]
        if len(u) == 1 and times[0] <= edges[0] and edges[-1] <= times[1]:  # one acceleration over all of them
            return u.repeat(len(edges) - 1, axis=0)
        reached = np.minimum(np.maximum(edges[:, None], times[:-1]), times[1:])
        return np.asarray((reached[1:] - reached[:-1]) @ u / (edges[1:] - edges[:-1])[:, None])


def _accelerated(X: np.ndarray, u: np.ndarray, since: np.ndarray | float) -> np.ndarray:
    """Return states X (K, 2n) after times (K, 1) or () [s] under accelerations u (K, n); X itself, overwritten."""
    n = u.shape[1]
    Q = X[:, :n]
    Qdot = X[:, n:]
    gained = since * u
    Q += since * (Qdot + gained / 2)
    Qdot += gained
    return X


def states_of(plans: Sequence[Plan], times: Sequence[float]) -> np.ndarray:
    """Return the state of each plan at a time of its own [s], (len(plans), 2n), as `Plan.states_at` does."""
    at = [
        (each, each.times[1:].searchsorted(time + 1e-12, side="right")) for each, time in zip(plans, times, strict=True)
    ]
    since = np.array(times) - [plan.times[k] for plan, k in at]
    X = np.array([plan.X[k] for plan, k in at])
    u = np.array([plan._u_and_none[k] for plan, k in at])
    return _accelerated(X, u, since[:, None])


def resting_plan(start: float, horizon: float, nodes: int, x: np.ndarray, chart: Chart = PLANAR) -> Plan:
    """Return the plan that applies no control from x on: the first guess of a run."""
    n = len(x) // 2
    times = start + horizon * np.arange(nodes + 1) / nodes
    Qdot = np.broadcast_to(x[n:], (nodes + 1, n))
    X = np.hstack([x[:n] + (times - start)[:, None] * Qdot, Qdot])
    return Plan(times, X, np.zeros((nodes, n)), np.zeros(0), chart)


def shift(plan: Plan, now: float, horizon: float, x: np.ndarray, instants: np.ndarray | None = None) -> Plan:
    """Return the plan from now on, begun at the measured state x (2n,) and extended to the horizon's new end.

    Its instants are those of the plan that are still to come, if none (S,) [s] are given.
    """
    end = now + horizon
    first, stop = plan.times.searchsorted((now + 1e-9, end - 1e-9))
    u = plan._u_and_none[first - 1 : stop]
    last = plan.X[stop - 1 : stop].copy()
    X = np.concatenate((x[None], plan.X[first:stop], _accelerated(last, u[-1:], end - plan.times[stop - 1])))
    times = np.concatenate(((now,), plan.times[first:stop], (end,)))
    instants = plan.instants[plan.instants > now] if instants is None else instants
    return Plan(times, X, u, instants, plan.chart)


def braking_plan(start: float, x: np.ndarray, duration: float, horizon: float = 0.0, chart: Chart = PLANAR) -> Plan:
    """Return the plan that brings all velocities to rest at a constant rate, and then rests.

    Args:
        start: When it begins [s].
        x: State there (2n,).
        duration: Within which time the robot comes to rest [s].
        horizon: How long the plan is at least [s].
        chart: The chart of x.
    """
    n = len(x) // 2
    u = -x[n:] / duration
    at_rest = np.r_[x[:n] + duration / 2 * x[n:], np.zeros(n)]
    braking = Plan(np.array([start, start + duration]), np.vstack([x, at_rest]), u[None], np.zeros(0), chart)
    return shift(braking, start, horizon, x) if horizon > duration else braking
