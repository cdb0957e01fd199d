from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from psmpc_cli.simulation.sweep_cells import SweepCells, sweep_cells
from psmpc_cli.studies.claims import Claim
from psmpc_cli.studies.findings import Finding
from psmpc_cli.studies.published import load_published
from psmpc_cli.studies.sweep_claims import weights_claims
from psmpc_cli.studies.sweep_findings import judge_weights, least_slack, settled, trends

from ..made_up_sweep import EPSILONS, T_H, T_S, Numbers, made_up_sweep, numbers

Sweep = Callable[..., SweepCells]

CLAIMS = {claim.id: claim for claim in weights_claims(load_published())}


@pytest.fixture
def sweep(tmp_path: Path) -> Sweep:
    return lambda sampling="7x7", **given: sweep_cells(made_up_sweep(tmp_path / "sweep.h5", sampling, **given))


def starting(at: Callable[[float], list[float]]) -> Callable[[float], Numbers]:
    """Made-up cells with other actual starts."""
    return lambda ratio: {**numbers(ratio), "actual_start": at(ratio)}


def judged(name: str, cells: SweepCells) -> Finding:
    return judge_weights(CLAIMS[f"weights.{name}"], cells)


def test_there_is_a_claim_for_all_that_is_published_of_the_weights() -> None:
    assert list(CLAIMS) == ["weights.trend", "weights.floor", "weights.settles", "weights.chosen"]
    assert {claim.group for claim in CLAIMS.values()} == {"weights"}


def test_a_sweep_as_published_holds_everywhere(sweep: Sweep) -> None:
    cells = sweep()
    assert all(judge_weights(claim, cells).holds for claim in CLAIMS.values())
    assert all(not judge_weights(claim, cells).cause for claim in CLAIMS.values())


def test_trends_are_by_threshold_from_the_smallest_ratio_to_the_largest(sweep: Sweep) -> None:
    fine, coarse = trends(sweep())
    assert (fine.epsilon, coarse.epsilon) == EPSILONS
    assert (fine.rise, coarse.rise) == (0.0, 0.0)
    assert (coarse.first, coarse.last) == (T_S, 6.2)


def test_a_start_that_comes_later_at_a_larger_ratio_breaks_the_trend(sweep: Sweep) -> None:
    def rising(by: float) -> Callable[[float], Numbers]:
        return starting(lambda ratio: [6.2, numbers(ratio)["actual_start"][1] + by * (ratio > 1e5)])

    within, beyond = judged("trend", sweep(of=rising(0.1))), judged("trend", sweep(of=rising(0.2)))
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
    assert not judged("trend", cells).holds


def test_a_start_that_stays_where_it_is_does_not_advance(sweep: Sweep) -> None:
    finding = judged("trend", sweep(of=starting(lambda ratio: [T_S, T_S])))
    assert not finding.holds
    assert len(finding.cause) == len(EPSILONS)


def test_the_floor_is_broken_more_than_a_sample_before_it(sweep: Sweep) -> None:
    floor = T_S - T_H
    for start, holds in ((floor - 0.09, True), (floor - 0.11, False)):
        cells = sweep(of=starting(lambda ratio, start=start: [start if ratio > 1e5 else 7.0, 8.0]))
        found, finding = least_slack(cells), judged("floor", cells)
        assert found.slack == pytest.approx(start - floor)
        assert (found.ratio, found.epsilon) == (pytest.approx(1e6), EPSILONS[0])
        assert finding.holds == holds
        assert bool(finding.cause) != holds


def test_failed_cells_have_no_say(sweep: Sweep) -> None:
    cells = sweep(failed=(0,))
    cells.results["actual_start"][0, 0] = 0.0
    assert least_slack(cells).slack == pytest.approx(6.2 - (T_S - T_H))
    assert max(trend.rise for trend in trends(cells)) == 0.0


def test_where_it_settles_is_known_with_the_ratio_from_which_on(sweep: Sweep) -> None:
    found = settled(sweep())
    assert found.start == 6.2
    assert found.ratio == pytest.approx(1e3)
    early = judged("settles", sweep())
    assert (early.published, early.reproduced, early.holds) == (6.5, 6.2, True)
    late = judged("settles", sweep(of=starting(lambda ratio: [8.0, 8.0])))
    assert not late.holds
    assert late.difference == pytest.approx(1.5)
    assert any("t_s - T_h = 6.14 s" in point for point in late.cause)


def test_the_chosen_ratio_is_sooner_than_equal_weights_at_less_effort_than_the_largest(sweep: Sweep) -> None:
    slow = judged("chosen", sweep(of=lambda ratio: {**numbers(ratio), "completion_time": 15.0}))
    costly = judged("chosen", sweep(of=lambda ratio: {**numbers(ratio), "control_effort": 2.0}))
    assert not slow.holds
    assert not costly.holds
    assert "no earlier" in slow.cause[0]
    assert "no less effort" in costly.cause[0]


@pytest.mark.parametrize("claim", CLAIMS.values(), ids=list(CLAIMS))
def test_without_a_cell_that_ended_nothing_holds(sweep: Sweep, claim: Claim) -> None:
    finding = judge_weights(claim, sweep("2", failed=(0, 1)))
    assert not finding.holds
    assert np.isnan(finding.difference)
    assert "time limit of 30 s reached" in finding.cause


def test_a_claim_without_a_rule_is_an_error(sweep: Sweep) -> None:
    with pytest.raises(TypeError, match="Claim"):
        judge_weights(Claim("a", "b", "weights", "c", "d"), sweep("2"))
