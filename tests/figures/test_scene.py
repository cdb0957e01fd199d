"""The robot and its object at an instant: where they are, and in which view."""

from collections.abc import Callable

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.patches import Polygon

from psmpc_cli.figures.scene import PLAN, grasp_frame, scene_of
from psmpc_cli.figures.snapshots import draw_scene
from psmpc_cli.figures.style import new_figure
from psmpc_cli.logs.run import Run
from psmpc_cli.robot.configuration import pose_frames

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
    assert (scene.taken, scene.left, scene.lost) == (13.0, 23.0, False)
    rests, moves, stays = (scene.object_frame(time + share * span) for time, span in ((0, 13), (13, 10), (23, 6)))
    assert run.task.spec.object is not None and rests is not None and moves is not None
    np.testing.assert_array_equal(rests, pose_frames(run.task.spec.object.pose))
    np.testing.assert_array_equal(stays, scene.object_frame(23.0))
    frames = [grasp_frame(run.problem.model, run.motion.coordinates_at(time)) for time in (13.0, 13.0 + 10 * share)]
    held = [np.linalg.inv(frame) @ thing for thing, frame in zip((rests, moves), frames, strict=True)]
    np.testing.assert_allclose(held[1], held[0], atol=1e-9)


def test_the_object_is_lost_when_the_grippers_open_too_early(load: Load) -> None:
    scene = scene_of(load(early={1: 6.4, 3: 19.0}))
    assert scene.lost and 19.0 < scene.left < 23.0
    assert [scene.events(time)[-1] for time in np.array([18.0, 29.6])] == ["transport", "object lost"]
    np.testing.assert_array_equal(scene.object_frame(29.6), scene.object_frame(scene.left))
