from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from psmpc_cli.errors import LogError
from psmpc_cli.figures.registry import draw
from psmpc_cli.logs.run import Run, read_run
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.simulation.run import simulate
from psmpc_cli.specs.load import Task, load_task
from psmpc_cli.studies.ablations import (
    CHANGES,
    GUESSES,
    PROMINENT,
    Ablation,
    ahead,
    ending,
    meshes,
    minima,
    run_ablations,
    variation,
)
from psmpc_cli.studies.one_window import (
    CLOSE,
    OneWindow,
    Scan,
    instant_grid,
    led_to,
    on_mesh,
    optimize_instants,
    pick_window,
    scan_instants,
    with_priorities,
)

NODES = 8
SMALL = (
    f"controller={{kind: psmpc, horizon: 1.6, nodes: {NODES}}}",
    "plant={kind: ideal, low_level_rate: 100}",
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
def one(log: Run) -> OneWindow:
    return pick_window(log)


@pytest.fixture(scope="module")
def told() -> list[str]:
    return []


@pytest.fixture(scope="module")
def ablations(small: Task, told: list[str]) -> Mapping[str, Ablation]:
    found = run_ablations(small, jobs=1, done=told.append, points=8)
    return {ablation.name: ablation for ablation in found}


@pytest.mark.slow
def test_each_departure_is_taken_back(ablations: Mapping[str, Ablation], told: list[str]) -> None:
    assert list(ablations) == ["pending_cost", "normalization", "discretization"]
    runs = {*CHANGES, *(f"{kind}, {count} nodes" for kind in ("exact", "euler") for count in meshes(NODES))}
    assert set(told) == runs - {f"exact, {NODES} nodes"}


@pytest.mark.slow
def test_a_sentence_is_one_and_has_the_numbers_measured(ablations: Mapping[str, Ablation]) -> None:
    for ablation in ablations.values():
        assert ablation.sentence.endswith(".")
        assert ". " not in ablation.sentence
    ends = [ablations["normalization"].numbers[f"end, {name}"] for name in ("ours", "none", "range")]
    assert all(ending(end) in ablations["normalization"].sentence for end in ends)


@pytest.mark.slow
def test_what_is_measured_can_be_drawn(ablations: Mapping[str, Ablation], tmp_path: Path) -> None:
    for name, ablation in ablations.items():
        (path,) = draw("ablations", ablation.panels, tmp_path, only=[f"ablation_{name}"])
        assert path.stat().st_size > 10_000


@pytest.mark.slow
def test_the_runs_differ_from_ours_where_they_are_changed(ablations: Mapping[str, Ablation]) -> None:
    """As printed the instant lies at the end of the horizon, with the pending cost it does not."""
    numbers = ablations["pending_cost"].numbers
    assert numbers["at T_f, printed"] > numbers["at T_f, ours"]
    assert numbers["end, printed"] > numbers["end, ours"]


def test_the_window_is_the_run_s(log: Run, one: OneWindow) -> None:
    sample = int(np.argmin(np.abs(log.time - one.window.start)))
    assert log["window/count"][sample] == 2
    np.testing.assert_allclose(one.window.x0, np.r_[log["state/Q"][sample], log["state/Qdot"][sample]])
    np.testing.assert_allclose(one.window.scale, log["normalization/nadir"][sample])
    assert one.plan.instants == pytest.approx(log["window/instants"][sample, :1])


@pytest.mark.slow
def test_the_windows_are_of_runs_with_other_priorities(ablations: Mapping[str, Ablation], one: OneWindow) -> None:
    assert one.label == "1 : 10"
    for objective in ("printed", "ours"):
        assert list(ablations["pending_cost"].panels[f"J, {objective}"]) == ["1 : 1", "1 : 10", "1 : 1 from 1 : 10"]


def test_other_priorities_are_normalized_by_their_own_optimum(one: OneWindow) -> None:
    other = with_priorities(one, (1.0, 1e-3))
    np.testing.assert_array_equal(other.window.omega, [1.0, 1e-3])
    assert not np.array_equal(other.window.scale, one.window.scale)
    at_rest = np.zeros((1, one.experiment.model.n))
    for stage, scale in zip(other.window.stages, other.window.scale, strict=True):
        assert scale >= one.experiment.costs.at(stage, one.window.x0[None], at_rest)[0]


def test_a_run_of_one_stage_has_no_window_to_look_at(tmp_path: Path) -> None:
    one_stage = "stages=[{name: go, skill: move, target: {base: [0, 0, 0], arms: [0.02, 0, 0]}, ends_when: " + (
        "{coordinates: all}}]"
    )
    simulate(load_task("transport", [*SMALL, one_stage]), tmp_path / "run.h5")
    with pytest.raises(LogError, match="no window with one switch"):
        pick_window(read_run(tmp_path / "run.h5"))


def test_j_at_the_optimal_instant_is_the_optimum(one: OneWindow, log: Run) -> None:
    instant = one.plan.instants - one.window.start
    scan = scan_instants(one, instant)
    sample = int(np.argmin(np.abs(log.time - one.window.start)))
    largest = max(log.stages["priority"])
    J = np.interp(instant, scan.instants, scan.with_pending(one.window.pending_cost))
    np.testing.assert_allclose(J * largest, log["solver/objective"][sample], rtol=1e-6)


def test_the_scan_ends_at_the_earliest_feasible_instant(one: OneWindow) -> None:
    scan = scan_instants(one, instant_grid(one.window.horizon, 8))
    target = one.window.stages[0]
    away = np.abs(one.experiment.costs.errors(target, one.window.x0[None])[0, list(target.end_rows)]) - target.tolerance
    least = float(np.max(away / target.limits.velocity_high[list(target.end_rows)]))
    assert least <= scan.instants[0] <= least + CLOSE + 0.02
    assert np.all(np.diff(scan.instants) > 0)
    assert np.all(np.isfinite(scan.cost))


def test_with_the_pending_cost_every_guess_leads_to_the_scan_s_minimum(one: OneWindow) -> None:
    scan = scan_instants(one, instant_grid(one.window.horizon, 8))
    found = optimize_instants(one, 1.0, [part * one.window.horizon for part in GUESSES])
    assert np.ptp(found) < 1e-3
    best = scan.instants[np.argmin(scan.with_pending(1.0))]
    assert found[0] == pytest.approx(best, abs=0.05)


def test_eulers_error_is_of_first_order_and_the_exact_one_has_none(one: OneWindow) -> None:
    errors = {kind: [on_mesh(one, nodes, kind)[0] for nodes in (20, 40)] for kind in ("euler", "exact")}
    assert errors["euler"][0] / errors["euler"][1] == pytest.approx(2, rel=0.2)
    assert max(errors["exact"]) < 1e-9


def test_where_the_exact_plan_leads_meets_the_condition(one: OneWindow) -> None:
    assert on_mesh(one, 20, "exact")[1] <= 1 + 1e-4
    assert on_mesh(one, 20, "euler")[1] > 1.2


@given(st.lists(st.floats(0.01, 0.5), min_size=1, max_size=6), st.randoms(use_true_random=False))
def test_a_plan_s_control_leads_where_the_double_integrator_goes(steps, random) -> None:
    u = np.array([[random.uniform(-1, 1) for _ in range(2)] for _ in steps])
    x = np.array([random.uniform(-1, 1) for _ in range(4)])
    expected = [x]
    for dt, a in zip(steps, u, strict=True):
        Q, Qdot = expected[-1][:2], expected[-1][2:]
        expected.append(np.r_[Q + dt * Qdot + dt**2 / 2 * a, Qdot + dt * a])
    X = np.vstack([x, np.zeros((len(u), 4))])
    plan = Plan(np.r_[0.0, np.cumsum(steps)], X, u, np.zeros(0))
    np.testing.assert_allclose(led_to(plan), expected, atol=1e-12)


def curve(cost: list[float]) -> Scan:
    return Scan(np.arange(float(len(cost))), np.array(cost))


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
    assert minima(curve(cost)) == found


def test_ahead_falls_with_time_and_is_unknown_without_a_switch(log: Run) -> None:
    _, to_go = ahead(log)
    np.testing.assert_array_equal(np.isnan(to_go), log["window/count"] < 2)
    known = np.isfinite(to_go)
    assert np.all(np.diff(to_go[known]) < 0)
    assert np.all(to_go[known] <= log.attributes["horizon"])


def test_variation_is_the_joints_alone_and_never_falls(log: Run) -> None:
    time, total = variation(log)
    assert len(time) == len(total)
    assert np.all(np.diff(total) >= 0)
    joints = [i for i, name in enumerate(log.coordinates) if name.startswith("arm_")]
    assert total[-1] == pytest.approx(np.abs(np.diff(log["control/u"][:, joints], axis=0)).sum())


def test_meshes_are_parts_of_the_task_s() -> None:
    assert meshes(100) == [10, 20, 50, 100]
    assert meshes(4) == [2, 4]
