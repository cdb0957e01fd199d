import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from psmpc_cli.errors import SpecError
from psmpc_cli.specs.coordinates import Space, labels, names, rows, stack, tolerances
from psmpc_cli.specs.load import load_robot
from psmpc_cli.specs.robot import Arm, Link, Mount, RobotSpec
from psmpc_cli.specs.task import EndCondition

DUAL = load_robot("planar_dual_arm").spec
LINK = Link(mass=1, inertia=1, a=0.1, b=0.1)
UNEVEN = RobotSpec.model_validate(
    {
        **DUAL.model_dump(exclude={"limits"}),
        "arms": {
            "short": Arm(mount=Mount(position=(0, 0)), links=(LINK,)),
            "long": Arm(mount=Mount(position=(0, 0)), links=(LINK,) * 4),
        },
    }
)


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
    ],
)
def test_names_select_sorted_rows(chosen: list[str], space: Space, expected: tuple[int, ...]) -> None:
    assert rows(chosen, UNEVEN, space) == expected


@pytest.mark.parametrize(
    ("name", "space"), [("short.2", "joint"), ("long.x", "joint"), ("long.1", "task"), ("", "task")]
)
def test_name_of_no_coordinate_is_refused_with_the_names_there_are(name: str, space: Space) -> None:
    with pytest.raises(
        SpecError, match=f'found the coordinate "{name}".*expected one of base, short, long, arms, all, base.x'
    ):
        rows([name], UNEVEN, space)


@pytest.mark.parametrize("space", ["joint", "task"])
@given(data=st.data())
def test_every_offered_name_selects_and_every_label_selects_its_row(space: Space, data: st.DataObject) -> None:
    assert rows([data.draw(st.sampled_from(names(UNEVEN, space)))], UNEVEN, space)
    row = data.draw(st.integers(0, len(labels(UNEVEN, space)) - 1))
    assert rows([labels(UNEVEN, space)[row]], UNEVEN, space) == (row,)


def test_stack_follows_the_order_of_the_robot_and_own_numbers_come_before_those_of_all_arms() -> None:
    parts = {"arms": (9.0, 9.0, 9.0), "arm_1": (1.0, 2.0, 3.0), "base": (4.0, 5.0, 6.0)}
    assert stack(parts, DUAL, "joint").tolist() == [4, 5, 6, 1, 2, 3, 9, 9, 9]
    assert stack({"short": (1.0,), "base": (0.0,) * 3, "long": (2.0,) * 4}, UNEVEN, "joint").shape == (8,)


def test_stack_fills_or_refuses_what_is_missing() -> None:
    assert stack({"arm_2": (1.0, 1.0, 1.0)}, DUAL, "joint", missing=0.0).tolist() == [0] * 6 + [1] * 3
    with pytest.raises(SpecError, match="found none of the numbers of base, expected 3"):
        stack({"arms": (1.0, 1.0, 1.0)}, DUAL, "joint")
    with pytest.raises(SpecError, match="found 2 of the numbers of arm_1, expected 3"):
        stack({"base": (0.0,) * 3, "arms": (1.0, 1.0)}, DUAL, "task")


def test_tolerances_belong_to_the_selected_rows() -> None:
    one = EndCondition(coordinates=("base.x", "arm_2"), tolerance=0.1)
    assert tolerances(one, DUAL, "task").tolist() == [0.1] * 4
    by_part = EndCondition.model_validate(
        {"coordinates": ["arm_2", "base.theta"], "tolerance": {"base": 0.3, "arms": [0.1, 0.2, 1]}}
    )
    assert tolerances(by_part, DUAL, "task").tolist() == [0.3, 0.1, 0.2, 1.0]
    with pytest.raises(SpecError, match=r"found no tolerance of base\.theta"):
        tolerances(by_part.model_copy(update={"tolerance": {"arms": (0.1,)}}), DUAL, "task")


@given(st.permutations(["base", "arm_1", "arm_2"]))
def test_order_of_keys_does_not_matter(order: list[str]) -> None:
    values = {"base": (1.0, 2.0, 3.0), "arm_1": (4.0, 5.0, 6.0), "arm_2": (7.0, 8.0, 9.0)}
    np.testing.assert_array_equal(stack({part: values[part] for part in order}, DUAL, "joint"), np.arange(1.0, 10.0))
