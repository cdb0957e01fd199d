from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from psmpc_cli.errors import LogError
from psmpc_cli.simulation.sweep_cells import GRID, RANDOM, RATIOS, along_ratio, sweep_cells

from ..made_up_sweep import EPSILONS, T_H, T_S, made_up_sweep, numbers, sampling_of


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "sweep.h5"


@pytest.mark.parametrize(("sampling", "kind"), [("3x5", GRID), ("7", RATIOS), ("random:9", RANDOM)])
def test_cells_stand_in_the_order_of_the_sampling(path: Path, sampling: str, kind: str) -> None:
    cells = sweep_cells(made_up_sweep(path, sampling))
    assert cells.sampling == kind
    np.testing.assert_allclose(cells.omega, sampling_of(sampling).omega)
    np.testing.assert_allclose(cells.ratio, sampling_of(sampling).ratio)
    for cell, ratio in enumerate(cells.ratio):
        np.testing.assert_allclose(cells.of("actual_start")[cell], numbers(ratio)["actual_start"])
        assert cells.of("completion_time")[cell] == numbers(ratio)["completion_time"]


def test_every_cell_waits_failed_or_ended(path: Path) -> None:
    cells = sweep_cells(made_up_sweep(path, "3x3", waiting=(0, 1), failed=(4,)))
    assert np.flatnonzero(cells.waiting).tolist() == [0, 1]
    assert np.flatnonzero(cells.failed).tolist() == [4]
    np.testing.assert_array_equal(cells.ended, ~cells.waiting & ~cells.failed)


def test_names_instants_and_priorities_are_those_of_the_studied_stages(path: Path) -> None:
    cells = sweep_cells(made_up_sweep(path, "3x3"))
    assert cells.names == ("approach", "capture")
    assert cells.own_ratio == 100.0
    np.testing.assert_allclose(cells.instant, T_S)
    np.testing.assert_allclose(cells.floor, T_S - T_H)


@pytest.mark.parametrize(("epsilons", "chosen"), [(EPSILONS, 0.1), ((0.1, 1.0, 10.0), 0.1), ((1e-3, 1e-2), 1e-2)])
def test_the_chosen_threshold_is_the_tasks_or_the_largest(
    path: Path, epsilons: tuple[float, ...], chosen: float
) -> None:
    cells = sweep_cells(made_up_sweep(path, "2", waiting=(0, 1), epsilons=epsilons))
    assert cells.epsilons[cells.chosen] == chosen


def test_cells_of_one_ratio_are_taken_together(path: Path) -> None:
    cells = sweep_cells(made_up_sweep(path, "3x3", failed=(0,)))
    values = np.arange(9.0)
    found = along_ratio(cells, values)
    np.testing.assert_allclose(found.ratio, [1e-6, 1e-3, 1.0, 1e3, 1e6])
    # the cell in row omega_2 and column omega_1 has the number 3 row + column, and 0 on the diagonal failed
    np.testing.assert_array_equal(found.lowest, [2, 1, 4, 3, 6])
    np.testing.assert_array_equal(found.highest, [2, 5, 8, 7, 6])
    np.testing.assert_array_equal(found.middle, [2, 3, 6, 5, 6])


def test_what_cells_share_counts_once(path: Path) -> None:
    cells = sweep_cells(made_up_sweep(path, "3x3", waiting=(1,), failed=(2,)))
    assert cells.count("solves") == 700
    cells.results["origin"][2, 2] = 0
    assert cells.count("solves") == 600


def test_a_sweep_without_ended_cells_has_nothing_along_the_ratio(path: Path) -> None:
    cells = sweep_cells(made_up_sweep(path, "3", waiting=(0, 1), failed=(2,)))
    assert len(along_ratio(cells, cells.instant).ratio) == 0


@pytest.mark.parametrize(
    "changes", [{"stages": ""}, {"stages": "one,two"}, {"task_yaml": "robot: nobody"}, {"robot_yaml": None}]
)
def test_a_file_that_does_not_say_what_ran_is_refused_by_name(path: Path, changes: dict[str, str | None]) -> None:
    results = made_up_sweep(path, "2")
    attributes = {key: value for key, value in {**results.attributes, **changes}.items() if value is not None}
    with pytest.raises(LogError, match=str(path)):
        sweep_cells(replace(results, attributes=attributes))
