"""Pareto studies of a small run: the trade-offs of one window, and the file of several."""

from pathlib import Path

import numpy as np
import pytest

from psmpc_cli.errors import InputError, LogError
from psmpc_cli.logs.results import Results
from psmpc_cli.logs.run import Run, read_run
from psmpc_cli.ocp.problem import build_problem
from psmpc_cli.simulation.replay import logged_solve
from psmpc_cli.simulation.run import converging, simulate
from psmpc_cli.solvers import Solution
from psmpc_cli.specs.load import load_task
from psmpc_cli.studies.fronts import STATUS, dominated, extents, front_points
from psmpc_cli.studies.pareto import (
    ParetoSettings,
    TradeOff,
    choose_samples,
    epsilon_constraint,
    objective_values,
    point_costs,
    solve_pareto,
    weighted_sum,
)

from ..short_runs import TASK

pytestmark = pytest.mark.slow

POINTS = 6


def run_there_and_back(directory: Path, *changes: str) -> Path:
    """Run the task and return its log."""
    (directory / "task.yaml").write_text(TASK)
    loaded = load_task(directory / "task.yaml", ["log.plans=true", "log.shares=false", *changes])
    simulate(loaded, directory / "run.h5")
    return directory / "run.h5"


def settings(**changes: object) -> ParetoSettings:
    asked: dict[str, object] = {"stages": "1,2", "at": (), "points": POINTS, "method": "both", "free": False}
    return ParetoSettings(**(asked | changes))


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return run_there_and_back(tmp_path_factory.mktemp("run"), "stages[1].priority=3")


@pytest.fixture(scope="module")
def log(run: Path) -> Run:
    return read_run(run)


@pytest.fixture(scope="module")
def studied(log: Run, tmp_path_factory: pytest.TempPathFactory) -> Results:
    path = tmp_path_factory.mktemp("held") / "pareto.h5"
    return solve_pareto(log, settings(at=(0.2, 0.5)), path, 1)


@pytest.fixture(scope="module")
def in_space(log: Run, tmp_path_factory: pytest.TempPathFactory) -> Results:
    path = tmp_path_factory.mktemp("free") / "pareto.h5"
    return solve_pareto(log, settings(at=(0.3,), method="weighted-sum", free=True), path, 1)


def test_every_point_is_solved_for(studied: Results, in_space: Results) -> None:
    for results, names in ((studied, ("weighted", "constrained")), (in_space, ("weighted", "free"))):
        for name in names:
            assert np.all(results[f"{name}_status"] == STATUS.index("optimal"))
            assert np.isfinite(results[f"{name}_J_1"]).all()


def test_the_chosen_point_is_the_run_s(studied: Results, log: Run) -> None:
    for i, instant in enumerate(studied["instant"]):
        sample = int(np.argmin(np.abs(log.time - instant)))
        chosen = [studied["chosen_J_1"][i], studied["chosen_J_2"][i]]
        np.testing.assert_allclose(chosen, log["window/cost"][sample, :2], rtol=1e-6)
        assert studied["t_s"][i] == pytest.approx(log["window/instants"][sample, 0])
        np.testing.assert_allclose(studied["scale"][i], log["normalization/nadir"][sample, :2])


def test_the_front_falls_and_the_run_s_point_lies_on_it(studied: Results) -> None:
    for i, J in enumerate(front_points(studied, "weighted")[0][:, 0]):
        least = 1e-6 * extents(J)
        assert np.all(np.diff(J[:, 0]) >= -least[0])
        assert np.all(np.diff(J[:, 1]) <= least[1])
        chosen = np.array([[studied["chosen_J_1"][i], studied["chosen_J_2"][i]]])
        assert not dominated(np.vstack([J, chosen]))[-1]


def test_no_point_of_a_front_costs_less_with_the_run_s_weights_than_the_run_s_point(studied: Results) -> None:
    """Each solve ends about 1e-6 above its optimum, relative to the objective."""
    for i, ratio in enumerate(studied["chosen_ratio"]):
        chosen = studied["chosen_J_1"][i] + ratio * studied["chosen_J_2"][i]
        front = studied["weighted_J_1"][i] + ratio * studied["weighted_J_2"][i]
        assert ratio == pytest.approx(3.0)
        assert front.min() >= chosen * (1 - 1e-5)
        assert front.min() == front[np.argmin(np.abs(np.log(np.geomspace(1e-3, 1e3, POINTS) / ratio)))]


def test_both_methods_agree_on_a_convex_front(studied: Results) -> None:
    assert not studied["weighted_dominated"].any()
    assert not studied["constrained_dominated"].any()


def test_bounds_are_kept_to_and_reach_from_one_end_of_the_front_to_the_other(studied: Results) -> None:
    limit, second = studied["constrained_limit"], studied["constrained_J_2"]
    assert np.all(second <= limit * (1 + 1e-6))
    np.testing.assert_allclose(limit[:, [0, -1]], studied["weighted_J_2"][:, [0, -1]])


def test_a_third_criterion_has_its_own_fronts(in_space: Results) -> None:
    waits = in_space["weighted_wait"][0]
    assert np.all(np.ptp(waits, axis=1) < 1e-9)
    assert np.all(np.diff(waits[:, 0]) > 0)
    assert waits[0, 0] == pytest.approx(in_space["t_s"][0] - in_space["instant"][0])
    assert len(in_space["reference"]) == 3
    assert not in_space["free_dominated"].any()


def test_bounds_alone_need_two_weighted_sums_only(log: Run, tmp_path: Path) -> None:
    path = tmp_path / "pareto.h5"
    results = solve_pareto(log, settings(at=(0.5,), method="epsilon-constraint"), path, 1)
    assert "weighted_J_1" not in results.quantities
    assert results["constrained_J_1"].shape == (1, POINTS)


def test_samples_are_those_whose_window_holds_both_stages_alone(log: Run) -> None:
    samples = choose_samples(log, (0, 1), ())
    assert len(samples) == 5
    assert np.all(log["window/count"][samples] == 2)
    assert np.all(log["window/first"][samples] == 0)
    possible = np.flatnonzero((log["window/count"] == 2) & (log["window/first"] == 0))
    assert samples[0] == possible[0] and samples[-1] == possible[-1]


def test_times_without_such_a_window_are_refused(log: Run) -> None:
    with pytest.raises(InputError, match=r"--at: found 1\.5, .* go and back alone; expected times from 0\.1 to 0\.6"):
        choose_samples(log, (0, 1), (0.3, 1.5))


def test_a_run_without_such_a_window_is_refused(tmp_path: Path) -> None:
    log = read_run(run_there_and_back(tmp_path, "controller.kind=hard"))
    with pytest.raises(InputError, match="found no sample whose window holds go and back alone"):
        choose_samples(log, (0, 1), ())


def test_a_log_without_plans_is_refused(tmp_path: Path) -> None:
    run = read_run(run_there_and_back(tmp_path, "log.plans=false"))
    with pytest.raises(LogError, match="holds no plans"):
        solve_pareto(run, settings(), tmp_path / "pareto.h5", 1)


RATIOS = (0.03, 0.3, 1.0, 3.0, 30.0)


@pytest.fixture(scope="module")
def solve(log: Run) -> Solution:
    """One in the middle of those with the switch in the window; its omega_2 / omega_1 is 3."""
    with_switch = np.flatnonzero((log["window/count"] == 2) & (log["window/first"] == 0))
    return logged_solve(log, int(with_switch[len(with_switch) // 2]))


@pytest.fixture(scope="module")
def trade_off(log: Run) -> TradeOff:
    return TradeOff(build_problem(converging(log.task)))


@pytest.fixture(scope="module")
def wait(solve: Solution) -> float:
    return float(solve.plan.switch_times[0]) - solve.window.start


def wait_of(point: Solution) -> float:
    return float(point.plan.switch_times[0]) - point.window.start


def test_the_run_s_own_weights_lead_to_the_run_s_optimum(trade_off: TradeOff, solve: Solution, wait: float) -> None:
    costs = trade_off.solver.costs(solve.window, solve.plan)
    for held in (wait, None):
        point = trade_off.solve(weighted_sum(solve.window, 3.0), solve, held)
        np.testing.assert_allclose(point_costs([point])[0], costs, rtol=1e-3)
        assert wait_of(point) == pytest.approx(wait, abs=1e-4)
        assert point.objective == pytest.approx(solve.objective, rel=1e-5)


@pytest.mark.parametrize("ratio", RATIOS[1:-1])
def test_a_bound_where_a_weighted_sum_ends_leads_to_the_same_point(
    trade_off: TradeOff, solve: Solution, wait: float, ratio: float
) -> None:
    """On a convex front both methods find the same points, and the multiplier of the bound is the ratio."""
    summed = trade_off.solve(weighted_sum(solve.window, ratio), solve, wait)
    J = point_costs([summed])
    bounded = trade_off.solve(epsilon_constraint(solve.window, float(J[0, 1])), solve, wait)
    np.testing.assert_allclose(point_costs([bounded]), J, rtol=1e-5)
    assert bounded.bound_multiplier == pytest.approx(ratio, rel=1e-2)


def test_a_bound_no_plan_keeps_to_gives_no_point(trade_off: TradeOff, solve: Solution, wait: float) -> None:
    point = trade_off.solve(epsilon_constraint(solve.window, 1e-9), solve, wait)
    assert not point.outcome.usable
    assert np.isnan(point_costs([point])).all()
    assert objective_values(weighted_sum(solve.window, 1.0), [point]) == np.inf
