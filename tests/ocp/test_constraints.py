"""The constraints at nodes: every back-end takes the same rows, and their derivatives are those of the rows."""

from collections.abc import Iterator
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray

from psmpc_cli.ocp.constraints import (
    CONSTRAINTS,
    Constraint,
    ConstraintFunctions,
    IntervalFunctions,
    IntervalRows,
    NodeRows,
    node_rows,
    rows_at_nodes,
)
from psmpc_cli.ocp.plan import resting_plan
from psmpc_cli.ocp.problem import Problem, build_problem, in_own_chart
from psmpc_cli.ocp.stage import ConstraintNumbers
from psmpc_cli.ocp.window import Kept, Window, WindowShape, window_numbers, window_shape
from psmpc_cli.ocp.window_record import WindowFrame, read_window, record_of
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.simulation.run import simulate
from psmpc_cli.solvers import Outcome, build_solver
from psmpc_cli.solvers.nlp import Nlp
from psmpc_cli.specs.controller import SolverSpec
from psmpc_cli.specs.load import load_task
from psmpc_cli.specs.robots.robot import stack
from psmpc_cli.specs.task import TaskSpec

from .constraints.held_objects import without_forces

Array = NDArray[np.float64]

BOUND = 0.3
INSTANT = 1.4


@pytest.fixture(scope="module", params=["transport", "servicing"])
def problem(request: pytest.FixtureRequest) -> Problem:
    return build_problem(load_task(request.param))


def window_of(problem: Problem, kept: bool) -> Window:
    """Two stages with an end condition between them, or one that keeps the errors of the other at every node."""
    task = problem.task
    Q = stack(task.spec.initial, task.robot, "joint")
    placed = [in_own_chart(problem.model, each, Q, np.zeros(problem.model.n)) for each in problem.stages[:2]]
    stages, states = zip(*((without_forces(stage), state) for stage, state in placed), strict=True)
    rows = len(stages[0].weights)
    earlier = Kept(stages[0], 1.0, np.full((6, rows), BOUND))
    of_window = stages[1:] if kept else stages
    return Window(
        stages=of_window,
        start=0.0,
        elapsed=0.0,
        x0=states[0],
        omega=np.ones(len(of_window)),
        offset=np.zeros(len(of_window)),
        scale=np.ones(len(of_window)),
        horizon=3.0,
        pending_cost=0.01,
        terminal_cost=0.0,
        nodes=(6,) if kept else (4, 2),
        kept=(earlier,) if kept else (),
        chart=problem.model.space.chart_at(Q),
    )


def rows_of(problem: Problem, window: Window) -> list[NodeRows]:
    return node_rows(problem.model, window_shape(window))


def some_state(model: RobotModel) -> Array:
    return 0.4 * np.random.default_rng(3).standard_normal(2 * model.n)


def test_an_end_condition_stands_at_the_last_node_of_its_stage(problem: Problem) -> None:
    window = window_of(problem, kept=False)
    (rows,) = rows_of(problem, window)
    stage = window.stages[0]
    x = some_state(problem.model)
    p = window_numbers(window, np.array([INSTANT]))
    assert list(rows.nodes) == [4]
    low, high = rows.bounds(window)
    found = rows.functions.value(x, rows.argument(p))[0].ravel()
    np.testing.assert_allclose(found - (low + high) / 2, problem.costs.ends(stage, x[None])[0], atol=1e-12)
    np.testing.assert_allclose((high - low) / 2, stage.end.half_widths)


def test_kept_errors_stand_at_every_node_after_the_first(problem: Problem) -> None:
    window = window_of(problem, kept=True)
    rows = rows_of(problem, window)
    x = some_state(problem.model)
    p = window_numbers(window, np.zeros(0))
    assert [list(each.nodes) for each in rows] == [[1], [2], [3], [4], [5], [6]]
    for each in rows:
        found = each.functions.value(x, each.argument(p))[0].ravel()
        np.testing.assert_allclose(found, problem.costs.errors(window.kept[0].stage, x[None])[0], atol=1e-12)
        np.testing.assert_array_equal(each.bounds(window)[1], BOUND)


@pytest.mark.parametrize("kept", [False, True])
def test_derivatives_are_those_of_the_rows(problem: Problem, kept: bool) -> None:
    window = window_of(problem, kept)
    rows = rows_of(problem, window)[0]
    n = problem.model.n
    x = some_state(problem.model)
    a = rows.argument(window_numbers(window, np.array([INSTANT][: not kept])))
    value, jacobian = rows.functions.with_jacobian(x, a)
    jacobian = jacobian.reshape(rows.functions.count, 2 * n)
    h = 1e-6
    differences = [
        (rows.functions.value(x + h * each, a)[0] - rows.functions.value(x - h * each, a)[0]).ravel() / (2 * h)
        for each in np.eye(2 * n)
    ]
    np.testing.assert_allclose(jacobian, np.transpose(differences), atol=1e-8)
    np.testing.assert_allclose(value.ravel(), rows.functions.value(x, a)[0].ravel(), atol=1e-14)
    curvature = rows.functions.curvature
    if curvature is not None:
        y = np.random.default_rng(4).standard_normal(rows.functions.count)
        upper = curvature(x, a, y)[0].reshape(n, n)

        def by_Q(at: Array) -> Array:
            return (y @ rows.functions.with_jacobian(at, a)[1].reshape(-1, 2 * n))[:n]

        ahead = [(by_Q(x + h * each) - by_Q(x - h * each)) / (2 * h) for each in np.eye(2 * n)[:n]]
        np.testing.assert_allclose(upper, np.triu(ahead), atol=1e-7)


@pytest.mark.parametrize("kept", [False, True])
def test_the_nonlinear_program_has_the_same_rows(problem: Problem, kept: bool) -> None:
    window = window_of(problem, kept)
    switch_times = np.array([INSTANT][: not kept])
    p = window_numbers(window, switch_times)
    nlp = Nlp(problem.model, window_shape(window), p)
    plan = replace(resting_plan(0.0, 3.0, 6, window.x0, window.chart), switch_times=switch_times)
    bounds = nlp.bounds(window, plan, np.inf)
    X = np.array([some_state(problem.model) * (1 + k) for k in range(7)])
    tau = np.tile(switch_times[:, None], 7)
    sums = np.zeros((0, 7))
    x = nlp.pack(
        X.T, tau, sums, np.zeros((0, 7)), np.zeros((0, 7)), [], *(np.zeros((problem.model.n, N)) for N in window.nodes)
    )
    g = np.asarray(nlp.rows(x, ca.vertcat(*(ca.vec(ca.DM(each)) for each in p.pieces())))).ravel()
    for rows in rows_of(problem, window):
        value = rows.functions.value(X[rows.nodes[0]], rows.argument(p))[0].ravel()
        _, high = rows.bounds(window)
        places = [i for i in range(len(g) - len(value) + 1) if np.allclose(g[i : i + len(value)], value, atol=1e-12)]
        assert any(np.array_equal(bounds["ubg"][i : i + len(value)], high) for i in places)


CENTRE = np.array([-0.4, 0.5])
RADIUS = 0.3
"""A disc on the way of the base in the first stage of transport."""


@pytest.fixture
def disc_in_first_stage(monkeypatch: pytest.MonkeyPatch) -> None:
    """A constraint with numbers of the task: all that a new one is, but for its key in the task."""

    def numbers(task: TaskSpec, model: RobotModel, stage: int) -> ConstraintNumbers | None:
        edge = np.zeros(1)
        return None if stage else ConstraintNumbers((), np.append(CENTRE, RADIUS), edge, np.inf + edge)

    def functions(model: RobotModel, structure: tuple[str, ...]) -> ConstraintFunctions:
        """(|p - c|^2 / r - r) / 2 >= 0: near the edge the distance from it."""
        x = ca.SX.sym("x", 2 * model.n)
        argument = ca.SX.sym("argument", model.space.n_anchor + 3)
        centre, radius = argument[-3:-1], argument[-1]
        return ConstraintFunctions(x, argument, (ca.sumsqr(x[:2] - centre) / radius - radius) / 2)

    monkeypatch.setitem(CONSTRAINTS, "disc", Constraint(rows_at_nodes("disc", functions), numbers))


@pytest.mark.usefixtures("disc_in_first_stage")
def test_numbers_that_a_constraint_has_of_a_stage_are_in_windows_and_those_of_their_records() -> None:
    problem = build_problem(load_task("transport"))
    Q = stack(problem.spec.initial, problem.task.robot, "joint")
    window = window_of(problem, kept=False)
    frame = WindowFrame(window.indices, window.nodes, 0.0, Q, np.zeros(problem.model.n))
    for each in (window, read_window(problem, frame, record_of(window))):
        (rows,) = (rows for rows in rows_of(problem, each) if rows.name == "disc")
        argument = rows.argument(window_numbers(each, np.array([INSTANT])))
        assert list(rows.nodes) == [1, 2, 3, 4]
        np.testing.assert_array_equal(argument, [*CENTRE, RADIUS])
        np.testing.assert_array_equal(rows.bounds(each), [[0], [np.inf]])


@pytest.mark.slow
@pytest.mark.usefixtures("disc_in_first_stage")
@pytest.mark.parametrize("solver", ["sqp", "fatrop", "ipopt"])
def test_every_solver_leads_the_base_round_a_disc(solver: str) -> None:
    """Between nodes it may cut into the disc: over an interval h at the speed v by (v h)^2 / (8 r).

    By twice that at most: a sample may begin between two nodes of the plan before it, within the disc by as much.
    """
    largest_speed = 0.2 * np.sqrt(2)
    h = 4.0 / 20
    changes = {
        "controller.nodes": 20,
        "plant.kind": "ideal",
        "log.shares": False,
        "solver.kind": solver,
        "time_limit": 6.0,
    }
    run = simulate(load_task("transport", changes))
    distances = np.linalg.norm(run.motion.Q[:, :2] - CENTRE, axis=1)
    assert not run["events/solve_failed"].any()
    assert 0 <= RADIUS - distances.min() <= 2 * (largest_speed * h) ** 2 / (8 * RADIUS)
    assert run.motion.Q[-1, 0] < -0.9  # behind it


SLOW = 0.06
"""Acceleration of the base that is too little for its first stage [m/s^2, rad/s^2]."""


@pytest.fixture
def slow_base_over_intervals(monkeypatch: pytest.MonkeyPatch) -> None:
    """A constraint over intervals that says the same as a limit on the base's acceleration."""

    def rows(model: RobotModel, shape: WindowShape) -> Iterator[IntervalRows]:
        x, dv = ca.SX.sym("x", 2 * model.n), ca.SX.sym("dv", model.n)
        nothing = ca.SX.sym("nothing", 0)
        functions = IntervalFunctions(x, dv, ca.SX.sym("h"), nothing, dv[:3], ends=(0,))
        bounds = -SLOW * np.ones(3), SLOW * np.ones(3)
        yield IntervalRows("slow", range(sum(shape.nodes)), functions, lambda p: np.zeros(0), lambda window: bounds)

    monkeypatch.setitem(CONSTRAINTS, "slow", Constraint(rows, lambda task, model, stage: None))


def resting_window(problem: Problem) -> Window:
    """A window over the first stage alone, from rest."""
    both = window_of(problem, kept=False)
    alone = np.ones(1)
    return replace(both, stages=both.stages[:1], omega=alone, offset=0 * alone, scale=alone, nodes=(6,))


@pytest.fixture(scope="module")
def slow_optimum() -> float:
    """J where the limit is one on accelerations, which has a path of its own."""
    problem = build_problem(load_task("transport"))
    window = resting_window(problem)
    high = window.stages[0].limits.acceleration_high.copy()
    high[:3] = SLOW
    limits = replace(window.stages[0].limits, acceleration_low=-high, acceleration_high=high)
    window = replace(window, stages=(replace(window.stages[0], limits=limits),))
    solver = build_solver(problem, SolverSpec(kind="sqp", tolerance=1e-9, iterations=50))
    return solver.solve(window, resting_plan(0.0, 3.0, 6, window.x0, window.chart)).objective


@pytest.mark.parametrize("solver", ["sqp", "fatrop", "ipopt"])
def test_every_solver_keeps_what_is_bounded_over_intervals(
    solver: str, slow_optimum: float, slow_base_over_intervals: None
) -> None:
    problem = build_problem(load_task("transport"))
    window = resting_window(problem)
    spec = SolverSpec(kind=solver, tolerance=1e-9, iterations=50)
    found = build_solver(problem, spec).solve(window, resting_plan(0.0, 3.0, 6, window.x0, window.chart))
    assert found.outcome is Outcome.OPTIMAL
    assert np.abs(found.plan.u[:, :3]).max() == pytest.approx(SLOW, abs=1e-6)
    assert found.objective == pytest.approx(slow_optimum, rel=1e-6)
