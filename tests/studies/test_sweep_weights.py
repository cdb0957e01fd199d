"""Pairs of priorities: which ones a sweep tries, what its cells came to, and which ratio it recommends."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from psmpc_cli.errors import LogError
from psmpc_cli.specs.load import load_task
from psmpc_cli.studies.runner import FAILED, REFERENCE, WAITING
from psmpc_cli.studies.sampling import Draws, FullFactorial, Ratios, Sampling, parse_sampling
from psmpc_cli.studies.sweep import (
    QuantityByRatio,
    Recommendation,
    SweepCells,
    first_equal_runs,
    parse_stages,
    recommend,
)

from ..synthetic_sweep import EPSILONS, T_S, Numbers, numbers, sampling_of, synthetic_sweep


def test_stages_go_by_number_or_name() -> None:
    task = load_task("transport")
    assert parse_stages("2,3", task) == parse_stages("capture, transport", task) == (1, 2)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "sweep.h5"


@pytest.mark.parametrize(("sampling", "kind"), [("3x5", FullFactorial), ("7", Ratios), ("random:9", Draws)])
def test_cells_stand_in_the_order_of_the_sampling(path: Path, sampling: str, kind: type[Sampling]) -> None:
    cells = SweepCells(synthetic_sweep(path, sampling))
    assert cells.sampling is kind
    np.testing.assert_allclose(cells.omega, sampling_of(sampling).omega)
    np.testing.assert_allclose(cells.ratio, sampling_of(sampling).ratio)
    for cell, ratio in enumerate(cells.ratio):
        np.testing.assert_allclose(cells.quantity("actual_start")[cell], numbers(ratio)["actual_start"])
        assert cells.quantity("completion_time")[cell] == numbers(ratio)["completion_time"]


@pytest.mark.parametrize(("epsilons", "chosen"), [(EPSILONS, 0.1), ((0.1, 0.5, 0.9), 0.5), ((1e-3, 1e-2), 1e-2)])
def test_the_chosen_threshold_is_the_tasks_or_the_largest(
    path: Path, epsilons: tuple[float, ...], chosen: float
) -> None:
    cells = SweepCells(synthetic_sweep(path, "2", waiting=(0, 1), own_status=WAITING, epsilons=epsilons))
    assert cells.epsilons[cells.shown_threshold] == chosen


def test_cells_of_one_ratio_are_taken_together(path: Path) -> None:
    cells = SweepCells(synthetic_sweep(path, "3x3", failed=(0,)))
    values = np.arange(9.0)
    found = QuantityByRatio(cells, values)
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
    assert len(np.unique(first_equal_runs(load_task("approach_capture"), (0, 1), omega))) == 5
    assert len(np.unique(first_equal_runs(load_task("transport"), (0, 1), omega))) == 9


def test_runs_go_from_the_smallest_ratio_to_the_largest(path: Path) -> None:
    assert SweepCells(synthetic_sweep(path, "3x3", failed=(0, 4, 8))).ended_by_ratio.tolist() == [2, 1, 3, 6]
    assert len(SweepCells(synthetic_sweep(path, "3x3", task="transport")).ended_by_ratio) == 9


BEST = 1e-2

COSTS: dict[float, Numbers] = {
    1e-6: {"end": 20.0},
    1e-4: {"end": 8.0, "succeeded": 0},
    BEST: {"end": 12.0},
    1.0: {"end": 11.0, "final_error": 1.06},
    100.0: {"end": 13.0},
    1e4: {"end": 10.0, "control_effort": 2.01},
    1e6: {"end": 9.0, "peak_base_force": 50.1},
}
"""What distinguishes the runs of seven ratios; the task's own one is 100. All but `BEST` are slower or break a rule."""


def costing(ratio: float, **changes: Numbers) -> Numbers:
    """Made-up numbers by the table of costs, or by other entries for some ratios, named such as r100."""
    key = float(f"{ratio:.6g}")
    found = {"control_effort": 2.0, **changes.get(f"r{key:g}", COSTS[key])}
    end = found.pop("end")
    assert isinstance(end, float)
    return {**numbers(ratio), **found, "switch_time": [T_S, end], "completion_time": end}


Recommended = Callable[..., Recommendation]


@pytest.fixture
def recommended(path: Path) -> Recommended:
    def of(sampling: str = "7", changes: dict[str, Numbers] | None = None, **given: object) -> Recommendation:
        run = partial(costing, **(changes or {}))
        return recommend(SweepCells(synthetic_sweep(path, sampling, **{"of": run, **given})))

    return of


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changes", "ratio"),
    [
        ({}, BEST),
        ({"r0.01": {"end": 12.0, "succeeded": 0}}, 100.0),
        ({"r0.01": {"end": 12.0, "end_error": [1.2]}}, 100.0),  # it is not the last stage alone that counts
        ({"r0.01": {"end": 13.0}}, 100.0),  # as fast as the task's own, for as much
        ({"r0.01": {"end": 13.0, "control_effort": 1.9}}, BEST),  # as fast, for less
        ({"r1": {"end": 11.0, "final_error": 1.05}}, 1.0),  # as much as the plant may miss the plan's end
        ({"r10000": {"end": 10.0, "control_effort": 2.0}}, 1e4),
        ({"r1e+06": {"end": 9.0, "peak_base_force": 50.0}}, 1e6),
        ({"r0.0001": {"end": 8.0}}, 1e-4),
        ({"r100": {"end": 13.0, "control_effort": 3.0, "peak_base_force": 60.0}}, 1e6),
        ({"r100": {"end": 11.5, "final_error": 1.3}}, BEST),  # although it is slower: the task's own misses its end
    ],
)
def test_the_fastest_whole_mission_at_no_more_cost_than_with_the_tasks_own_priorities(
    recommended: Recommended, changes: dict[str, Numbers], ratio: float
) -> None:
    assert recommended(changes=changes).ratio == pytest.approx(ratio)


def test_the_largest_effort_the_latest_start_and_an_error_are_never_recommended(recommended: Recommended) -> None:
    """A low ratio with a hundred times the effort, which earlier rules chose since it came first and ended in time."""
    bad: Numbers = {"end": 8.0, "control_effort": 200.0, "final_error": 1.2}
    assert recommended(changes={"r1e-06": bad}).ratio == pytest.approx(BEST)
    assert recommended(changes={"r1e-06": {**bad, "final_error": 0.9}}).ratio == pytest.approx(BEST)
    assert recommended(changes={"r1e-06": {**bad, "control_effort": 1.0}}).ratio == pytest.approx(BEST)


def test_own_priorities_that_no_cell_has_are_compared_with_all_the_same(recommended: Recommended) -> None:
    """Of three ratios 1e-6, 1 and 1e6 none is the task's own."""
    assert recommended("3", {"r1": {"end": 11.0}}).ratio == pytest.approx(1.0)
    found = recommended("3")
    assert found.ratio == pytest.approx(100.0)
    assert "the task's own: the mission ends at 13.00 s with control effort 2, peak force on the base 50 N" in (
        found.sentence
    )
    assert "of the 3 other runs 1 had a larger peak force on the base, 1 ended a stage at more than" in found.sentence


def test_where_runs_of_one_ratio_differ_a_pair_of_priorities_is_recommended(recommended: Recommended) -> None:
    """Since the stages after them keep their priorities."""
    sentence = recommended(
        "3x3", of=lambda ratio: {**numbers(ratio), "control_effort": 1 / ratio}, task="transport"
    ).sentence
    assert sentence.startswith("recommended omega_2/omega_1: 1e+06 (omega_1 = 0.001, omega_2 = 1000), ")


def test_it_is_told_in_one_line_with_what_speaks_for_it(recommended: Recommended) -> None:
    assert recommended().sentence == (
        "recommended omega_2/omega_1: 0.01 (omega_1 = 10, omega_2 = 0.1), the fastest mission at no more effort and "
        "force than with the task's own 100 (omega_1 = 1, omega_2 = 100): it ends at 12.00 s with control effort 2, "
        "peak force on the base 50 N and end errors up to 0.90 of the tolerance; with the task's own it ends at "
        "13.00 s with control effort 2, peak force on the base 50 N and end errors up to 0.90 of the tolerance"
    )
    assert recommended(waiting=(0,)).sentence.startswith("recommended omega_2/omega_1 so far: 0.01 ")


@pytest.mark.parametrize(
    ("given", "why"),
    [
        ({"own_status": WAITING}, "the task's own priorities have not been run yet"),
        (
            {"failed": (4,), "own_status": FAILED},
            "the mission fails with the task's own priorities (time limit of 30 s reached), so that there is no whole "
            "mission whose effort and force bound those of others; 5 of 6 others succeed, the fastest that of ratio "
            "1e+06, at 9.00 s",
        ),
        ({"own": {"succeeded": 0}, "sampling": "3"}, "(a monitor broke, or the object was not delivered)"),
        (
            {"own": {"final_error": 1.3}, "sampling": "3", "failed": (0,)},
            "of 4 runs 1 failed, 1 had a larger peak force on the base, 2 ended a stage at more than 1.05 tolerances; "
            "with the task's own priorities the mission ends at 13.00 s",
        ),
    ],
)
def test_why_there_is_none_is_told(recommended: Recommended, given: dict[str, object], why: str) -> None:
    found = recommended(**given)
    assert found.ratio is None
    assert found.sentence.startswith("no ratio is recommended: ")
    assert why in found.sentence


def test_a_file_whose_runs_end_with_the_second_stage_is_told_in_one_line(path: Path) -> None:
    results = synthetic_sweep(path, "2")
    kept = {name: each for name, each in results.quantities.items() if not name.startswith(REFERENCE)}
    with pytest.raises(
        LogError, match="as earlier versions made it, expected whole missions: run the sweep again"
    ) as e:
        SweepCells(replace(results, quantities=kept))
    assert "\n" not in str(e.value)
