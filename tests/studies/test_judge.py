from collections.abc import Callable
from dataclasses import replace
from math import isnan, nan
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from psmpc_cli.logs.results import Results
from psmpc_cli.studies.claims import Claim, Evidence, Finding, RunEvidence, least_slack, load_claims, settled, trends
from psmpc_cli.studies.fronts import front_movement
from psmpc_cli.studies.judge import judge
from psmpc_cli.studies.weights import SweepCells, sweep_cells

from ..made_up_fronts import FALLING, RISING, made_up_fronts
from ..made_up_sweep import EPSILONS, T_H, T_S, Numbers, made_up_sweep, numbers
from .hand_made import HELD, evidence, lost, onset, run

CLAIMS = {claim.id: claim for claim in load_claims().claims}

Sweep = Callable[..., SweepCells]
Study = Callable[..., Results]


def claim(rule: str, *reads: str, published: Any = "as published") -> Claim:
    return Claim(id="smpc.x", statement="x", source="section IV", rule=rule, reads=reads, published=published)


def time_claim(read: str, published: float) -> Claim:
    return claim("time", read, published=published)


def found(claim: Claim, run: RunEvidence) -> Finding:
    return judge(claim, evidence(smpc=run))


def told(finding: Finding) -> str:
    return "\n".join(finding.cause)


@pytest.mark.parametrize(("published", "reproduced"), [(10.0, 10.8), (10.0, 9.2), (30.0, 31.5), (30.0, 28.5)])
def test_a_time_holds_within_its_tolerance_however_the_mission_ends(published: float, reproduced: float) -> None:
    for monitors in ((HELD,), (lost(5.0),)):
        finding = found(time_claim("smpc.t1", published), run(ends=(reproduced, nan, nan, nan), monitors=monitors))
        assert finding.holds
        assert not finding.earlier
        assert finding.cause == ()


def test_a_time_earlier_than_published_holds_and_is_marked_if_the_mission_succeeded() -> None:
    finding = found(time_claim("smpc.t_end", 33.0), run())
    assert finding.holds
    assert finding.earlier
    assert finding.difference == pytest.approx(-3.0)
    assert "the mission succeeded" in told(finding)


def test_an_earlier_time_does_not_count_if_the_mission_failed() -> None:
    finding = found(time_claim("smpc.t_end", 33.0), run(monitors=(lost(23.4),)))
    assert not finding.holds
    assert not finding.earlier
    assert "'object held' was violated at 23.4 s" in told(finding)


def test_a_late_time_does_not_hold_even_if_the_mission_succeeded() -> None:
    errors = {"capture": (np.array([0.0, 10.0, 12.0]), np.array([90.0, 50.0, 0.9]))}
    finding = found(time_claim("smpc.t2", 11.0), run(errors=errors))
    assert not finding.holds
    assert "at 11 s capture was still 25 tolerances away" in told(finding)


def test_the_cause_says_where_a_difference_arises() -> None:
    late = run(ends=(10.6, 17.0, 24.0, 30.0), monitors=(lost(5.0),))
    assert "+0.30 s from the start to t1, +1.60 s from t1 to t2" in told(found(time_claim("smpc.t2", 15.1), late))
    psmpc = judge(CLAIMS["psmpc.t3"], evidence(psmpc=run(ends=(10.0, 13.0, 22.0, 30.0))))
    assert "-0.80 s from the start to t2, -1.60 s from t2 to t3" in told(psmpc)


def test_the_cause_says_that_no_run_could_end_when_it_is_published() -> None:
    claim, limits = time_claim("smpc.t1", 9.0), {"approach": 9.985}
    assert "approach cannot end before 9.98 s" in told(found(claim, run(earliest_ends=limits)))
    assert "cannot" not in told(found(claim, run(earliest_ends={"approach": 8.5})))


def test_a_time_that_never_came_does_not_hold() -> None:
    never = found(time_claim("smpc.t_end", 31.3), run(ends=(10.0, 14.0, 24.0, nan)))
    unknown = found(time_claim("smpc.t_end", 31.3), replace(run(), summary=replace(run().summary, stages=())))
    for finding, cause in ((never, "time limit of 60 s reached"), (unknown, "the task has no such stage")):
        assert not finding.holds
        assert isnan(finding.difference)
        assert cause in told(finding)


@given(st.floats(1.0, 60.0), st.floats(-10.0, 10.0), st.booleans())
def test_times_have_one_rule(published: float, off: float, succeeded: bool) -> None:
    evidence = run(ends=(published + off, 80.0, 90.0, 99.0), monitors=(HELD,) if succeeded else (lost(85.0),))
    finding = found(time_claim("smpc.t1", published), evidence)
    near = abs(finding.difference) <= max(0.8, 0.05 * published) + 1e-9
    assert finding.holds == (near or (off < 0 and succeeded))
    assert finding.earlier == (finding.holds and not near)
    assert bool(finding.cause) == (not near)


PRESENCE = onset({6.2: 0.02, 6.4: 0.3, 7.8: 0.1, 8.4: 0.5, 9.0: 0.4, 9.8: 2.0}, {1e-4: 6.2, 0.1: 6.4, 1.0: 9.8})


def test_the_cause_of_a_start_says_which_thresholds_would_give_it() -> None:
    evidence = run(early={"capture": 6.4}, onsets={"capture": PRESENCE}, monitors=(lost(23.0),))
    finding = found(time_claim("smpc.t1_real", 8.8), evidence)
    assert not finding.holds
    assert "a start from 8.00 s to 9.60 s takes an epsilon above 0.3 and up to 0.5" in told(finding)
    assert "6.20 s for 0.0001, 6.40 s for 0.1, 9.80 s for 1" in told(finding)


def test_the_cause_of_a_start_says_if_no_threshold_would_give_it() -> None:
    evidence = run(early={"capture": 6.4}, onsets={"capture": PRESENCE}, monitors=(lost(23.0),))
    finding = found(time_claim("smpc.t1_real", 7.3), evidence)
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
    about = claim("on_time", "smpc.t2_real")
    assert found(about, run()).holds
    assert found(about, run(early={"transport": 13.9})).holds
    finding = found(
        about, run(early={"transport": 13.8}, onsets={"transport": onset({13.7: 0.05, 13.8: 0.4, 13.9: 0.6})})
    )
    assert not finding.holds
    assert finding.difference == pytest.approx(-0.2)
    assert "takes an epsilon above 0.4" in told(finding)
    assert "up to" not in told(finding)
    assert "'object held' held, margin 0.050" in told(finding)


def test_a_start_once_seen_is_a_horizon_before_the_end() -> None:
    about = claim("once_seen", "smpc.t1_real")
    assert found(about, run(early={"capture": 6.1})).holds
    late = run(early={"capture": 6.4}, onsets={"capture": onset({6.3: 0.01, 6.4: 0.2}, postponed=2)})
    finding = found(about, late)
    assert not finding.holds
    assert finding.difference == pytest.approx(0.4)
    assert "at 2 samples" in told(finding)
    assert not found(about, run()).holds


def test_a_start_without_the_end_it_belongs_to_does_not_hold() -> None:
    about = claim("on_time", "smpc.t3_real")
    finding = found(about, run(ends=(10.0, 14.0, nan, nan)))
    assert not finding.holds
    assert "release did not start" in told(finding)


def test_no_start_may_come_before_its_end_is_seen() -> None:
    about = claim("floor", "smpc.t1_real", "smpc.t2_real")
    finding = found(about, run(early={"capture": 5.95}))
    assert finding.holds
    assert finding.reproduced == pytest.approx(-0.05)
    broken = found(about, run(early={"capture": 5.5}))
    assert not broken.holds
    assert broken.difference == pytest.approx(-0.5)
    assert "capture starts 0.50 s before t1 - T_h" in told(broken)
    nothing = found(about, run(ends=(nan, nan, nan, nan), early={}))
    assert not nothing.holds
    assert "no stage ended" in told(nothing)


def test_all_stages_have_to_start_early() -> None:
    about = claim("all_early", "smpc.t1_real", "smpc.t3_real")
    assert found(about, run(early={"capture": 8.0, "release": 22.0})).holds
    finding = found(about, run(early={"capture": 8.0}, onsets={"release": onset({21.0: 0.01, 22.0: 0.03})}))
    assert not finding.holds
    assert finding.reproduced == ("capture",)
    assert "release adds at most 0.03" in told(finding)


def test_an_order_holds_or_not_however_little_is_between() -> None:
    claim = CLAIMS["order.t2"]
    runs = {
        name: run(ends=(9.0, time, 24.0, 30.0)) for name, time in (("psmpc", 13.0), ("smpc", 13.01), ("htmpc", 18.0))
    }
    assert judge(claim, evidence(**runs)).holds
    finding = judge(claim, evidence(**{**runs, "psmpc": run(ends=(9.0, 13.01, 24.0, 30.0))}))
    assert not finding.holds
    assert told(finding) == "t2 of PSMPC = 13.01 s is not before t2 of SMPC = 13.01 s"
    assert not judge(claim, evidence(**{**runs, "htmpc": run(ends=(9.0, nan, nan, nan))})).holds


def test_a_mission_ends_as_published_or_the_cause_says_how() -> None:
    succeeds, fails = (claim("mission", "smpc", published=wanted) for wanted in ("succeeds", "fails"))
    assert found(succeeds, run()).holds
    assert found(fails, run(monitors=(lost(23.4),))).holds
    assert "'object held' was violated at 23.4 s, by up to 0.500" in told(found(succeeds, run(monitors=(lost(23.4),))))
    assert "'object held' held, margin 0.050" in told(found(fails, run()))
    assert "time limit" in told(found(succeeds, run(ends=(10.0, 14.0, 24.0, nan))))


@pytest.mark.parametrize(
    ("early", "broken", "holds"), [(22.0, 23.4, True), (None, 23.4, False), (22.0, 21.0, False), (22.0, None, False)]
)
def test_the_object_is_lost_between_the_early_start_and_the_destination(
    early: float | None, broken: float | None, holds: bool
) -> None:
    about = claim("released_early", "smpc.t3_real")
    evidence = run(
        early={} if early is None else {"release": early}, monitors=(HELD if broken is None else lost(broken),)
    )
    finding = found(about, evidence)
    assert finding.holds == holds
    assert holds or "release starts at" in told(finding)


def test_a_setting_holds_if_all_runs_have_it() -> None:
    claim = CLAIMS["setting.nodes"]
    runs = {"psmpc": run(), "smpc": run()}
    assert judge(claim, evidence(**runs)).holds
    finding = judge(claim, evidence(**{**runs, "smpc": replace(run(), nodes=20)}))
    assert not finding.holds
    assert finding.reproduced == 20.0
    assert "20" in told(finding)


WEIGHTS = ("trend", "floor", "settles", "chosen")


@pytest.fixture
def sweep(tmp_path: Path) -> Sweep:
    return lambda sampling="7x7", **given: sweep_cells(made_up_sweep(tmp_path / "sweep.h5", sampling, **given))


def starting(at: Callable[[float], list[float]]) -> Callable[[float], Numbers]:
    """Made-up cells with other actual starts."""
    return lambda ratio: {**numbers(ratio), "actual_start": at(ratio)}


def of_weights(name: str, cells: SweepCells) -> Finding:
    return judge(CLAIMS[f"weights.{name}"], Evidence(load_claims(), {}, cells, None))


@pytest.mark.parametrize("name", WEIGHTS)
def test_a_sweep_as_published_holds_everywhere(sweep: Sweep, name: str) -> None:
    finding = of_weights(name, sweep())
    assert finding.holds
    assert not finding.cause


def test_trends_are_by_threshold_from_the_smallest_ratio_to_the_largest(sweep: Sweep) -> None:
    fine, coarse = trends(sweep())
    assert (fine.epsilon, coarse.epsilon) == EPSILONS
    assert (fine.rise, coarse.rise) == (0.0, 0.0)
    assert (coarse.first, coarse.last) == (T_S, 6.2)


def test_a_start_that_comes_later_at_a_larger_ratio_breaks_the_trend(sweep: Sweep) -> None:
    def rising(by: float) -> Callable[[float], Numbers]:
        return starting(lambda ratio: [6.2, numbers(ratio)["actual_start"][1] + by * (ratio > 1e5)])

    within, beyond = of_weights("trend", sweep(of=rising(0.1))), of_weights("trend", sweep(of=rising(0.2)))
    assert within.difference == pytest.approx(0.1)
    assert beyond.difference == pytest.approx(0.2)
    assert not beyond.holds
    assert any("epsilon = 0.1 it is 0.20 s later at ratio 1e+06" in point for point in beyond.cause)
    assert not any("later" in point for point in within.cause)


def test_cells_of_one_ratio_are_to_start_together(sweep: Sweep) -> None:
    cells = sweep()
    cells.results["actual_start"][6, 5, 1] += 0.3  # one of the cells of ratio 10: omega = (1e2, 1e3)
    worst = trends(cells)[1]
    assert worst.ratio == pytest.approx(10.0)
    assert worst.rise == pytest.approx(0.3)
    assert not of_weights("trend", cells).holds


def test_a_start_that_stays_where_it_is_does_not_advance(sweep: Sweep) -> None:
    finding = of_weights("trend", sweep(of=starting(lambda ratio: [T_S, T_S])))
    assert not finding.holds
    assert len(finding.cause) == len(EPSILONS)


def test_the_floor_is_broken_more_than_a_sample_before_it(sweep: Sweep) -> None:
    floor = T_S - T_H
    for start, holds in ((floor - 0.09, True), (floor - 0.11, False)):
        cells = sweep(of=starting(lambda ratio, start=start: [start if ratio > 1e5 else 7.0, 8.0]))
        finding = of_weights("floor", cells)
        assert least_slack(cells) == (pytest.approx(start - floor), start, pytest.approx(1e6), EPSILONS[0])
        assert finding.holds == holds
        assert bool(finding.cause) != holds


def test_failed_cells_have_no_say(sweep: Sweep) -> None:
    cells = sweep(failed=(0,))
    cells.results["actual_start"][0, 0] = 0.0
    assert least_slack(cells)[0] == pytest.approx(6.2 - (T_S - T_H))
    assert max(trend.rise for trend in trends(cells)) == 0.0


def test_where_it_settles_is_known_with_the_ratio_from_which_on(sweep: Sweep) -> None:
    assert settled(sweep()) == (6.2, pytest.approx(1e3))
    early = of_weights("settles", sweep())
    assert (early.reproduced, early.holds) == (6.2, True)
    late = of_weights("settles", sweep(of=starting(lambda ratio: [8.0, 8.0])))
    assert not late.holds
    assert late.difference == pytest.approx(1.5)
    assert any("t_s - T_h = 6.14 s" in point for point in late.cause)


def test_the_chosen_ratio_is_sooner_than_equal_weights_at_less_effort_than_the_largest(sweep: Sweep) -> None:
    slow = of_weights("chosen", sweep(of=lambda ratio: {**numbers(ratio), "completion_time": 15.0}))
    costly = of_weights("chosen", sweep(of=lambda ratio: {**numbers(ratio), "control_effort": 2.0}))
    assert not slow.holds
    assert not costly.holds
    assert "no earlier" in slow.cause[0]
    assert "no less effort" in costly.cause[0]


@pytest.mark.parametrize("name", WEIGHTS)
def test_without_a_cell_that_ended_nothing_holds(sweep: Sweep, name: str) -> None:
    finding = of_weights(name, sweep("2", failed=(0, 1)))
    assert not finding.holds
    assert np.isnan(finding.difference)
    assert "time limit of 30 s reached" in finding.cause


@pytest.fixture
def study(tmp_path: Path) -> Study:
    return lambda **given: made_up_fronts(tmp_path / "fronts.h5", **given)


def of_fronts(name: str, results: Results | None) -> Finding:
    movement = None if results is None else front_movement(results)
    given = Evidence(load_claims(), {}, evidence().weights, movement)
    return judge(CLAIMS[f"fronts.{name}"], given)


def test_fronts_as_published_hold(study: Study) -> None:
    results = study(drift=RISING)
    for name, reproduced in (("with_ratio", "upper left at 3 of 3"), ("with_time", "upper left (2 of 2)")):
        finding = of_fronts(name, results)
        assert finding.holds
        assert finding.cause == ()
        assert finding.reproduced == reproduced


def test_fronts_that_move_elsewhere_say_where_and_what_goes_with_it(study: Study) -> None:
    results = study(drift=FALLING)
    finding = of_fronts("with_time", results)
    assert not finding.holds
    assert (finding.claim.published, finding.reproduced) == ("upper left", "lower right (2 of 2)")
    assert any("over its own extent" in point for point in finding.cause)
    assert any("part of the horizon goes from 3.50 to 1.50 s" in point for point in finding.cause)
    assert of_fronts("with_ratio", results).holds


def test_one_step_elsewhere_is_enough(study: Study) -> None:
    results = study(drift=RISING)
    results["weighted_J_2"][2] += 3.0
    finding = of_fronts("with_time", results)
    assert finding.reproduced == "upper left (1 of 2) and upper right (1 of 2)"
    assert not finding.holds


def test_an_optimum_that_moves_back_breaks_the_claim_where_it_does(study: Study) -> None:
    results = study()
    results["weighted_J_1"][1, [2, 3]] = results["weighted_J_1"][1, [3, 2]]
    finding = of_fronts("with_ratio", results)
    assert not finding.holds
    assert finding.reproduced == "upper left at 2 of 3"
    assert [point.startswith("at 7.5 s it moves against it by 0.") for point in finding.cause] == [True]


def test_an_optimum_that_stays_where_it_is_does_not_move(study: Study) -> None:
    results = study()
    for J in ("J_1", "J_2"):
        results[f"weighted_{J}"][0] = 1.0
    finding = of_fronts("with_ratio", results)
    assert not finding.holds
    assert finding.cause == ("at 6.5 s it does not move, or was not found",)


def test_points_that_failed_show_no_movement(study: Study) -> None:
    results = study(drift=RISING, failed=(1,))
    assert not of_fronts("with_ratio", results).holds
    assert of_fronts("with_time", results).reproduced == "unknown (2 of 2)"
    assert not of_fronts("with_time", results).holds


def test_one_sample_says_nothing_of_time(study: Study) -> None:
    results = study(samples=1)
    assert of_fronts("with_ratio", results).holds
    assert not of_fronts("with_time", results).holds
    assert "single sample" in of_fronts("with_time", results).cause[0]


@pytest.mark.parametrize("name", ["with_ratio", "with_time"])
def test_without_a_window_nothing_holds(name: str) -> None:
    finding = of_fronts(name, None)
    assert not finding.holds
    assert finding.reproduced == "unknown"
    assert np.isnan(finding.difference)
    assert "no window" in finding.cause[0]
