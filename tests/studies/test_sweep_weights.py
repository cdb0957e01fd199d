"""Pairs of priorities: which ones a sweep tries, what its cells came to, and which ratio it recommends."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from psmpc_cli.errors import LogError
from psmpc_cli.specs.load import load_task
from psmpc_cli.studies.sampling import Draws, Grid, Ratios, Sampling, parse_sampling
from psmpc_cli.studies.sweep import COMPLETION_TOLERANCE, AlongRatio, SweepCells, origins, parse_stages, recommend

from ..synthetic_sweep import EPSILONS, Numbers, numbers, sampling_of, synthetic_sweep


def test_stages_go_by_number_or_name() -> None:
    task = load_task("transport")
    assert parse_stages("2,3", task) == parse_stages("capture, transport", task) == (1, 2)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "sweep.h5"


@pytest.mark.parametrize(("sampling", "kind"), [("3x5", Grid), ("7", Ratios), ("random:9", Draws)])
def test_cells_stand_in_the_order_of_the_sampling(path: Path, sampling: str, kind: type[Sampling]) -> None:
    cells = SweepCells(synthetic_sweep(path, sampling))
    assert cells.sampling is kind
    np.testing.assert_allclose(cells.omega, sampling_of(sampling).omega)
    np.testing.assert_allclose(cells.ratio, sampling_of(sampling).ratio)
    for cell, ratio in enumerate(cells.ratio):
        np.testing.assert_allclose(cells.of("actual_start")[cell], numbers(ratio)["actual_start"])
        assert cells.of("completion_time")[cell] == numbers(ratio)["completion_time"]


@pytest.mark.parametrize(("epsilons", "chosen"), [(EPSILONS, 0.1), ((0.1, 0.5, 0.9), 0.5), ((1e-3, 1e-2), 1e-2)])
def test_the_chosen_threshold_is_the_tasks_or_the_largest(
    path: Path, epsilons: tuple[float, ...], chosen: float
) -> None:
    cells = SweepCells(synthetic_sweep(path, "2", waiting=(0, 1), epsilons=epsilons))
    assert cells.epsilons[cells.chosen] == chosen


def test_cells_of_one_ratio_are_taken_together(path: Path) -> None:
    cells = SweepCells(synthetic_sweep(path, "3x3", failed=(0,)))
    values = np.arange(9.0)
    found = AlongRatio(cells, values)
    np.testing.assert_allclose(found.ratio, [1e-6, 1e-3, 1.0, 1e3, 1e6])
    # the cell in row omega_2 and column omega_1 has the number 3 row + column, and 0 on the diagonal failed
    np.testing.assert_array_equal(found.lowest, [2, 1, 4, 3, 6])
    np.testing.assert_array_equal(found.highest, [2, 5, 8, 7, 6])
    np.testing.assert_array_equal(found.middle, [2, 3, 6, 5, 6])


def test_what_cells_share_counts_once(path: Path) -> None:
    assert SweepCells(synthetic_sweep(path, "3x3")).count("solves") == 500
    assert SweepCells(synthetic_sweep(path, "3x3", waiting=(2,))).count("solves") == 400
    assert SweepCells(synthetic_sweep(path, "3x3", task="transport")).count("solves") == 900


@pytest.mark.parametrize(
    "changes", [{"stages": ""}, {"stages": "one,two"}, {"task_yaml": "robot: nobody"}, {"robot_yaml": None}]
)
def test_a_file_that_does_not_say_what_ran_is_refused_by_name(path: Path, changes: dict[str, str | None]) -> None:
    results = synthetic_sweep(path, "2")
    attributes = {key: value for key, value in {**results.attributes, **changes}.items() if value is not None}
    with pytest.raises(LogError, match=str(path)):
        SweepCells(replace(results, attributes=attributes))


def test_runs_are_shared_where_all_priorities_over_the_largest_are_equal() -> None:
    omega = parse_sampling("3x3", (0.1, 10.0)).omega
    assert len(np.unique(origins(load_task("approach_capture"), (0, 1), omega))) == 5
    assert len(np.unique(origins(load_task("transport"), (0, 1), omega))) == 9


def test_runs_go_from_the_smallest_ratio_to_the_largest(path: Path) -> None:
    assert SweepCells(synthetic_sweep(path, "3x3", failed=(0, 4, 8))).runs.tolist() == [2, 1, 3, 6]
    assert len(SweepCells(synthetic_sweep(path, "3x3", task="transport")).runs) == 9


SEVEN = "7"
"""Ratios 1e-6, 1e-4, ..., 1e6; completion within 5 % of the earliest from 100 on, 14.02 s."""


Recommended = Callable[..., tuple[float | None, str]]


@pytest.fixture
def recommended(tmp_path: Path) -> Recommended:
    def of(sampling: str = SEVEN, **given: object) -> tuple[float | None, str]:
        return recommend(SweepCells(synthetic_sweep(tmp_path / "sweep.h5", sampling, **given)))

    return of


def with_error(at: dict[float, float]) -> Callable[[float], Numbers]:
    """Made-up numbers with other final errors at some ratios."""
    return lambda ratio: {**numbers(ratio), "final_error": at.get(float(f"{ratio:.6g}"), 0.9)}


@pytest.mark.parametrize(
    ("sampling", "given", "ratio"),
    [
        ("13", {}, 10.0),
        (SEVEN, {"of": with_error({1e-6: 0.5, 100.0: 1.0})}, 100.0),  # errors within the tolerance are none
        (SEVEN, {"of": with_error({100.0: 1.01})}, 1e4),
        (SEVEN, {"of": with_error({1e-6: 1.2, 100.0: 1.2})}, 100.0),  # the smallest ratio has it as well
        ("7x7", {"failed": (35,)}, 10.0),  # omega = (1e-3, 1e2)
        ("7x7", {"failed": (23,)}, 100.0),  # omega = (0.1, 1)
    ],
)
def test_it_is_the_smallest_ratio_that_completes_early_raises_no_error_and_has_no_failed_cell(
    recommended: Recommended, sampling: str, given: dict[str, object], ratio: float
) -> None:
    assert recommended(sampling, **given)[0] == pytest.approx(ratio)


def test_it_is_told_in_one_line_with_what_speaks_for_it(recommended: Recommended) -> None:
    _, line = recommended("13")
    assert "\n" not in line
    assert line.startswith("recommended omega_2/omega_1: 10,")
    assert "completes within 5% of the earliest: at 14.20 s, earliest 14.00 s" in line
    assert "final error is 0.90 of the tolerance; control effort 1.10, of 1.00 to 10001.00" in line
    assert numbers(1.0)["completion_time"] > (1 + COMPLETION_TOLERANCE) * 14.0


@pytest.mark.parametrize(
    ("given", "why"),
    [
        ({"failed": tuple(range(7))}, "no cell has come to its end"),
        ({"of": lambda ratio: {**numbers(ratio), "final_error": 0.9 + ratio}}, "raised the final error"),
        ({"sampling": "3x3", "failed": (0, 4, 3, 6)}, "had a cell that failed"),
    ],
)
def test_why_there_is_none_is_told(recommended: Recommended, given: dict[str, object], why: str) -> None:
    ratio, line = recommended(**given)
    assert ratio is None
    assert line.startswith("no ratio is recommended: ")
    assert why in line
