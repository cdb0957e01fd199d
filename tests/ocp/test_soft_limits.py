from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from psmpc_cli.ocp.transcription import Nlp, transcribe

from psmpc_cli.ocp.plan import mesh, resting_plan
from psmpc_cli.ocp.problem import Stage, StageCosts
from psmpc_cli.ocp.window import (
    PENALTY,
    Window,
    bounds,
    node_limits,
    own_violations,
    pack_guess,
    parameter_vector,
    shares_of_time,
    window_shape,
    worst_violations,
)
from psmpc_cli.robot.model import RobotModel

from .test_transcription import INSTANTS, N, window_over


@pytest.fixture(scope="module")
def hard(model: RobotModel, stages: tuple[Stage, ...]) -> Nlp:
    return transcribe(model, window_shape(stages[:2], (N, N), "exact"))


@pytest.fixture(scope="module")
def soft(model: RobotModel, stages: tuple[Stage, ...]) -> Nlp:
    return transcribe(model, window_shape(stages[:2], (N, N), "exact", soft=True))


@pytest.fixture
def window(stages: tuple[Stage, ...]) -> Window:
    """One that begins beyond the limit of a velocity, and coasts there."""
    window: Window = window_over(stages[:2])
    x0 = window.x0.copy()
    x0[9] = 0.3
    return replace(window, x0=x0)


def guess(nlp: Nlp, window: Window, costs: StageCosts) -> np.ndarray:
    return pack_guess(nlp, window, resting_plan(window.start, window.horizon, N, window.x0), INSTANTS, costs)


def values(nlp: Nlp, z: np.ndarray, p: np.ndarray) -> tuple[float, np.ndarray]:
    f, g = ca.Function("nlp", [nlp.x, nlp.p], [nlp.f, nlp.g])(z, p)
    return float(f), np.asarray(g).ravel()


def test_at_a_switch_the_limits_of_both_stages_hold(soft: Nlp, stages: tuple[Stage, ...]) -> None:
    narrow = replace(stages[1].limits, velocity_high=stages[1].limits.velocity_high / 2)
    _, high = node_limits(soft.layout, (stages[0], replace(stages[1], limits=narrow)))
    wide = stages[0].limits.velocity_high
    assert np.array_equal(high[:N, 9:], np.tile(wide, (N, 1)))
    assert np.array_equal(high[N:, 9:], np.tile(wide / 2, (N + 1, 1)))


def test_nodes_share_the_time_of_the_intervals_beside_them() -> None:
    tau = np.array([1.5, 2.5])
    times = mesh(tau, (2, 5))
    values = np.random.default_rng(0).standard_normal(8)
    shares = shares_of_time(np.diff(times)[:, None])
    assert shares[:, 0] @ values == pytest.approx(np.trapezoid(values, times))


def test_violations_cost_their_integral_over_time(hard: Nlp, soft: Nlp, window: Window, costs: StageCosts) -> None:
    p = parameter_vector(soft, window, INSTANTS)
    with_it, _ = values(soft, guess(soft, window, costs), p)
    without, _ = values(hard, guess(hard, window, costs), p)
    assert with_it - without == pytest.approx(PENALTY * 0.1 * window.horizon)


def test_a_guess_that_violates_soft_limits_meets_the_bounds_of_its_nlp(
    soft: Nlp, window: Window, costs: StageCosts
) -> None:
    z, limits = guess(soft, window, costs), bounds(soft, window)
    _, g = values(soft, z, parameter_vector(soft, window, INSTANTS))
    rows = soft.limit_rows
    assert ((z >= limits.lbx) & (z <= limits.ubx)).all()
    assert (g[rows] >= limits.lbg[rows] - 1e-12).all()
    assert (g[rows] <= limits.ubg[rows] + 1e-12).all()
    worst = np.where(np.arange(18) == 9, 0.1, 0.0)
    assert worst_violations(soft.layout, z) == pytest.approx(worst)
    assert own_violations(window.x0, window.stages) == pytest.approx(worst)


def test_the_stage_structure_holds_every_variable_and_row(soft: Nlp) -> None:
    assert sum(soft.nx) + sum(soft.nu) == soft.x.shape[0] == soft.layout.size
    assert sum(soft.nx[1:]) + sum(soft.ng) == soft.g.shape[0] == len(soft.equality)
    assert not np.array(soft.equality)[soft.limit_rows].any()
