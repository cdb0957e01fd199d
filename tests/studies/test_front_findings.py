from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from psmpc_cli.logs.results import Results
from psmpc_cli.studies.findings import Finding
from psmpc_cli.studies.front_claims import FrontClaim, fronts_claims
from psmpc_cli.studies.front_findings import judge_fronts
from psmpc_cli.studies.published import load_published

from ..made_up_fronts import FALLING, RISING, made_up_fronts

CLAIMS = {claim.id: claim for claim in fronts_claims(load_published())}

Study = Callable[..., Results]


@pytest.fixture
def study(tmp_path: Path) -> Study:
    return lambda **given: made_up_fronts(tmp_path / "fronts.h5", **given)


def judged(name: str, results: Results | None) -> Finding:
    return judge_fronts(CLAIMS[f"fronts.{name}"], results)


def test_there_is_a_claim_for_all_that_is_published_of_the_fronts() -> None:
    assert list(CLAIMS) == ["fronts.with_ratio", "fronts.with_time"]
    assert {claim.group for claim in CLAIMS.values()} == {claim.topic for claim in CLAIMS.values()} == {"fronts"}
    assert all("upper left" in claim.statement for claim in CLAIMS.values())


def test_fronts_as_published_hold(study: Study) -> None:
    results = study(drift=RISING)
    for claim in CLAIMS.values():
        finding = judge_fronts(claim, results)
        assert finding.holds
        assert finding.cause == ()
    assert judged("with_ratio", results).reproduced == "upper left at 3 of 3"
    assert judged("with_time", results).reproduced == "upper left (2 of 2)"


def test_fronts_that_move_elsewhere_say_where_and_what_goes_with_it(study: Study) -> None:
    results = study(drift=FALLING)
    finding = judged("with_time", results)
    assert not finding.holds
    assert (finding.published, finding.reproduced) == ("upper left", "lower right (2 of 2)")
    assert any("over its own extent" in point for point in finding.cause)
    assert any("part of the horizon goes from 3.50 to 1.50 s" in point for point in finding.cause)
    assert judged("with_ratio", results).holds


def test_one_step_elsewhere_is_enough(study: Study) -> None:
    results = study(drift=RISING)
    results["weighted_J_2"][2] += 3.0
    finding = judged("with_time", results)
    assert finding.reproduced == "upper left (1 of 2) and upper right (1 of 2)"
    assert not finding.holds


def test_an_optimum_that_moves_back_breaks_the_claim_where_it_does(study: Study) -> None:
    results = study()
    results["weighted_J_1"][1, [2, 3]] = results["weighted_J_1"][1, [3, 2]]
    finding = judged("with_ratio", results)
    assert not finding.holds
    assert finding.reproduced == "upper left at 2 of 3"
    assert [point.startswith("at 7.5 s it moves against it by 0.") for point in finding.cause] == [True]


def test_an_optimum_that_stays_where_it_is_does_not_move(study: Study) -> None:
    results = study()
    for J in ("J_1", "J_2"):
        results[f"weighted_{J}"][0] = 1.0
    finding = judged("with_ratio", results)
    assert not finding.holds
    assert finding.cause == ("at 6.5 s it does not move, or could not be found",)


def test_points_that_failed_show_no_movement(study: Study) -> None:
    results = study(drift=RISING, failed=(1,))
    assert not judged("with_ratio", results).holds
    assert judged("with_time", results).reproduced == "unknown (2 of 2)"
    assert not judged("with_time", results).holds


def test_one_sample_says_nothing_of_time(study: Study) -> None:
    results = study(samples=1)
    assert judged("with_ratio", results).holds
    assert not judged("with_time", results).holds
    assert "one sample alone" in judged("with_time", results).cause[0]


@pytest.mark.parametrize("claim", CLAIMS.values(), ids=list(CLAIMS))
def test_without_a_window_nothing_holds(claim: FrontClaim) -> None:
    finding = judge_fronts(claim, None)
    assert not finding.holds
    assert finding.reproduced == "unknown"
    assert np.isnan(finding.difference)
    assert "no window" in finding.cause[0]


def test_a_claim_without_a_rule_is_an_error(study: Study) -> None:
    with pytest.raises(TypeError, match="FrontClaim"):
        judge_fronts(FrontClaim("a", "b", "fronts", "c", "d", "upper left"), study())
