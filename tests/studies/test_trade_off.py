import numpy as np
import pytest

from psmpc_cli.logs.run import Run, read_run
from psmpc_cli.simulation.setup import build_experiment
from psmpc_cli.studies.one_window import window_at
from psmpc_cli.studies.pareto import Scalarization, TradeOff, constrained, weighted_sum

from .there_and_back_run import run_there_and_back

RATIOS = (0.03, 0.3, 1.0, 3.0, 30.0)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return read_run(run_there_and_back(tmp_path_factory.mktemp("run"), "stages[1].priority=3"))


@pytest.fixture(scope="module")
def sample(log: Run) -> int:
    """One in the middle of those with the switch in the window."""
    with_switch = np.flatnonzero((log["window/count"] == 2) & (log["window/first"] == 0))
    return int(with_switch[len(with_switch) // 2])


@pytest.fixture(scope="module")
def trade_off(log: Run, sample: int) -> TradeOff:
    return TradeOff(window_at(log, build_experiment(log.task), sample))


@pytest.fixture(scope="module")
def wait(trade_off: TradeOff) -> float:
    return float(trade_off.one.plan.instants[0]) - trade_off.one.window.start


def test_the_run_s_own_weights_lead_to_the_run_s_optimum(
    trade_off: TradeOff, log: Run, sample: int, wait: float
) -> None:
    costs = trade_off.costs_of(trade_off.one.plan)
    np.testing.assert_allclose(costs, log["window/cost"][sample, :2], rtol=1e-6)
    for held in (wait, None):
        point = trade_off.solve(weighted_sum(3.0), trade_off.one.plan, held)
        np.testing.assert_allclose(point.J, costs, rtol=1e-3)
        assert point.wait == pytest.approx(wait, abs=1e-4)
        assert point.objective * 3.0 == pytest.approx(log["solver/objective"][sample], rel=1e-5)


def test_only_the_ratio_of_the_weights_counts() -> None:
    assert weighted_sum(100.0) == Scalarization((0.01, 1.0))
    assert weighted_sum(0.01) == Scalarization((1.0, 0.01))


def test_more_weight_on_the_second_stage_makes_it_cheaper_and_the_first_dearer(
    trade_off: TradeOff, wait: float
) -> None:
    J = np.array([trade_off.solve(weighted_sum(ratio), trade_off.one.plan, wait).J for ratio in RATIOS])
    assert np.all(np.diff(J[:, 0]) > 0)
    assert np.all(np.diff(J[:, 1]) < 0)


@pytest.mark.parametrize("ratio", RATIOS[1:-1])
def test_a_bound_where_a_weighted_sum_ends_leads_to_the_same_point(
    trade_off: TradeOff, wait: float, ratio: float
) -> None:
    """On a convex front both methods find the same points, and the multiplier of the bound is the ratio."""
    summed = trade_off.solve(weighted_sum(ratio), trade_off.one.plan, wait)
    bounded = trade_off.solve(constrained(float(summed.J[1])), trade_off.one.plan, wait)
    np.testing.assert_allclose(bounded.J, summed.J, rtol=1e-5)
    assert bounded.ratio == pytest.approx(ratio, rel=1e-2)


def test_a_bound_no_plan_keeps_to_gives_no_point(trade_off: TradeOff, wait: float) -> None:
    point = trade_off.solve(constrained(1e-9), trade_off.one.plan, wait)
    assert not point.outcome.usable
    assert np.isnan(point.J).all()
    assert trade_off.value(weighted_sum(1.0), point) == np.inf


def test_a_held_instant_stays_and_a_free_one_is_the_cheapest(trade_off: TradeOff, wait: float) -> None:
    later = trade_off.solve(weighted_sum(3.0), trade_off.one.plan, wait + 0.1)
    assert later.wait == pytest.approx(wait + 0.1, abs=1e-12)
    free = trade_off.solve(weighted_sum(3.0), later, None)
    assert free.objective <= later.objective
    assert free.wait == pytest.approx(wait, abs=1e-3)


def test_a_point_serves_other_problems_if_it_keeps_to_their_bound(trade_off: TradeOff, wait: float) -> None:
    point = trade_off.solve(weighted_sum(1.0), trade_off.one.plan, wait)
    own = trade_off.value(weighted_sum(1.0), point)
    assert own == pytest.approx(point.objective, rel=1e-9)
    assert trade_off.value(constrained(float(point.J[1])), point) < own
    assert trade_off.value(constrained(0.9 * float(point.J[1])), point) == np.inf
