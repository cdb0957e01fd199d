from dataclasses import replace
from math import isnan, nan

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from psmpc_cli.studies.claims import (
    Claim,
    EarlyClaim,
    FloorClaim,
    MissionClaim,
    Moment,
    OrderClaim,
    ReleaseClaim,
    SettingClaim,
    StartClaim,
    TimeClaim,
)
from psmpc_cli.studies.evidence import Evidence, Nearness
from psmpc_cli.studies.findings import Finding, judge

from .hand_made import HELD, STAGES, lost, onset, run

ABOUT = ("id", "smpc", "times", "a statement", "section IV")

SYMBOLS = ("t1", "t2", "t3", "t_end")


def end(stage: str, method: str = "smpc") -> Moment:
    return Moment(method, SYMBOLS[STAGES.index(stage)] if stage in STAGES else "t", stage, "end")


def start(stage: str, method: str = "smpc") -> Moment:
    return Moment(method, f"{SYMBOLS[STAGES.index(stage) - 1]}_real", stage, "start")


def found(claim: Claim, evidence: Evidence) -> Finding:
    return judge(claim, {"smpc": evidence})


def told(finding: Finding) -> str:
    return "\n".join(finding.cause)


def time_claim(moment: Moment, published: float) -> TimeClaim:
    return TimeClaim(*ABOUT, moment, published)


@pytest.mark.parametrize(("published", "reproduced"), [(10.0, 10.8), (10.0, 9.2), (30.0, 31.5), (30.0, 28.5)])
def test_a_time_holds_within_its_tolerance_however_the_mission_ends(published: float, reproduced: float) -> None:
    for monitors in ((HELD,), (lost(5.0),)):
        finding = found(
            time_claim(end("approach"), published), run(ends=(reproduced, nan, nan, nan), monitors=monitors)
        )
        assert finding.holds
        assert not finding.earlier
        assert finding.cause == ()


def test_a_time_earlier_than_published_holds_and_is_marked_if_the_mission_succeeded() -> None:
    finding = found(time_claim(end("release"), 33.0), run())
    assert finding.holds
    assert finding.earlier
    assert finding.difference == pytest.approx(-3.0)
    assert "the mission succeeded" in told(finding)


def test_an_earlier_time_does_not_count_if_the_mission_failed() -> None:
    finding = found(time_claim(end("release"), 33.0), run(monitors=(lost(23.4),)))
    assert not finding.holds
    assert not finding.earlier
    assert "'object held' broke at 23.4 s" in told(finding)


def test_a_late_time_does_not_hold_even_if_the_mission_succeeded() -> None:
    nearness = {"capture": Nearness(np.array([0.0, 10.0, 12.0]), np.array([90.0, 50.0, 0.9]))}
    finding = found(time_claim(end("capture"), 11.0), run(nearness=nearness))
    assert not finding.holds
    assert "at 11 s capture was still 25 tolerances away" in told(finding)


def test_the_cause_says_where_a_difference_arises() -> None:
    known = ((end("approach"), 9.7), (end("capture"), 12.0))
    finding = found(TimeClaim(*ABOUT, end("transport"), 21.0, known), run())
    assert "+0.30 s from the start to t1, +1.70 s from t1 to t2, +1.00 s from t2 to t3" in told(finding)


def test_the_cause_says_that_no_run_could_end_when_it_is_published() -> None:
    claim, limits = time_claim(end("approach"), 9.0), {"approach": 9.985}
    assert "approach cannot end before 9.98 s" in told(found(claim, run(earliest_ends=limits)))
    assert "cannot" not in told(found(claim, run(earliest_ends={"approach": 8.5})))


def test_a_time_that_never_came_does_not_hold() -> None:
    never = found(time_claim(end("release"), 31.3), run(ends=(10.0, 14.0, 24.0, nan)))
    unknown = found(time_claim(end("docking"), 31.3), run())
    for finding, cause in ((never, "time limit of 60 s reached"), (unknown, "the task has no such stage")):
        assert not finding.holds
        assert isnan(finding.difference)
        assert cause in told(finding)


@given(st.floats(1.0, 60.0), st.floats(-10.0, 10.0), st.booleans())
def test_times_have_one_rule(published: float, off: float, succeeded: bool) -> None:
    evidence = run(ends=(published + off, 80.0, 90.0, 99.0), monitors=(HELD,) if succeeded else (lost(85.0),))
    finding = found(time_claim(end("approach"), published), evidence)
    near = abs(finding.difference) <= max(0.8, 0.05 * published) + 1e-9
    assert finding.holds == (near or (off < 0 and succeeded))
    assert finding.earlier == (finding.holds and not near)
    assert bool(finding.cause) == (not near)


PRESENCE = onset({6.2: 0.02, 6.4: 0.3, 7.8: 0.1, 8.4: 0.5, 9.0: 0.4, 9.8: 2.0}, {1e-4: 6.2, 0.1: 6.4, 1.0: 9.8})


def test_the_cause_of_a_start_says_which_thresholds_would_give_it() -> None:
    evidence = run(early={"capture": 6.4}, onsets={"capture": PRESENCE}, monitors=(lost(23.0),))
    finding = found(time_claim(start("capture"), 8.8), evidence)
    assert not finding.holds
    assert "a start from 8.00 s to 9.60 s takes an epsilon above 0.3 and up to 0.5" in told(finding)
    assert "6.20 s for 0.0001, 6.40 s for 0.1, 9.80 s for 1" in told(finding)


def test_the_cause_of_a_start_says_if_no_threshold_would_give_it() -> None:
    evidence = run(early={"capture": 6.4}, onsets={"capture": PRESENCE}, monitors=(lost(23.0),))
    finding = found(time_claim(start("capture"), 7.3), evidence)
    assert "no epsilon gives a start from 6.50 s to 8.10 s" in told(finding)


@given(
    st.lists(st.floats(1e-5, 10.0), min_size=1, max_size=30), st.integers(0, 30), st.integers(0, 30), st.floats(0, 1)
)
def test_thresholds_give_the_starts_they_are_said_to(values: list[float], a: int, b: int, share: float) -> None:
    times = [round(6.0 + 0.1 * i, 1) for i in range(len(values))]
    earliest, latest = sorted(round(6.0 + 0.1 * i, 1) for i in (a, b))
    above, at_most = onset(dict(zip(times, values, strict=True))).thresholds(earliest, latest)
    epsilon = min(above + (1 - share) * (at_most - above), at_most)
    if at_most > above and epsilon > above:
        first = next(time for time, value in zip(times, values, strict=True) if value >= epsilon)
        assert earliest <= first <= latest


def test_a_start_on_time_holds_to_one_sample() -> None:
    claim = StartClaim(*ABOUT, start("transport"), end("capture"), "on time")
    assert found(claim, run()).holds
    assert found(claim, run(early={"transport": 13.9})).holds
    finding = found(
        claim, run(early={"transport": 13.8}, onsets={"transport": onset({13.7: 0.05, 13.8: 0.4, 13.9: 0.6})})
    )
    assert not finding.holds
    assert finding.difference == pytest.approx(-0.2)
    assert "takes an epsilon above 0.4" in told(finding)
    assert "up to" not in told(finding)
    assert "'object held' held, margin 0.050" in told(finding)


def test_a_start_once_seen_is_a_horizon_before_the_end() -> None:
    claim = StartClaim(*ABOUT, start("capture"), end("approach"), "once seen")
    assert found(claim, run(early={"capture": 6.1})).holds
    late = run(early={"capture": 6.4}, onsets={"capture": onset({6.3: 0.01, 6.4: 0.2}, postponed=2)})
    finding = found(claim, late)
    assert not finding.holds
    assert finding.difference == pytest.approx(0.4)
    assert "seen at 2 samples" in told(finding)
    assert not found(claim, run()).holds


def test_a_start_without_the_end_it_belongs_to_does_not_hold() -> None:
    claim = StartClaim(*ABOUT, start("release"), end("transport"), "on time")
    finding = found(claim, run(ends=(10.0, 14.0, nan, nan)))
    assert not finding.holds
    assert "release did not start" in told(finding)


def test_no_start_may_come_before_its_end_is_seen() -> None:
    claim = FloorClaim(*ABOUT, ((start("capture"), end("approach")), (start("transport"), end("capture"))))
    finding = found(claim, run(early={"capture": 5.95}))
    assert finding.holds
    assert finding.reproduced == pytest.approx(-0.05)
    broken = found(claim, run(early={"capture": 5.5}))
    assert not broken.holds
    assert broken.difference == pytest.approx(-0.5)
    assert "capture starts 0.50 s before t1 - T_h" in told(broken)
    nothing = found(claim, run(ends=(nan, nan, nan, nan), early={}))
    assert not nothing.holds
    assert "no stage ended" in told(nothing)


def test_all_stages_have_to_start_early() -> None:
    claim = EarlyClaim(*ABOUT, (start("capture"), start("release")))
    assert found(claim, run(early={"capture": 8.0, "release": 22.0})).holds
    finding = found(claim, run(early={"capture": 8.0}, onsets={"release": onset({21.0: 0.01, 22.0: 0.03})}))
    assert not finding.holds
    assert finding.reproduced == ("capture",)
    assert "release adds 0.03" in told(finding)


def test_an_order_holds_or_not_however_little_is_between() -> None:
    moments = (end("capture", "psmpc"), end("capture", "smpc"), end("capture", "htmpc"))
    claim = OrderClaim(*ABOUT, moments, (13.8, 15.1, 17.2))
    runs = {
        name: run(ends=(9.0, time, 24.0, 30.0)) for name, time in (("psmpc", 13.0), ("smpc", 13.01), ("htmpc", 18.0))
    }
    assert judge(claim, runs).holds
    finding = judge(claim, {**runs, "psmpc": run(ends=(9.0, 13.01, 24.0, 30.0))})
    assert not finding.holds
    assert told(finding) == "t2 of PSMPC = 13.01 s is not before t2 of SMPC = 13.01 s"
    assert not judge(claim, {**runs, "htmpc": run(ends=(9.0, nan, nan, nan))}).holds


def test_a_mission_ends_as_published_or_the_cause_says_how() -> None:
    succeeds, fails = (MissionClaim(*ABOUT, "smpc", wanted) for wanted in (True, False))
    assert found(succeeds, run()).holds
    assert found(fails, run(monitors=(lost(23.4),))).holds
    assert "'object held' broke at 23.4 s, by up to 0.500" in told(found(succeeds, run(monitors=(lost(23.4),))))
    assert "'object held' held, margin 0.050" in told(found(fails, run()))
    assert "time limit" in told(found(succeeds, run(ends=(10.0, 14.0, 24.0, nan))))


@pytest.mark.parametrize(
    ("early", "broken", "holds"), [(22.0, 23.4, True), (None, 23.4, False), (22.0, 21.0, False), (22.0, None, False)]
)
def test_the_object_is_lost_between_the_early_start_and_the_destination(
    early: float | None, broken: float | None, holds: bool
) -> None:
    claim = ReleaseClaim(*ABOUT, start("release"), end("transport"))
    evidence = run(
        early={} if early is None else {"release": early}, monitors=(HELD if broken is None else lost(broken),)
    )
    finding = found(claim, evidence)
    assert finding.holds == holds
    assert holds or "release starts at" in told(finding)


def test_a_setting_holds_if_all_runs_have_it() -> None:
    claim = SettingClaim(*ABOUT, "nodes", 100.0)
    runs = {"psmpc": run(), "smpc": run()}
    assert judge(claim, runs).holds
    finding = judge(claim, {**runs, "smpc": replace(run(), nodes=20)})
    assert not finding.holds
    assert finding.reproduced == 20.0
    assert "20" in told(finding)


def test_a_claim_of_no_known_kind_is_not_judged() -> None:
    with pytest.raises(TypeError, match="found a claim of kind Claim"):
        judge(Claim(*ABOUT), {})
