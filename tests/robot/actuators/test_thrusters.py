"""What thrusters can give: the polytope of their wrenches, thrusts for a wrench, pulses for thrusts."""

from dataclasses import replace
from itertools import combinations, product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from psmpc_cli.errors import InputError
from psmpc_cli.robot.actuators.thrusters import Thrusters
from psmpc_cli.specs.load import load_robot
from psmpc_cli.specs.robots.actuators import PlanarThruster, SpatialThruster, Thruster

PLATFORM = Thrusters.of(load_robot("thruster_platform").thrusters)
TICK = 1e-3


def one(rng: np.random.Generator, d: int) -> Thruster:
    """A thruster in a random place and direction, in the plane (3) or in space (6)."""
    kind, axes = (PlanarThruster, 2) if d == 3 else (SpatialThruster, 3)
    position, direction = rng.uniform(-1, 1, axes), rng.normal(size=axes)
    return kind(position=position.tolist(), direction=direction.tolist(), force=rng.uniform(1, 5))


def drawn(seed: int, count: int = 6, d: int = 3) -> Thrusters:
    """Thrusters in random places and directions, which push and turn in every direction."""
    rng = np.random.default_rng(seed)
    while True:
        made = Thrusters.of([one(rng, d) for _ in range(count)])
        low, high = made.half_spaces.low, made.half_spaces.high
        if low.max() < -1e-3 and high.min() > 1e-3:
            return made


def is_attainable(thrusters: Thrusters, wrench: np.ndarray) -> bool:
    """Whether a linear program finds thrusts for a wrench."""
    bounds = [(0, force) for force in thrusters.force]
    found = linprog(np.zeros(thrusters.count), A_eq=thrusters.wrenches, b_eq=wrench, bounds=bounds)
    return bool(found.status == 0)


def test_wrenches_are_about_the_origin_of_the_base() -> None:
    planar = PlanarThruster(position=(0.2, 0.5), direction=(-3, 0), force=1)
    spatial = SpatialThruster(position=(0.2, 0.5, 0.1), direction=(0, 0, 2), force=1)
    assert planar.wrench == pytest.approx([-1, 0, 0.5])
    assert spatial.wrench == pytest.approx([0, 0, 1, 0.5, -0.2, 0])


@pytest.mark.parametrize(
    "thrusters", [PLATFORM, drawn(1), drawn(2, 9), drawn(3, 9, 6)], ids=["platform", "6", "9", "3d"]
)
def test_the_half_spaces_are_what_thrusts_can_give(thrusters: Thrusters) -> None:
    """Random thrusts are inside, corners touch, and just outside of each facet no thrusts give the wrench."""
    rng = np.random.default_rng(0)
    faces = thrusters.half_spaces
    thrusts = thrusters.force[:, None] * np.hstack(
        [rng.uniform(size=(thrusters.count, 300)), np.array(list(product((0, 1), repeat=thrusters.count)), float).T]
    )
    values = faces.normals @ thrusters.wrenches @ thrusts
    assert (values <= faces.high[:, None] + 1e-9).all()
    assert (values >= faces.low[:, None] - 1e-9).all()
    np.testing.assert_allclose(values.max(axis=1), faces.high)
    np.testing.assert_allclose(values.min(axis=1), faces.low, atol=1e-12)
    for normal, high in zip(faces.normals, faces.high, strict=True):
        on_facet = thrusters.wrenches @ np.where(normal @ thrusters.wrenches > 0, thrusters.force, 0)
        assert is_attainable(thrusters, 0.999 * on_facet)
        assert not is_attainable(thrusters, on_facet + 1e-3 * high * normal / (normal @ normal))


@pytest.mark.parametrize("thrusters", [PLATFORM, drawn(1), drawn(3, 9, 6)], ids=["platform", "6", "3d"])
def test_wrenches_within_all_half_spaces_have_thrusts(thrusters: Thrusters) -> None:
    """No half-space is missing: rays end where the linear program does."""
    rng = np.random.default_rng(5)
    faces = thrusters.half_spaces
    for ray in rng.normal(size=(20, len(thrusters.wrenches))):
        along = faces.normals @ ray
        reach = (np.where(along > 0, faces.high, faces.low)[along != 0] / along[along != 0]).min()
        assert is_attainable(thrusters, 0.999 * reach * ray)
        assert not is_attainable(thrusters, 1.001 * reach * ray)


def test_aligned_thrusters_have_few_facets() -> None:
    assert len(PLATFORM.half_spaces.normals) == 6
    low, high = PLATFORM.extent
    np.testing.assert_allclose(high, [20, 20, 9.6])
    np.testing.assert_allclose(low, -high)


def test_too_many_facets_are_refused() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(InputError, match=r"found 14 in 14 directions.*make thrusters parallel, or leave them out"):
        _ = Thrusters.of([one(rng, 6) for _ in range(14)]).half_spaces


def least_cost(thrusters: Thrusters, wrench: np.ndarray, cost: np.ndarray) -> float:
    """The least cost of thrusts for a wrench (3,), of all basic solutions: all but three at one of their bounds."""
    T = thrusters.count
    least = np.inf
    for basic in map(list, combinations(range(T), 3)):
        others = [i for i in range(T) if i not in basic]
        for at_bounds in product((0, 1), repeat=len(others)):
            thrusts = np.zeros(T)
            thrusts[others] = thrusters.force[others] * at_bounds
            thrusts[basic] = np.linalg.solve(thrusters.wrenches[:, basic], wrench - thrusters.wrenches @ thrusts)
            if (thrusts >= -1e-9).all() and (thrusts <= thrusters.force + 1e-9).all():
                least = min(least, float(cost @ thrusts))
    return least


@pytest.mark.parametrize("impulses", [[60] * 6, [60, 200, 60, 200, 60, 200]], ids=["alike", "unlike"])
def test_allocation_is_the_best_of_all_basic_solutions(impulses: list[float]) -> None:
    """Least propellant; within the polytope the wrench is given exactly."""
    made = drawn(1)
    thrusters = Thrusters(made.wrenches, made.force, made.force, 0 * made.force, np.array(impulses, float))
    cost = 1 / thrusters.specific_impulse
    for share in np.random.default_rng(1).uniform(size=(20, thrusters.count)):
        wrench = thrusters.wrenches @ (share * thrusters.force)
        found = thrusters.allocate(wrench)
        np.testing.assert_allclose(thrusters.wrenches @ found.thrusts, wrench, atol=1e-8)
        assert (found.residual == 0).all()
        assert (found.thrusts >= 0).all()
        assert (found.thrusts <= thrusters.force).all()
        assert cost @ found.thrusts == pytest.approx(least_cost(thrusters, wrench, cost), rel=1e-7)


def test_a_wrench_beyond_them_gets_the_nearest() -> None:
    """No attainable wrench is nearer; what is left is the residual."""
    thrusters = drawn(2, 9)
    rng = np.random.default_rng(3)
    scale = np.array([1, 1, 1 / thrusters.arm])
    for wrench in 20 * rng.normal(size=(20, 3)):
        found = thrusters.allocate(wrench)
        np.testing.assert_allclose(wrench - thrusters.wrenches @ found.thrusts, found.residual, atol=1e-9)
        distance = np.linalg.norm(scale * found.residual)
        others = thrusters.wrenches @ (thrusters.force[:, None] * rng.uniform(size=(9, 2000)) ** 0.2)
        nearer = thrusters.wrenches @ found.thrusts + 0.1 * (others.T - thrusters.wrenches @ found.thrusts)
        assert distance > 0
        assert (np.linalg.norm(scale * (wrench - nearer), axis=1) >= distance * (1 - 1e-6)).all()


def test_nothing_is_allocated_for_nothing() -> None:
    found = PLATFORM.allocate(np.zeros(3))
    assert not found.thrusts.any()
    assert not found.residual.any()


@given(
    st.lists(st.floats(0, 10), min_size=3, max_size=3),
    st.integers(20, 200),
    st.floats(0, 0.02),
    st.sampled_from([10.0, 4.0, 1.0]),
)
@settings(deadline=None, max_examples=200)
def test_pulses_give_the_impulse_up_to_half_of_the_shortest(
    wanted: list[float], ticks: int, shortest: float, smallest: float
) -> None:
    """None is shorter than the shortest, weaker than the smallest force or stronger than the largest; one a period."""
    thrusts = np.array(wanted)
    ones = np.ones(3)
    wrenches = PLATFORM.wrenches[:, :3]
    thrusters = Thrusters(wrenches, 10 * ones, smallest * ones, shortest * ones, np.nan * ones)
    fired = thrusters.pulses(thrusts, ticks, TICK)
    assert fired.shape == (ticks, 3)
    fires = fired > 0
    assert (fired[fires] <= 10).all()
    assert (fired[fires] >= smallest * (1 - 1e-12)).all()
    width = fires.sum(axis=0)
    assert ((width == 0) | (width * TICK >= shortest - 1e-9)).all()
    edges = np.diff(np.vstack([np.zeros(3), fires, np.zeros(3)]), axis=0)
    assert (np.abs(edges).sum(axis=0) <= 2).all()
    error = np.abs(fired.sum(axis=0) - thrusts * ticks) * TICK
    assert (error <= smallest * max(np.ceil(shortest / TICK - 1e-9), 1) * TICK / 2 + 1e-9).all()


def test_pulses_are_about_the_middle_of_the_period() -> None:
    fired = PLATFORM.pulses(np.full(8, 12.0 / 2), 200, TICK)[:, 0]
    assert np.flatnonzero(fired)[[0, -1]].tolist() == [40, 159]


def test_throttled_thrusters_give_the_constant_thrust() -> None:
    ones = np.ones(8)
    throttled = Thrusters(PLATFORM.wrenches, 10 * ones, 2 * ones, 0 * ones, 60 * ones)
    np.testing.assert_allclose(throttled.pulses(np.full(8, 3.3), 50, TICK), 3.3)


def test_propellant_is_the_impulse_over_the_exhaust_velocity() -> None:
    assert PLATFORM.propellant(np.full(8, 9.80665)) == pytest.approx(8 / 60)
    assert np.isnan(drawn(1).propellant(np.ones(6)))


@pytest.mark.parametrize("thrusters", [PLATFORM, drawn(2, 9), drawn(3, 9, 6)], ids=["platform", "9", "3d"])
def test_the_same_facets_bound_what_is_left_when_some_are_shut(thrusters: Thrusters) -> None:
    """Exactly, also where those that are left cannot push in every direction: what is inside has thrusts."""
    rng = np.random.default_rng(1)
    normals = thrusters.half_spaces.normals
    is_inside_often = 0
    for count in (1, 2, 3, thrusters.count - 2, thrusters.count - 1):
        is_shut = np.zeros(thrusters.count, bool)
        is_shut[rng.choice(thrusters.count, count, replace=False)] = True
        (low,), (high,) = thrusters.bounds(normals, is_shut[None])
        left = replace(thrusters, force=np.where(is_shut, 0.0, thrusters.force))
        thrusts = left.force[:, None] * rng.uniform(size=(thrusters.count, 200))
        along = normals @ (left.wrenches @ thrusts)
        assert (along >= low[:, None] - 1e-9).all() and (along <= high[:, None] + 1e-9).all()
        for wrench in (left.wrenches @ thrusts[:, :40]).T * rng.uniform(0.5, 2.0, (40, 1)):
            along = normals @ wrench
            is_inside = bool((along >= low + 1e-7).all() and (along <= high - 1e-7).all())
            is_outside = bool((along < low - 1e-6).any() or (along > high + 1e-6).any())
            is_inside_often += is_inside
            assert not is_inside or is_attainable(left, wrench)
            assert not is_outside or not is_attainable(left, wrench)
    assert is_inside_often > 20


def test_thrusters_that_are_shut_get_no_thrust() -> None:
    is_shut = np.isin(np.arange(8), (2, 3))
    wanted = np.array([-5.0, 3.0, 0.5])
    allocation = PLATFORM.allocate(wanted, is_shut)
    assert not allocation.thrusts[is_shut].any() and allocation.thrusts.any()
    np.testing.assert_allclose(PLATFORM.wrenches @ allocation.thrusts + allocation.residual, wanted)
    assert allocation.residual[0] == pytest.approx(-5.0)
    none = PLATFORM.allocate(wanted, np.ones(8, bool))
    assert not none.thrusts.any()
    np.testing.assert_array_equal(none.residual, wanted)
    for each, other in zip(
        vars(PLATFORM.allocate(wanted)).values(),
        vars(PLATFORM.allocate(wanted, np.zeros(8, bool))).values(),
        strict=True,
    ):
        np.testing.assert_allclose(each, other, atol=1e-9)
