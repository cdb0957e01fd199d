"""How fronts move."""

from pathlib import Path

import numpy as np

from psmpc_cli.logs.results import Quantity, Results
from psmpc_cli.studies.front_movement import FrontMovement

RATIOS = np.geomspace(0.1, 10.0, 7)


INSTANTS = np.array([6.0, 7.0, 8.0])


def made_up(J: np.ndarray) -> Results:
    """A study with these J_1 and J_2 (instants, ratios, 2), of a switch at 9 s in a horizon of 4 s."""
    arrays = {"instant": INSTANTS[: len(J)], "t_s": np.full(len(J), 9.0)}
    arrays |= {"weighted_J_1": J[..., 0], "weighted_J_2": J[..., 1], "weighted_dominated": np.zeros(J.shape[:2])}
    quantities = {name: Quantity(name, (), values, "s", "") for name, values in arrays.items()}
    return Results(Path("made_up.h5"), {"horizon": 4.0}, quantities)


def front(right: float = 0.0, up: float = 0.0) -> np.ndarray:
    along = np.linspace(0.1, 1.0, len(RATIOS))
    return np.column_stack([along**2 + up, (1 - along) ** 2 + right])


def test_a_front_that_moves_to_the_upper_left_is_said_to() -> None:
    movement = FrontMovement(made_up(np.array([front(2, 0), front(1, 1), front(0, 2)])))
    assert movement.n_moving == 3
    assert movement.moves_over_time
    np.testing.assert_allclose(movement.steps["normalized"], [[1, -1], [1, -1]])
    assert movement.steps_back == [0.0, 0.0, 0.0]


def test_a_step_back_along_a_front_is_found_and_last_digits_are_none() -> None:
    swapped, rounded = front(), front()
    swapped[[2, 3]] = swapped[[3, 2]]
    rounded[3] = rounded[2] * [1 - 1e-7, 1 + 1e-7]
    movement = FrontMovement(made_up(np.array([front(), swapped, rounded])))
    assert movement.n_moving == 2
    assert movement.steps_back[0] == 0.0
    assert movement.steps_back[1] > 0.1
    assert "upper left at 2 of 3 samples" in movement.over_ratio


def test_costs_that_follow_the_stages_parts_of_the_horizon_do_not_move_per_second() -> None:
    parts = np.array([[3.0, 1.0], [2.0, 2.0], [1.0, 3.0]])
    movement = FrontMovement(made_up(parts[:, None, :] * front()))
    np.testing.assert_allclose(movement.parts, parts)
    assert movement.directions() == "lower right (2 of 2)"
    np.testing.assert_allclose(movement.steps["per second"], np.zeros((2, 2)), atol=1e-12)
