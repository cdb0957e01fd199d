"""Routes of a disc among discs: clear, short, repeatable, of the free coordinates alone; and how they are followed."""

import json
import subprocess
import sys
from collections.abc import Sequence

import numpy as np
import pytest

from psmpc_cli.control.routes.route import Route, StraightMotions, find_route
from psmpc_cli.errors import InputError

RADIUS = 0.2
"""Of the robot [m]."""

MARGIN = 0.02
STEP = 0.05
"""In the metric [s]: 2.5 cm of travel."""

VELOCITY_LIMIT = 0.5

ONE_DISC = ((0.0, 0.0, 0.5),)
"""Position and radius [m] of what is in the way."""

SEVERAL_DISCS = ((0.0, 0.05, 0.3), (0.4, 0.8, 0.25), (-0.5, -0.7, 0.3), (0.7, -0.5, 0.2), (-0.6, 0.6, 0.2))

RING = tuple((1.5 + 0.6 * np.cos(angle), 0.6 * np.sin(angle), 0.2) for angle in np.linspace(0.0, 2 * np.pi, 13)[:-1])
"""Discs that touch each other, about the goal."""

START = np.array([-1.5, 0.0])
GOAL = np.array([1.5, 0.0])


def distances(configurations: np.ndarray, discs: Sequence[tuple[float, float, float]]) -> np.ndarray:
    """From configurations (K, n), the first two coordinates of which are the position, to distances (K,) [m]."""
    centres = np.array(discs)
    apart = np.linalg.norm(configurations[:, None, :2] - centres[:, :2], axis=2)
    return np.asarray(np.min(apart - centres[:, 2], axis=1) - RADIUS)


def motions_among(
    discs: Sequence[tuple[float, float, float]], size: int = 2, margin: float = MARGIN
) -> StraightMotions:
    return StraightMotions(lambda Q: distances(Q, discs) - margin, np.full(size, 1.0 / VELOCITY_LIMIT), STEP)


def route_among(
    discs: Sequence[tuple[float, float, float]],
    start: np.ndarray = START,
    goal: np.ndarray = GOAL,
    *,
    bound: float = 2.5,
    free: Sequence[int] = (0, 1),
    seed: int = 1,
    iterations: int = 500,
    slack: float = 0.0,
) -> Route | None:
    return find_route(
        start,
        goal,
        low=np.full(len(start), -bound),
        high=np.full(len(start), bound),
        free=free,
        motions=motions_among(discs, len(start)),
        seed=seed,
        iterations=iterations,
        slack=slack,
    )


def sagitta(radius: float) -> float:
    """How far a motion between two tested places comes into a circle that both are outside of [m]."""
    return (VELOCITY_LIMIT * STEP / 2) ** 2 / (2 * radius)


def finely(route: Route) -> np.ndarray:
    return route.configurations_at(np.linspace(0.0, 1.0, 5001))


def test_a_motion_is_clear_if_it_is_so_all_along() -> None:
    motions = motions_among(ONE_DISC)
    assert not motions.is_clear(START, GOAL)
    above = np.array([0.0, 1.0])
    assert motions.is_clear(above, above + 1.0)
    assert motions.is_clear(above, above)
    assert not motions.is_clear(np.zeros(2), above)
    assert not motions.is_clear(above, np.zeros(2))
    assert motions.length(START, GOAL) == pytest.approx(3.0 / VELOCITY_LIMIT)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_route_leads_from_start_to_goal_and_hits_nothing(seed: int) -> None:
    route = route_among(SEVERAL_DISCS, seed=seed)
    assert route is not None
    assert not motions_among(SEVERAL_DISCS).is_clear(START, GOAL)
    np.testing.assert_array_equal(route.waypoints[0], START)
    np.testing.assert_array_equal(route.waypoints[-1], GOAL)
    places = finely(route)
    assert distances(places, SEVERAL_DISCS).min() > MARGIN - sagitta(RADIUS + 0.2)
    assert np.abs(places).max() <= 2.5


@pytest.mark.parametrize("seed", [2, 3])
def test_a_route_is_almost_as_short_as_the_shortest_even_if_the_planner_has_little_time(seed: int) -> None:
    route = route_among(ONE_DISC, seed=seed, iterations=60)
    assert route is not None
    kept_away = 0.5 + RADIUS + MARGIN
    tangent = np.sqrt(1.5**2 - kept_away**2)
    arc = kept_away * (np.pi - 2 * np.arccos(kept_away / 1.5))
    shortest = (2 * tangent + arc) / VELOCITY_LIMIT
    # A polygon about the arc with corners 0.1 m apart, a thirtieth of the route, is 0.2 % longer; corners are not quite
    # where they would be best. The arc may be cut by the sagitta, 0.1 mm of 0.7 m.
    assert 0.999 * shortest < route.length < 1.01 * shortest


def test_a_clear_straight_motion_is_the_route_and_takes_no_planner(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ompl", None)
    ends = np.stack([START, GOAL]) + np.array([0.0, 1.0])
    route = route_among(ONE_DISC, ends[0], ends[1])
    assert route is not None
    np.testing.assert_array_equal(route.waypoints, ends)


def test_a_missing_planner_is_said_with_what_brings_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ompl", None)
    with pytest.raises(InputError, match=r"ompl.*pip install 'psmpc\[routes\]'"):
        route_among(ONE_DISC)


@pytest.mark.slow
def test_a_seed_has_one_route_whatever_was_planned_before_and_in_every_process(
    capfd: pytest.CaptureFixture[str],
) -> None:
    seeds = (0, 1)
    forwards = {seed: route_among(SEVERAL_DISCS, seed=seed) for seed in seeds}
    backwards = {seed: route_among(SEVERAL_DISCS, seed=seed) for seed in reversed(seeds)}
    assert capfd.readouterr() == ("", "")
    elsewhere = subprocess.run([sys.executable, __file__], check=True, capture_output=True, text=True)
    first, second = forwards[0], forwards[1]
    assert first is not None and second is not None
    assert first.waypoints.tolist() != second.waypoints.tolist()
    for seed in seeds:
        one, other = forwards[seed], backwards[seed]
        assert one is not None and other is not None
        np.testing.assert_array_equal(one.waypoints, other.waypoints)
    np.testing.assert_array_equal(second.waypoints, json.loads(elsewhere.stdout))
    assert elsewhere.stderr == ""


def test_only_free_coordinates_move() -> None:
    start = np.array([-1.5, 0.3, 0.0, -0.4])
    goal = np.array([1.5, 0.8, 0.0, 0.9])
    swapped = StraightMotions(
        lambda Q: distances(Q[:, [0, 2]], ONE_DISC) - MARGIN, np.array([2.0, 1.0, 2.0, 1.0]), STEP
    )
    bound = np.full(4, 2.5)
    route = find_route(start, goal, low=-bound, high=bound, free=(0, 2), motions=swapped, seed=1, iterations=500)
    assert route is not None
    assert len(route.waypoints) > 2
    np.testing.assert_array_equal(route.waypoints[:, [1, 3]], np.broadcast_to(start[[1, 3]], (len(route.waypoints), 2)))
    np.testing.assert_array_equal(route.waypoints[-1, [0, 2]], goal[[0, 2]])
    assert distances(finely(route)[:, [0, 2]], ONE_DISC).min() > 0.0


def test_a_goal_behind_walls_has_no_route() -> None:
    assert route_among(RING) is None
    assert route_among(RING, goal=np.array([2.4, 1.0])) is not None


def test_iterations_are_the_budget() -> None:
    assert route_among(SEVERAL_DISCS, iterations=0) is None
    assert route_among(SEVERAL_DISCS, iterations=500) is not None


def test_no_bounds_are_replaced_by_the_surroundings_of_start_and_goal() -> None:
    route = route_among(ONE_DISC, bound=np.inf)
    assert route is not None
    assert distances(finely(route), ONE_DISC).min() > 0.0
    assert np.abs(finely(route)[:, 1]).max() <= 3.0


def test_a_start_within_the_margin_takes_slack_and_is_left_without_coming_nearer() -> None:
    start = np.array([-0.71, 0.0])
    assert distances(start[None], ONE_DISC)[0] == pytest.approx(0.01)
    assert route_among(ONE_DISC, start) is None
    assert route_among(ONE_DISC, start, slack=0.005) is None
    route = route_among(ONE_DISC, start, slack=0.015)
    assert route is not None
    places = finely(route)
    left = np.linalg.norm(places - start, axis=1) > 0.1 * np.linalg.norm(GOAL - start)
    assert distances(places, ONE_DISC).min() > 0.01 - sagitta(RADIUS + 0.5)
    assert distances(places[left], ONE_DISC).min() > MARGIN - sagitta(RADIUS + 0.5)


def test_what_a_clearance_raises_comes_through() -> None:
    calls = []

    def interrupted(Q: np.ndarray) -> np.ndarray:
        calls.append(len(Q))
        if len(calls) == 50:
            raise KeyboardInterrupt
        return distances(Q, ONE_DISC)

    motions = StraightMotions(interrupted, np.ones(2), STEP)
    with pytest.raises(KeyboardInterrupt):
        find_route(START, GOAL, low=START - 1, high=GOAL + 1, free=(0, 1), motions=motions, seed=1)
    assert len(calls) == 50
    assert route_among(ONE_DISC) is not None


def test_progress_is_a_share_of_the_length() -> None:
    route = Route(np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]]), np.array([1.0, 3.0]))
    assert route.length == pytest.approx(4.0)
    np.testing.assert_allclose(route.configurations_at(np.array([0.0, 0.125, 0.25, 0.625, 1.0])).tolist(), [
        [0.0, 0.0], [0.5, 0.0], [1.0, 0.0], [1.0, 0.5], [1.0, 1.0],
    ])  # fmt: skip


def test_the_farthest_point_in_sight_leads_along_the_route_and_never_back() -> None:
    route = route_among(SEVERAL_DISCS)
    assert route is not None
    sight = motions_among(SEVERAL_DISCS, margin=0.0)
    Q = START
    progress = 0.0
    passed = []
    for _ in range(200):
        after = progress
        progress, waypoint = route.farthest_clear(Q, sight, after)
        assert progress >= after
        motion = Route(np.stack([Q, waypoint]), route.scale)
        assert distances(finely(motion), SEVERAL_DISCS).min() > -sagitta(RADIUS + 0.2)
        np.testing.assert_allclose(waypoint, route.configurations_at(np.array([progress]))[0])
        passed.append(progress)
        towards = waypoint - Q
        Q = Q + towards * min(1.0, 0.05 / max(float(np.linalg.norm(towards)), 1e-12))
    assert 0.0 < passed[0] < 1.0
    np.testing.assert_allclose(Q, GOAL, atol=1e-12)


def test_in_a_narrow_corridor_the_corner_is_gone_to_before_what_is_behind_it() -> None:
    corner = np.array([0.7071, 0.0])
    route = Route(np.array([[0.0, 0.0], corner, [0.7071, 1.0]]), np.ones(2))

    def clearance(Q: np.ndarray) -> np.ndarray:
        """Return how far from the walls points are in a corridor of 2 mm along the route."""
        ends = (route.waypoints[:-1], route.waypoints[1:])
        nearest = np.clip(Q[:, None], np.minimum(*ends), np.maximum(*ends))
        return np.asarray(1e-3 - np.linalg.norm(Q[:, None] - nearest, axis=2).min(axis=1))

    motions = StraightMotions(clearance, np.ones(2), 1e-3)
    progress, waypoint = route.farthest_clear(np.zeros(2), motions, 0.0)
    assert progress == pytest.approx(0.7071 / route.length)
    np.testing.assert_allclose(waypoint, corner)
    progress, waypoint = route.farthest_clear(corner, motions, progress)
    assert progress == 1.0


def test_who_is_at_the_goal_stays_there() -> None:
    for start, discs, slack in ((START, ONE_DISC, 0.0), (np.array([-0.71, 0.0]), ONE_DISC, 0.015)):
        route = route_among(discs, start, start, slack=slack)
        assert route is not None
        assert route.length == 0.0
        progress, waypoint = route.farthest_clear(start, motions_among(discs, margin=0.0), 0.0)
        assert progress == 1.0
        np.testing.assert_array_equal(waypoint, start)


def test_where_nothing_is_in_sight_the_progress_stays() -> None:
    route = Route(np.array([START, [0.0, 1.0], GOAL]), np.ones(2))
    progress, waypoint = route.farthest_clear(np.zeros(2), motions_among(ONE_DISC), 0.3)
    assert progress == 0.3
    np.testing.assert_allclose(waypoint, route.configurations_at(np.array([0.3]))[0])
    assert route.farthest_clear(START, motions_among(ONE_DISC), 1.0)[0] == 1.0


if __name__ == "__main__":
    planned = route_among(SEVERAL_DISCS, seed=1)
    sys.stdout.write(json.dumps(planned.waypoints.tolist() if planned is not None else None))
