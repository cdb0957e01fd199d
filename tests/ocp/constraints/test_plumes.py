"""Which thrusters plans may use whose plumes would reach something, and that plans keep to the others."""

from pathlib import Path

import numpy as np
import pytest

from psmpc_cli.control.controller import Controller
from psmpc_cli.control.interface import State
from psmpc_cli.errors import SpecError
from psmpc_cli.ocp.constraints.clearance import solids_of_obstacle
from psmpc_cli.ocp.constraints.plumes import PlumeForecast, Surrounding
from psmpc_cli.ocp.plan import resting_plan
from psmpc_cli.ocp.stage import SampleContext
from psmpc_cli.plant.base import Setpoints
from psmpc_cli.plant.rk4 import Rk4Plant
from psmpc_cli.robot.actuators.plumes import Plumes
from psmpc_cli.robot.actuators.thrusters import Thrusters
from psmpc_cli.robot.configuration import IDENTITY
from psmpc_cli.robot.model import RobotModel, load_robot
from psmpc_cli.specs.geometry import ObstacleSpec
from psmpc_cli.specs.load import Task, load_task
from psmpc_cli.specs.robots.actuators import SpatialThruster
from psmpc_cli.specs.robots.robot import stack

from ...plumed import AHEAD, before_a_panel, robot_in

Array = np.ndarray

GRASP = {
    "at": {"arm_1": [-0.3, 0, 0]},
    "envelope": {"position": 0.01, "angle": 0.1, "velocity": 0.1, "angular_velocity": 0.1},
    "stiffness": [1000, 100],
}
"""Of an object with a mass, which one hand takes."""


def forecast(task: Task, stage: int = 0) -> tuple[PlumeForecast, RobotModel]:
    model = RobotModel(task.robot)
    return PlumeForecast.of(task.spec, model, stage), model


def sample_at(
    task: Task,
    model: RobotModel,
    base: list[float],
    velocity: float = 0.0,
    object_state: tuple[np.ndarray, np.ndarray] | None = None,
) -> SampleContext:
    """A sample in which the robot is folded, with a plan that goes on at a velocity along x."""
    x = np.r_[stack(task.spec.initial, task.robot, "joint"), np.zeros(model.n)]
    x[:3] = base
    x[model.n] = velocity
    plan = resting_plan(0.0, 8.0, 1, x, IDENTITY)
    return SampleContext(0.0, x, np.zeros(0), plan=plan, object_state=object_state)


def test_thrusters_are_shut_while_their_plumes_reach_an_obstacle(tmp_path: Path) -> None:
    """The panel begins at 2.1 m, rounded at its corners, the nozzles are 0.25 m ahead, and plumes are 1.5 m long."""
    plumes, model = forecast(task := before_a_panel(tmp_path))
    far, near, turned = (
        plumes.is_shut(plumes.numbers(model, sample_at(task, model, base)))
        for base in ([0.2, 0, 0], [0.6, 0, 0], [1.2, 0, np.pi])
    )
    assert not far.any()
    assert near.all(axis=0).nonzero()[0].tolist() == list(AHEAD)
    assert turned.all(axis=0).nonzero()[0].tolist() == [0, 1]


def test_the_plan_in_force_says_when_thrusters_will_be_shut(tmp_path: Path) -> None:
    """At 0.1 m/s from 0.2 m on, a plume reaches the panel at some 0.3 m; from there bounds are those of the others."""
    plumes, model = forecast(task := before_a_panel(tmp_path))
    numbers = plumes.numbers(model, sample_at(task, model, [0.2, 0, 0], 0.1))
    is_shut = plumes.is_shut(numbers)
    (first,) = {int(is_shut[:, number].argmax()) for number in AHEAD}
    assert 3 < first < 20 and is_shut[first:, AHEAD].all() and not is_shut[:first].any()
    thrusters = Thrusters.of(task.robot.thrusters)
    normals = np.array([[1.0, 0.0, 0.0]])
    shut_at = plumes.since[first]
    times = np.array([0.0, shut_at - 0.25, shut_at - 0.05, shut_at + 0.01, 8.0])
    low, high = plumes.bounds(normals, np.zeros(1), numbers, times)
    everything, canted = -20 - 2 * 10 * 0.5 / np.hypot(0.5, 0.866), -2 * 10 * 0.5 / np.hypot(0.5, 0.866)
    # the time before the first at which they are shut is next to it, so the second interval counts already
    np.testing.assert_allclose(low.ravel(), [everything, canted, canted, canted], atol=1e-4)
    np.testing.assert_allclose(high, 20, atol=1e-4)
    unloading = plumes.bounds(normals, np.array([1.0]), numbers, times)
    np.testing.assert_allclose(unloading[0], low + 1.0)
    np.testing.assert_allclose(unloading[1], high - 1.0)
    assert len(thrusters.force) == 10


def test_an_obstacle_that_moves_is_where_it_is_then(tmp_path: Path) -> None:
    obstacle = {"name": "ball", "shape": {"sphere": 0.1}, "pose": [1.0, 1.0, 0], "velocity": [0, -0.25]}
    plumes, model = forecast(task := before_a_panel(tmp_path, obstacles=[obstacle]))
    is_shut = plumes.is_shut(plumes.numbers(model, sample_at(task, model, [0, 0, 0])))[:, AHEAD].any(axis=1)
    reached = plumes.since[is_shut]
    assert 1.0 < reached.min() < 2.5 and 5.5 < reached.max() < 7.0
    np.testing.assert_array_equal(np.diff(is_shut.astype(int)).nonzero()[0].size, 2)


@pytest.fixture
def carrying(tmp_path: Path) -> Task:
    """The capture of a floating object with a plume ahead; it is held in the fourth stage."""
    robot = robot_in(tmp_path, {"angle": "20 deg", "length": 2.0})
    changes = {"robot": str(robot), "plumes": "avoided", "limits.arms.force": [5, 5, 5]}
    return load_task("capture_floating", changes)


def test_the_object_counts_where_it_is_free_and_in_the_gripper_where_it_is_held(carrying: Task) -> None:
    names = [stage.name for stage in carrying.spec.stages]
    free, model = forecast(carrying, names.index("approach"))
    held, _ = forecast(carrying, names.index("transport"))
    at = ([0.0, 1.0, 0.0], [0.0, 0.0, 0.0])
    for pose, numbers in ((np.array([0.0, 1.0, 0.0]), (6, 7)), (np.array([1.0, 0.0, 0.0]), (2, 3))):
        sample = sample_at(carrying, model, at[1], object_state=(pose, np.zeros(3)))
        is_shut = free.is_shut(free.numbers(model, sample)).all(axis=0).nonzero()[0].tolist()
        # those that push the base away from what is ahead of their plumes: along -y, along -x
        assert set(is_shut) >= set(numbers) and not set(is_shut) & {0, 1, 4, 5}
    hand = model.poses(sample.x[:9])[1]
    inside = np.array(carrying.spec.body.grasp.at["arm_1"])
    in_hand = model.space.composed(hand, model.space.relative(model.space.neutral, inside))
    elsewhere = sample_at(carrying, model, at[1], object_state=(np.array([9.0, 9.0, 0.0]), np.zeros(3)))
    later = held.numbers(model, SampleContext(**{**vars(elsewhere), "is_current": False}))
    there = sample_at(carrying, model, at[1], object_state=(in_hand, np.zeros(3)))
    assert later.any()
    np.testing.assert_array_equal(later, free.numbers(model, there))
    np.testing.assert_array_equal(held.numbers(model, there), later)


def test_a_plan_asks_for_what_the_remaining_thrusters_can_give(tmp_path: Path) -> None:
    """At both ends of every interval: a linear program finds thrusts of those that are not shut in it.

    The robot is on its way where plumes reach the panel; windows are solved to 1e-8 of the largest change of velocity.
    """
    task = before_a_panel(tmp_path, controller={"horizon": 8, "nodes": 20}, solver={"iterations": 20})
    controller = Controller(task)
    model = controller.problem.model
    plant = Rk4Plant(model, 1e-3)
    thrusters = Thrusters.of(task.robot.thrusters)
    state = np.r_[stack(task.spec.initial, task.robot, "joint"), np.zeros(model.n)]
    state[[0, model.nq]] = 0.1, 0.2
    plumes = PlumeForecast.of(task.spec, model, 0)
    asked = np.zeros(2)
    for k in range(6):
        command = controller.step(0.1 * k, State.of(state))
        assert command.solution.outcome.usable
        (constraint,) = [each for each in command.stage.constraints.values() if each.for_bounds]
        is_shut = plumes.is_shut(constraint.of_bounds)
        plan = command.plan
        for i, (begins, ends) in enumerate(zip(plan.times[:-1] - 0.1 * k, plan.times[1:] - 0.1 * k, strict=True)):
            inside = (plumes.since >= begins - 0.1) & (plumes.since <= ends + 0.1)
            some_are_shut = is_shut[inside].any(axis=0)
            for X in plan.X[i : i + 2]:
                F = model.inverse_dynamics(X[: model.n], X[model.n :], plan.u[i])
                wanted = np.array(model.space.along_base_axes(X[: model.n], F))[:3]
                residual = thrusters.allocate(wanted, some_are_shut).residual
                np.testing.assert_allclose(residual, 0.0, atol=2e-3)
                asked[int(some_are_shut.any())] += np.abs(wanted).sum()
        state = plant.advance(0.1 * k, state, Setpoints(command.u)).states[-1]
    assert (asked > 10).all()  # it is asked for forces with and without some that are shut


def test_a_marker_object_is_nothing_that_plumes_are_kept_off(tmp_path: Path) -> None:
    """An object without a mass is drawn only: alone it is no reason to avoid plumes, and beside a panel it is none."""
    marker = {"shape": [0.4, 0.4], "pose": [1.2, 0, 0], "taken_by": "fly"}
    robot = robot_in(tmp_path)
    with pytest.raises(SpecError, match="an object with a mass, or obstacles"):
        before_a_panel(tmp_path, robot, obstacles=None, object=marker)
    plumes, model = forecast(task := before_a_panel(tmp_path, robot, object=marker))
    assert len(plumes.surroundings) == 1
    sample = sample_at(task, model, [0.2, 0, 0])
    assert not plumes.is_shut(plumes.numbers(model, sample)).any()
    body = {"mass": 5, "inertia": 0.1, "grasp": GRASP}
    heavy, model = forecast(task := before_a_panel(tmp_path, robot, object={**marker, **body}))
    pose, v = np.array([1.2, 0, 0]), np.zeros(3)
    sample = sample_at(task, model, [0.2, 0, 0], object_state=(pose, v))
    assert heavy.is_shut(heavy.numbers(model, sample))[:, AHEAD].all()


def test_nothing_is_looked_at_where_plumes_are_ignored(tmp_path: Path) -> None:
    for use in ("ignored", None):
        controller = Controller(before_a_panel(tmp_path, plumes=use))
        assert list(controller.problem.stages[0].constraints["forces"].argument) == []
        assert not controller.problem.stages[0].sampled_constraints


def test_plumes_of_a_spatial_robot_turn_with_its_base() -> None:
    """Turned by a quarter about z, a plume along its x leaves along y, and stays as the plan turns the base about x.

    The chart is about the attitude of the sample.
    """
    model = load_robot("free_flyer_arm")
    plume = {"angle": 0.2, "length": 1.0}
    kinds = [
        SpatialThruster(position=(0.2, 0, 0), direction=(-1, 0, 0), force=1, plume=plume),
        SpatialThruster(position=(0, 0, 0.2), direction=(0, 0, -1), force=1, plume=plume),
    ]
    places = {"ahead": [0, 1.0, 0], "above": [0, 0, 1.0], "aside": [1.0, 0, 0]}
    anchor = np.array([np.sqrt(0.5), 0, 0, np.sqrt(0.5)])
    Q = np.array(model.neutral)
    Q[3:7] = anchor
    v = np.zeros(model.n)
    v[3] = 0.5
    chart = model.space.chart_at(Q)
    x = chart.to_chart(Q[None], v[None])[0]
    sample = SampleContext(0.0, x, anchor, plan=resting_plan(0.0, 2.0, 1, x, chart))
    for name, position in places.items():
        obstacle = ObstacleSpec(name=name, shape={"sphere": 0.1}, pose=(*position, 1, 0, 0, 0))
        body = Surrounding(solids_of_obstacle(obstacle), lambda sample, at=obstacle: (np.array(at.pose), np.zeros(6)))
        plumes = PlumeForecast(Thrusters.of(kinds), Plumes.of(kinds), (body,), np.arange(0, 2.0, 0.1))
        is_shut = plumes.is_shut(plumes.numbers(model, sample))
        assert is_shut[0].tolist() == [name == "ahead", name == "above"]
        # the plume along z turns away from above, the other one stays
        assert is_shut[-1].tolist() == [name == "ahead", False]


def test_more_than_eight_thrusters_take_more_numbers(tmp_path: Path) -> None:
    plumes, model = forecast(task := before_a_panel(tmp_path))
    assert plumes.thrusters.count == 10 and plumes.size == 2 * 81
    is_shut = np.random.default_rng(0).uniform(size=(81, 10)) > 0.5
    packed = np.packbits(is_shut, axis=1).astype(float).ravel()
    np.testing.assert_array_equal(plumes.is_shut(packed), is_shut)
    assert plumes.numbers(model, sample_at(task, model, [0, 0, 0])).shape == (162,)
