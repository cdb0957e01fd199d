from collections.abc import Callable
from pathlib import Path

import pytest

from psmpc_cli.simulation.recommendation import WITHIN, Recommendation, recommend
from psmpc_cli.simulation.sweep_cells import sweep_cells

from ..made_up_sweep import Numbers, made_up_sweep, numbers

Recommend = Callable[..., Recommendation | None]

SEVEN = "7"
"""Ratios 1e-6, 1e-4, ..., 1e6; completion within 5 % of the earliest from 100 on, 14.02 s."""


@pytest.fixture
def recommended(tmp_path: Path) -> Recommend:
    def of(sampling: str = SEVEN, **given: object) -> Recommendation | None:
        return recommend(sweep_cells(made_up_sweep(tmp_path / "sweep.h5", sampling, **given)))

    return of


def with_error(at: dict[float, float]) -> Callable[[float], Numbers]:
    """Made-up numbers with other final errors at some ratios."""
    return lambda ratio: {**numbers(ratio), "final_error": at.get(float(f"{ratio:.6g}"), 0.9)}


def test_it_is_the_smallest_ratio_that_completes_early_enough(recommended: Recommend) -> None:
    best = recommended("13")
    assert best is not None
    assert best.ratio == pytest.approx(10.0)
    assert best.completion <= (1 + WITHIN) * best.earliest
    assert numbers(1.0)["completion_time"] > (1 + WITHIN) * best.earliest
    assert best.effort == pytest.approx(1.1)
    assert best.efforts == pytest.approx((1.0, 1.0 + 1e4))
    assert not best.preliminary


def test_errors_within_the_tolerance_are_none(recommended: Recommend) -> None:
    best, other = recommended(), recommended(of=with_error({1e-6: 0.5, 100.0: 1.0}))
    assert best is not None
    assert other is not None
    assert (best.ratio, other.ratio) == (pytest.approx(100.0), pytest.approx(100.0))


def test_a_ratio_that_raises_the_error_is_passed_over(recommended: Recommend) -> None:
    best = recommended(of=with_error({100.0: 1.01}))
    assert best is not None
    assert best.ratio == pytest.approx(1e4)


def test_an_error_is_not_raised_that_the_smallest_ratio_has_as_well(recommended: Recommend) -> None:
    best = recommended(of=with_error({1e-6: 1.2, 100.0: 1.2}))
    assert best is not None
    assert best.ratio == pytest.approx(100.0)


def test_a_stage_without_end_condition_has_no_error_to_raise(recommended: Recommend) -> None:
    best = recommended(of=lambda ratio: {**numbers(ratio), "final_error": float("nan")})
    assert best is not None
    assert best.ratio == pytest.approx(100.0)
    assert "final error" not in str(best)


def test_a_ratio_with_a_failed_cell_is_passed_over(recommended: Recommend) -> None:
    elsewhere = recommended("7x7", failed=(35,))  # omega = (1e-3, 1e2)
    there = recommended("7x7", failed=(23,))  # omega = (0.1, 1)
    assert elsewhere is not None
    assert there is not None
    assert (elsewhere.ratio, there.ratio) == (pytest.approx(10.0), pytest.approx(100.0))


def test_what_waits_makes_it_preliminary(recommended: Recommend) -> None:
    best = recommended(waiting=(4,))
    assert best is not None
    assert best.preliminary
    assert best.ratio == pytest.approx(1e4)
    assert "so far" in str(best)


def test_where_nothing_has_ended_there_is_none(recommended: Recommend) -> None:
    assert recommended(failed=tuple(range(7))) is None


def test_it_is_told_in_one_line(recommended: Recommend) -> None:
    line = str(recommended())
    assert "\n" not in line
    assert line.startswith("recommended omega_2/omega_1: 100,")
    assert "completes within 5% of the earliest: at 14.00 s, earliest 14.00 s" in line
    assert "final error is 0.90 of the tolerance" in line
