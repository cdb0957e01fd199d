"""Names of coordinates, numbers by part as vectors, trajectories and limits."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from psmpc_cli.errors import SpecError
from psmpc_cli.specs.load import load_robot, load_task, parse_task
from psmpc_cli.specs.parts import POINT_AXES, SKILL_KINDS, SkillKindTraits, Space, axes_of, keys_of, names, part_faults
from psmpc_cli.specs.robots.robot import Arm, Link, Mount, PartLimits, labels, resolve_limits, rows, stack, units
from psmpc_cli.specs.stages import EndCondition, TrajectorySpec

from ..sliding_arm import ROBOT as SLIDING_ARM
from ..sliding_arm import sliding_task

DUAL = load_robot("planar_dual_arm")
LINK = Link(mass=1, inertia=1, a=0.1, b=0.1)
ARMS = {size: Arm(mount=Mount(position=(0, 0)), links=(LINK,) * size) for size in (1, 4)}
UNEVEN = DUAL.model_copy(update={"arms": {"short": ARMS[1], "long": ARMS[4]}, "limits": {}})


@pytest.mark.parametrize(
    ("chosen", "space", "expected"),
    [
        (["base"], "joint", (0, 1, 2)),
        (["arms"], "joint", (3, 4, 5, 6, 7)),
        (["all"], "joint", tuple(range(8))),
        (["long.4", "base.theta", "short"], "joint", (2, 3, 7)),
        (["long.2", "long"], "joint", (4, 5, 6, 7)),
        (["arms"], "task", tuple(range(3, 9))),
        (["long.theta", "short.x", "base.y"], "task", (1, 3, 8)),
        (["long.direction", "base"], "point", (0, 1, 2, 4)),
    ],
)
def test_names_select_sorted_rows(chosen: list[str], space: Space, expected: tuple[int, ...]) -> None:
    assert rows(chosen, UNEVEN, space) == expected


def test_a_point_has_two_numbers_an_arm_and_one_row_of_the_error() -> None:
    assert stack({"arms": (1.0, 2.0)}, UNEVEN, "point", missing=0.0).tolist() == [0, 0, 0, 1, 2, 1, 2]
    assert labels(UNEVEN, "point")[3:] == ("short.direction", "long.direction")
    weights = {"base": (1.0, 1.0, 1.0), "long": (5.0,)}
    assert stack(weights, UNEVEN, "point", missing=0.0, of_error=True).tolist() == [1, 1, 1, 0, 5]


@given(st.permutations(["base", "arm_1", "arm_2"]))
def test_stack_follows_the_order_of_the_robot_not_of_the_keys(order: list[str]) -> None:
    values = {"base": (1.0, 2.0, 3.0), "arm_1": (4.0, 5.0, 6.0), "arm_2": (7.0, 8.0, 9.0)}
    np.testing.assert_array_equal(stack({part: values[part] for part in order}, DUAL, "joint"), np.arange(1.0, 10.0))


def test_numbers_of_an_arm_take_precedence_over_those_of_all_arms() -> None:
    parts = {"arms": (9.0, 9.0, 9.0), "arm_1": (1.0, 2.0, 3.0), "base": (4.0, 5.0, 6.0)}
    assert stack(parts, DUAL, "joint").tolist() == [4, 5, 6, 1, 2, 3, 9, 9, 9]
    assert stack({"arm_2": (1.0, 1.0, 1.0)}, DUAL, "joint", missing=0.0).tolist() == [0] * 6 + [1] * 3


def test_tolerances_belong_to_the_selected_rows() -> None:
    one = EndCondition(coordinates=("base.x", "arm_2"), tolerance=0.1)
    assert one.tolerances(DUAL, "task").tolist() == [0.1] * 4
    by_part = EndCondition.model_validate(
        {"coordinates": ["arm_2", "base.theta"], "tolerance": {"base": 0.3, "arms": [0.1, 0.2, 1]}}
    )
    assert by_part.tolerances(DUAL, "task").tolist() == [0.3, 0.1, 0.2, 1.0]


FOLLOW = """\
robot: planar_dual_arm
initial: {base: [0, 0, 0], arms: [0, 0, 0]}
skills: {move: {space: joint, weights: {base: [1, 1, 1], arms: [1, 1, 1]}}}
stages:
  - name: follow
    skill: move
    target:
      {times: [0, 4], base: [[0, 0, 0], [0.5, 0, 30 deg]], arm_1: [[0, 0, 0], [1, 2, 3]], arms: [[0, 0, 0], [4, 5, 6]]}
    ends_when: {coordinates: base}
"""
ROBOT = load_task("transport").robot_yaml


def test_rows_of_a_trajectory_are_stacked_in_the_order_of_q() -> None:
    target = parse_task(FOLLOW, ROBOT, "follow").spec.stages[0].target
    assert isinstance(target, TrajectorySpec)
    assert target.times == (0, 4)
    np.testing.assert_allclose(
        target.stacked(DUAL, "joint"), [np.zeros(9), [0.5, 0, math.radians(30), 1, 2, 3, 4, 5, 6]]
    )


bounds = st.floats(0.0, 10.0).flatmap(lambda high: st.tuples(st.floats(-10.0, 0.0), st.just(high)))
layers = st.dictionaries(
    st.sampled_from(["base", "arms", "arm_1", "arm_2"]),
    st.builds(
        PartLimits, position=st.tuples(bounds, bounds, bounds), velocity=st.none() | st.tuples(bounds, bounds, bounds)
    ),
)


def test_limits_are_in_the_order_of_q_and_an_arm_s_own_take_precedence_over_those_of_all_arms() -> None:
    limits = resolve_limits(DUAL)
    np.testing.assert_allclose(limits.position_high, [5, 5, np.pi, *[np.pi / 2, np.pi, np.pi] * 2])
    np.testing.assert_array_equal(limits.velocity_low, [-0.2] * 3 + [-0.15] * 6)
    np.testing.assert_array_equal(limits.acceleration_high, [np.inf] * 9)
    half = {"arms": PartLimits(velocity=((-0.1, 0.1),) * 3), "arm_2": PartLimits(velocity=((0.0, 0.05),) * 3)}
    assert resolve_limits(DUAL, half).velocity_high.tolist() == [0.2] * 3 + [0.1] * 3 + [0.05] * 3
    assert resolve_limits(DUAL, half).velocity_low.tolist() == [-0.2] * 3 + [-0.1] * 3 + [0.0] * 3


@settings(max_examples=40)
@given(layers, layers)
def test_more_limits_only_tighten_in_any_order(one: dict[str, PartLimits], other: dict[str, PartLimits]) -> None:
    both, turned, alone = resolve_limits(DUAL, one, other), resolve_limits(DUAL, other, one), resolve_limits(DUAL, one)
    for name in ("position", "velocity", "acceleration"):
        np.testing.assert_array_equal(getattr(both, f"{name}_low"), getattr(turned, f"{name}_low"))
        assert (getattr(both, f"{name}_low") >= getattr(alone, f"{name}_low")).all()
        assert (getattr(both, f"{name}_high") <= getattr(alone, f"{name}_high")).all()


CENTRE: Any = "centre"


@pytest.fixture
def with_a_part_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """One more row in the table of spaces: a skill about the base and a point that no arm has."""
    traits = SkillKindTraits("a point of the whole robot", {"centre": (POINT_AXES, POINT_AXES)})
    monkeypatch.setitem(SKILL_KINDS, CENTRE, traits)


@pytest.mark.usefixtures("with_a_part_of_its_own")
def test_a_skill_may_have_a_part_that_no_robot_has() -> None:
    assert labels(UNEVEN, CENTRE) == ("base.x", "base.y", "base.theta", "centre.x", "centre.y")
    assert rows(["base.theta", "centre"], UNEVEN, CENTRE) == (2, 3, 4)
    assert stack({"centre": (5.0, 6.0)}, UNEVEN, CENTRE, missing=0.0).tolist() == [0, 0, 0, 5, 6]
    assert names(UNEVEN.parts, CENTRE) == ("base", "centre", "all", *labels(UNEVEN, CENTRE))


@pytest.mark.usefixtures("with_a_part_of_its_own")
def test_numbers_of_parts_that_a_skill_does_not_have_are_faults() -> None:
    axes = axes_of(UNEVEN.parts, CENTRE)
    found = list(part_faults({"base": [0, 0, 0], "arms": [0]}, axes, axes))
    assert [at for at, _ in found] == [("arms",)]
    assert found[0][1].context == {
        "tail": ", expected one of base, centre",
        "found": "no such part here",
        "at_key": True,
    }
    assert list(part_faults({"base": [0, 0, 0], "centre": [0, 0]}, axes, axes)) == []


@pytest.mark.parametrize("space", SKILL_KINDS)
def test_every_skill_has_a_pose_of_the_base_first(space: Space) -> None:
    assert labels(DUAL, space)[:3] == ("base.x", "base.y", "base.theta")
    assert keys_of(axes_of(DUAL.parts, space)) == ("base", "arm_1", "arm_2", "arms")


PLACES = {
    "initial": ("initial.arm", ["{of}", "{at}"]),
    "target": ("stages[0].target.arm", ["{of}", "{at}"]),
    "trajectory": ("stages[0].target", {"times": [0, 1], "arm": [["{of}", "{at}"], ["{of}", "{at}"]]}),
    "rate": ("initial_velocity", {"arm": ["{of}", "{at}"]}),
    "tolerance": ("stages[0].ends_when.tolerance", {"arm": ["{of}", "{at}"]}),
    "at rest": ("stages[0].ends_when.velocity", {"arm": ["{of}", "{at}"]}),
    "limit": ("limits", {"arm": {"position": [[-0.1, "{of}"], [0, "{at}"]]}}),
    "limit of every arm": ("limits", {"arms": {"velocity": ["{of}", "{at}"]}}),
}


def filled(value: Any, of: Any, at: Any) -> Any:
    """A value of `PLACES` with what is written of the joint that turns and of the one that slides."""
    if isinstance(value, dict):
        return {key: filled(each, of, at) for key, each in value.items()}
    if isinstance(value, list):
        return [filled(each, of, at) for each in value]
    return {"{of}": of, "{at}": at}.get(value, value)


@pytest.mark.parametrize("place", [*PLACES])
def test_units_are_those_of_the_coordinate(tmp_path: Path, place: str) -> None:
    """Wherever numbers of coordinates stand: lengths of joints that slide, angles of those that turn, rates of both."""
    (tmp_path / "slider.yaml").write_text(SLIDING_ARM)
    path, value = PLACES[place]
    task = sliding_task(str(tmp_path / "slider.yaml"))
    for of, at in ((0.2, 0.3), ("0.2 rad", "0.3 m"), ("1 deg", "0.3 m")):
        load_task(task, set={path: filled(value, of, at)})
    rates = place in ("rate", "limit of every arm")
    angle, length = ("a number in rad/s,", "a number in m/s,") if rates else ("an angle", "a length")
    for of, at, wanted in (("0.2 m", 0.3, angle), (0.2, "0.3 rad", length), (0.2, "1 deg", length)):
        with pytest.raises(SpecError, match=f"expected {wanted}"):
            load_task(task, set={path: filled(value, of, at)})


@pytest.mark.parametrize(
    ("path", "value", "wanted"),
    [
        ("stages[0].ends_when.tolerance", "1 deg", "expected a length"),
        ("stages[0].ends_when.tolerance", "0.1 m", "expected an angle"),
        ("initial.base", ["30 deg", 0, 0, 1, 0, 0, 0], "expected a length"),
        ("initial.base", [0, 0, 0, 1, "30 deg", 0, 0], "expected a number alone"),
        ("stages[0].target.arm", [8, 0.1], "8 rad .*did you mean"),
        ("skills.move.weights.arm", ["1 deg", 1], "expected a number"),
        (
            "obstacles",
            [{"name": "o", "shape": {"sphere": 0.1}, "pose": ["3 deg", 0, 0, 1, 0, 0, 0]}],
            "expected a length",
        ),
    ],
)
def test_a_unit_of_another_kind_of_coordinate_is_rejected(tmp_path: Path, path: str, value: Any, wanted: str) -> None:
    (tmp_path / "slider.yaml").write_text(SLIDING_ARM)
    with pytest.raises(SpecError, match=wanted):
        load_task(sliding_task(str(tmp_path / "slider.yaml")), set={path: value})


def test_joints_that_slide_are_in_metres(tmp_path: Path) -> None:
    """Also where a limit is beyond what would be a turn."""
    (tmp_path / "slider.yaml").write_text(SLIDING_ARM)
    task = load_task(sliding_task(str(tmp_path / "slider.yaml")))
    assert task.spec.initial["arm"] == (0.1, 7.0)
    tolerance = task.spec.stages[0].ends_when
    assert tolerance is not None
    np.testing.assert_allclose(tolerance.tolerances(task.robot, "joint"), [np.radians(2), 0.02])
    assert [each.position for each in units(task.robot)[6:]] == ["rad", "m"]
    assert [each.force for each in units(task.robot)[6:]] == ["N m", "N"]
    assert resolve_limits(task.robot).position_high[6:].tolist() == [np.pi / 2, 8]
