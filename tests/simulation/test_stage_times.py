from types import SimpleNamespace
from typing import cast

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from psmpc_cli.logs.record import Record
from psmpc_cli.logs.write import StageTimes
from psmpc_cli.simulation.stage_times import StageClock

STAGES, SAMPLE = 4, 0.125
SERIES, EPSILON = (1e-3, 1e-2, 1.0), 0.1


def record(time: float, presence: dict[int, float], switches: tuple[tuple[int, float], ...] = ()) -> Record:
    return cast(Record, SimpleNamespace(time=time, presence=presence, switches=switches))


@st.composite
def runs(draw: st.DrawFn) -> list[Record]:
    """Samples of a run: stages hand over in order, and only those that wait are looked at."""
    records, current = [], 0
    for k in range(draw(st.integers(0, 30))):
        time = SAMPLE * k
        switches: tuple[tuple[int, float], ...] = ()
        if k and current < STAGES - 1 and draw(st.integers(0, 4)) == 0:
            switches = ((current, time - draw(st.floats(0, SAMPLE))),)
            current += 1
        waiting = draw(st.integers(0, STAGES - 1 - current))
        presence = {current + i: 10.0 ** draw(st.floats(-5, 1)) for i in range(1, waiting + 1)}
        records.append(record(time, presence, switches))
    return records


def follow(records: list[Record]) -> StageTimes:
    clock = StageClock(STAGES, EPSILON, SERIES)
    for one in records:
        clock.update(one)
    return clock.times


def first_at(records: list[Record], stage: int, epsilon: float) -> float:
    return next((one.time for one in records if one.presence.get(stage, 0.0) >= epsilon), np.nan)


@given(runs())
def test_a_stage_starts_at_its_first_sample_above_the_threshold_or_at_its_instant(records: list[Record]) -> None:
    times = follow(records)
    regular = [0.0, *times.switch_time[:-1]]
    for stage in range(STAGES):
        early = first_at(records, stage, EPSILON)
        assert times.premature[stage] == (not np.isnan(early))
        np.testing.assert_equal(times.actual_start[stage], regular[stage] if np.isnan(early) else early)
        for start, epsilon in zip(times.by_epsilon[stage], SERIES, strict=True):
            early = first_at(records, stage, epsilon)
            np.testing.assert_equal(start, regular[stage] if np.isnan(early) else early)


@given(runs())
def test_a_stage_starts_no_later_than_the_one_before_it_ends(records: list[Record]) -> None:
    times = follow(records)
    ended = times.switch_time[:-1]
    known = ~np.isnan(ended)
    assert np.all(times.actual_start[1:][known] <= ended[known])


@given(runs())
def test_a_larger_threshold_is_reached_no_earlier(records: list[Record]) -> None:
    starts = np.where(np.isnan(by_epsilon := follow(records).by_epsilon), np.inf, by_epsilon)
    assert np.all(starts[:, 1:] >= starts[:, :-1])


@given(runs())
def test_a_change_is_told_when_there_is_one_and_only_then(records: list[Record]) -> None:
    clock = StageClock(STAGES, EPSILON, SERIES)
    for one in records:
        before = clock.times
        changed = clock.update(one)
        after = clock.times
        same = all(
            np.array_equal(getattr(before, name), getattr(after, name), equal_nan=True)
            for name in ("switch_time", "actual_start", "premature", "by_epsilon")
        )
        assert changed is not same


def test_the_first_stage_starts_at_once_and_the_last_ends_with_the_run() -> None:
    clock = StageClock(2, EPSILON, SERIES)
    np.testing.assert_equal(clock.times.actual_start, [0.0, np.nan])
    clock.hand_over(((0, 1.5), (1, 2.5)))
    np.testing.assert_equal(clock.times.actual_start, [0.0, 1.5])
    np.testing.assert_equal(clock.times.switch_time, [1.5, 2.5])
