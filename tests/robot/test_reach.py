"""What an arm reaches from a base pose."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from psmpc_cli.errors import InputError
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.robot.reach import TOLERANCE, reach_of
from psmpc_cli.specs.robots.robot import PartLimits, RobotSpec

from .strategies import Array, State, laws, moving_robots

BASE = (-2.0, 2.0, math.pi / 6)
GRASP = {"arm_1": (-1.9334, 3.1677, math.radians(165)), "arm_2": (-3.0446, 2.5261, math.radians(-105))}


def with_links(robot: RobotSpec, *numbers: int) -> RobotSpec:
    """A robot with one arm, of these links of arm_1, without limits."""
    arm = robot.arms["arm_1"]
    links = tuple(arm.links[number - 1] for number in numbers)
    return robot.model_copy(update={"arms": {"arm": arm.model_copy(update={"links": links})}, "limits": {}})


def with_limits(robot: RobotSpec, **position: tuple[tuple[float, float], ...]) -> RobotSpec:
    return robot.model_copy(update={"limits": {name: PartLimits(position=rows) for name, rows in position.items()}})


def assert_takes(robot: RobotSpec, arm: str, base: tuple[float, ...], pose: tuple[float, ...], q: Array) -> None:
    """The arm's end-effector is at the pose, its angle modulo 2 pi, with joints at q."""
    model = RobotModel(robot)
    Q = np.zeros(model.n)
    Q[model.parts["base"]], Q[model.parts[arm]] = base, q
    miss = model.poses(Q)[list(model.pose_rows).index(arm)] - pose
    assert np.hypot(*miss[:2]) <= TOLERANCE
    assert abs(math.remainder(miss[2], 2 * math.pi)) <= TOLERANCE


@pytest.mark.parametrize("arm", ["arm_1", "arm_2"])
def test_grasp_is_reached_as_published(model: RobotModel, arm: str) -> None:
    reach = reach_of(model, arm, BASE, GRASP[arm])
    sign = 1 if arm == "arm_1" else -1
    assert reach.reachable
    assert reach.configuration is not None
    np.testing.assert_allclose(reach.configuration, sign * np.radians([45, 30, 60]), atol=2e-4)
    assert reach.wrist_distance == pytest.approx(math.cos(math.radians(15)), abs=1e-4)
    assert reach.distance == pytest.approx(1.0359, abs=1e-4)
    assert (reach.inner, reach.outer) == (0.0, 1.0)
    assert reach.full_reach == pytest.approx(1.2)


@pytest.mark.slow
@given(moving_robots())
@laws
def test_any_pose_an_arm_takes_is_reachable(state: State) -> None:
    model, Q, _, _ = state
    base = tuple(Q[model.parts["base"]])
    for arm, pose in zip(model.spec.arms, model.poses(Q)[1:], strict=True):
        reach = reach_of(model, arm, base, tuple(pose))
        assert reach.within_annulus
        assert reach.reachable
        assert_takes(model.spec, arm, base, tuple(pose), np.array(reach.configuration))


@pytest.mark.slow
@given(moving_robots(3, 3), st.data())
@laws
def test_three_links_find_what_limits_allow(state: State, data: st.DataObject) -> None:
    model, Q, _, _ = state
    span = st.lists(st.floats(0, 1), min_size=3, max_size=3).map(np.array)
    below, above = data.draw(span), data.draw(span)
    q = Q[3:6]
    robot = with_limits(model.spec, arm_1=tuple(zip((q - below).tolist(), (q + above).tolist(), strict=True)))
    found = np.array(reach_of(RobotModel(robot), "arm_1", tuple(Q[:3]), tuple(model.poses(Q)[1])).configuration)
    assert np.all((found >= q - below) & (found <= q + above))
    assert_takes(model.spec, "arm_1", tuple(Q[:3]), tuple(model.poses(Q)[1]), found)


@pytest.mark.parametrize("elbow", [0.8, -0.8])
def test_the_branch_is_that_of_the_posture_from_which_the_arm_moves(planar_dual_arm: RobotSpec, elbow: float) -> None:
    wide = with_limits(planar_dual_arm, arms=((-math.pi, math.pi),) * 3)
    found = reach_of(RobotModel(wide), "arm_1", BASE, GRASP["arm_1"], near=(0.2, elbow, 0.0)).configuration
    assert found is not None
    assert math.copysign(1, found[1]) == math.copysign(1, elbow)
    assert_takes(planar_dual_arm, "arm_1", BASE, GRASP["arm_1"], np.array(found))


def test_limits_choose_the_elbow(planar_dual_arm: RobotSpec) -> None:
    free = ((-math.pi, math.pi), (0.0, math.pi), (-math.pi, math.pi))
    bent = ((-math.pi, math.pi), (-math.pi, 0.0), (-math.pi, math.pi))
    for limits, sign in ((free, 1), (bent, -1)):
        q = reach_of(RobotModel(with_limits(planar_dual_arm, arms=limits)), "arm_1", BASE, GRASP["arm_1"]).configuration
        assert q is not None
        assert math.copysign(1, q[1]) == sign
        assert_takes(planar_dual_arm, "arm_1", BASE, GRASP["arm_1"], np.array(q))


def test_an_arms_own_limits_come_before_those_of_all_arms(planar_dual_arm: RobotSpec) -> None:
    free, fixed = ((-math.pi, math.pi),) * 3, ((-0.1, 0.1),) * 3
    robot = with_limits(planar_dual_arm, arms=free, arm_2=fixed)
    assert reach_of(RobotModel(robot), "arm_1", BASE, GRASP["arm_1"]).reachable
    reach = reach_of(RobotModel(robot), "arm_2", BASE, GRASP["arm_2"])
    assert reach.within_annulus
    assert not reach.reachable


def test_limits_a_turn_away_are_met_by_an_equivalent_angle(planar_dual_arm: RobotSpec) -> None:
    turned = ((2 * math.pi, 2 * math.pi + 1),) + ((-4.0, 4.0),) * 2
    reach = reach_of(RobotModel(with_limits(planar_dual_arm, arms=turned)), "arm_1", BASE, GRASP["arm_1"])
    assert reach.configuration is not None
    assert reach.configuration[0] == pytest.approx(2 * math.pi + math.pi / 4, abs=1e-3)


def test_two_links_reach_a_full_pose_only_on_their_circle(planar_dual_arm: RobotSpec) -> None:
    short = RobotModel(with_links(planar_dual_arm, 1, 2))
    assert reach_of(short, "arm", (0, 0, 0), (0.8, 0.5, math.pi / 2)).reachable
    off = reach_of(short, "arm", (0, 0, 0), (0.8, 0.5, math.pi / 4))
    assert not off.reachable
    assert (off.inner, off.outer) == (0.5, 0.5)


def test_links_of_unequal_length_leave_a_hole(planar_dual_arm: RobotSpec) -> None:
    reach = reach_of(RobotModel(with_links(planar_dual_arm, 1, 3, 3)), "arm", (0, 0, 0), (0.3 + 0.1 + 0.2, 0.0, 0.0))
    assert reach.inner == pytest.approx(0.3)
    assert reach.wrist_distance == pytest.approx(0.1)
    assert not reach.within_annulus


def test_unknown_arm_and_short_pose_are_named(model: RobotModel) -> None:
    with pytest.raises(InputError, match=r"no arm 'arm_3'; it has arm_1, arm_2"):
        reach_of(model, "arm_3", (0, 0, 0), (1, 0, 0))
    with pytest.raises(InputError, match=r"pose is \[1, 0\], but 3 numbers"):
        reach_of(model, "arm_1", (0, 0, 0), (1, 0))
