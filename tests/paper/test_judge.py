import re
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
from psmpc_cli.paper.claims import Claim, Finding, load_claims
from psmpc_cli.paper.judge import Reproduction, judge
from psmpc_cli.specs.load import load_task
from psmpc_cli.studies.sweep import SweepCells

from ..synthetic_fronts import FALLING, RISING, synthetic_fronts
from ..synthetic_sweep import T_H, T_S, Numbers, numbers, synthetic_sweep
from .synthetic_runs import grasped, hand_made, reproduced

CLAIMS = {claim.id: claim for claim in load_claims()}

Sweep = Callable[..., SweepCells]
Study = Callable[..., Results]


def claim(rule: str, *reads: str, published: Any = "as published") -> Claim:
    return Claim(id="psmpc.x", statement="x", source="section IV", rule=rule, reads=reads, published=published)


def judged(rule: str, *reads: str, published: Any = "as published", **run: Any) -> Finding:
    """What becomes of a claim of a rule, of a hand-made run."""
    return judge(claim(rule, *reads, published=published), reproduced(psmpc=hand_made(**run)))


def told(finding: Finding) -> str:
    return "\n".join(finding.cause)


def test_a_time_earlier_than_published_holds_and_is_marked_if_the_mission_succeeded() -> None:
    finding = judged("time", "psmpc.t_end", published=33.0)
    assert finding.holds
    assert finding.earlier
    assert finding.difference == pytest.approx(-3.0)
    assert "the mission succeeded" in told(finding)
    failed = judged("time", "psmpc.t_end", published=33.0, lost=23.4)
    assert not failed.holds
    assert not failed.earlier
    assert "'object held' was violated at 23.4 s" in told(failed)


def test_the_cause_says_that_no_run_could_end_when_it_is_published() -> None:
    assert "approach cannot end before 9.9" in told(judged("time", "psmpc.t1", published=9.0))
    assert "cannot" not in told(judged("time", "psmpc.t1", published=12.0))
    late = told(
        judge(CLAIMS["smpc.t2"], reproduced(smpc=hand_made((10.6, 17.0, 24.0, 30.0), lost=20.0, method="smpc")))
    )
    assert re.fullmatch(r"at 15\.1 s capture was still \d+\.\d tolerances away", late)


def test_a_time_that_never_came_does_not_hold() -> None:
    finding = judged("time", "psmpc.t_end", published=31.3, ends=(10.0, 14.0, 24.0, nan))
    assert not finding.holds
    assert isnan(finding.difference)
    assert "time limit of 60 s reached" in told(finding)


@given(st.floats(8.0, 12.0), st.floats(-3.0, 3.0), st.booleans())
def test_times_have_one_rule(published: float, off: float, succeeded: bool) -> None:
    ends = (published + off, 16.0, 20.0, 30.0)
    finding = judged("time", "psmpc.t1", published=published, ends=ends, lost=None if succeeded else 18.0)
    near = abs(finding.difference) <= max(0.8, 0.05 * published) + 1e-9
    assert finding.holds == (near or (off < 0 and succeeded))
    assert finding.earlier == (finding.holds and not near)
    assert bool(finding.cause) == (not near)


def test_the_cause_of_a_start_says_how_it_depends_on_the_threshold() -> None:
    run: dict[str, Any] = {"early": {"capture": 6.4}, "starts": {0.1: 6.4, 1e-4: 6.2, 10.0: nan}, "lost": 23.0}
    finding = judged("time", "psmpc.t1_real", published=8.8, **run)
    assert not finding.holds
    assert "by its closeness it starts at 6.20 s for epsilon = 0.0001, 6.40 s for epsilon = 0.1, never" in told(finding)


def test_a_start_on_time_holds_to_one_sample() -> None:
    assert judged("on_time", "psmpc.t2_real").holds
    assert judged("on_time", "psmpc.t2_real", early={"transport": 13.9}).holds
    finding = judged("on_time", "psmpc.t2_real", early={"transport": 13.8})
    assert not finding.holds
    assert finding.difference == pytest.approx(-0.2)
    assert "transport starts at 13.80 s, t2 = 14.00 s" in told(finding)


def test_a_start_once_seen_is_a_horizon_before_the_end() -> None:
    assert judged("once_seen", "psmpc.t1_real", early={"capture": 6.1}).holds
    late = judged("once_seen", "psmpc.t1_real", early={"capture": 6.4})
    assert not late.holds
    assert late.difference == pytest.approx(0.4)
    assert not judged("once_seen", "psmpc.t1_real").holds


def test_no_start_may_come_before_its_end_is_seen() -> None:
    about = ("floor", "psmpc.t1_real", "psmpc.t2_real")
    finding = judged(*about, early={"capture": 5.95})
    assert finding.holds
    assert finding.reproduced == pytest.approx(-0.05)
    broken = judged(*about, early={"capture": 5.5})
    assert not broken.holds
    assert broken.difference == pytest.approx(-0.5)
    assert "capture starts 0.50 s before t_s - T_h" in told(broken)
    nothing = judged(*about, ends=(nan, nan, nan, nan))
    assert not nothing.holds
    assert "capture did not start: time limit" in told(nothing)


def test_all_stages_have_to_start_early() -> None:
    about = ("all_early", "psmpc.t1_real", "psmpc.t3_real")
    assert judged(*about, early={"capture": 8.0, "release": 22.0}).holds
    finding = judged(*about, early={"capture": 8.0})
    assert not finding.holds
    assert finding.reproduced == ("capture",)
    assert told(finding).startswith("release starts at 24.00 s, t3 = 24.00 s")


@pytest.mark.parametrize(("psmpc", "htmpc", "holds"), [(13.0, 18.0, True), (13.01, 18.0, False), (13.0, nan, False)])
def test_an_order_holds_or_not_however_little_is_between(psmpc: float, htmpc: float, holds: bool) -> None:
    times = {"psmpc": psmpc, "smpc": 13.01, "htmpc": htmpc}
    runs = {name: hand_made((9.0, time, 24.0, 30.0), method=name) for name, time in times.items()}
    finding = judge(CLAIMS["order.t2"], reproduced(**runs))
    assert finding.holds == holds
    assert finding.reproduced == pytest.approx((psmpc, 13.01, htmpc), nan_ok=True)


def test_a_mission_ends_as_published_or_the_cause_says_how() -> None:
    assert judged("mission", "psmpc", published="succeeds").holds
    assert judged("mission", "psmpc", published="fails", lost=23.4).holds
    lost = judged("mission", "psmpc", published="succeeds", lost=23.4)
    assert "'object held' was violated at 23.4 s, by up to " in told(lost)
    assert "'object held' held, margin 0.050" in told(judged("mission", "psmpc", published="fails"))
    late = judged("mission", "psmpc", published="succeeds", ends=(10.0, 14.0, 24.0, nan))
    assert "time limit" in told(late)


@pytest.mark.parametrize(
    ("smpc", "found", "holds"),
    [
        ({"off": 0.08}, "let go 8.0 cm off at 0.20 m/s", True),
        ({"lost": 23.4}, "lost at 23.4 s", True),
        ({"taken": False}, "not taken", False),
        ({"opened": False}, "still held", False),
        ({}, "delivered", False),
    ],
)
def test_a_grasped_object_is_delivered_by_one_controller_and_let_go_elsewhere_by_the_other(
    smpc: dict[str, Any], found: str, holds: bool
) -> None:
    made = Reproduction({}, reproduced().weights, None, grasps={"psmpc": grasped(), "smpc": grasped(**smpc)})
    finding = judge(CLAIMS["grasp.delivered"], made)
    assert finding.reproduced == ("delivered", found)
    assert finding.holds == holds
    both = {"psmpc": grasped(**smpc), "smpc": grasped(0.08)}
    assert judge(CLAIMS["grasp.delivered"], replace(made, grasps=both)).holds == (found == "delivered")


@pytest.mark.parametrize(
    ("early", "lost", "holds"), [(22.0, 23.4, True), (None, 23.4, False), (22.0, 21.0, False), (22.0, None, False)]
)
def test_the_object_is_lost_between_the_early_start_and_the_destination(
    early: float | None, lost: float | None, holds: bool
) -> None:
    starts = {} if early is None else {"release": early}
    finding = judged("released_early", "psmpc.t3_real", early=starts, lost=lost)
    assert finding.holds == holds
    assert holds or "release starts at" in told(finding)


def test_a_setting_holds_if_all_runs_have_it() -> None:
    runs = {"psmpc": hand_made(), "smpc": hand_made()}
    assert judge(CLAIMS["setting.nodes"], reproduced(**runs)).holds
    for nodes, found in (("20", 20.0), ("auto", nan)):
        vars(runs["smpc"])["task"] = load_task("transport", [f"controller.nodes={nodes}"])
        finding = judge(CLAIMS["setting.nodes"], reproduced(**runs))
        assert not finding.holds
        assert finding.reproduced == pytest.approx(found, nan_ok=True)


WEIGHTS = ("trend", "floor", "settles", "chosen")


@pytest.fixture
def sweep(tmp_path: Path) -> Sweep:
    return lambda sampling="7x7", **given: SweepCells(synthetic_sweep(tmp_path / "sweep.h5", sampling, **given))


def with_changed(**changes: Callable[[float], Any]) -> Callable[[float], Numbers]:
    """Made-up cells in which some numbers are other ones, given the ratio."""
    return lambda ratio: {**numbers(ratio), **{name: change(ratio) for name, change in changes.items()}}


def of_weights(name: str, cells: SweepCells) -> Finding:
    return judge(CLAIMS[f"weights.{name}"], Reproduction({}, cells, None))


@pytest.mark.parametrize("name", WEIGHTS)
def test_a_sweep_as_published_holds_everywhere(sweep: Sweep, name: str) -> None:
    finding = of_weights(name, sweep())
    assert finding.holds
    assert not finding.cause
    assert name != "trend" or (finding.reproduced, finding.difference) == (f"{T_S:.2f} s to 6.20 s", 0.0)


@pytest.mark.parametrize("by", [0.1, 0.2])
def test_a_start_that_comes_later_at_a_larger_ratio_breaks_the_trend(sweep: Sweep, by: float) -> None:
    rising = with_changed(actual_start=lambda ratio: [6.2, numbers(ratio)["actual_start"][1] + by * (ratio > 1e5)])
    finding = of_weights("trend", sweep(of=rising))
    assert finding.difference == pytest.approx(by)
    later = [point for point in finding.cause if "by up to 0.20 s later at a larger ratio" in point]
    assert len(later) == (by > 0.1)


@pytest.mark.parametrize(
    ("name", "changed", "causes"),
    [
        ("trend", {"actual_start": lambda ratio: [T_S, T_S]}, ["from 10.14 s to 10.14 s"] * 2),
        ("settles", {"actual_start": lambda ratio: [8.0, 8.0]}, ["t_s - T_h = 6.14 s"]),
        ("chosen", {"completion_time": lambda ratio: 15.0}, []),
        ("chosen", {"control_effort": lambda ratio: 2.0}, []),
        (
            "floor",
            {"actual_start": lambda ratio: [T_S - T_H - 0.11 if ratio > 1e5 else 7.0, 8.0]},
            ["at ratio 1e+06 and epsilon = 0.001 capture starts 0.11 s before"],
        ),
    ],
)
def test_a_sweep_that_is_not_as_published_says_where(
    sweep: Sweep, name: str, changed: dict[str, Any], causes: list[str]
) -> None:
    finding = of_weights(name, sweep(of=with_changed(**changed)))
    assert not finding.holds
    assert all(cause in point for cause, point in zip(causes, finding.cause, strict=True))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("ratio", "unknown"),
    [
        (1e6, {"trend", "floor", "settles", "chosen"}),
        (100.0, {"trend", "floor", "chosen"}),
        (1.0, {"trend", "floor", "chosen"}),
        (10.0, {"trend", "floor"}),
    ],
)
def test_what_is_said_of_ratios_takes_that_their_cells_ended(sweep: Sweep, ratio: float, unknown: set[str]) -> None:
    failed = tuple(np.flatnonzero(np.isclose(sweep().ratio, ratio)).tolist())
    findings = {name: of_weights(name, sweep(failed=failed)) for name in WEIGHTS}
    assert {name for name, finding in findings.items() if not finding.holds} == unknown
    assert all(findings[name].cause[0] == f"no cell ended at ratio {ratio:g}" for name in unknown)


def test_weights_are_not_chosen_by_a_cell_of_another_ratio(sweep: Sweep) -> None:
    finding = of_weights("chosen", sweep("3x3"))
    assert (finding.holds, finding.cause) == (False, ("no cell ended at ratio 100",))


@pytest.mark.parametrize("name", WEIGHTS)
def test_without_a_cell_that_ended_nothing_holds(sweep: Sweep, name: str) -> None:
    finding = of_weights(name, sweep("2", failed=(0, 1)))
    assert not finding.holds
    assert np.isnan(finding.difference)
    assert "time limit of 30 s reached" in finding.cause


@pytest.fixture
def study(tmp_path: Path) -> Study:
    return lambda **given: synthetic_fronts(tmp_path / f"{len(list(tmp_path.iterdir()))}.h5", **given)


def of_fronts(name: str, results: Results | None) -> Finding:
    return judge(CLAIMS[f"fronts.{name}"], Reproduction({}, reproduced().weights, results))


def test_fronts_as_published_hold(study: Study) -> None:
    results = study(drift=RISING)
    for name, found in (("with_ratio", "upper left at 3 of 3"), ("with_time", "upper left (2 of 2)")):
        finding = of_fronts(name, results)
        assert finding.holds
        assert finding.cause == ()
        assert finding.reproduced == found


def test_fronts_that_move_elsewhere_say_where_and_what_goes_with_it(study: Study) -> None:
    results = study(drift=FALLING)
    finding = of_fronts("with_time", results)
    assert not finding.holds
    assert (finding.claim.published, finding.reproduced) == ("upper left", "lower right (2 of 2)")
    assert "over its own extent" in told(finding)
    assert "part of the horizon goes from 3.50 to 1.50 s" in told(finding)
    assert of_fronts("with_ratio", results).holds
    results = study(drift=RISING)
    results["weighted_J_2"][2] += 3.0
    finding = of_fronts("with_time", results)
    assert finding.reproduced == "upper left (1 of 2) and upper right (1 of 2)"
    assert not finding.holds


def test_an_optimum_that_moves_back_or_stays_breaks_the_claim_where_it_does(study: Study) -> None:
    results = study()
    results["weighted_J_1"][1, [2, 3]] = results["weighted_J_1"][1, [3, 2]]
    back = of_fronts("with_ratio", results)
    assert (back.holds, back.reproduced) == (False, "upper left at 2 of 3")
    assert [point.startswith("at 7.5 s it moves against it by 0.") for point in back.cause] == [True]
    results = study()
    for J in ("J_1", "J_2"):
        results[f"weighted_{J}"][0] = 1.0
    still = of_fronts("with_ratio", results)
    assert (still.holds, still.cause) == (False, ("at 6.5 s it does not move, or was not found",))


def test_too_few_points_show_no_movement(study: Study) -> None:
    failed, single = study(drift=RISING, failed=(1,)), study(samples=1)
    assert not of_fronts("with_ratio", failed).holds
    assert (of_fronts("with_time", failed).reproduced, of_fronts("with_time", failed).holds) == (
        "unknown (2 of 2)",
        False,
    )
    assert "fewer windows" in of_fronts("with_time", single).cause[0]
    for name in ("with_ratio", "with_time"):
        finding = of_fronts(name, None)
        assert (finding.holds, finding.reproduced) == (False, "unknown")
        assert "fewer windows" in finding.cause[0]
