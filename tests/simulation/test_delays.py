"""What is under way between controller and robot."""

import numpy as np
import pytest

from psmpc_cli.control.offset_free import Offset
from psmpc_cli.simulation.delays import Delays
from psmpc_cli.specs.load import load_task

N, TICKS = 9, 100


def delays(delay: int, known: int, velocity: float = 0.0) -> Delays:
    task = load_task("transport", [f"uncertainty.delay={delay}", f"controller.known_delay={known}"]).spec
    return Delays.at_start(task, np.r_[np.zeros(N), np.full(N, velocity)])


def of(sample: int) -> np.ndarray:
    """Return accelerations that tell their sample."""
    return np.full((TICKS, N), float(sample + 1))


@pytest.mark.parametrize(("delay", "known"), [(0, 0), (2, 0), (3, 1), (2, 2)])
def test_only_what_is_not_known_of_a_delay_keeps_controls_waiting(delay: int, known: int) -> None:
    underway, reached = delays(delay, known), []
    for sample in range(5):
        u, underway = underway.after(np.zeros(2 * N), of(sample), None)
        reached.append(float(u[0, 0]))
    late = delay - known
    assert reached == [0.0] * late + [float(sample + 1) for sample in range(5 - late)]


def test_without_a_known_delay_the_measured_state_is_the_one_to_decide_from() -> None:
    x = np.arange(2.0 * N)
    assert delays(2, 0).foreseen(x) is x


def test_the_foreseen_state_is_of_old_measurements_and_what_was_planned_since() -> None:
    """Two samples of 0.1 s under 1 and 2 m/s^2 from rest at 7: 7 + 0.005 + 0.01 + 0.01 m, and 0.3 m/s."""
    underway = delays(2, 2)
    for sample in range(2):
        _, underway = underway.after(np.r_[np.full(N, 7.0 + sample), np.zeros(N)], of(sample), None)
    foreseen = underway.foreseen(np.full(2 * N, np.nan))
    np.testing.assert_allclose(foreseen, np.r_[np.full(N, 7.025), np.full(N, 0.3)], atol=1e-12)


def test_a_robot_that_moves_at_the_start_was_moving_before() -> None:
    underway = delays(3, 3, velocity=0.1)
    np.testing.assert_allclose(underway.foreseen(np.zeros(2 * N)), np.r_[np.zeros(N), np.full(N, 0.1)], atol=1e-12)


def test_what_was_taken_off_for_a_disturbance_is_expected_on_top_again() -> None:
    d = np.full(N, 0.25)
    _, underway = delays(1, 1).after(np.zeros(2 * N), of(0) - d, Offset(d, np.zeros(N), ()))
    np.testing.assert_allclose(underway.foreseen(np.zeros(2 * N))[N:], 0.1, atol=1e-12)
