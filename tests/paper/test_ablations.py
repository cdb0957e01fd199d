from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from psmpc_cli.errors import LogError
from psmpc_cli.logs.run import Run, read_run
from psmpc_cli.paper.ablations import (
    CHANGES,
    CLOSE,
    PROMINENT,
    Ablation,
    SwitchWindow,
    errors_on_mesh,
    pick_window,
    run_ablations,
    scan_switch_times,
    switch_time_grid,
    switch_times_from_guesses,
    switch_times_of_minima,
)
from psmpc_cli.paper.figures import save_ablation
from psmpc_cli.simulation.run import simulate
from psmpc_cli.specs.load import Task, load_task

NODES = 8
SMALL = (
    f"controller={{kind: psmpc, horizon: 1.6, nodes: {NODES}}}",
    "plant={kind: ideal, low_level_rate: 100}",
    "skills.move.weights.control=0.03",
    "stages=[{name: go, skill: move, target: {base: [-0.12, 0.06, 0], arms: [0, 0, 0]}, "
    "ends_when: {coordinates: base}}, {name: reach, skill: move, priority: 10, target: {base: [-0.12, 0.06, 0], "
    "arms: [0.06, 0.04, 0]}, ends_when: {coordinates: all, tolerance: 0.01}, onset: arms}]",
    "object=null",
    "monitors=[]",
    "published={}",
    "time_limit=4",
)


@pytest.fixture(scope="module")
def small() -> Task:
    """Two stages that take less than 2 s."""
    return load_task("transport", SMALL)


@pytest.fixture(scope="module")
def log(small: Task, tmp_path_factory: pytest.TempPathFactory) -> Run:
    path = tmp_path_factory.mktemp("one") / "run.h5"
    simulate(small, path)
    return read_run(path)


@pytest.fixture(scope="module")
def one(log: Run) -> SwitchWindow:
    return pick_window(log)


@pytest.fixture(scope="module")
def told() -> list[str]:
    return []


@pytest.fixture(scope="module")
def ablations(small: Task, told: list[str]) -> Mapping[str, Ablation]:
    found = run_ablations(small, jobs=1, watch=lambda progress: told.append(progress.last), points=5)
    return {ablation.name: ablation for ablation in found}


@pytest.mark.slow
def test_each_departure_is_taken_back_measured_and_drawn(
    ablations: Mapping[str, Ablation], told: list[str], tmp_path: Path
) -> None:
    assert list(ablations) == ["pending_cost", "normalization", "discretization"]
    runs = {*CHANGES, *(f"{kind}, {count} nodes" for kind in ("exact", "euler") for count in (2, 4, NODES))}
    assert set(told) - {""} == runs - {f"exact, {NODES} nodes"}
    for ablation in ablations.values():
        path = save_ablation(ablation, tmp_path)
        assert path.stat().st_size > 10_000
    for objective in ("printed", "ours"):
        assert list(ablations["pending_cost"].panels[f"J, {objective}"]) == ["1 : 1", "1 : 10", "1 : 1 from 1 : 10"]


@pytest.mark.slow
def test_as_printed_the_instant_lies_at_the_end_of_the_horizon(ablations: Mapping[str, Ablation]) -> None:
    numbers = ablations["pending_cost"].numbers
    assert numbers["planned t_s at T_f, printed"] > numbers["planned t_s at T_f, ours"]
    assert numbers["end [s], printed"] > numbers["end [s], ours"]


def test_a_run_of_one_stage_has_no_window_to_look_at(tmp_path: Path) -> None:
    one_stage = "stages=[{name: go, skill: move, target: {base: [0, 0, 0], arms: [0.02, 0, 0]}, ends_when: " + (
        "{coordinates: all}}]"
    )
    simulate(load_task("transport", [*SMALL, one_stage]), tmp_path / "run.h5")
    with pytest.raises(LogError, match="no window with one switch"):
        pick_window(read_run(tmp_path / "run.h5"))


def test_j_at_the_optimal_instant_is_the_optimum(one: SwitchWindow, log: Run) -> None:
    instant = one.plan.switch_times - one.window.start
    switch_times, cost = scan_switch_times(one, instant)
    sample = int(np.argmin(np.abs(log.time - one.window.start)))
    largest = max(log.stages["priority"])
    J = np.interp(instant, switch_times, cost + one.window.pending_cost * switch_times)
    np.testing.assert_allclose(J * largest, log["solver/objective"][sample], rtol=1e-6)


def test_the_scan_ends_at_the_earliest_feasible_instant(one: SwitchWindow) -> None:
    switch_times, cost = scan_switch_times(one, switch_time_grid(one.window.horizon, 8))
    target = one.window.stages[0]
    away = (
        np.abs(one.problem.costs.errors(target, one.window.x0[None])[0, list(target.end.rows)]) - target.end.tolerance
    )
    least = float(np.max(away / target.limits.velocity_high[list(target.end.rows)]))
    assert least <= switch_times[0] <= least + CLOSE + 0.02
    assert np.all(np.diff(switch_times) > 0)
    assert np.all(np.isfinite(cost))


def test_with_the_pending_cost_every_guess_leads_to_the_scan_s_minimum(one: SwitchWindow) -> None:
    switch_times, cost = scan_switch_times(one, switch_time_grid(one.window.horizon, 8))
    found = switch_times_from_guesses(one, 1.0)
    assert np.ptp(found) < 1e-3
    best = switch_times[np.argmin(cost + switch_times)]
    assert found[0] == pytest.approx(best, abs=0.05)


def test_eulers_error_is_of_first_order_and_the_exact_one_has_none(one: SwitchWindow) -> None:
    (coarse, missed), (fine, _) = (errors_on_mesh(one, nodes, "euler") for nodes in (20, 40))
    assert coarse / fine == pytest.approx(2, rel=0.2)
    assert missed > 1.2
    error, met = errors_on_mesh(one, 20, "exact")
    assert error < 1e-9
    assert met <= 1 + 1e-4


@pytest.mark.parametrize(
    ("cost", "found"),
    [
        ([1.0, 2.0, 3.0], [0.0]),
        ([3.0, 2.0, 1.0], [2.0]),
        ([0.5, 0.6, 0.7, 0.2], [3.0, 0.0]),
        ([2.0, 1.0, 2.0, 0.0, 2.0], [3.0, 1.0]),
        ([1.0, 1.0 - 0.3 * PROMINENT, 1.0, 0.0], [3.0]),
        ([1.0, 0.5, 0.5, 1.0], [1.0]),
    ],
)
def test_minima_are_found_the_lowest_first_and_shallow_ones_left_out(cost: list[float], found: list[float]) -> None:
    assert switch_times_of_minima(np.arange(len(cost)), np.array(cost)).tolist() == found
