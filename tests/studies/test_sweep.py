"""The weight study on coarse meshes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from psmpc_cli.errors import InputError
from psmpc_cli.logs.results import Results
from psmpc_cli.specs.load import Task
from psmpc_cli.studies import cell as cell_module
from psmpc_cli.studies.parallel import LocalCalls
from psmpc_cli.studies.sampling import grid_sampling
from psmpc_cli.studies.sweep import SweepProgress, load_sweep_task, origins, parse_stages, run_sweep
from psmpc_cli.studies.sweep_file import COMPUTED, FAILED, SHARED, WAITING, Sweep, read_sweep

from .here_calls import HereCalls

COARSE = ("controller.nodes=12", "plant.kind=ideal")


def sweep_of(grid: str = "2x2", every_cell: bool = False, task: str = "approach_capture", stages: str = "1,2") -> Sweep:
    loaded = load_sweep_task(task, COARSE, ())
    return Sweep(loaded, parse_stages(stages, loaded), grid_sampling(grid, (0.1, 10.0)), every_cell)


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Results:
    path = tmp_path_factory.mktemp("sweep") / "shared.h5"
    run_sweep(sweep_of(), path, LocalCalls(2))
    return read_sweep(path)


@pytest.fixture(scope="module")
def computed(tmp_path_factory: pytest.TempPathFactory) -> Results:
    path = tmp_path_factory.mktemp("sweep") / "computed.h5"
    run_sweep(sweep_of(every_cell=True), path, LocalCalls(2))
    return read_sweep(path)


def test_cells_that_share_come_out_as_if_each_had_been_computed(shared: Results, computed: Results) -> None:
    assert np.all(computed["status"] == COMPUTED)
    assert shared["status"].ravel().tolist() == [COMPUTED, COMPUTED, COMPUTED, SHARED]
    assert shared["origin"].ravel().tolist() == [0, 1, 2, 0]
    np.testing.assert_allclose(shared["switch_time"], computed["switch_time"], atol=1e-3)
    np.testing.assert_allclose(shared["instant_at_detection"], computed["instant_at_detection"], atol=1e-3)
    np.testing.assert_allclose(shared["actual_start"], computed["actual_start"], atol=0.1 + 1e-9)
    for name in ("control_effort", "stage_cost", "base_force", "variation_joints"):
        np.testing.assert_allclose(shared[name], computed[name], rtol=1e-3)
    for name in ("solves", "appended", "fallbacks"):
        np.testing.assert_array_equal(shared[name], computed[name])


def test_a_cell_holds_what_its_run_came_to(shared: Results) -> None:
    assert np.all(shared["detection_time"] < shared["instant_at_detection"])
    assert np.all(shared["switch_time"][..., 0] < shared["completion_time"])
    np.testing.assert_array_equal(shared["switch_time"][..., 1], shared["completion_time"])
    assert np.all((shared["final_error"] > 0) & (shared["final_error"] <= 1 + 1e-3))
    assert np.all(np.diff(shared["actual_start"], axis=-1) >= 0), "a higher threshold is reached later"
    np.testing.assert_allclose(shared["solves"] * 0.1, shared["completion_time"], atol=0.1 + 1e-9)


def test_a_higher_ratio_starts_the_second_stage_no_later_and_never_before_it_is_seen(shared: Results) -> None:
    by_ratio = np.argsort(shared["ratio"], axis=None)
    starts = shared["actual_start"].reshape(4, -1)[by_ratio]
    assert np.all(np.diff(starts, axis=0) <= 0.1 + 1e-9)
    assert np.all(starts[-1] < starts[0])
    floor = shared["switch_time"].reshape(4, -1)[by_ratio, :1] - float(shared.attributes["horizon"])
    assert np.all(starts >= floor - 1e-9)


def test_one_more_stage_with_its_own_priority_leaves_nothing_to_share_but_the_beginning() -> None:
    assert len(np.unique(origins(sweep_of("3x3")))) == 5
    assert len(np.unique(origins(sweep_of("3x3", task="transport")))) == 9
    assert len(np.unique(origins(sweep_of("3x3", every_cell=True)))) == 9


def test_a_sweep_that_was_stopped_goes_on_where_it_was(tmp_path: Path, shared: Results) -> None:
    path, sweep, seen = tmp_path / "sweep.h5", sweep_of(), list[SweepProgress]()
    with pytest.raises(KeyboardInterrupt):
        run_sweep(sweep, path, HereCalls(most=1))
    stopped = read_sweep(path)
    assert stopped["status"].ravel().tolist() == [COMPUTED, WAITING, WAITING, SHARED]
    run_sweep(sweep, path, HereCalls(), resume=True, watch=seen.append)
    assert seen[-1].runs == seen[-1].ended == 2
    resumed = read_sweep(path)
    assert float(resumed["wall_time"]) > float(stopped["wall_time"])
    for name, quantity in shared.quantities.items():
        if not name.endswith(("_time_median", "_time_largest", "cell_time", "wall_time")):
            np.testing.assert_array_equal(resumed[name], quantity.values, err_msg=name)


@pytest.mark.parametrize(
    ("other", "named"),
    [
        (sweep_of("3x3"), "sampling 2x2, this one has 3x3"),
        (sweep_of(every_cell=True), "every cell 0, this one has 1"),
        (
            replace(sweep_of(), task=load_sweep_task("approach_capture", ("controller.nodes=9",), ())),
            "controller.nodes ",
        ),
    ],
)
def test_the_file_of_another_sweep_is_not_gone_on_with(shared: Results, other: Sweep, named: str) -> None:
    before = shared.path.read_bytes()
    with pytest.raises(InputError, match="holds another sweep") as error:
        run_sweep(other, shared.path, HereCalls(), resume=True)
    assert named in str(error.value)
    assert shared.path.read_bytes() == before


def test_a_failed_cell_stays_visible_and_ends_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    build = cell_module.build_experiment

    def broken(task: Task) -> object:
        if task.spec.stages[0].priority == 10.0:
            raise ArithmeticError("no such luck")
        return build(task)

    monkeypatch.setattr(cell_module, "build_experiment", broken)
    path = tmp_path / "sweep.h5"
    run_sweep(sweep_of(), path, HereCalls())
    results = read_sweep(path)
    assert results["status"].tolist() == [[COMPUTED, FAILED], [COMPUTED, SHARED]]
    assert results["reason"][0, 1] == "ArithmeticError: no such luck"
    assert np.isnan(results["completion_time"][0, 1])


def test_a_cell_whose_mission_takes_too_long_fails_with_the_reason(tmp_path: Path) -> None:
    task = load_sweep_task("approach_capture", (*COARSE, "time_limit=7"), ())
    path = tmp_path / "sweep.h5"
    run_sweep(Sweep(task, (0, 1), grid_sampling("2", (1.0, 10.0)), False), path, HereCalls())
    results = read_sweep(path)
    assert results["status"].tolist() == [FAILED, FAILED]
    assert results["reason"].tolist() == ["time limit of 7 s reached"] * 2
    assert np.all(results["detection_time"] > 0)


@pytest.mark.parametrize("text", ["1", "1,3", "2,1", "2,3", "approach,transport", "0,1", "1,2,3", "a,b", ""])
def test_two_stages_that_are_none_are_refused_with_the_choices(text: str) -> None:
    task = load_sweep_task("approach_capture", COARSE, ())
    with pytest.raises(InputError, match="1 approach, 2 capture"):
        parse_stages(text, task)


def test_stages_go_by_number_or_name() -> None:
    task = load_sweep_task("transport", (), ())
    assert parse_stages("2,3", task) == parse_stages("capture, transport", task) == (1, 2)


@pytest.mark.parametrize("kind", ["smpc", "hard", "htmpc"])
def test_a_controller_without_priorities_is_refused(kind: str) -> None:
    task = load_sweep_task("approach_capture", (f"controller.kind={kind}",), ())
    with pytest.raises(InputError, match="knows no priorities"):
        parse_stages("1,2", task)


def test_with_a_small_pending_cost_every_window_is_solved_from_several_guesses(tmp_path: Path) -> None:
    task = load_sweep_task("approach_capture", (*COARSE, "controller.pending_cost=0.1"), ())
    assert task.spec.controller.multistart == 3
    assert load_sweep_task("approach_capture", COARSE, ()).spec.controller.multistart == 1
    asked = load_sweep_task("approach_capture", (*COARSE, "controller.pending_cost=0.1", "controller.multistart=2"), ())
    assert asked.spec.controller.multistart == 2
    path = tmp_path / "sweep.h5"
    run_sweep(Sweep(task, (0, 1), grid_sampling("2", (1.0, 10.0)), False), path, LocalCalls(2))
    results = read_sweep(path)
    assert np.all(results["status"] == COMPUTED)
    assert np.all(results["basin_changes"] >= 0)
    assert np.any(results["basin_changes"] > 0), "a high ratio makes the last plan's basin the lesser one"
