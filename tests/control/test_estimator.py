from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from psmpc_cli.control import State
from psmpc_cli.control.estimator import Estimate, Estimator
from psmpc_cli.robot.configuration import PlanarSpace, SpatialSpace
from psmpc_cli.robot.motion import over_ticks
from psmpc_cli.specs.load import load_task

T, TICKS = 0.1, 5


def estimator(noise: float = 0.0, gain: float = 0.3, delay: int = 0, n: int = 3, offset_free: bool = True) -> Estimator:
    """Build an estimator that is told of a delay of so many samples."""
    changes = [f"controller.offset_free={offset_free}", f"controller.delay={delay * T} s"]
    spec = load_task("transport", changes).spec.controller.model_copy(update={"offset_gain": gain})
    space = SpatialSpace(n - 6) if n > 6 else PlanarSpace(n - 3)
    return Estimator(spec, space, np.ones(n, bool), np.r_[np.full(n, noise), np.zeros(n)], T / TICKS)


def follow(true: np.ndarray, gain: float, samples: int, noise: float = 0.0, delay: int = 0) -> np.ndarray:
    """Estimate a disturbance (n,) of a double integrator; (samples, n)."""
    random, estimating = np.random.default_rng(4), estimator(gain=gain, delay=delay)
    v, under_way, found = np.zeros(3), [np.zeros(3)] * delay, []
    estimate: Estimate | None = None
    for k in range(samples):
        measured = State(np.zeros(3), v + noise * random.standard_normal(3))
        planned = np.tile([np.sin(k), np.cos(k), 0.1 * k], (TICKS, 1))
        estimate, u = estimating.command(estimating.after_measurement(estimate, k * T, measured), planned)
        under_way.append(u.mean(axis=0))
        v = v + T * (under_way.pop(0) + true)
        found.append(estimate.disturbance)
    return np.array(found)


@pytest.mark.parametrize("delay", [0, 1, 10])
@pytest.mark.parametrize("gain", [0.1, 0.3, 1.0])
def test_a_constant_disturbance_is_found_at_the_filter_s_pace_however_late_commands_are(
    gain: float, delay: int
) -> None:
    true = np.array([0.2, -0.5, 0.1])
    left = 1 - follow(true, gain, 30, delay=delay) / true
    expected = (1 - gain) ** np.arange(30)
    np.testing.assert_allclose(left, np.tile(expected[:, None], 3), atol=1e-12)


def test_a_smaller_gain_lets_less_noise_through() -> None:
    quiet, loud = (follow(np.zeros(3), gain, 2000, 1e-3).std() for gain in (0.1, 1.0))
    assert quiet < 0.3 * loud


def test_a_measurement_that_is_not_finite_changes_no_disturbance() -> None:
    estimating, u = estimator(gain=0.5), np.zeros((TICKS, 3))
    estimate, _ = estimating.command(estimating.after_measurement(None, 0.0, State(np.zeros(3), np.zeros(3))), u)
    estimate = estimating.after_measurement(estimate, T, State(np.zeros(3), np.array([np.nan, 1.0, 0.0])))
    np.testing.assert_allclose(estimate.disturbance, [0.0, 5.0, 0.0])


def reserves(errors: list[float], noise: float = 0.0, grippers_moved: bool = False) -> list[float]:
    """Return the reserve of a coordinate after samples over which its velocity changed by so much more than planned."""
    spec = load_task("transport", {"controller.delay": 0, "controller.speed_reserve": 2}).spec.controller
    estimating = Estimator(spec, PlanarSpace(0), np.ones(3, bool), np.r_[np.zeros(3), np.full(3, noise)], T / TICKS)
    u = np.tile([0.3, 0.0, 0.0], (TICKS, 1))
    v = np.zeros(3)
    estimate = estimating.after_measurement(None, 0.0, State(np.zeros(3), v))
    found = []
    for k, error in enumerate(errors):
        estimate, _ = estimating.command(estimate, u)
        v = v + np.array([0.03 + error, 0.0, 0.0])
        measured = State(np.zeros(3), v)
        estimate = estimating.after_measurement(estimate, (k + 1) * T, measured, grippers_moved=grippers_moved)
        found.append(float(estimate.speed_reserve[0]))
    return found


def test_the_reserve_of_speed_is_the_largest_error_of_late_times_the_factor() -> None:
    np.testing.assert_allclose(reserves([0.0, 0.01, -0.002, 0.0, -0.05]), [0, 0.02, 0.019, 0.01805, 0.1], atol=1e-12)


def test_neither_noise_nor_a_jump_as_grippers_move_asks_for_a_reserve() -> None:
    assert reserves([0.004, -0.004], noise=1e-3) == [0.0, 0.0]
    np.testing.assert_allclose(reserves([0.01], noise=1e-3), [2 * (0.01 - 3 * np.sqrt(2) * 1e-3)])
    assert reserves([0.05], grippers_moved=True) == [0.0]


def test_without_a_measurement_the_reserve_decays() -> None:
    np.testing.assert_allclose(reserves([0.01, np.nan]), [0.02, 0.019])


def test_without_delay_and_noise_the_measured_state_is_the_one_to_decide_from() -> None:
    state, estimating = State(np.zeros(3), np.ones(3)), estimator()
    estimate, _ = estimating.command(estimating.after_measurement(None, 0.0, state), np.ones((TICKS, 3)))
    assert estimating.predicted_over_delay(estimating.after_measurement(estimate, T, state)) is state


def test_the_foreseen_state_follows_what_was_planned_since_the_measurement() -> None:
    """Two samples of 0.1 s under 1 and 2 m/s^2 from rest at 7: 7 + 0.005 + 0.01 + 0.01 m, and 0.3 m/s."""
    estimating, state = estimator(delay=2, offset_free=False), State(np.full(3, 7.0), np.zeros(3))
    estimate = estimating.after_measurement(None, 0.0, state)
    np.testing.assert_allclose(estimating.predicted_over_delay(estimate).vector, state.vector)
    for k, u in enumerate((1.0, 2.0)):
        estimate, _ = estimating.command(estimate, np.full((TICKS, 3), u))
        estimate = estimating.after_measurement(estimate, (k + 1) * T, state)
    np.testing.assert_allclose(estimating.predicted_over_delay(estimate).vector, [7.025] * 3 + [0.3] * 3, atol=1e-12)


SIGMA = 1e-3


class Filtered:
    """A robot whose coordinates are measured with noise, and what is estimated of it sample by sample."""

    def __init__(self, spatial: bool = False, delay: int = 0, seed: int = 0) -> None:
        n = 7 if spatial else 3
        self.space = SpatialSpace(1) if spatial else PlanarSpace()
        self.estimator = estimator(SIGMA, delay=delay, n=n, offset_free=False)
        self.random = np.random.default_rng(seed)
        self.true = State(np.r_[np.zeros(3), 1.0, np.zeros(4)] if spatial else np.zeros(3), np.zeros(n))
        self.delay = delay
        self.under_way = [np.zeros((TICKS, n))] * delay
        self.expected: list[State] = []
        self.estimate: Estimate | None = None
        self.errors: list[np.ndarray] = []
        self.noises: list[np.ndarray] = []
        self.count = 0

    def step(self, u: Any = 0.0, jump: Any = 0.0, is_measured: bool = True) -> None:
        """Measure, decide for planned accelerations u, and move; velocities jump at the sample's end."""
        n = len(self.true.v)
        noise = SIGMA * self.random.standard_normal(n)
        measured = State(np.array(self.space.integrate(self.true.Q, noise)), self.true.v)
        if not is_measured:
            measured = State(np.full_like(measured.Q, np.nan), np.full(n, np.nan))
        estimate = self.estimator.after_measurement(self.estimate, self.count * T, measured)
        self.expected.append(self.estimator.predicted_over_delay(estimate))
        if len(self.expected) > self.delay:
            self.errors.append(np.array(self.space.difference(self.true.Q, self.expected[self.count - self.delay].Q)))
        self.noises.append(noise)
        planned = np.broadcast_to(u, (TICKS, n)).astype(float)
        self.estimate, commanded = self.estimator.command(estimate, planned)
        self.under_way.append(commanded)
        Q, v = over_ticks(self.space, self.true.Q, self.true.v, self.under_way.pop(0), T / TICKS)
        self.true = State(Q[-1], v[-1] + jump)
        self.count += 1

    @property
    def ratio(self) -> float:
        """Error of the estimate over the noise, root mean squares of the second half of the samples."""
        half = len(self.errors) // 2
        return float(np.std(self.errors[half:]) / np.std(self.noises[half:]))


@pytest.mark.parametrize("delay", [0, 3])
@pytest.mark.parametrize("spatial", [False, True], ids=["plane", "space"])
def test_noise_is_filtered_while_the_robot_follows_its_plan(spatial: bool, delay: int) -> None:
    """A random walk of 9e-5 m a sample, (0.2 |u| + 0.01) T^2 / sqrt(12), leaves sqrt(0.09) of a noise of 1e-3 m."""
    robot = Filtered(spatial, delay)
    for k in range(400):
        robot.step(0.1 * np.sin(0.05 * k))
    assert robot.ratio < 0.4


@pytest.mark.parametrize("spatial", [False, True], ids=["plane", "space"])
def test_a_jump_of_the_velocities_leaves_no_error_beyond_that_of_a_measurement(spatial: bool) -> None:
    """Grippers that close, a blow: what the filter expected is given up, not corrected bit by bit."""
    robot = Filtered(spatial)
    for k in range(200):
        robot.step(jump=np.where(k == 150, 0.2, 0.0))
    assert np.abs(robot.errors[151:]).max() < 4 * SIGMA
    assert np.abs(robot.errors[190:]).max() < SIGMA


def test_what_is_not_measured_is_predicted() -> None:
    robot = Filtered()
    for k in range(100):
        robot.step(0.1 * np.sin(0.05 * k), is_measured=k not in range(50, 60))
    assert np.abs(robot.errors[50:60]).max() < SIGMA


@settings(max_examples=30)
@given(st.integers(0, 1000), st.floats(-3.0, 3.0), st.floats(-3.0, 3.0))
def test_an_estimate_does_not_depend_on_the_attitude_it_is_about(seed: int, about_x: float, about_z: float) -> None:
    """A filter of rotation vectors is the same from every attitude."""
    upright, turned = Filtered(spatial=True, seed=seed), Filtered(spatial=True, seed=seed)
    Q = np.array(turned.space.integrate(turned.true.Q, [0, 0, 0, about_x, 0, about_z, 0]))
    turned.true = State(Q, turned.true.v)
    for _ in range(5):
        upright.step(0.1)
        turned.step(0.1)
    np.testing.assert_allclose(turned.errors, upright.errors, atol=1e-12)


def test_velocities_that_commands_do_not_explain_tell_of_no_delay() -> None:
    spec = load_task("transport").spec.controller
    estimating = Estimator(spec, PlanarSpace(1), np.ones(4, bool), np.zeros(8), T / TICKS)
    found = dict[bool, float]()
    for is_unexplained in (False, True):
        estimate = estimating.after_measurement(None, 0.0, State(np.zeros(4), np.zeros(4)))
        for k in range(30):
            estimate, _ = estimating.command(estimate, np.full((TICKS, 4), np.sin(k)))
            v = np.full(4, T * sum(np.sin(j) for j in range(k - 2)))  # three samples late
            state = State(np.zeros(4), v)
            estimate = estimating.after_measurement(estimate, (k + 1) * T, state, shares_load=is_unexplained)
        found[is_unexplained] = estimate.delay.seconds
    assert found[False] == pytest.approx(3 * T, abs=0.01)
    assert found[True] == 0.0
