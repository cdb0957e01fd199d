import casadi as ca
import numpy as np
import pytest
from psmpc_cli.ocp.transcription import Nlp, transcribe

from psmpc_cli.ocp.plan import mesh, resting_plan
from psmpc_cli.ocp.problem import Stage, StageCosts
from psmpc_cli.ocp.window import Window, bounds, durations, pack_guess, parameter_vector, unpack_plan, window_shape
from psmpc_cli.robot.model import RobotModel

N = 4
INSTANTS = np.array([2.5])


def window_over(stages: tuple[Stage, ...], **changes: object) -> Window:
    numbers = {
        "stages": stages,
        "start": 1.0,
        "elapsed": 0.5,
        "x0": np.r_[np.linspace(-0.4, 0.4, 9), np.linspace(0.1, -0.1, 9)],
        "omega": np.array([stage.priority for stage in stages]),
        "offset": np.zeros(len(stages)),
        "scale": np.full(len(stages), 50.0),
        "horizon": 4.0,
        "pending_cost": 1.0,
        "terminal_cost": 0.0,
        "nodes": (N,) * len(stages),
    }
    return Window(**{**numbers, **changes})


@pytest.fixture(scope="module")
def nlp(model: RobotModel, stages: tuple[Stage, ...]) -> Nlp:
    return transcribe(model, window_shape(stages[:2], (N, N), "exact"))


def random_point(nlp: Nlp, window: Window, costs: StageCosts) -> np.ndarray:
    """A point of the NLP: a coasting plan with other controls."""
    z = pack_guess(nlp, window, resting_plan(1.0, 4.0, N, window.x0), INSTANTS, costs)
    random = np.random.default_rng(0)
    for s in range(2):
        inputs = nlp.layout.input_index(s)
        z[inputs] = random.standard_normal(inputs.shape)
    return z


def rows_of(nlp: Nlp, z: np.ndarray, p: np.ndarray) -> np.ndarray:
    return np.asarray(ca.Function("g", [nlp.x, nlp.p], [nlp.g])(z, p)).ravel()


def objective(nlp: Nlp, z: np.ndarray, p: np.ndarray) -> float:
    return float(ca.Function("f", [nlp.x, nlp.p], [nlp.f])(z, p))


def test_objective_is_the_weighted_sum_of_the_stage_costs_and_the_pending_cost(
    nlp: Nlp, stages: tuple[Stage, ...], costs: StageCosts
) -> None:
    window = window_over(stages[:2])
    z = random_point(nlp, window, costs)
    plan = unpack_plan(nlp, window, z)
    J = 0.0
    for s, stage in enumerate(window.stages):
        nodes = slice(s * N, (s + 1) * N)
        running = costs.at(stage, plan.X[:-1][nodes], plan.u[nodes]) / window.scale[s]
        J += stage.priority / 100 * float(running @ np.diff(plan.times)[nodes])
    assert objective(nlp, z, parameter_vector(nlp, window, INSTANTS)) == pytest.approx(J + 1.5, rel=1e-12)


def test_terminal_cost_is_that_of_the_last_stage_at_the_last_node(
    nlp: Nlp, stages: tuple[Stage, ...], costs: StageCosts
) -> None:
    without, with_it = window_over(stages[:2]), window_over(stages[:2], terminal_cost=2.0)
    z = random_point(nlp, without, costs)
    X = unpack_plan(nlp, without, z).X[-1:]
    added = objective(nlp, z, parameter_vector(nlp, with_it, INSTANTS)) - objective(
        nlp, z, parameter_vector(nlp, without, INSTANTS)
    )
    assert added == pytest.approx(2.0 * float(costs.at(stages[1], X, np.zeros((1, 9)))[0]) / 50.0, rel=1e-9)


def test_scaling_all_priorities_changes_nothing(nlp: Nlp, stages: tuple[Stage, ...]) -> None:
    omega = np.array([2.0, 0.3])
    once, scaled = (parameter_vector(nlp, window_over(stages[:2], omega=k * omega), INSTANTS) for k in (1.0, 512.0))
    np.testing.assert_array_equal(once, scaled)


def test_gaps_vanish_on_a_rollout_and_only_there(nlp: Nlp, stages: tuple[Stage, ...], costs: StageCosts) -> None:
    window = window_over(stages[:2])
    p = parameter_vector(nlp, window, INSTANTS)
    coasting = pack_guess(nlp, window, resting_plan(1.0, 4.0, N, window.x0), INSTANTS, costs)
    np.testing.assert_allclose(rows_of(nlp, coasting, p)[nlp.gap_rows], 0, atol=1e-12)
    assert np.abs(rows_of(nlp, random_point(nlp, window, costs), p)[nlp.gap_rows]).max() > 1e-3


def test_end_rows_are_the_named_coordinates_error_at_the_end_of_the_stage(
    nlp: Nlp, stages: tuple[Stage, ...], costs: StageCosts
) -> None:
    window = window_over(stages[:2])
    z = random_point(nlp, window, costs)
    X = unpack_plan(nlp, window, z).X[N : N + 1]
    expected = costs.errors(stages[0], X)[0, list(stages[0].end_rows)]
    np.testing.assert_allclose(
        rows_of(nlp, z, parameter_vector(nlp, window, INSTANTS))[nlp.end_rows[0]], expected, atol=1e-12
    )


def test_rows_and_variables_follow_the_order_structured_solvers_need(nlp: Nlp) -> None:
    layout = nlp.layout
    assert sum(nlp.nx) + sum(nlp.nu) == layout.size
    assert sum(nlp.nx[1:]) + sum(nlp.ng) == nlp.g.shape[0] == len(nlp.equality)
    row = 0
    for k in range(layout.K):
        assert nlp.gap_rows[k].tolist() == list(range(row, row + layout.nx))
        row += layout.nx + nlp.ng[k]


def test_bounds_hold_every_stages_limits_tolerance_and_dwell(nlp: Nlp, stages: tuple[Stage, ...]) -> None:
    limits = bounds(nlp, window_over(stages[:2]))
    state = nlp.layout.state_index
    assert np.isinf(limits.lbx[state[0]]).all()
    np.testing.assert_allclose(limits.ubx[state[1:],][:, 9:12], 0.2)
    np.testing.assert_allclose(limits.lbx[state[1:],][:, 12:], -0.15)
    np.testing.assert_allclose(limits.ubg[nlp.end_rows[0]], 2e-3)
    assert limits.lbx[nlp.layout.duration_index[0, 0]] == 1e-3


def test_mesh_divides_every_stage_evenly() -> None:
    times = mesh(np.array([1.0, 3.0]), (2, 3))
    np.testing.assert_allclose(times, [0, 0.5, 1, 2, 3, 4])
    np.testing.assert_allclose(durations(np.array([2.0]), 1.0, 4.0), [1, 3])
