"""The delay of commands, found out from what was commanded and the velocities that were measured."""

import numpy as np
import pytest

from psmpc_cli.control.identification.delay import LONGEST, DelayEstimate, DelayEstimator, Sent, SentCommands
from psmpc_cli.simulation.run import simulate
from psmpc_cli.specs.load import load_task

T, TICK, N = 0.1, 1e-3, 4


def moved(
    delay: float,
    samples: int = 12,
    noise: float = 0.0,
    gain: np.ndarray | None = None,
    seed: int = 0,
    change: tuple[int, float] | None = None,
) -> list[DelayEstimate]:
    """Estimate the delay of a robot that follows random commands late, with a gain matrix (N, N)."""
    random = np.random.default_rng(seed)
    estimator = DelayEstimator(np.full(N, noise), np.ones(N, bool), TICK, T, largest=4.0)
    commands, found, estimate = SentCommands(N, TICK), list[DelayEstimate](), estimator.first
    v = np.zeros(N)
    level = random.uniform(-0.3, 0.3, N)
    for k in range(samples):
        estimate = estimator.after_measurement(estimate, k * T, v + noise * random.standard_normal(N), commands)
        found.append(estimate)
        level = level + random.uniform(-0.1, 0.1, N)
        u = np.tile(level, (round(T / TICK), 1))
        commands = commands.after(Sent(k * T, u, u), oldest=k * T - 3.0)
        late = change[1] if change and k >= change[0] else delay
        acting = commands.commanded(k * T - late, (k + 1) * T - late)
        v = v + TICK * acting.sum(axis=0) @ (np.eye(N) if gain is None else gain).T
    return found


@pytest.mark.parametrize("delay", [0.0, 0.001, 0.05, 0.13, 0.2, 0.347])
def test_exact_velocities_tell_the_delay_to_a_tick(delay: float) -> None:
    found = moved(delay)[-1]
    assert found.seconds == pytest.approx(delay, abs=1.01 * TICK)
    assert found.deviation < 0.01


def test_before_anything_moves_no_delay_is_counted_with_and_then_no_more_than_the_robot_shows() -> None:
    found = moved(0.3)
    assert (found[0].seconds, found[0].deviation) == (0.0, np.inf)
    assert [each.seconds for each in found[1:4]] == pytest.approx([0.1, 0.2, 0.3], abs=2e-3)


def test_wrong_masses_and_noise_leave_some_milliseconds() -> None:
    """Gain matrices that are off by 10 % in every entry, velocities by 1 mm/s."""
    errors = []
    for seed in range(40):
        random = np.random.default_rng(1000 + seed)
        gain = np.eye(N) + 0.1 * random.uniform(-1, 1, (N, N))
        errors.append(moved(0.13, noise=1e-3, gain=gain, seed=seed)[10].seconds - 0.13)
    assert np.quantile(np.abs(errors), 0.95) < 0.01


def test_a_delay_that_changes_is_followed() -> None:
    found = moved(0.05, samples=60, change=(30, 0.2), noise=1e-3)
    assert found[30].seconds == pytest.approx(0.05, abs=0.005)
    assert found[-1].seconds == pytest.approx(0.2, abs=0.01)


def test_what_is_not_measured_and_what_comes_after_a_jump_is_left_out() -> None:
    estimator = DelayEstimator(np.zeros(N), np.ones(N, bool), TICK, T, largest=4.0)
    u = np.full((100, N), 0.1)
    commands = SentCommands(N, TICK).after(Sent(0.0, u, u), oldest=-1.0)
    begun = estimator.after_measurement(estimator.first, 0.0, np.zeros(N), SentCommands(N, TICK))
    unmeasured = estimator.after_measurement(begun, 0.1, np.full(N, np.nan), commands)
    assert unmeasured.times == begun.times
    after_jump = estimator.after_measurement(estimator.unsettled(begun, 0.1), 0.2, np.full(N, 0.5), commands)
    assert (after_jump.seconds, after_jump.times) == (0.0, ())


def test_coordinates_that_no_command_acts_on_tell_nothing() -> None:
    acted_on = np.array([False, True, True, True])
    estimator = DelayEstimator(np.zeros(N), acted_on, TICK, T, largest=4.0)
    u = np.full((100, N), 0.1)
    commands = SentCommands(N, TICK).after(Sent(0.0, u, u), oldest=-1.0)
    estimate = estimator.after_measurement(estimator.first, 0.0, np.zeros(N), SentCommands(N, TICK))
    found = estimator.after_measurement(estimate, 0.1, np.array([np.pi, 0.005, 0.005, 0.005]), commands)
    assert found.seconds == pytest.approx(0.05, abs=2e-3)


def test_sent_commands_hold_until_the_next_one_arrives() -> None:
    first, second = (np.arange(3.0)[:, None] + 10 * k for k in range(2))
    commands = SentCommands(1, 0.1).after(Sent(0.0, first, first - 0.5), -1.0).after(Sent(0.5, second, second), -1.0)
    assert commands.planned(-0.2, 0.7).ravel().tolist() == [0, 0, 0, 1, 2, 2, 2, 10, 11]
    assert commands.commanded(0.0, 0.3).ravel().tolist() == [-0.5, 0.5, 1.5]
    kept = commands.after(Sent(0.8, first, first), oldest=0.5)
    assert [one.time for one in kept.sent] == [0.5, 0.8]


def test_delays_are_at_most_the_longest_or_what_the_horizon_leaves() -> None:
    assert len(DelayEstimator(np.zeros(N), np.ones(N, bool), TICK, T, largest=4.0).first.evidence) == LONGEST / TICK + 1
    assert len(DelayEstimator(np.zeros(N), np.ones(N, bool), TICK, T, largest=0.3).first.evidence) == 201


@pytest.mark.parametrize("delay", ["0 s", "0.07 s", "0.2 s"])
def test_a_run_finds_out_its_delay_and_says_so(delay: str) -> None:
    changes = {"controller.nodes": 12, "log": {"plans": False, "shares": False}, "time_limit": 1.0}
    run = simulate(load_task("transport", {**changes, "uncertainty.delay": delay}))
    assert run["delay/expected"][-1] == pytest.approx(float(delay[:-2]), abs=1.01 * TICK)
    assert run["delay/deviation"][-1] < 2e-3
