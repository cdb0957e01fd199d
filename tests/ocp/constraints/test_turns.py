"""Limits of positions between the nodes: what the rows say of a motion, and plans that keep to them."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from psmpc_cli.control import Command, Controller, State
from psmpc_cli.ocp.constraints.turns import UNIT, extreme_positions, position_limits
from psmpc_cli.ocp.objective import Intervals
from psmpc_cli.ocp.problem import build_problem
from psmpc_cli.robot.model import RobotModel, load_robot
from psmpc_cli.solvers import Outcome
from psmpc_cli.specs.load import load_task

JOINT = 3
"""The first joint of the first arm, whose position is limited to 90 deg and whose rate to 0.15 rad/s."""

HIGH = np.pi / 2
RATES = st.floats(-0.3, 0.3)
LENGTHS = st.floats(0.01, 3.0)
FREE = 1e12


def extreme(model: RobotModel, limits: list[float], is_first: bool, q: float, v: float, v_next: float, h: float) -> Any:
    """Value (1,) and derivatives (1, 4n + 1) of the row of the joint, in rad."""
    rows = extreme_positions(model, (JOINT,), is_first)
    x = np.zeros((2, 2 * model.n))
    x[0, JOINT] = q
    x[:, model.n + JOINT] = v, v_next
    arguments = Intervals(x, np.array([[h]]), np.zeros(0), np.array([0])), np.array(limits)
    return UNIT * rows.values(*arguments)[0, 0], UNIT * rows.jacobian(*arguments)[0, 0]


@given(v=RATES, v_next=RATES, h=LENGTHS)
def test_the_row_is_the_position_farthest_out_where_a_motion_turns_round(
    model: RobotModel, v: float, v_next: float, h: float
) -> None:
    value, _ = extreme(model, [-HIGH, HIGH, -FREE, FREE], False, 1.0, v, v_next, h)
    t = np.linspace(0.0, h, 2001)
    q = 1.0 + v * t + (v_next - v) / h * t**2 / 2
    if v * v_next < 0:
        assert value == pytest.approx(q.max() if v > 0 else q.min(), abs=1e-6)
    else:
        assert value == pytest.approx(q[-1], abs=1e-12)


@pytest.mark.parametrize("v", [0.1, -0.1])
def test_coming_to_rest_at_a_limit_is_no_edge(model: RobotModel, v: float) -> None:
    """The value of the row and its derivatives are the same on both sides of it."""
    limits = [-HIGH, HIGH, -FREE, FREE]
    sides = [extreme(model, limits, False, 1.0, v, v_next, 0.5) for v_next in (-1e-9, 1e-9)]
    assert sides[0][0] == pytest.approx(sides[1][0], abs=1e-9)
    np.testing.assert_allclose(sides[0][1], sides[1][1], atol=1e-7)


@pytest.mark.parametrize(
    ("q", "v", "acceleration", "unavoidable"),
    [
        (HIGH - 0.1, 0.1, FREE, 0.0),  # stops at once
        (HIGH - 0.1, 0.2, 0.4, 0.0),  # stops after 5 cm
        (HIGH - 0.1, 0.4, 0.4, 0.1),  # after 20 cm
        (HIGH + 0.02, -0.1, 0.4, 0.02),  # is on its way back
        (HIGH + 0.02, 0.1, FREE, 0.02 + 0.5 * 0.1 / 2),  # may take the interval to stop
    ],
)
def test_the_first_interval_allows_what_the_strongest_braking_leaves(
    model: RobotModel, q: float, v: float, acceleration: float, unavoidable: float
) -> None:
    """Towards either limit alike."""
    for sign in (1.0, -1.0):
        limits = [-HIGH, HIGH, -acceleration, acceleration]
        values = [extreme(model, limits, is_first, sign * q, sign * v, 0.0, 0.5)[0] for is_first in (False, True)]
        assert sign * (values[0] - values[1]) == pytest.approx(unavoidable, abs=1e-9)


def first_command(*changes: str) -> Command:
    """The first plan of a robot that moves towards a limit, with two intervals of 2 s, to a target at the limit."""
    task = load_task(
        "transport",
        [
            "controller.nodes=2",
            "stages.approach.target.arm_1=[90 deg, 0, 0]",
            "stages.approach.ends_when.coordinates=[arm_1]",
            "initial.arm_1=[84 deg, 0, 0]",
            *changes,
        ],
    )
    controller = Controller(task)
    Q = np.zeros(9)
    Q[JOINT] = np.radians(84)
    v = np.zeros(9)
    v[JOINT] = 0.15
    return controller.step(0.0, State(Q, v))


@pytest.mark.parametrize(
    "solver", ["{kind: sqp}", "{kind: sqp, compiled: false}", "{kind: ipopt}", "{kind: fatrop}"], ids=str
)
def test_a_plan_turns_round_inside_its_limits(solver: str) -> None:
    """From 6 deg before it at 0.15 rad/s: a plan inside the limits at its nodes alone goes 0.01 rad beyond."""
    command = first_command(f"solver={solver}")
    assert command.solution.outcome in (Outcome.OPTIMAL, Outcome.FEASIBLE)
    plan = command.solution.plan
    farthest = plan.states_at(np.linspace(plan.start, plan.end, 4001))[:, JOINT].max()
    assert HIGH - 2e-3 < farthest < HIGH + 1e-6


def test_soft_limits_and_straight_lines_have_no_rows() -> None:
    for changes in (["controller.soft_limits=true"], ["controller.discretization=euler"]):
        plan = first_command(*changes).solution.plan
        farthest = plan.states_at(np.linspace(plan.start, plan.end, 4001))[:, JOINT].max()
        assert farthest > HIGH + 5e-3


@pytest.mark.slow
def test_the_attitude_of_a_spatial_base_has_no_row() -> None:
    task = load_task("servicing")
    found = position_limits(task.spec, build_problem(task).model, 0)
    assert found is not None
    assert found.structure == tuple(range(6, 20))
    assert position_limits(load_task("fly_and_point").spec, load_robot("free_flyer_arm"), 0) is not None
