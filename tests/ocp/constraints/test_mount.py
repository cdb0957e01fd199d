"""Windows in which a mount takes hold of the base, or lets it go."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from psmpc_cli.ocp.problem import Problem, build_problem
from psmpc_cli.solvers import Outcome
from psmpc_cli.specs.robots.robot import stack

from .floating_windows import planar_task, solved, spatial_task, window_of

AT_REST = {"coordinates": ["base"], "tolerance": 0.02, "velocity": 5e-3}


def mounted(held: str, robot: Path | None) -> Problem:
    """The problem of a robot, in the plane or in space, whose base a mount holds in one of two stages."""
    pose: object = [0.05, -0.05, 0.1] if robot else {"position": [0.05, 0, -0.05]}
    weights = [100, 100, 10] if robot else [100, 100, 100, 10, 10, 10]
    other = "home" if held == "reach" else "reach"
    changes: dict[str, Any] = {
        "mobility": "free-flying",
        f"stages.{held}.mobility": "fixed",
        f"skills.{other}.weights.base": weights,
        f"stages.{other}.target.base": pose,
    }
    if held == "home":
        changes["stages.reach.ends_when"] = AT_REST
    if robot is None:
        return build_problem(spatial_task({**changes, "controller.horizon": 6}))
    return build_problem(planar_task(robot, changes))


@pytest.mark.parametrize("held", ["reach", "home"])
@pytest.mark.parametrize("where", ["plane", "space"])
def test_sqp_and_ipopt_agree_and_the_base_stands_still_while_it_is_held(fast_arms: Path, where: str, held: str) -> None:
    """J to 1e-5, both from the plan of `sqp`; the base comes to rest, or starts from it, at the switch."""
    problem = mounted(held, fast_arms if where == "plane" else None)
    model = problem.model
    Q = stack(problem.spec.initial, model.spec, "joint")
    v = np.zeros(model.n)
    if held == "home":
        v[model.space.base] = 0.02
    window = window_of(problem, Q, v)
    first = solved(problem, window, "sqp")
    own = solved(problem, window, "sqp", first.plan)
    other = solved(problem, window, "ipopt", first.plan)
    assert own.outcome is other.outcome is Outcome.OPTIMAL
    assert own.objective == pytest.approx(other.objective, rel=1e-5)
    np.testing.assert_allclose(own.plan.switch_times, other.plan.switch_times, atol=1e-3)
    n = model.n
    at_switch = window.nodes[0]
    rates = own.plan.X[:, n:][:, model.space.base]
    if held == "reach":
        np.testing.assert_allclose(rates[: at_switch + 1], 0.0, atol=1e-12)
        assert np.abs(rates[at_switch + 1 :]).max() > 1e-3
    else:
        np.testing.assert_allclose(rates[at_switch + 1 :], 0.0, atol=1e-12)
        assert np.abs(rates[at_switch]).max() <= 5e-3 * (1 + 1e-3)
        assert np.abs(rates[:at_switch]).max() > 5e-3
