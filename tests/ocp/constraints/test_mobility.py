"""Bases without thrusters: the rows that give their rates, and plans and runs that keep to them."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from psmpc_cli.control import Controller, State
from psmpc_cli.ocp.constraints.mobility import momentum_changes
from psmpc_cli.ocp.gauss_newton import Unknowns, VelocityForm
from psmpc_cli.ocp.loads import LoadKind
from psmpc_cli.ocp.objective import Intervals
from psmpc_cli.ocp.problem import build_problem
from psmpc_cli.ocp.window import window_numbers, window_shape
from psmpc_cli.plant import Plant, Setpoints
from psmpc_cli.plant.mujoco import MujocoPlant
from psmpc_cli.plant.rk4 import Rk4Plant
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.simulation.run import simulate
from psmpc_cli.solvers import Outcome
from psmpc_cli.specs.load import Task
from psmpc_cli.specs.robots.robot import stack

from .floating_windows import START, drawn, planar_task, problem_of, solved, spatial_task, window_of

MOMENTUM = np.array([0.5, -0.3, 0.2])
"""[N s, N s, N m s]"""


def drift(model: RobotModel, Q: np.ndarray, h: np.ndarray) -> np.ndarray:
    """Velocity of the base (n_twist,) with which a robot whose joints are at rest has a momentum."""
    P = np.array([model.momentum(Q, each) for each in np.eye(model.n)[model.space.base]]).T
    return np.asarray(np.linalg.solve(P, h))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["sqp", "fatrop", "ipopt"])
@pytest.mark.parametrize(
    ("momentum", "instant", "J"),
    [
        (np.zeros(3), 1.2869, 4.35661),
        (MOMENTUM, 1.378, None),
    ],
    ids=["at rest", "drifting"],
)
def test_a_window_has_the_optimum_of_the_problem_without_the_base(
    fast_arms: Path, kind: str, momentum: np.ndarray, instant: float, J: float | None
) -> None:
    """The switch time and J of the same problem in the joint rates alone, by other equations of motion and IPOPT."""
    problem = build_problem(planar_task(fast_arms))
    model = problem.model
    Q = np.r_[0, 0, 0, START["arm_1"], START["arm_2"]]
    v = np.zeros(9)
    v[model.space.base] = drift(model, Q, momentum)
    solution = solved(problem, window_of(problem, Q, v), kind)
    assert solution.outcome.usable
    assert solution.plan.switch_times == pytest.approx([instant], abs=1e-3)
    if J is not None:  # objectives are over the largest priority
        assert solution.objective * problem.stages[1].priority == pytest.approx(J, abs=1e-4)


@pytest.mark.parametrize("mobility", ["free-floating", "attitude", "fixed"])
@pytest.mark.parametrize("build", [planar_task, spatial_task])
def test_rows_and_their_derivatives(fast_arms: Path, build: Callable[..., Task], mobility: str) -> None:
    """With the rates that are solved for the rows are 0; derivatives by central differences."""
    task = build(fast_arms, {"mobility": mobility}) if build is planar_task else build({"mobility": mobility})
    problem = build_problem(task)
    model = problem.model
    n = model.n
    rng = np.random.default_rng(7)
    Q = stack(problem.spec.initial, problem.task.robot, "joint")
    form = VelocityForm(model, window_shape(window_of(problem, Q, np.zeros(n))))
    p = window_numbers(window_of(problem, Q, np.zeros(n)), np.array([1.0]))
    X = 0.3 * rng.standard_normal((form.grid.K + 1, 2 * n))
    tau = np.array([1.0])
    if mobility == "fixed":
        solved_for = form.with_dependent_rates(Unknowns(X, tau), p).X
        np.testing.assert_array_equal(solved_for[1:, n:][:, model.space.base], 0)
        return
    of_stage, _ = (each for each in form.interval_rows if each.name == "mobility")
    rows = of_stage.functions
    free = model.space.dimension if mobility == "attitude" else model.space.n_twist
    assert rows.count == free
    argument = np.asarray(of_stage.argument(p))

    def at(X: np.ndarray) -> Intervals:
        return Intervals(X, np.ones((len(X) - 1, 1)), np.zeros(0), np.array([2]))

    jacobian = rows.jacobian(at(X), argument)[0]
    step = 1e-6
    for i in range(4 * n):
        moved = np.zeros_like(X)
        moved[2 + i // (2 * n), i % (2 * n)] = step
        difference = rows.values(at(X + moved), argument) - rows.values(at(X - moved), argument)
        np.testing.assert_allclose(jacobian[:, i], difference[0] / (2 * step), atol=1e-7)
    np.testing.assert_array_equal(jacobian[:, -1], 0)

    there = form.with_dependent_rates(Unknowns(X, tau), p).X
    chart = model.space.chart_at(Q)
    momentum = model.balance(*chart.from_chart(there))[:, :free]
    np.testing.assert_allclose(momentum, np.tile(momentum[0], (len(X), 1)), atol=1e-12)
    unsolved = np.ones(2 * n, bool)
    unsolved[n : n + free] = False
    np.testing.assert_array_equal(there[:, unsolved], X[:, unsolved])


@pytest.mark.parametrize("payload", [0.0, 3.0])
def test_momentum_is_that_of_robot_and_payload(fast_arms: Path, payload: float) -> None:
    """The mass of a payload is a number of the rows: they are the same functions for each."""
    model = RobotModel(planar_task(fast_arms).robot)
    kind = LoadKind(carries=True, grippers=())
    rng = np.random.default_rng(8)
    X = 0.3 * rng.standard_normal((2, 2 * model.n))
    masses, inertias = np.array([[payload, 2.0], [0.5, 0.1]])
    intervals = Intervals(X, np.ones((1, 1)), np.zeros(0), np.array([0]))
    (found,) = momentum_changes(model, kind).values(intervals, np.r_[masses, inertias])
    parameters = model.nominal.holding(masses, inertias)
    begin, end = (model.momentum(*np.split(x, 2), parameters) for x in X)
    np.testing.assert_allclose(found, end - begin, atol=1e-12)


def test_another_payload_rebuilds_nothing(fast_arms: Path) -> None:
    """The shape of a stage decides its functions: rows of momentum and of forces, and what force costs."""
    changes = {
        "object": {"shape": [0.2, 0.2], "pose": [0, 1, 0], "taken_by": "reach"},
        "limits": {"arms": {"force": [4.0] * 3}},
        "skills.home.weights.force": 0.02,
    }
    shapes = []
    for mass in (5, 8):
        payload = {"mass": mass, "inertia": 0.7, "known": True}
        problem = build_problem(planar_task(fast_arms, {**changes, "uncertainty.payload": payload}))
        window = window_of(problem, stack(problem.spec.initial, problem.task.robot, "joint"), np.zeros(9))
        shapes.append(window_shape(window))
        assert window.stages[1].load_numbers.sum() == pytest.approx(mass + 0.7)
    assert shapes[0] == shapes[1]
    assert shapes[0].stages[1].force_load == LoadKind(carries=True, grippers=())
    assert {name for name, _ in shapes[0].stages[1].constraints} >= {"forces", "mobility"}


@pytest.mark.slow
@pytest.mark.parametrize("mobility", ["free-flying", "free-floating", "fixed"])
@pytest.mark.parametrize(("where", "seed"), [("plane", 0), ("space", 1)])
def test_sqp_and_ipopt_agree(fast_arms: Path, mobility: str, where: str, seed: int) -> None:
    """Windows from random states, with momentum where the base moves: J to 1e-5, both from the plan of `sqp`.

    `benchmarks/mobility_windows.py` has 20 a mobility.

    Limits of rates are those in the chart about a guess, so solves of the same guess are compared.
    """
    problem = problem_of(mobility, fast_arms if where == "plane" else None)
    window = drawn(problem, seed)
    first = solved(problem, window, "sqp")
    assert first.outcome is Outcome.OPTIMAL
    own = solved(problem, window, "sqp", first.plan)
    other = solved(problem, window, "ipopt", first.plan)
    assert own.outcome is Outcome.OPTIMAL
    assert other.outcome is Outcome.OPTIMAL
    assert own.objective == pytest.approx(other.objective, rel=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mobility", "where", "seed"),
    [
        ("free-floating", "plane", 2),
        ("free-floating", "plane", 4),
        ("free-floating", "space", 18),
        ("fixed", "space", 17),
    ],
)
def test_a_window_without_a_solution_where_it_is_linearized_is_solved(
    fast_arms: Path, mobility: str, where: str, seed: int
) -> None:
    """From rest the first or second program has no step; J to 1e-5 is that of IPOPT from the plan of `sqp`."""
    problem = problem_of(mobility, fast_arms if where == "plane" else None)
    window = drawn(problem, seed)
    found = solved(problem, window, "sqp")
    assert found.outcome is Outcome.OPTIMAL
    own = solved(problem, window, "sqp", found.plan)
    other = solved(problem, window, "ipopt", found.plan)
    assert own.outcome is other.outcome is Outcome.OPTIMAL
    assert own.objective == pytest.approx(other.objective, rel=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("plant", [Rk4Plant, MujocoPlant])
@pytest.mark.parametrize("build", ["plane", "space"])
def test_a_floating_robot_keeps_its_momentum_and_moves_its_base_as_planned(
    fast_arms: Path, build: str, plant: Callable[..., Plant]
) -> None:
    """Joint forces alone: base force exactly 0, momentum kept, and the base within 1e-3 of each sample's plan."""
    task = planar_task(fast_arms, {"controller.horizon": 4}) if build == "plane" else spatial_task()
    controller = Controller(task)
    model = controller.problem.model
    space = model.space
    physics = plant(model, 1e-3)
    Q = stack(task.spec.initial, task.robot, "joint")
    h = MOMENTUM / 2 if build == "plane" else np.array([0.05, 0, 0, 0, 0.01, 0.01])
    x = np.r_[Q, np.zeros(model.n)]
    x[model.nq :][space.base] = drift(model, Q, h)
    time = 0.0
    while not controller.done and time < 15:
        command = controller.step(time, State(x[: model.nq], x[model.nq :]))
        ticks = physics.advance(time, x, Setpoints(command.u))
        assert (ticks.F[:, space.base] == 0.0).all()
        chart = command.plan.chart
        planned = command.plan.states_at(ticks.time[-1:])
        reached = chart.states_in_chart(ticks.states[-1:])
        assert np.abs(reached - planned)[0, : space.n_twist].max() < 1e-3
        x = ticks.states[-1]
        time = float(ticks.time[-1])
        assert model.momentum(x[: model.nq], x[model.nq :]) == pytest.approx(h, abs=1e-10)
    assert controller.done


@pytest.mark.slow
@pytest.mark.parametrize("plant", ["rk4", "mujoco"])
@pytest.mark.parametrize("build", ["plane", "space"])
def test_a_fixed_base_stands_still(fast_arms: Path, build: str, plant: str) -> None:
    changes = {"mobility": "fixed", "plant.kind": plant, "log.ticks": True}
    run = simulate(planar_task(fast_arms, changes) if build == "plane" else spatial_task(changes))
    space = run.problem.model.space
    assert run.summary().succeeded
    assert (run["ticks/F"][:, space.base] == 0.0).all()
    assert (run["ticks/Q"][:, space.base_coordinates] == run["ticks/Q"][0, space.base_coordinates]).all()
    assert (run["ticks/Qdot"][:, space.base] == 0.0).all()
