"""Bases without thrusters: the rows that give their rates, and plans and runs that keep to them."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from psmpc_cli.control import Controller, State
from psmpc_cli.ocp.constraints.mobility import functions
from psmpc_cli.ocp.loads import LoadKind, known_load
from psmpc_cli.ocp.problem import build_problem
from psmpc_cli.ocp.window import window_shape
from psmpc_cli.plant import Plant
from psmpc_cli.plant.mujoco import MujocoPlant
from psmpc_cli.plant.rk4 import Rk4Plant
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.simulation.run import simulate
from psmpc_cli.solvers import Outcome
from psmpc_cli.specs.load import Task
from psmpc_cli.specs.robot import stack

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
    assert solution.plan.instants == pytest.approx([instant], abs=1e-3)
    if J is not None:  # objectives are over the largest priority
        assert solution.objective * problem.stages[1].priority == pytest.approx(J, abs=1e-4)


@pytest.mark.parametrize("mobility", ["free-floating", "fixed"])
@pytest.mark.parametrize("build", [planar_task, spatial_task])
def test_rows_and_their_derivatives(fast_arms: Path, build: Callable[..., Task], mobility: str) -> None:
    """At the rates that momentum, or the mount, gives the base the rows are 0; derivatives by central differences."""
    task = build(fast_arms, {"mobility": mobility}) if build is planar_task else build({"mobility": mobility})
    model = RobotModel(task.robot)
    rng = np.random.default_rng(7)
    Q = model.space.path(model.space.neutral, 0.4 * rng.standard_normal((1, model.n)))[-1]
    anchor = np.asarray(Q[model.space.attitude])
    own = functions(model, known_load(task.spec, model, 0).kind)
    x = 0.3 * rng.standard_normal(2 * model.n)
    h = rng.standard_normal(model.space.n_twist)
    argument = np.r_[anchor, h if mobility == "free-floating" else []]
    value, jacobian = own.with_jacobian(x, argument)
    jacobian = jacobian.reshape(model.space.n_twist, -1)
    step = 1e-6
    for i, e in enumerate(np.eye(len(x))):
        difference = own.value(x + step * e, argument)[0] - own.value(x - step * e, argument)[0]
        np.testing.assert_allclose(jacobian[:, i], difference.ravel() / (2 * step), atol=1e-7)
    G = own.by_solved_for(x, argument)[1].reshape(model.space.n_twist, -1)
    x[model.n :][model.space.base] -= np.linalg.solve(G, value.ravel())
    np.testing.assert_allclose(own.value(x, argument)[0], 0, atol=1e-12)
    if mobility == "free-floating":
        there, v = model.space.chart_at(Q).from_chart(x[None])
        np.testing.assert_allclose(model.momentum(there[0], v[0]), h, atol=1e-10)


@pytest.mark.parametrize("payload", [0.0, 3.0])
def test_momentum_is_that_of_robot_and_payload(fast_arms: Path, payload: float) -> None:
    """The mass of a payload is a number of the rows: they are the same functions for each."""
    model = RobotModel(planar_task(fast_arms).robot)
    kind = LoadKind(carries=True, grippers=())
    rng = np.random.default_rng(8)
    x = 0.3 * rng.standard_normal(2 * model.n)
    h = rng.standard_normal(model.space.n_twist)
    masses, inertias = np.array([[payload, 2.0], [0.5, 0.1]])
    found = functions(model, kind).value(x, np.r_[h, masses, inertias])[0].ravel()
    parameters = model.nominal.holding(masses, inertias)
    np.testing.assert_allclose(found, model.momentum(*np.split(x, 2), parameters) - h, atol=1e-12)


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
        ticks = physics.advance(time, x, command.u)
        assert (ticks.F[:, space.base] == 0.0).all()
        chart = command.plan.chart
        planned = command.plan.states_at(ticks.time[-1:])
        reached = chart.entered(ticks.states[-1:])
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
