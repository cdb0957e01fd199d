from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from psmpc_cli.ocp.end import NEVER, AtTime, ByObject, ByState, End, NormBound, PlannedEnd, StageProgress
from psmpc_cli.ocp.plan import Plan, resting_plan

BY_STATE = ByState(rows=(0, 2), tolerance=np.array([0.01, 0.02]), rate_tolerance=np.array([0.1, 0.2]))
BY_OBJECT = ByObject(
    rows=(1,),
    tolerance=np.array([0.05]),
    frame="arm_1",
    norms=(NormBound("position", 0.02, 2), NormBound("angle", 0.03, 1)),
    destination=np.array([1.0, 0.0, 0.5]),
    inside=np.array([0.1, 0.0, 0.0]),
)
PLAN: Plan = resting_plan(2.0, 4.0, 40, np.zeros(4))


def met_from(time: float) -> Callable[[np.ndarray], np.ndarray]:
    """Tell of the states of `PLAN`, which do not differ, that they meet an end condition from a time on."""
    return lambda X: PLAN.times[-len(X) - 1 : -1] >= time


def planned(instant: float, is_renewed: bool = True, moves_grippers: bool = False, is_near: bool = False) -> PlannedEnd:
    return PlannedEnd(instant, 2.0, 2.1, is_renewed, moves_grippers, lambda: is_near)


def test_a_stage_without_an_end_goes_on() -> None:
    assert not NEVER.is_over(StageProgress(0.0), 1e9, lambda: True)
    assert NEVER.predicted_end(StageProgress(0.0), PLAN, met_from(0.0)) == np.inf
    assert not NEVER.has_condition
    assert not NEVER.shape.is_fixed


@pytest.mark.parametrize(("at", "seen"), [(1.9, np.inf), (3.0, 3.0), (6.5, np.inf)])
def test_a_given_time_is_seen_inside_the_window(at: float, seen: float) -> None:
    assert AtTime(at=at).predicted_end(StageProgress(0.0), PLAN, met_from(0.0)) == seen
    assert (AtTime(at=at).earliest, AtTime(at=at).latest) == (at, at)


def test_a_given_time_ends_a_stage_that_has_lasted_its_dwell_time() -> None:
    end = AtTime(dwell=1.0, at=2.0)
    assert end.is_over(StageProgress(0.5), 2.0, lambda: False)
    assert not end.is_over(StageProgress(0.5), 1.9, lambda: True)
    assert not end.is_over(StageProgress(1.5), 2.0, lambda: True)


def test_an_end_condition_is_seen_where_the_plan_meets_it_after_the_dwell_time() -> None:
    seen = BY_STATE.predicted_end(StageProgress(0.0), PLAN, met_from(3.45))
    assert seen == pytest.approx(3.5)
    waiting = replace(BY_STATE, dwell=2.0).predicted_end(StageProgress(3.0), PLAN, met_from(0.0))
    assert waiting >= 5.0


def test_bounds_are_those_of_rows_then_rates_then_the_object() -> None:
    np.testing.assert_allclose(BY_STATE.half_widths, [0.01, 0.02, 0.1, 0.2])
    moving = BY_STATE.with_target_rates(np.array([1.0, 2.0, 3.0]))
    np.testing.assert_allclose(moving.centers, [0, 0, 1.0, 3.0])
    np.testing.assert_allclose(BY_OBJECT.half_widths, [0.05, *[0.02 / np.sqrt(2)] * 2, 0.03])
    assert BY_OBJECT.component_numbers == (1, 2, 1)
    assert BY_OBJECT.shape.measures == ("position", "angle")


def test_an_object_is_awaited_until_it_is_where_it_has_to_be() -> None:
    gripper = {"arm_1": np.array([0.9, 0.0, 0.5])}
    for x, awaited in ((1.1, True), (1.01, False)):
        end = BY_OBJECT.with_held_object(gripper, np.array([x, 0.0, 0.5]), np.zeros(3))
        assert end.awaits_object == awaited
        assert end.is_over(StageProgress(0.0), 5.0, lambda: True) != awaited
        assert end.time_left(StageProgress(0.0), 5.0, 0.1) == (0.1 if awaited else 0.0)
        np.testing.assert_allclose(BY_OBJECT.recorded(end.record).arguments, end.arguments)


@pytest.mark.parametrize(
    ("end", "plan", "accepted"),
    [
        (BY_STATE, planned(2.05), True),
        (BY_STATE, planned(2.05, is_renewed=False), True),
        (BY_STATE, planned(2.0, is_renewed=False), False),
        (BY_STATE, planned(2.0, is_renewed=False, is_near=True), True),
        (BY_STATE.unplanned(), planned(2.0), False),
        (BY_STATE, planned(1.95, is_renewed=False, moves_grippers=True), True),
        (AtTime(at=2.0), planned(2.0, is_renewed=False), True),
        (replace(BY_OBJECT, awaits_object=True), planned(2.05), False),
        (replace(BY_OBJECT, awaits_object=True), planned(2.2), True),
        (replace(BY_OBJECT, awaits_object=True), planned(1.95), True),
        (BY_OBJECT, planned(2.05), True),
    ],
)
def test_a_plan_may_end_a_stage_where_it_is_to_be_trusted(end: End, plan: PlannedEnd, accepted: bool) -> None:
    assert end.accepts(plan) == accepted
