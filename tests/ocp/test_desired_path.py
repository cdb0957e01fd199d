"""A stage that follows a trajectory, running or waiting in a window."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from psmpc_cli.ocp.lexicographic import Level, LevelShape, level_parameters, transcribe_level
from psmpc_cli.ocp.transcription import Nlp, transcribe

from psmpc_cli.ocp.gradient import Rollout
from psmpc_cli.ocp.plan import mesh, resting_plan
from psmpc_cli.ocp.problem import Stage, StageCosts, Trajectory
from psmpc_cli.ocp.window import (
    Window,
    desired_paths,
    durations,
    normalization,
    pack_guess,
    parameter_vector,
    window_shape,
)
from psmpc_cli.robot.model import RobotModel

from .test_transcription import window_over

N, GUESS = 5, np.array([2.4, 3.7])


@pytest.fixture(scope="module")
def windows(stages: tuple[Stage, ...]) -> Window:
    """A stage that stands still, one that follows a trajectory in task space, one in joint space."""
    values = np.random.default_rng(1).standard_normal((2, 2, 9))
    straight = [Trajectory(np.array([0.0, 30.0]), rows) for rows in values]
    moving = [
        replace(stage, trajectory=path, target=path.values[-1])
        for stage, path in zip(stages[1:3], straight, strict=True)
    ]
    return window_over((stages[0], *moving), terminal_cost=0.5)


def of_two(window: Window, *stages: Stage) -> Window:
    """A window over two stages only."""
    return replace(window, stages=stages, omega=window.omega[:2], offset=window.offset[:2], scale=window.scale[:2])


@pytest.fixture(scope="module")
def nlp(model: RobotModel, windows: Window) -> Nlp:
    return transcribe(model, window_shape(windows.stages, (N,) * len(windows.stages), "exact"))


def objective(nlp: Nlp, window: Window, instants: np.ndarray, guess: np.ndarray, costs: StageCosts) -> float:
    z = pack_guess(nlp, window, resting_plan(1.0, 4.0, 40, window.x0), instants, costs)
    return float(ca.Function("f", [nlp.x, nlp.p], [nlp.f])(z, parameter_vector(nlp, window, guess)))


def by_hand(window: Window, instants: np.ndarray, costs: StageCosts) -> float:
    """The objective of coasting, each trajectory's time counted from where its stage begins."""
    tau = durations(instants, window.start, window.horizon)
    times = window.start + mesh(tau, (N,) * 3)
    X = resting_plan(1.0, 4.0, 40, window.x0).states_at(times)
    begins = [window.start - window.elapsed, *instants]
    J, u = float(window.pending_cost * np.sum(instants - window.start)), np.zeros((len(times), 9))
    for s, (stage, begin) in enumerate(zip(window.stages, begins, strict=True)):
        nodes = slice(s * N, (s + 1) * N)
        L = costs.at(stage, X[nodes], u[nodes], times[nodes] - begin) / window.scale[s]
        J += window.omega[s] / window.omega.max() * float(L.sum() * tau[s] / N)
    last = costs.at(window.stages[-1], X[-1:], u[-1:], times[-1:] - begins[-1])[0] / window.scale[-1]
    return J + window.terminal_cost * window.omega[-1] / window.omega.max() * float(last)


@given(first=st.floats(1.1, 2.9), second=st.floats(0.1, 1.9))
@settings(max_examples=20, deadline=None)
def test_waiting_trajectory_begins_with_its_stage_wherever_the_optimizer_moves_it(
    nlp: Nlp, windows: Window, costs: StageCosts, first: float, second: float
) -> None:
    instants = np.array([first, first + second])
    assert objective(nlp, windows, instants, GUESS, costs) == pytest.approx(by_hand(windows, instants, costs), rel=1e-9)


def test_running_trajectory_goes_on_from_where_it_is(model: RobotModel, windows: Window, costs: StageCosts) -> None:
    window = replace(windows, stages=windows.stages[::-1], elapsed=7.5)
    nlp = transcribe(model, window_shape(window.stages, (N,) * len(window.stages), "exact"))
    for instants in (GUESS, np.array([1.6, 4.4])):
        assert objective(nlp, window, instants, GUESS, costs) == pytest.approx(by_hand(window, instants, costs))


def test_path_bends_where_the_trajectory_does(windows: Window) -> None:
    bent = Trajectory(np.array([0.0, 1.0, 2.0]), np.outer([0.0, 1.0, 5.0], np.ones(9)))
    window = of_two(windows, windows.stages[0], replace(windows.stages[1], trajectory=bent))
    _, path = desired_paths((4, 4), window, np.array([3.0]))
    np.testing.assert_allclose(path.values[:, 0] + 2.0 * path.slopes[:, 0], [0, 0.5, 1, 3, 5])
    np.testing.assert_allclose(path.slopes[:, 0], [0, 0.25, 2, 3, 0])


def test_end_condition_is_about_the_last_row_even_if_the_guess_ends_the_stage_before(
    model: RobotModel, windows: Window, costs: StageCosts
) -> None:
    window = of_two(windows, windows.stages[1], windows.stages[0])
    nlp = transcribe(model, window_shape(window.stages, (N,) * len(window.stages), "exact"))
    guess = np.array([1.2])
    z = pack_guess(nlp, window, resting_plan(1.0, 4.0, 40, window.x0), guess, costs)
    g = np.asarray(ca.Function("g", [nlp.x, nlp.p], [nlp.g])(z, parameter_vector(nlp, window, guess))).ravel()
    X = resting_plan(1.0, 4.0, 40, window.x0).states_at(guess)
    rows = list(window.stages[0].end_rows)
    np.testing.assert_allclose(g[nlp.end_rows[0]], costs.errors(window.stages[0], X)[0, rows], atol=1e-9)


def test_only_a_moving_target_adds_parameters(model: RobotModel, stages: tuple[Stage, ...], nlp: Nlp) -> None:
    still = transcribe(model, window_shape(stages[:3], (N,) * 3, "exact"))
    assert nlp.p.shape[0] - still.p.shape[0] == 2 * (9 * 2 * (N + 1))


def test_level_follows_the_running_trajectory_and_draws_a_waiting_one_to_its_first_row(
    model: RobotModel, windows: Window
) -> None:
    shape = LevelShape(("task", "joint"), "error", N, "exact")
    stages = windows.stages[1:]
    level = Level(stages, windows.x0, 1.0, 4.0, 7.5, np.ones(2), (np.zeros((N, 9)),), 1e-3)
    p = level_parameters(transcribe_level(model, shape), level)
    first, second = (piece[18:].reshape(N + 1, 9) for piece in np.split(p[18 + 1 + 2 :], 2))
    np.testing.assert_allclose(first, stages[0].reference(7.5 + np.linspace(0, 4, N + 1)))
    np.testing.assert_allclose(second, np.tile(stages[1].waypoints[0], (N + 1, 1)))


@pytest.mark.parametrize("begins", [0.0, 2.0, 9.0])
def test_nadir_of_a_trajectory_counts_from_where_its_stage_begins(
    windows: Window, costs: StageCosts, begins: float
) -> None:
    stage, plan = windows.stages[1], resting_plan(0.0, 4.0, 40, windows.x0)
    _, scale = normalization("nadir", 0.0, [stage], np.array([begins]), costs, plan, 0.1)
    times = np.linspace(0, 4, 41)
    errors = costs.errors(replace(stage, trajectory=None), plan.states_at(times)) + stage.target
    wanted = np.array([np.interp(times - begins, [0, 30], column) for column in stage.waypoints.T]).T
    assert scale[0] == pytest.approx(np.max((errors - wanted) ** 2 @ stage.weights))


@given(seed=st.integers(0, 2**32 - 1), shares=st.tuples(*[st.floats(0.2, 1.0)] * 3))
@settings(max_examples=5, deadline=None)
def test_gradient_with_trajectories_is_the_same_three_ways(
    model: RobotModel, windows: Window, seed: int, shares: tuple[float, ...]
) -> None:
    rollout = Rollout(model, window_shape(windows.stages, (N,) * len(windows.stages), "exact"), windows, GUESS)
    tau = 4.0 * np.array(shares) / sum(shares)
    U = list(0.1 * np.random.default_rng(seed).standard_normal((3, N, 9)))
    adjoint = rollout.by_adjoint(tau, U)
    scale = np.abs(adjoint).max()
    np.testing.assert_allclose(adjoint, rollout.by_differentiation(tau, U), atol=1e-8 * scale)
    np.testing.assert_allclose(adjoint, rollout.by_differences(tau, U), atol=1e-6 * scale)
