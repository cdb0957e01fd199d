from dataclasses import fields, replace

import numpy as np
import pytest

from psmpc_cli.control.sequence import (
    FaultKind,
    GraspFault,
    GraspProgress,
    MovingSequence,
    detect,
    drop_met,
    drop_passed,
)
from psmpc_cli.ocp.end import ByObject
from psmpc_cli.ocp.objective import StageCosts
from psmpc_cli.ocp.plan import Plan, resting_plan
from psmpc_cli.ocp.stage import PlacedStage

from ..ocp.transport_windows import ending, sequence_of

AT_TARGET = np.r_[-2.0, 2.0, np.pi / 6, np.zeros(15)]


def arriving(at: float, end: float = 4.0) -> Plan:
    """A plan whose base reaches Approach's target at the given time and stays there."""
    times = np.linspace(0, end, 401)
    X = np.tile(AT_TARGET, (401, 1))
    X[:, 0] += 0.2 * np.maximum(at - times, 0)
    return Plan(times, X, np.zeros((400, 9)), np.zeros(0))


def test_every_stage_whose_instant_has_passed_is_dropped() -> None:
    sequence, switches = drop_passed(sequence_of(0, [1.0, 1.05, 3.0]), 1.1)
    assert [(s.stage, s.time) for s in switches] == [(0, 1.0), (1, 1.05)]
    assert (sequence.first, sequence.progress.entered, sequence.switch_times.tolist()) == (2, 1.05, [3.0])


def test_the_current_stage_is_dropped_when_the_measured_state_meets_its_condition(
    stages: tuple[PlacedStage, ...], costs: StageCosts
) -> None:
    sequence, switches = drop_met(sequence_of(0, [3.0]), stages, costs, 2.0, AT_TARGET)
    assert [(s.stage, s.time) for s in switches] == [(0, 2.0)]
    assert sequence.first == 1
    away, none = drop_met(sequence_of(0, [3.0]), stages, costs, 2.0, np.zeros(18))
    assert (away.first, none) == (0, [])


def test_a_stage_stays_for_its_dwell_time(stages: tuple[PlacedStage, ...], costs: StageCosts) -> None:
    dwelling = (ending(stages[0], dwell=2.5), *stages[1:])
    kept, _ = drop_met(sequence_of(0), dwelling, costs, 2.4, AT_TARGET)
    dropped, _ = drop_met(sequence_of(0), dwelling, costs, 2.5, AT_TARGET)
    assert (kept.first, dropped.first) == (0, 1)
    longer = detect(sequence_of(0), dwelling, costs, arriving(1.0), 10)
    assert longer is not None
    assert longer.switch_times[0] >= 2.5


def test_the_next_stage_is_detected_at_the_predicted_hitting_time_within_the_margin(
    stages: tuple[PlacedStage, ...], costs: StageCosts
) -> None:
    longer = detect(sequence_of(0), stages, costs, arriving(2.0), 10)
    assert longer is not None
    assert abs(longer.switch_times[0] - (2.0 - 0.02 / 0.2)) < 0.02
    assert detect(sequence_of(0), stages, costs, arriving(4.5), 10) is None


def test_nothing_is_detected_after_the_last_stage(stages: tuple[PlacedStage, ...], costs: StageCosts) -> None:
    assert detect(sequence_of(3), stages, costs, arriving(1.0), 10) is None


AT_TARGET = np.r_[-2.0, 2.0, np.pi / 6, np.zeros(15)]


HOLD = 0.5


@pytest.fixture
def holding(stages: tuple[PlacedStage, ...]) -> tuple[PlacedStage, ...]:
    return (ending(stages[0], hold=HOLD), *stages[1:])


def seen(states: list[np.ndarray], stages: tuple[PlacedStage, ...], costs: StageCosts) -> MovingSequence:
    """The sequence after samples 0.1 s apart."""
    sequence = sequence_of(0)
    for k, x in enumerate(states):
        sequence = sequence.with_measurement(stages, costs, 0.1 * k, x)
    return sequence


def test_a_stage_ends_when_its_condition_was_met_long_enough(
    holding: tuple[PlacedStage, ...], costs: StageCosts
) -> None:
    for samples, over in ((5, False), (6, True)):
        sequence, now = seen([np.zeros(18), *[AT_TARGET] * samples], holding, costs), 0.1 * samples
        assert holding[0].end.hold_left(sequence.progress, now) == pytest.approx(HOLD + 0.1 - now)
        assert bool(drop_met(sequence, holding, costs, now, AT_TARGET)[1]) is over


def test_a_break_begins_the_hold_again_and_keeps_the_next_stage_out(
    holding: tuple[PlacedStage, ...], costs: StageCosts
) -> None:
    prediction = resting_plan(0.3, 4.0, 10, AT_TARGET)
    unbroken, broken = (seen([AT_TARGET, x, AT_TARGET, AT_TARGET], holding, costs) for x in (AT_TARGET, np.zeros(18)))
    assert (unbroken.progress.met_since, broken.progress.met_since) == (0.0, pytest.approx(0.2))
    longer = detect(unbroken, holding, costs, prediction, 10)
    assert longer is not None
    assert longer.switch_times.tolist() == pytest.approx([HOLD])
    assert detect(broken, holding, costs, prediction, 10) is None
    assert detect(seen([np.zeros(18)], holding, costs), holding, costs, prediction, 10) is None
    lost = longer.with_measurement(holding, costs, 0.4, np.zeros(18))
    assert (lost.count, lost.progress.hold_lost) == (1, True)


def test_a_stage_that_awaits_its_object_does_not_end(stages: tuple[PlacedStage, ...], costs: StageCosts) -> None:
    of_state = {each.name: getattr(stages[0].end, each.name) for each in fields(stages[0].end)}
    end = ByObject(**of_state, awaits_object=True, inside=np.zeros(3))
    awaiting = (replace(stages[0], end=end), *stages[1:])
    kept, _ = drop_met(sequence_of(0, [3.0]), awaiting, costs, 2.0, AT_TARGET)
    assert (kept.first, kept.switch_times.tolist()) == (0, [3.0])


CONTINUING = replace(sequence_of(1, [2.0], 0.5), segments=(1, 1))
"""Capture, which began at 0.5 s, before and after its end, planned at 2 s."""


def test_a_stage_that_continues_is_alone_in_its_window() -> None:
    assert (CONTINUING.count, CONTINUING.first, CONTINUING.last) == (1, 1, 1)
    assert (CONTINUING.planned_end, CONTINUING.begins) == (2.0, (0.5,))
    several = sequence_of(1, [2.0], 0.5)
    assert (several.count, several.last, several.begins) == (2, 2, (0.5, 2.0))
    alone = CONTINUING.current_only
    assert (alone.segments, alone.planned_end) == ((1,), np.inf)
    assert CONTINUING.up_to(1).segments == (1, 1)
    assert several.up_to(1).segments == (1,)


def test_the_next_stage_follows_one_that_continued(stages: tuple[PlacedStage, ...], costs: StageCosts) -> None:
    passed, switches = drop_passed(CONTINUING, 2.1)
    assert [(s.stage, s.time) for s in switches] == [(1, 2.0)]
    assert (passed.segments, passed.progress.entered, len(passed.switch_times)) == ((2,), 2.0, 0)
    approaching = replace(CONTINUING, segments=(0, 0))
    met, switches = drop_met(approaching, stages, costs, 1.5, AT_TARGET)
    assert [(s.stage, s.time) for s in switches] == [(0, 1.5)]
    assert met.segments == (1,)


def test_a_stage_alone_in_its_window_continues_once(stages: tuple[PlacedStage, ...], costs: StageCosts) -> None:
    longer = detect(sequence_of(0), stages, costs, arriving(1.0), 10, is_of_one_stage=True)
    assert longer is not None
    assert longer.segments == (0, 0)
    assert detect(longer, stages, costs, arriving(1.0), 10, is_of_one_stage=True) is None


def test_an_end_that_no_window_plans_is_not_detected(stages: tuple[PlacedStage, ...], costs: StageCosts) -> None:
    unplanned = (replace(stages[0], end=stages[0].end.unplanned()), *stages[1:])
    assert detect(sequence_of(0), unplanned, costs, arriving(1.0), 10) is None
    assert drop_met(sequence_of(0), unplanned, costs, 1.5, AT_TARGET)[0].first == 1


HELD = range(2, 4)
HANDS = ("arm_1", "arm_2")


def test_what_grippers_report_counts_once_they_were_to_close() -> None:
    """The object is held in stages 2 and 3; stage 2 began at 5 s, which is when the grippers closed."""
    approaching, carrying = MovingSequence.of(1, 2.0), MovingSequence.of(2, 5.0)
    empty = {"arm_1": True, "arm_2": False}
    for sequence, time in ((approaching, 6.0), (carrying, 5.0), (MovingSequence.of(4, 5.0), 6.0)):
        progress, fault = GraspProgress(is_taken=True).observed(sequence, HELD, HANDS, empty, time)
        assert (progress.is_taken, fault) == (False, None)
    _, fault = GraspProgress().observed(carrying, HELD, HANDS, empty, 5.1)
    assert fault == GraspFault(("arm_2",), FaultKind.MISSED, stage=1, time=5.0)
    assert fault.describe("capture", tries=1) == "arm_2 missed the object at the end of capture, at 5.0 s"
    assert fault.describe("capture", tries=3).endswith(", in the last of 3 tries")


def test_an_object_is_lost_that_every_gripper_has_held() -> None:
    carrying = MovingSequence.of(3, 5.0)
    some, none = GraspProgress().observed(carrying, HELD, HANDS, {"arm_1": True}, 5.1)
    assert (some.is_taken, none) == (False, None)
    taken, none = some.observed(carrying, HELD, HANDS, {"arm_1": True, "arm_2": True}, 5.2)
    assert (taken.is_taken, none) == (True, None)
    _, fault = taken.observed(carrying, HELD, HANDS, {"arm_1": False, "arm_2": False}, 5.3)
    assert fault == GraspFault(HANDS, FaultKind.LOST, stage=3, time=5.3)
    assert fault.describe("carry", tries=1) == "arm_1 and arm_2 lost the object in carry, at 5.3 s"


def test_an_object_that_is_taken_at_the_end_of_the_task_is_held_from_then_on() -> None:
    ended = replace(MovingSequence.of(1, 2.0), ended_at=5.0)
    assert ended.since_closing(range(2, 3)) == 5.0
    assert MovingSequence.of(1, 2.0).since_closing(range(2, 3)) == np.inf
