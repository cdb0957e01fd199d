"""What wheels store and what their motors give: rows of plans that are those of the plants, and optima of them."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from psmpc_cli.control import State
from psmpc_cli.ocp.constraints import interval_rows, node_rows
from psmpc_cli.ocp.constraints.base import is_entry_of
from psmpc_cli.ocp.constraints.wheels import wheel_momenta
from psmpc_cli.ocp.loads import FOLLOWS, NOTHING, STAYS, LoadKind, known_load
from psmpc_cli.ocp.objective import Intervals
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.ocp.problem import Problem, build_problem
from psmpc_cli.ocp.window import Window, window_numbers, window_shape
from psmpc_cli.plant.base import Setpoints
from psmpc_cli.robot.actuators.wheels import Wheels
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.simulation.run import build_experiment
from psmpc_cli.solvers import Outcome, Solution
from psmpc_cli.specs.load import Task, load_robot
from psmpc_cli.specs.robots.robot import stack

from ...wheeled import changing_in, planar_in, spatial_in
from .floating_windows import solved

BUILDS = pytest.mark.parametrize("build", [planar_in, spatial_in])


def a_solve(task: Task, seed: int) -> tuple[Problem, Solution]:
    """The first solve over several stages of a loop from a random state near the initial one, or the last of 5 s."""
    experiment = build_experiment(task)
    model = experiment.problem.model
    drive = experiment.drive
    assert drive is not None
    random = np.random.default_rng(seed)
    start = stack(task.spec.initial, task.robot, "joint")
    Q = model.space.path(start, 0.05 * random.standard_normal((1, model.n)))[-1]
    x = np.r_[Q, 0.005 * random.standard_normal(model.n)]
    for sample in range(50):
        command = experiment.controller.step(0.1 * sample, State.of(x, drive.momentum))
        x = experiment.plant.advance(0.1 * sample, x, Setpoints(command.u, driven=command.driven)).states[-1]
        if sample > 1 and len(command.solution.window.stages) > 1:
            break
    return experiment.problem, command.solution


@BUILDS
def test_what_follows_from_the_state_is_what_plants_store(tmp_path: Path, build: Callable[..., Task]) -> None:
    """Along a motion of the plant: h = A^+ h_w(x, L) + what adds up to nothing, to rounding; derivatives as well."""
    task = build(tmp_path, {"plant.low_level_rate": 1000})
    experiment = build_experiment(task)
    model = experiment.problem.model
    drive = experiment.drive
    assert drive is not None
    wheels = drive.wheels
    random = np.random.default_rng(4)
    x = np.r_[experiment.initial_state[: model.nq], 0.05 * random.standard_normal(model.n)]
    load = known_load(task.spec, model, 0)
    assert load.stores == FOLLOWS
    at_first = (
        model.momentum(x[: model.nq], x[model.nq :])
        + wheels.momentum_and_energy(x[None, : model.nq], drive.momentum[None])[0, :-1]
    )
    L = at_first[model.space.rotation]
    argument = np.r_[x[: model.nq][model.space.attitude], load.numbers[: -len(L)], L, wheels.unseen @ drive.momentum]
    u = 0.005 * np.sin(np.outer(np.arange(400) / 40, 1 + np.arange(model.n)))  # no motor is cut
    ticks = experiment.plant.advance(0.0, x, Setpoints(u))
    assert ticks.wheels is not None
    X = model.space.chart_at(x[: model.nq]).states_in_chart(ticks.states)
    rows = wheel_momenta(model, load.kind)
    most = build_problem(task).stages[0].constraints["wheels 1"].high
    (stored,) = rows.value(X, argument, rows=len(X))
    np.testing.assert_allclose(stored / most * wheels.momentum, ticks.wheels.momentum, rtol=0, atol=1e-12)
    assert np.ptp(ticks.wheels.momentum, axis=0).min() > 1e-4
    _, by_x = rows.with_jacobian(X[200], argument)
    for i, step in enumerate(1e-6 * np.eye(2 * model.n)):
        ((above,), (below,)) = rows.value(X[200] + step, argument)[0], rows.value(X[200] - step, argument)[0]
        difference = (above - below) / 2e-6
        np.testing.assert_allclose(by_x.reshape(wheels.count, -1)[:, i], difference, atol=1e-7)


@BUILDS
def test_rows_of_motor_torques_are_those_of_the_law(tmp_path: Path, build: Callable[..., Task]) -> None:
    """At the beginning of an interval, for its acceleration, with what wheels store at the sample."""
    problem, solution = a_solve(build(tmp_path), 3)
    window = solution.window
    model = problem.model
    n = model.n
    wheels = Wheels.of(model.spec)
    (of_stage,) = (rows for rows in interval_rows(model, window_shape(window)) if rows.name == "forces 1")
    (of_nodes,) = (rows for rows in node_rows(model, window_shape(window)) if rows.name == "wheels 1")
    p = window_numbers(window, solution.plan.switch_times)
    stored = np.asarray(of_nodes.functions.value(window.x0, np.asarray(of_nodes.argument(p)))[0][0])
    h_wheels = stored / of_nodes.bounds(window)[1] * wheels.momentum
    assert np.abs(h_wheels - wheels.initial).max() > 1e-4
    h = 0.05
    u = 0.02 * np.random.default_rng(5).standard_normal(n)
    X = np.array([window.x0, window.x0 + h * np.r_[window.x0[n:], u]])
    interval = Intervals(X, np.array([[h]]), np.zeros(0), np.array([0]))
    (values,) = of_stage.functions.values(interval, np.asarray(of_stage.argument(p)))
    _, high = of_stage.bounds(window)
    of_motors = slice(len(high) // 2 - wheels.count, len(high) // 2)
    torques = values[of_motors] / high[of_motors] * wheels.torque / h
    (Q,), (v,) = window.chart.from_chart(window.x0[None])
    parameters = model.nominal.storing(wheels.axes @ h_wheels)
    # where the chart has its anchor rates of v are those of its coordinates
    F = model.computed_torque(Q, v, u, parameters, model.driven(problem.stages[0].moved_by))
    np.testing.assert_allclose(torques, -wheels.allocation @ F[model.space.rotation], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    ("build", "mobility", "stores"),
    [
        (planar_in, "attitude", FOLLOWS),
        (spatial_in, "attitude", FOLLOWS),
        (spatial_in, "free-floating", STAYS),
        (planar_in, "free-floating", NOTHING),
        (planar_in, "free-flying", NOTHING),
    ],
)
def test_what_is_known_of_wheels(tmp_path: Path, build: Callable[..., Task], mobility: str, stores: str) -> None:
    task = build(tmp_path, {"stages.0.mobility": mobility})
    model = RobotModel(task.robot)
    load = known_load(task.spec, model, 0)
    assert load.stores == stores
    assert (
        len(load.numbers)
        == load.kind.count(model)
        == (0 if stores == NOTHING else model.space.n_twist - model.dimension)
    )


def test_a_robot_without_wheels_has_no_rows_and_no_numbers_of_them() -> None:
    model = RobotModel(load_robot("free_flyer_arm"))
    assert model.nominal.stored.shape == (0,)
    assert LoadKind(carries=False, grippers=()).count(model) == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("build", "seed", "tight"),
    [
        (planar_in, 0, {"torque": 0.05}),
        (spatial_in, 3, {"momentum": 0.11}),
        (changing_in, 4, {"torque": 0.01}),
    ],
)
def test_sqp_and_ipopt_agree(tmp_path: Path, build: Callable[..., Task], seed: int, tight: dict[str, float]) -> None:
    """Windows from random states with limits that bind: J to 1e-5, both from the plan of `sqp`."""
    problem, solution = a_solve(build(tmp_path, {}, **tight), seed)
    window = solution.window
    assert len(window.stages) > 1
    first = solved(problem, window, "sqp", solution.plan)
    own = solved(problem, window, "sqp", first.plan)
    other = solved(problem, window, "ipopt", first.plan)
    assert own.outcome is other.outcome is Outcome.OPTIMAL
    assert own.objective == pytest.approx(other.objective, rel=1e-5)
    assert np.isclose(utilization(problem.model, window, own.plan), 1.0, atol=1e-6) or build is changing_in


def utilization(model: RobotModel, window: Window, plan: Plan) -> float:
    """The largest part of a limit of wheels that a plan uses."""
    p = window_numbers(window, plan.switch_times)
    shape = window_shape(window)
    largest = 0.0
    h = np.diff(plan.times)[:, None]
    for rows in interval_rows(model, shape):
        if is_entry_of("forces", rows.name):
            k = np.array(rows.intervals)
            at = Intervals(plan.X, h, p.before, k)
            values = rows.functions.values(at, np.asarray(rows.argument(p))) / h[k]
            largest = max(largest, float(np.abs(values / rows.bounds(window)[1]).max()))
    for of_nodes in node_rows(model, shape):
        if is_entry_of("wheels", of_nodes.name):
            X = plan.X[list(of_nodes.nodes)]
            (values,) = of_nodes.functions.value(X, np.asarray(of_nodes.argument(p)), rows=len(X))
            largest = max(largest, float(np.abs(values / of_nodes.bounds(window)[1]).max()))
    return largest
