"""Cones: the rows of axes within and outside them, plans that keep them, and runs."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from psmpc_cli.ocp.constraints import NodeRows, node_rows, soft_row_violations
from psmpc_cli.ocp.constraints.cones import SIDES, angle_of_axis
from psmpc_cli.ocp.plan import resting_plan
from psmpc_cli.ocp.problem import Problem, build_problem, in_own_chart
from psmpc_cli.ocp.window import Window, window_numbers, window_shape
from psmpc_cli.ocp.window_record import WindowFrame, read_window, record_of
from psmpc_cli.robot.configuration import TILT
from psmpc_cli.simulation.run import simulate
from psmpc_cli.solvers import Outcome, build_solver
from psmpc_cli.specs.controller import SolverSpec
from psmpc_cli.specs.geometry import ConeSpec
from psmpc_cli.specs.load import Task, load_task
from psmpc_cli.specs.robots.robot import stack

Array = NDArray[np.float64]

NODES = 12

POINT = [2.0, 0.0, 0.0]
"""At which the base looks at the start."""

LOST = 1 - np.cos(np.pi / (2 * SIDES))
"""What the polygon of an axis within a cone in space leaves of its angle, at most."""


def planar(*cones: Mapping[str, Any], changes: Mapping[str, Any] | None = None, turned: float = 0.0) -> Task:
    """The base turns away from the point while it flies past it."""
    task = {
        "robot": "planar_dual_arm",
        "initial": {"base": [0, 0, turned], "arms": [0.2, 0.3, -0.4]},
        "controller": {"nodes": NODES, "horizon": 3},
        "skills": {"move": {"space": "joint", "weights": {"base": [100, 100, 10], "arms": [1, 1, 1], "control": 1}}},
        "stages": [
            {
                "name": "go",
                "skill": "move",
                "target": {"base": [-1, 1, 0.5], "arms": [0.5, 0.2, 0.2]},
                "ends_when": {"coordinates": ["base.x", "base.y"], "tolerance": 0.02},
                "cones": list(cones),
            }
        ],
    }
    return load_task(task, changes or {})


def spatial(*cones: Mapping[str, Any], turned: float = 0.0) -> Task:
    """The same in space, about a skew axis."""
    start = {"position": [0, 0, 0], "attitude": {"axis": [0.0, 0.6, 0.8], "angle": turned}}
    goal = {"position": [-1, 1, 0.3], "attitude": {"rpy": [0.2, -0.4, 0.5]}}
    weights = {"base": [100, 100, 100, 10, 10, 10], "arm": [1, 1, 1], "control": 1}
    return load_task(
        {
            "robot": "free_flyer_arm",
            "initial": {"base": start, "arm": [0, 0.5, -0.5]},
            "controller": {"nodes": NODES, "horizon": 3},
            "skills": {"move": {"space": "joint", "weights": weights}},
            "stages": [
                {
                    "name": "go",
                    "skill": "move",
                    "target": {"base": goal, "arm": [0.5, 0.2, 0.2]},
                    "ends_when": {"coordinates": "all", "tolerance": 0.02},
                    "cones": list(cones),
                }
            ],
        }
    )


BUILDS = {2: planar, 3: spatial}


def cone(dimension: int, **keys: Any) -> dict[str, Any]:
    """A cone about the point, of the x-axis of the base unless the keys say more."""
    axis = [1.0, 0.0, 0.0][:dimension]
    return {"frame": "base", "axis": axis, "of": {"point": POINT[:dimension]}, **keys}


def window_of(problem: Problem) -> Window:
    """The only stage of a task from its initial state, at rest."""
    Q = stack(problem.spec.initial, problem.task.robot, "joint")
    stage, x = in_own_chart(problem.model, problem.stages[0], Q, np.zeros(problem.model.n))
    one = np.ones(1)
    return Window(
        stages=(stage,),
        start=0.0,
        elapsed=0.0,
        x0=x,
        omega=one,
        offset=0 * one,
        scale=100 * one,
        horizon=3.0,
        pending_cost=0.01,
        terminal_cost=0.0,
        nodes=(NODES,),
        chart=problem.model.space.chart_at(Q),
    )


def rows_of(problem: Problem, window: Window) -> list[NodeRows]:
    return [rows for rows in node_rows(problem.model, window_shape(window)) if rows.name.startswith("cones")]


def some_state(problem: Problem, seed: int) -> Array:
    return 0.4 * np.random.default_rng(seed).standard_normal(2 * problem.model.n)


def angle_at(problem: Problem, window: Window, spec: ConeSpec, x: Array) -> float:
    """The angle of a cone's axis at a state (2n,) of a window's chart."""
    Q, _ = window.chart.from_chart(x[None])
    poses = dict(zip(problem.model.pose_rows, problem.model.poses(Q[0]), strict=True))
    return angle_of_axis(spec, poses[spec.frame], problem.model.space)


def several_cones(dimension: int) -> list[dict[str, Any]]:
    """Of all kinds: on base and arm, about point and direction, hard and soft, beyond 90 deg."""
    arm = "arm_1" if dimension == 2 else "arm"
    skew = [0.6, -0.8, 0.3][:dimension]
    return [
        cone(dimension, within=0.3),
        cone(dimension, outside=0.4, hard=True),
        cone(dimension, frame=arm, within=2.5, axis=skew, apex=[0.1, -0.2, 0.3][:dimension]),
        cone(dimension, frame=arm, outside=2.0, of={"direction": skew}, hard=True),
        cone(dimension, frame=arm, within=0.2, axis=[-1.0, 0.0, 0.0][:dimension], of={"direction": skew}),
    ]


@pytest.fixture(scope="module", params=[2, 3], ids=["plane", "space"])
def problem(request: pytest.FixtureRequest) -> Problem:
    return build_problem(BUILDS[request.param](*several_cones(request.param)))


@given(seed=st.integers(0, 10**6))
@settings(max_examples=8)
def test_a_state_is_allowed_where_the_angles_are(problem: Problem, seed: int) -> None:
    """Between the polygon in space and the cone the rows forbid what the cone allows: states there are not judged."""
    window = window_of(problem)
    x = some_state(problem, seed)
    p = window_numbers(window, np.zeros(0))
    lost = 0.0 if problem.model.dimension == 2 else LOST
    for spec, rows in zip(problem.spec.stages[0].cones, rows_of(problem, window), strict=True):
        value = rows.functions.value(x, rows.argument(p))[0].ravel()
        low, high = rows.bounds(window)
        excess = np.maximum(low - value, value - high)
        angle = angle_at(problem, window, spec, x)
        beyond = angle - spec.angle if spec.within is not None else spec.angle - angle
        narrow = min(spec.angle, np.pi - spec.angle)
        if not -lost * narrow < beyond < 0:
            assert (excess.max() > 0) == (beyond > 0)


def test_each_cone_is_soft_or_hard_at_every_node(problem: Problem) -> None:
    for spec, rows in zip(problem.spec.stages[0].cones, rows_of(problem, window_of(problem)), strict=True):
        assert rows.soft is not spec.hard
        assert list(rows.nodes) == list(range(1, NODES + 1))


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("angle", [0.02, 0.5, 1.2])
@pytest.mark.parametrize("side", ["within", "outside"])
def test_rows_have_the_slope_of_the_angle_at_the_edge(dimension: int, angle: float, side: str) -> None:
    """The base turns about z, which in space is across two sides of the polygon."""
    problem = build_problem(BUILDS[dimension](cone(dimension, **{side: angle}, of={"direction": POINT[:dimension]})))
    window = window_of(problem)
    (rows,) = rows_of(problem, window)
    a = rows.argument(window_numbers(window, np.zeros(0)))
    turn = problem.model.space.rotation.stop - 1
    x = np.zeros(2 * problem.model.n)

    def value(at: float) -> Array:
        x[turn] = at
        return rows.functions.value(x, a)[0].ravel()

    h = 1e-6
    slope = np.abs(value(angle + h) - value(angle - h)).max() / (2 * h)
    assert slope == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize("dimension", [2, 3])
def test_within_a_wide_cone_is_outside_the_narrow_one_about_the_opposite_axis(dimension: int) -> None:
    skew = np.array([0.6, -0.8, 0.3][:dimension])
    found = []
    for axis, side, angle in ((skew, "within", 2.0), (-skew, "outside", np.pi - 2.0)):
        problem = build_problem(BUILDS[dimension](cone(dimension, axis=axis.tolist(), **{side: angle})))
        window = window_of(problem)
        (rows,) = rows_of(problem, window)
        x = some_state(problem, 8)
        value = rows.functions.value(x, rows.argument(window_numbers(window, np.zeros(0))))[0].ravel()
        found.append(np.array([value, *rows.bounds(window)]))
    wide, narrow = found
    np.testing.assert_allclose(wide, narrow, atol=1e-14)


@given(seed=st.integers(0, 10**6))
@settings(max_examples=4)
def test_derivatives_are_those_of_the_rows(problem: Problem, seed: int) -> None:
    window = window_of(problem)
    n = problem.model.n
    x = some_state(problem, seed)
    h = 1e-6
    for rows in rows_of(problem, window):
        a = rows.argument(window_numbers(window, np.zeros(0)))
        count = rows.functions.count

        def by_x(at: Array, rows: NodeRows = rows, a: Array = a, count: int = count) -> Array:
            return rows.functions.with_jacobian(at, a)[1].reshape(count, 2 * n)

        differences = [
            (rows.functions.value(x + h * each, a)[0] - rows.functions.value(x - h * each, a)[0]).ravel() / (2 * h)
            for each in np.eye(2 * n)
        ]
        np.testing.assert_allclose(by_x(x), np.transpose(differences), atol=1e-7)
        y = np.random.default_rng(4).standard_normal(count)
        assert rows.functions.curvature
        upper = rows.functions.curvature(x, a, y)[0].reshape(n, n)
        ahead = [(y @ (by_x(x + h * each) - by_x(x - h * each)))[:n] / (2 * h) for each in np.eye(2 * n)[:n]]
        np.testing.assert_allclose(upper, np.triu(ahead), atol=1e-5)


@pytest.mark.parametrize("dimension", [2, 3])
def test_rows_are_finite_where_the_apex_is_at_the_point_and_where_the_axis_points_away(dimension: int) -> None:
    at_apex = {"point": [0.0] * dimension}
    behind = {"direction": [-1.0, 0.0, 0.0][:dimension]}
    cones = [cone(dimension, of=of, **{side: 0.3}) for of in (at_apex, behind) for side in ("within", "outside")]
    problem = build_problem(BUILDS[dimension](*cones))
    window = window_of(problem)
    for rows in rows_of(problem, window):
        for each in rows.functions.with_jacobian(window.x0, rows.argument(window_numbers(window, np.zeros(0)))):
            assert np.isfinite(each).all()


def test_a_window_reads_its_cones_from_the_task(problem: Problem) -> None:
    window = window_of(problem)
    Q = stack(problem.spec.initial, problem.task.robot, "joint")
    again = read_window(problem, WindowFrame((0,), (NODES,), 0.0, Q, np.zeros(problem.model.n)), record_of(window))
    np.testing.assert_array_equal(
        again.stages[0].constraints["cones 0"].argument, window.stages[0].constraints["cones 0"].argument
    )
    assert window_shape(again) == window_shape(window)


def test_a_stage_without_cones_has_none_and_its_task_the_digest_of_one_without_the_key() -> None:
    task = planar()
    assert not any(name.startswith("cones") for name in build_problem(task).stages[0].constraints)
    assert "cones" not in task.spec.stages[0].model_dump()


@pytest.mark.slow
@pytest.mark.parametrize("hard", [False, True], ids=["soft", "hard"])
@pytest.mark.parametrize(
    ("side", "angle", "turned"),
    [("within", 0.02, 0.005), ("within", 0.3, -0.1), ("outside", 0.45, -0.5)],
)
@pytest.mark.parametrize("dimension", [2, 3], ids=["plane", "space"])
def test_sqp_and_ipopt_agree(dimension: int, side: str, angle: float, turned: float, hard: bool) -> None:
    """J to 1e-5, both from the plan of `sqp`, in windows whose free plan leaves the cone."""
    given = cone(dimension, **{side: angle}, hard=hard)
    problem = build_problem(BUILDS[dimension](given, turned=turned))
    window = window_of(problem)
    guess = resting_plan(0.0, window.horizon, NODES, window.x0, window.chart)
    window = window.about(guess)
    sqp = SolverSpec(kind="sqp", tolerance=1e-9, iterations=100)
    first = build_solver(problem, sqp).solve(window, guess)
    assert first.outcome is Outcome.OPTIMAL
    about = window.about(first.plan)
    own = build_solver(problem, sqp).solve(about, first.plan)
    other = build_solver(problem, SolverSpec(kind="ipopt", tolerance=1e-9)).solve(about, first.plan)
    assert own.outcome is Outcome.OPTIMAL
    assert other.outcome is Outcome.OPTIMAL
    assert own.objective == pytest.approx(other.objective, rel=1e-5)
    assert soft_row_violations(problem.model, window, own.plan)[0] < 1e-6
    (spec,) = problem.spec.stages[0].cones
    tilted = TILT * (1 - np.cos(angle)) if dimension == 3 else 0.0  # by which `pointing_error` turns a line
    angles = np.array([angle_at(problem, window, spec, x) for x in own.plan.X[1:]])
    beyond = angles - angle if side == "within" else angle - angles
    assert beyond.max() < tilted + 1e-6
    assert beyond.max() > -LOST * angle - 1e-6  # the cone is what holds the plan


@pytest.mark.parametrize("solver", ["sqp", "fatrop"])
@pytest.mark.parametrize(("side", "angle", "turned"), [("within", 0.15, 0.0), ("outside", 0.25, -0.4)])
@pytest.mark.slow
def test_a_run_keeps_a_cone_that_a_free_run_leaves(solver: str, side: str, angle: float, turned: float) -> None:
    """Between nodes an axis may cut the edge: a sample and the node after it are 0.35 s apart at most."""
    changes = {"plant.kind": "ideal", "log.shares": False, "solver.kind": solver, "time_limit": 8.0}
    given = cone(2, **{side: angle})
    spec = ConeSpec.model_validate(given)

    def beyond(task: Task) -> float:
        run = simulate(task)
        assert not run["events/solve_failed"].any()
        angles = np.array([angle_of_axis(spec, Q[:3], run.problem.model.space) for Q in run.motion.Q])
        return float((angles - angle if side == "within" else angle - angles).max())

    assert beyond(planar(changes=changes, turned=turned)) > 0.1
    assert beyond(planar(given, changes=changes, turned=turned)) < 5e-3
