"""Sweeps on coarse meshes: over weights, and over any keys of a task."""

from pathlib import Path

import numpy as np
import pytest

import psmpc_cli
from psmpc_cli.errors import InputError, SpecError
from psmpc_cli.logs.results import Results
from psmpc_cli.simulation.run import simulate
from psmpc_cli.specs.load import Task, load_task
from psmpc_cli.studies.runner import COMPUTED, FAILED, SHARED, run_study, with_changes
from psmpc_cli.studies.sampling import parse_sampling
from psmpc_cli.studies.sweep import (
    ALLOWED_ERROR,
    Recommendation,
    SweepCells,
    load_sweep_task,
    parse_stages,
    recommend,
    sweep,
    weight_study,
)

from ..short_runs import TASK

COARSE = ("controller.nodes=12", "plant.kind=ideal")


def swept(
    grid: str = "2x2", every_cell: bool = False, task: str = "approach_capture", changes: tuple[str, ...] = COARSE
) -> Results:
    loaded = load_sweep_task(task, changes)
    study = weight_study(loaded, parse_stages("1,2", loaded), parse_sampling(grid, (0.1, 10.0)), every_cell)
    return run_study(study, jobs=2)


@pytest.fixture(scope="module")
def shared() -> Results:
    return swept()


@pytest.mark.slow
def test_cells_that_share_come_out_as_if_each_had_been_computed(shared: Results) -> None:
    computed = swept(every_cell=True)
    assert np.all(computed["status"] == COMPUTED)
    assert shared["status"].ravel().tolist() == [COMPUTED, COMPUTED, COMPUTED, SHARED]
    assert shared["origin"].ravel().tolist() == [0, 1, 2, 0]
    np.testing.assert_allclose(shared["switch_time"], computed["switch_time"], atol=1e-3)
    np.testing.assert_allclose(shared["instant_at_detection"], computed["instant_at_detection"], atol=1e-3)
    np.testing.assert_allclose(shared["actual_start"], computed["actual_start"], atol=0.1 + 1e-9)
    for name in ("control_effort", "stage_cost", "base_force", "variation_joints"):
        np.testing.assert_allclose(shared[name], computed[name], rtol=1e-3)
    for name in ("solves", "appended", "solves_failed"):
        np.testing.assert_array_equal(shared[name], computed[name])


def test_a_cell_holds_what_its_run_came_to(shared: Results) -> None:
    assert np.all(shared["detection_time"] < shared["instant_at_detection"])
    assert np.all(shared["switch_time"][..., 0] < shared["completion_time"])
    np.testing.assert_array_equal(shared["switch_time"][..., 1], shared["completion_time"])
    assert np.all((shared["final_error"] > 0) & (shared["final_error"] <= 1 + 1e-3))
    assert np.all(shared["succeeded"] == 1)
    np.testing.assert_array_equal(shared["end_time"], shared["completion_time"])
    assert np.all(np.diff(shared["actual_start"], axis=-1) >= 0), "a higher threshold is reached later"
    np.testing.assert_allclose(shared["solves"] * 0.1, shared["completion_time"], atol=0.1 + 1e-9)


def test_a_higher_ratio_starts_the_second_stage_no_later_and_never_before_it_is_seen(shared: Results) -> None:
    by_ratio = np.argsort(shared["ratio"], axis=None)
    starts = shared["actual_start"].reshape(4, -1)[by_ratio]
    assert np.all(np.diff(starts, axis=0) <= 0.1 + 1e-9)
    assert np.all(starts[-1] < starts[0])
    floor = shared["switch_time"].reshape(4, -1)[by_ratio, :1] - 4.0
    assert np.all(starts >= floor - 1e-9)


@pytest.mark.slow
def test_runs_go_on_to_the_end_of_the_mission_and_the_tasks_own_priorities_are_run_besides() -> None:
    """Two ratios of a transport on a coarse mesh: no cell has the ratio of the task itself."""
    task = load_sweep_task("transport", ("controller.nodes=12",))
    study = weight_study(task, (0, 1), parse_sampling("2", (0.1, 10.0)))
    results = run_study(study, jobs=2)
    run = simulate(task)
    summary = run.summary()
    error = run["deviation/end"][:, 1]
    np.testing.assert_array_equal(results["reference_switch_time"], run.stages["switch_time"])
    assert float(results["reference_completion_time"]) == run.stages["switch_time"][1]
    assert float(results["reference_end_time"]) == summary.duration
    assert float(results["reference_end_error"][1]) == error[np.isfinite(error)][-1]
    assert float(results["reference_control_effort"]) == summary.control_effort
    assert float(results["reference_peak_base_force"]) == summary.peaks["base_force"]
    assert int(results["reference_origin"]) == 2
    assert np.isfinite(results["switch_time"]).all()
    cells = SweepCells(results)
    assert_by_the_rule(cells, recommend(cells))


def assert_by_the_rule(cells: SweepCells, found: Recommendation) -> None:
    """The rule of docs/sweeps.md, written out for ratios: the recommended mission ends first of all that may be."""
    results = cells.results
    assert results["reference_succeeded"] == 1
    ends = {cells.own_ratio: float(results["reference_switch_time"][-1])}
    for cell, ratio in enumerate(cells.ratio):
        whole = results["succeeded"][cell] == 1 and cells.end_error[cell] <= ALLOWED_ERROR
        cheap = all(
            results[name][cell] <= results[f"reference_{name}"] for name in ("control_effort", "peak_base_force")
        )
        if whole and cheap:
            ends[float(ratio)] = float(results["switch_time"][cell, -1])
    assert found.ratio is not None
    assert ends[found.ratio] == min(ends.values())


@pytest.mark.slow
def test_a_sweep_of_a_task_whose_own_priorities_are_poor_finds_better_ones() -> None:
    """With a millionth of the published ratio Capture waits too long, and then takes more effort than at 0.01."""
    task = load_sweep_task("approach_capture", (*COARSE, "stages.capture.priority=1e-4"))
    results = run_study(weight_study(task, (0, 1), parse_sampling("3", (1e-2, 1.0))), jobs=2)
    cells = SweepCells(results)
    found = recommend(cells)
    assert found.ratio == pytest.approx(1e-2)
    assert_by_the_rule(cells, found)


def test_a_cell_whose_mission_takes_too_long_fails_with_the_reason() -> None:
    results = swept("2", changes=(*COARSE, "time_limit=7"))
    assert results["status"].tolist() == [FAILED, FAILED]
    assert results["reason"].tolist() == ["time limit of 7 s reached"] * 2
    found = recommend(SweepCells(results))
    assert found.ratio is None
    assert "fails with the task's own priorities (time limit of 7 s reached)" in found.sentence
    assert np.all(results["detection_time"] > 0)


@pytest.fixture
def task(tmp_path: Path) -> Task:
    (tmp_path / "task.yaml").write_text(TASK)
    return load_task(tmp_path / "task.yaml")


@pytest.mark.slow
def test_any_keys_are_swept_and_the_arrays_are_labelled(task: Task, tmp_path: Path) -> None:
    values = {"stages.back.priority": [1, 10.0], "controller.kind": ["psmpc", "smpc"]}
    results = psmpc_cli.sweep(task, values, tmp_path / "sweep.h5", jobs=2)
    assert results.quantities["switch_time"].dims == ("stages.back.priority", "controller.kind", "stage")
    assert results["stages.back.priority"].tolist() == [1.0, 10.0]
    assert results["controller.kind"].tolist() == ["psmpc", "smpc"]
    assert np.all(results["status"] == COMPUTED)
    assert np.all(results["succeeded"] == 1)
    run = simulate(with_changes(task, ("stages.back.priority=10.0", "controller.kind=smpc")))
    np.testing.assert_array_equal(results["switch_time"][1, 1], run.stages["switch_time"])
    assert results["stage_cost"][1, 1].sum() == pytest.approx(0.1 * run["cost/current_stage"].sum())
    xarray = pytest.importorskip("xarray")
    with xarray.open_dataset(tmp_path / "sweep.h5", engine="h5netcdf") as data:
        chosen = data["end_time"].sel({"stages.back.priority": 10, "controller.kind": "smpc"})
        assert float(chosen) == results["end_time"][1, 1]
        assert data["end_time"].attrs["units"] == "s"


def test_a_value_that_does_not_fit_is_told_before_anything_runs(task: Task, tmp_path: Path) -> None:
    with pytest.raises(SpecError, match="nodes"):
        sweep(task, {"controller.nodes": [5, -1]}, tmp_path / "sweep.h5")
    with pytest.raises(InputError, match="found 0 runs"):
        sweep(task, {})
    assert not (tmp_path / "sweep.h5").exists()
