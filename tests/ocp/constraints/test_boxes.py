"""Limits of single numbers at the nodes."""

from dataclasses import replace

import numpy as np
import pytest

from psmpc_cli.ocp.constraints.boxes import initial_violations, node_limits, shares_of_time
from psmpc_cli.ocp.plan import Grid, mesh
from psmpc_cli.ocp.stage import Stage


def test_at_a_switch_the_limits_of_both_stages_hold(stages: tuple[Stage, ...]) -> None:
    narrow = replace(stages[1].limits, velocity_high=stages[1].limits.velocity_high / 2)
    _, high = node_limits(Grid(9, (4, 4)), (stages[0], replace(stages[1], limits=narrow)))
    np.testing.assert_array_equal(high[:4, 9:], np.tile(stages[0].limits.velocity_high, (4, 1)))
    np.testing.assert_array_equal(high[4:, 9:], np.tile(narrow.velocity_high, (5, 1)))


def test_nodes_share_the_time_of_the_intervals_beside_them() -> None:
    times = mesh(np.array([0.0, 1.5, 4.0]), (2, 5))
    values = np.random.default_rng(0).standard_normal(8)
    assert shares_of_time(np.diff(times)[:, None])[:, 0] @ values == pytest.approx(np.trapezoid(values, times))


def test_a_measured_state_violates_the_limits_of_the_current_stage(stages: tuple[Stage, ...]) -> None:
    x0 = np.zeros(18)
    x0[9] = 0.3
    assert initial_violations(x0, stages) == pytest.approx(np.where(np.arange(18) == 9, 0.1, 0.0))
