"""The robot and its object at an instant: where they are, and in which view."""

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.patches import Polygon

from psmpc_cli.figures.scene import (
    PLAN,
    capsule_ends,
    capsules,
    grasp_frame,
    obstacle_frame,
    points_with_shadows,
    scene_of,
)
from psmpc_cli.figures.snapshots import draw_scene
from psmpc_cli.figures.style import new_figure
from psmpc_cli.logs.run import Run
from psmpc_cli.ocp.constraints.clearance import groups, poses_after
from psmpc_cli.ocp.stage import SampleContext
from psmpc_cli.robot.configuration import pose_frames
from psmpc_cli.robot.geometry import pieces_of
from psmpc_cli.robot.kinematics import PlanarFrame, place
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.robot.rotations import add, rotate
from psmpc_cli.specs.geometry import ObstacleSpec
from psmpc_cli.specs.load import Task

Load = Callable[..., Run]


def drawn_points(run: Run, time: float) -> np.ndarray:
    axes = new_figure().add_subplot()
    draw_scene(axes, scene_of(run), time, since=0.0, extent=np.zeros((1, 3)))
    outlines = [patch.get_xy() for patch in axes.patches if isinstance(patch, Polygon)]
    return np.vstack([*outlines, *(line.get_xydata() for line in axes.lines)])


@settings(max_examples=15)
@given(share=st.floats(0, 1))
def test_the_view_shows_all_that_is_drawn(run: Run, share: float) -> None:
    time = share * run.motion.end
    view, found = PLAN.view(scene_of(run).extent([time])), drawn_points(run, time)
    low, high = view.get_points()
    assert np.all((low < found) & (found < high))


@settings(max_examples=25)
@given(share=st.floats(0, 1))
def test_the_object_rests_moves_rigidly_with_the_grippers_and_stays_where_it_was_let_go(run: Run, share: float) -> None:
    scene = scene_of(run)
    assert (scene.taken_at, scene.released_at, scene.lost) == (13.0, 23.0, False)
    rests, moves, stays = (scene.object_frame(time + share * span) for time, span in ((0, 13), (13, 10), (23, 6)))
    assert run.task.spec.object is not None and rests is not None and moves is not None
    np.testing.assert_array_equal(rests, pose_frames(run.task.spec.object.pose))
    np.testing.assert_array_equal(stays, scene.object_frame(23.0))
    frames = [grasp_frame(run.problem.model, run.motion.coordinates_at(time)) for time in (13.0, 13.0 + 10 * share)]
    held = [np.linalg.inv(frame) @ thing for thing, frame in zip((rests, moves), frames, strict=True)]
    np.testing.assert_allclose(held[1], held[0], atol=1e-9)


def test_the_object_is_lost_when_the_grippers_open_too_early(load: Load) -> None:
    scene = scene_of(load(early={1: 6.4, 3: 19.0}))
    assert scene.lost and 19.0 < scene.released_at < 23.0
    assert [scene.events(time)[-1] for time in np.array([18.0, 29.6])] == ["transport", "object lost"]
    np.testing.assert_array_equal(scene.object_frame(29.6), scene.object_frame(scene.released_at))


def test_obstacles_are_drawn_where_they_are_kept_clear_of(load: Load, keeping_clear: dict[str, Any]) -> None:
    run = load(**keeping_clear)
    found = groups(run.task.spec, run.problem.model, 0)
    for obstacle in scene_of(run).obstacles:
        state = found[obstacle.name].state(SampleContext(4.0, run.motion.Q[10], run.motion.Q[10]))
        assert state is not None
        pose, velocity = state
        (expected,) = pose_frames(poses_after(run.problem.model, pose, velocity, np.array([2.0])))
        np.testing.assert_allclose(obstacle_frame(obstacle, 6.0), expected, atol=1e-12)


def test_capsules_are_drawn_where_distances_have_them(transport: Task, model: RobotModel) -> None:
    pieces = pieces_of(transport.robot)
    Q = np.array([0.3, -0.2, 0.5, 0.4, -0.3, 0.8, 1.0, -0.6, 0.2])
    bodies, _ = place(transport.robot, PlanarFrame(ca.DM(Q[:2]), Q[2]), Q[3:])
    for piece, (ends, radius) in zip(pieces, capsules(model, pieces, Q), strict=True):
        frame = piece.frame(bodies)
        expected = [add(frame.position, rotate(frame.quaternion, end)) for end in capsule_ends(piece.shape)]
        np.testing.assert_allclose(ends, [list(map(float, end)) for end in expected], atol=1e-12)
        assert radius == piece.shape.size[0]


def test_the_view_shows_obstacles_that_are_near_as_far_as_they_leave_room_for_the_robot() -> None:
    body = np.array([[-1.0, -1.0, 0.0], [1.0, 1.0, 0.0]])

    def view(shape: dict[str, Any], *position: float, **more: Any) -> np.ndarray:
        obstacle = ObstacleSpec(name="it", shape=shape, pose=(*position, 0.0), **more)
        points = points_with_shadows([body], [], [obstacle], [0.0, 10.0])
        return np.array([points.min(axis=0), points.max(axis=0)])[:, :2].ravel()

    assert view({"sphere": 0.2}, 1.1, 0.0) == pytest.approx([-1, -1, 1.3, 1])
    assert view({"sphere": 0.2}, 3.0, 0.0) == pytest.approx([-1, -1, 1, 1])
    assert view({"sphere": 0.2}, 3.0, 0.0, velocity=(-0.18, 0.0)) == pytest.approx([-1, -1, 1.4, 1])
    assert view({"box": (9.0, 9.0)}, 4.0, 0.0) == pytest.approx([-1, -1.5, 1.5, 1.5])
    assert view({"half_space": (0.0, -1.0)}, 0.0, 1.2) == pytest.approx([-1, -1, 1, 1.2])
