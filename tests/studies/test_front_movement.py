from pathlib import Path

import numpy as np
import pytest

from psmpc_cli.errors import InputError
from psmpc_cli.logs.results import Quantity, Results
from psmpc_cli.studies.fronts import front_movement

RATIOS = np.geomspace(1e-3, 1e3, 7)
INSTANTS = np.array([6.0, 7.0, 8.0])


def made_up(J: np.ndarray) -> Results:
    """A study with these J_1 and J_2 (instants, ratios, 2), of a switch at 9 s in a horizon of 4 s."""
    quantities = [
        Quantity("instant", ("instant",), INSTANTS[: len(J)], "s", ""),
        Quantity("t_s", ("instant",), np.full(len(J), 9.0), "s", ""),
        Quantity("ratio", ("ratio",), RATIOS, "1", ""),
        Quantity("weighted_J_1", ("instant", "ratio"), J[..., 0], "s", ""),
        Quantity("weighted_J_2", ("instant", "ratio"), J[..., 1], "s", ""),
    ]
    return Results(Path("made_up.h5"), {"horizon": 4.0}, {quantity.name: quantity for quantity in quantities})


def front(right: float = 0.0, up: float = 0.0) -> np.ndarray:
    along = np.linspace(0.1, 1.0, len(RATIOS))
    return np.column_stack([along**2 + up, (1 - along) ** 2 + right])


def test_a_front_that_moves_to_the_upper_left_is_said_to() -> None:
    movement = front_movement(made_up(np.array([front(2, 0), front(1, 1), front(0, 2)])))
    assert movement.moving == 3
    assert movement.with_time
    assert [step.right for step in movement.steps["normalized"]] == pytest.approx([-1, -1])
    assert movement.against == (0.0, 0.0, 0.0)


def test_where_each_step_leads_is_said() -> None:
    movement = front_movement(made_up(np.array([front(0, 1), front(1, 0), front(2, 1)])))
    assert [step.direction for step in movement.steps["normalized"]] == ["lower right", "upper right"]
    assert not movement.with_time
    assert any("lower right (1 of 2) and upper right (1 of 2)" in words for words in movement.over_time)


def test_a_step_back_along_a_front_is_found() -> None:
    J = front()
    J[[2, 3]] = J[[3, 2]]
    movement = front_movement(made_up(np.array([front(), J])))
    assert movement.moving == 1
    assert movement.against[0] == 0.0
    assert movement.against[1] > 0.1
    assert "upper left at 1 of 2 instants" in movement.over_ratio


def test_last_digits_are_no_step_back() -> None:
    J = front()
    J[3] = J[2] * [1 - 1e-7, 1 + 1e-7]
    assert front_movement(made_up(J[None])).moving == 1


def test_a_front_that_only_grows_does_not_move_over_its_own_extent() -> None:
    movement = front_movement(made_up(np.array([front(), 3 * front()])))
    (step,) = movement.steps["own extent"]
    assert (step.right, step.up) == (pytest.approx(0, abs=1e-12), pytest.approx(0, abs=1e-12))


def test_costs_that_follow_the_stages_parts_of_the_horizon_do_not_move_per_second() -> None:
    parts = np.array([[3.0, 1.0], [2.0, 2.0], [1.0, 3.0]])
    movement = front_movement(made_up(parts[:, None, :] * front()))
    np.testing.assert_allclose(movement.parts, parts)
    assert [step.direction for step in movement.steps["normalized"]] == ["lower right", "lower right"]
    for step in movement.steps["per second"]:
        assert (step.right, step.up) == (pytest.approx(0, abs=1e-12), pytest.approx(0, abs=1e-12))


def test_points_that_could_not_be_solved_for_are_left_out() -> None:
    J = np.array([front(1, 0), front(0, 1)])
    J[0, 2] = J[1, 5] = np.nan
    movement = front_movement(made_up(J))
    assert movement.moving == 2 and movement.with_time


def test_one_instant_does_not_move() -> None:
    movement = front_movement(made_up(front()[None]))
    assert movement.over_time == ()
    assert movement.steps["normalized"] == ()


def test_without_weighted_sums_there_is_nothing_to_follow() -> None:
    results = made_up(front()[None])
    kept = {name: quantity for name, quantity in results.quantities.items() if not name.startswith("weighted")}
    with pytest.raises(InputError, match="no weighted sums"):
        front_movement(Results(results.path, results.attributes, kept))
