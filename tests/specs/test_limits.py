import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from psmpc_cli.specs.coordinates import resolve_limits as resolve
from psmpc_cli.specs.load import load_robot
from psmpc_cli.specs.robot import PartLimits

ROBOT = load_robot("planar_dual_arm").spec

bounds = st.floats(0.0, 10.0).flatmap(lambda high: st.tuples(st.floats(-10.0, 0.0), st.just(high)))
layers = st.dictionaries(
    st.sampled_from(["base", "arms", "arm_1", "arm_2"]),
    st.builds(
        PartLimits, position=st.tuples(bounds, bounds, bounds), velocity=st.none() | st.tuples(bounds, bounds, bounds)
    ),
)


def test_robot_s_own_limits_in_the_order_of_Q() -> None:
    limits = resolve(ROBOT)
    np.testing.assert_allclose(limits.position_high, [5, 5, np.pi, *[np.pi / 2, np.pi, np.pi] * 2])
    np.testing.assert_array_equal(limits.velocity_low, [-0.2] * 3 + [-0.15] * 6)
    np.testing.assert_array_equal(limits.acceleration_high, [np.inf] * 9)


def test_an_arm_s_own_limits_come_before_those_of_all_arms() -> None:
    half = {"arms": PartLimits(velocity=((-0.1, 0.1),) * 3), "arm_2": PartLimits(velocity=((0.0, 0.05),) * 3)}
    limits = resolve(ROBOT, half)
    assert limits.velocity_high.tolist() == [0.2] * 3 + [0.1] * 3 + [0.05] * 3
    assert limits.velocity_low.tolist() == [-0.2] * 3 + [-0.1] * 3 + [0.0] * 3


@given(layers, layers)
def test_more_limits_only_tighten_in_any_order(one: dict[str, PartLimits], other: dict[str, PartLimits]) -> None:
    both, turned, alone = resolve(ROBOT, one, other), resolve(ROBOT, other, one), resolve(ROBOT, one)
    for name in ("position", "velocity", "acceleration"):
        np.testing.assert_array_equal(getattr(both, f"{name}_low"), getattr(turned, f"{name}_low"))
        assert (getattr(both, f"{name}_low") >= getattr(alone, f"{name}_low")).all()
        assert (getattr(both, f"{name}_high") <= getattr(alone, f"{name}_high")).all()
