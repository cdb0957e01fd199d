"""Routes: paths round what blocks the straight motion to a target, planned in the space of coordinates.

A route is planned by AORRTC of OMPL, which searches again and again for paths shorter than the best one so far:
T. S. Wilson, W. Thomason, Z. Kingston and J. D. Gammell, "AORRTC: Almost-surely asymptotically optimal planning with
RRT-Connect", IEEE Robotics and Automation Letters 10(12), 2025. It stops after a number of iterations, not after a
time, so that the same seed gives the same route in every process.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from types import ModuleType
from typing import Any

import numpy as np

from psmpc_cli.errors import InputError

Clearance = Callable[[np.ndarray], np.ndarray]
"""From configurations (K, n) to the smallest distance less the margin that is asked for (K,) [m]: clear from 0 on."""

ITERATIONS = 5000
"""Iterations of the planner, unless a caller says otherwise."""

LONGEST_PLANNING = 120.0
"""When the planner is stopped whatever its iterations [s]: a safety, since such a route is not repeatable."""

SHORTENING_POINTS = 30
"""Into how many pieces a route is divided to be shortened."""

SHORTENING_GAIN = 1e-3
"""What part of its length a pass of shortening must save for another to follow."""

SHORTEST = 1e-12
"""Lengths are divided by this at least: start and goal may be the same."""

ROUNDING = 1e-9
"""By how much the clearance of one configuration may differ between calls [m]."""

ALLOWED_SHARE = 0.1
"""Part of the distance from start to goal within which a route may be as near to obstacles as these are."""

COARSE = 8
"""A motion is tested at every so many of its configurations before it is at the others."""

FOLLOWED_POINTS = 50
"""Into how many pieces a route is divided to find its farthest point in sight."""


@dataclass(frozen=True, eq=False)
class StraightMotions:
    """Measures straight motions and tests whether they are clear.

    A motion is tested at configurations at most a step apart. Between them the clearance may be less by what the
    fastest point of the robot travels in half a step, which the margin has to cover.

    Attributes:
        clearance: Of configurations.
        scale: Weights of the metric (n,): with the reciprocals of velocity limits, lengths are times at these [s].
        step: Largest length between tested configurations, in the metric.
    """

    clearance: Clearance
    scale: np.ndarray
    step: float

    def length(self, start: np.ndarray, goal: np.ndarray) -> float:
        """Return the length of a motion between configurations (n,)."""
        return float(np.linalg.norm((goal - start) * self.scale))

    def is_clear(self, start: np.ndarray, goal: np.ndarray) -> bool:
        """Return whether the straight motion between configurations (n,) is clear, both of them included.

        Every `COARSE`-th configuration is tested first: most motions that are not clear are found by these.
        """
        pieces = max(1, int(np.ceil(self.length(start, goal) / self.step)))
        shares = np.linspace(0.0, 1.0, pieces + 1)
        is_coarse = np.arange(pieces + 1) % COARSE == 0
        of_both = (shares[is_tested, None] for is_tested in (is_coarse, ~is_coarse))
        return all(
            (self.clearance(start + fractions * (goal - start)) >= 0.0).all() for fractions in of_both if len(fractions)
        )


@dataclass(frozen=True, eq=False)
class Route:
    """A path of straight motions.

    Attributes:
        waypoints: Its corners (W, n), start and end included.
        scale: Weights of the metric in which it is measured (n,).
    """

    waypoints: np.ndarray
    scale: np.ndarray

    @property
    def marks(self) -> np.ndarray:
        """Length of the route up to each waypoint (W,), in the metric."""
        pieces = np.linalg.norm(np.diff(self.waypoints, axis=0) * self.scale, axis=1)
        return np.concatenate([[0.0], np.cumsum(pieces)])

    @property
    def length(self) -> float:
        """Length of the route, in the metric."""
        return float(self.marks[-1])

    def configurations_at(self, progress: np.ndarray) -> np.ndarray:
        """Return the configurations (K, n) at shares of the route's length (K,), from 0 to 1."""
        marks = self.marks
        wanted = np.asarray(progress) * marks[-1]
        return np.stack([np.interp(wanted, marks, values) for values in self.waypoints.T], axis=-1)

    def farthest_clear(self, Q: np.ndarray, motions: StraightMotions, after: float) -> tuple[float, np.ndarray]:
        """Return the farthest point of the route that a clear straight motion from a configuration reaches.

        It is the point that a robot on the route heads for; it never lies before the point of the sample before. The
        end of the route is tested first. If no clear straight motion leads there, the point is found by bisection, as
        if all points before the farthest reachable one could be reached, too. Candidates are the waypoints, and points
        at `FOLLOWED_POINTS` even shares of the length. From a candidate on the route the next one can always be
        reached, since no corner lies between them.

        Args:
            Q: Where the motion begins (n,).
            motions: Tests it. Its margin should be less than that with which the route was planned. If Q itself is
                nearer than the margin, no motion is clear, and the progress stays as it is.
            after: Progress of the point at the sample before, 0 at first.

        Returns:
            The progress of the point, its share of the route's length from 0 to 1, and the configuration there (n,).
        """
        shares = self.shares(FOLLOWED_POINTS)
        candidates = np.append(after, shares[shares > after])
        points = self.configurations_at(candidates)
        if motions.is_clear(Q, points[-1]):
            return float(candidates[-1]), points[-1]
        reached = 0
        beyond = len(candidates) - 1
        while beyond - reached > 1:
            middle = (reached + beyond) // 2
            if motions.is_clear(Q, points[middle]):
                reached = middle
            else:
                beyond = middle
        return float(candidates[reached]), points[reached]

    def shares(self, pieces: int) -> np.ndarray:
        """Return shares of the length from 0 to 1 (K,): so many even ones, and between them those of the waypoints."""
        return np.union1d(self.marks / max(self.length, SHORTEST), np.linspace(0.0, 1.0, pieces + 1))


def find_route(
    start: np.ndarray,
    goal: np.ndarray,
    *,
    low: np.ndarray,
    high: np.ndarray,
    free: Sequence[int],
    motions: StraightMotions,
    seed: int,
    iterations: int = ITERATIONS,
    slack: float = 0.0,
) -> Route | None:
    """Find a short route of clear straight motions from one configuration to another.

    If the straight motion is clear, it is the route. Others are planned by sampling, then shortened. The same arguments
    give the same route, in every process and whatever was planned before, unless planning lasts `LONGEST_PLANNING`.
    OMPL draws its seeds from one generator of the process: two threads must not plan at once.

    Args:
        start: Configuration at its beginning (n,); angles do not wrap.
        goal: Configuration at its end (n,).
        low: Least values of the coordinates (n,). Infinite ones are replaced: a route then leaves the box about start
            and goal by at most their distance in the metric. Start and goal may be outside.
        high: Largest values (n,), likewise.
        free: Which coordinates move. The others stay at the start's values, at the end of the route too.
        motions: Measures and tests motions.
        seed: An integer from 0 on.
        iterations: How often the planner looks whether it should stop: about how many configurations it draws.
        slack: By how much start and goal may be nearer to obstacles than the margin [m]. If one of them is, the route
            near it may be as well, and less so farther away: not at all at a tenth of the distance from start to goal.

    Returns:
        The route; None if start or goal is not clear, or if no route was found in so many iterations.

    Raises:
        InputError: A route has to be planned, and OMPL is not installed.
    """
    moving = np.asarray(free, dtype=int)
    end = start.copy()
    end[moving] = goal[moving]
    motions = _allowing_slack_near_ends(motions, start, end, slack)
    if np.any(motions.clearance(np.stack([start, end])) < 0.0):
        return None
    if motions.is_clear(start, end):
        return Route(np.stack([start, end]), motions.scale)

    reach = motions.length(start, end) / motions.scale
    lowest = np.minimum(start, end)
    highest = np.maximum(start, end)
    waypoints = _plan_with_ompl(
        start,
        end,
        low=np.where(np.isfinite(low), np.minimum(low, lowest), lowest - reach),
        high=np.where(np.isfinite(high), np.maximum(high, highest), highest + reach),
        moving=moving,
        motions=motions,
        seed=seed,
        iterations=iterations,
    )
    if waypoints is None or not all(map(motions.is_clear, waypoints[:-1], waypoints[1:])):
        return None  # the planner may have been stopped while it smoothed a path, before it tested that
    return _shortened(Route(waypoints, motions.scale), motions)


def _allowing_slack_near_ends(
    motions: StraightMotions, start: np.ndarray, end: np.ndarray, slack: float
) -> StraightMotions:
    """Return motions with a smaller margin near a start or an end that is itself nearer to obstacles than the margin.

    Otherwise no route could leave a start, or reach an end, where the robot is close to something on purpose. What is
    missing to the margin there is allowed at the end itself, and fades to 0 within a tenth of the motion's length.

    Args:
        motions: The motions.
        start: Where a route begins (n,).
        end: Where it ends (n,).
        slack: What may be missing to the margin at most [m]; an end that misses more is not clear.
    """
    ends = np.stack([start, end])
    lacking = -motions.clearance(ends)
    allowed = np.where((lacking > 0.0) & (lacking <= slack), lacking + ROUNDING, 0.0)
    if not np.any(allowed):
        return motions
    radius = max(ALLOWED_SHARE * motions.length(start, end), SHORTEST)

    def clearance(configurations: np.ndarray) -> np.ndarray:
        distances = np.linalg.norm((configurations[:, None] - ends) * motions.scale, axis=2)
        fading = np.maximum(0.0, 1.0 - distances / radius)
        return np.asarray(motions.clearance(configurations) + np.max(allowed * fading, axis=1))

    return replace(motions, clearance=clearance)


def _plan_with_ompl(
    start: np.ndarray,
    end: np.ndarray,
    *,
    low: np.ndarray,
    high: np.ndarray,
    moving: np.ndarray,
    motions: StraightMotions,
    seed: int,
    iterations: int,
) -> np.ndarray | None:
    """Return the corners (W, n) of the shortest path that the planner has found, None if it has found none.

    OMPL's states are the moving coordinates times their weights, so that its metric is the Euclidean one.
    """
    base, geometric, util = _ompl()
    count = len(moving)
    scale = motions.scale[moving]

    def configuration(state: Any) -> np.ndarray:
        values = start.copy()
        values[moving] = np.array(state[0:count]) / scale
        return values

    def is_clear(validator: Any, one: Any, other: Any) -> bool:
        return motions.is_clear(configuration(one), configuration(other))

    validator = type("Validator", (base.MotionValidator,), {"checkMotion": is_clear})
    space = base.RealVectorStateSpace(count)
    bounds = base.RealVectorBounds(count)
    for axis, coordinate in enumerate(moving):
        bounds.setLow(axis, float(low[coordinate] * scale[axis]))
        bounds.setHigh(axis, float(high[coordinate] * scale[axis]))
    space.setBounds(bounds)

    log_level = util.getLogLevel()
    util.setLogLevel(util.LOG_NONE)  # a generator that is seeded again is reported as an error: what is drawn is right
    try:
        util.RNG.setSeed(seed + 1)  # OMPL ignores a 0
        information = base.SpaceInformation(space)
        information.setMotionValidator(validator(information))
        information.setStateValidityChecker(lambda state: bool(motions.clearance(configuration(state)[None])[0] >= 0.0))
        information.setup()

        problem = base.ProblemDefinition(information)
        ends = []
        for values in (start, end):
            state = information.allocState()
            state[0:count] = [float(value) for value in values[moving] * scale]
            ends.append(state)
        problem.setStartAndGoalStates(*ends)
        problem.setOptimizationObjective(base.PathLengthOptimizationObjective(information))

        planner = geometric.AORRTC(information)
        planner.setProblemDefinition(problem)
        planner.setup()
        planner.solve(base.PlannerTerminationCondition(_Budget(iterations)))
    finally:
        util.setLogLevel(log_level)

    if not problem.hasExactSolution():
        return None
    inner = [configuration(state) for state in problem.getSolutionPath().getStates()[1:-1]]
    return np.stack([start, *inner, end])


class _Budget:
    """Tells a planner, which asks at every iteration, when to stop."""

    def __init__(self, iterations: int) -> None:
        self._left = iterations
        self._latest = time.monotonic() + LONGEST_PLANNING

    def __call__(self) -> bool:
        self._left -= 1
        return self._left < 0 or time.monotonic() > self._latest


def _ompl() -> tuple[ModuleType, ModuleType, ModuleType]:
    """Return the modules of OMPL."""
    try:
        from ompl import base, geometric, util
    except ImportError as error:
        raise InputError(
            f"routes: found no working package {error.name} ({error}); install it with pip install 'psmpc[routes]'"
        ) from None
    return base, geometric, util


def _shortened(route: Route, motions: StraightMotions) -> Route:
    """Return the route with corners cut, until a pass gains less than `SHORTENING_GAIN` of its length.

    A pass takes the shortest path along straight clear motions between points of the route.
    """
    while True:
        points = route.configurations_at(route.shares(SHORTENING_POINTS))
        shorter = Route(_shortest_path(points, motions), route.scale)
        if shorter.length > (1.0 - SHORTENING_GAIN) * route.length:
            return shorter
        route = shorter


def _shortest_path(points: np.ndarray, motions: StraightMotions) -> np.ndarray:
    """Return the shortest clear path from the first of some points to the last, which may leave out points between.

    It cuts the corners of a route. Points keep their order, so that dynamic programming finds the path: the shortest
    length up to each point follows from those of the points before it. A motion is tested only if it would be part of a
    shorter path than those found, because tests take most of the time.

    Args:
        points: Configurations (P, n); the motion from each to the next is clear.
        motions: Measures and tests motions.

    Returns:
        The points of the path (W, n), the first and the last included.
    """
    lengths = np.zeros(len(points))
    previous = np.zeros(len(points), dtype=int)
    for k in range(1, len(points)):
        # lengths of the paths to point k whose last motion begins at an earlier point, the shortest tested first
        through = lengths[:k] + np.linalg.norm((points[:k] - points[k]) * motions.scale, axis=1)
        candidates = np.argsort(through, kind="stable")
        previous[k] = next(j for j in candidates if j == k - 1 or motions.is_clear(points[j], points[k]))
        lengths[k] = through[previous[k]]
    path = [len(points) - 1]
    while path[-1] > 0:
        path.append(int(previous[path[-1]]))
    return points[path[::-1]]
