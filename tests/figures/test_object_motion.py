from collections.abc import Callable
from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from psmpc_cli.figures.object_motion import grasp, held_between, object_pose
from psmpc_cli.figures.run import Run

Load = Callable[..., Run]


def test_it_is_held_from_capture_to_release(run: Run) -> None:
    hold = held_between(run)
    assert (hold.start, hold.end, hold.lost) == (13.0, 23.0, False)


@given(time=st.floats(0, 13))
def test_it_rests_until_it_is_taken(run: Run, time: float) -> None:
    assert run.task.object is not None
    np.testing.assert_array_equal(object_pose(run, time), run.task.object.pose)


@given(time=st.floats(13, 23))
def test_it_moves_rigidly_with_the_grippers(run: Run, time: float) -> None:
    np.testing.assert_allclose(in_grasp(run, time), in_grasp(run, 13.0), atol=1e-9)


@given(time=st.floats(23, 29.6))
def test_it_stays_where_it_was_let_go(run: Run, time: float) -> None:
    np.testing.assert_array_equal(object_pose(run, time), object_pose(run, 23.0))


def in_grasp(run: Run, time: float) -> np.ndarray:
    """The object's pose in the frame of the grippers."""
    pose, frame = object_pose(run, time), grasp(run.model, run.coordinates_at(time))
    assert pose is not None
    c, s = np.cos(frame[2]), np.sin(frame[2])
    offset = pose[:2] - frame[:2]
    return np.array([c * offset[0] + s * offset[1], c * offset[1] - s * offset[0], np.cos(pose[2] - frame[2])])


def test_it_is_lost_when_the_grippers_open_too_early(load: Load) -> None:
    run = load(early={1: 6.4, 3: 19.0})
    hold = held_between(run)
    assert hold.lost and 19.0 < hold.end < 23.0
    np.testing.assert_array_equal(object_pose(run, 29.6), object_pose(run, hold.end))


def test_it_is_never_taken_in_a_run_killed_before(load: Load) -> None:
    hold = held_between(load(last=8.0))
    assert (hold.start, hold.end, hold.lost) == (np.inf, np.inf, False)


def test_a_task_without_an_object_has_none(load: Load, one_arm: dict[str, Any]) -> None:
    run = load(**one_arm)
    assert object_pose(run, 1.0) is None
    assert not held_between(run).lost


def test_one_arm_holds_with_its_gripper(load: Load, one_arm: dict[str, Any]) -> None:
    run = load(**one_arm)
    np.testing.assert_allclose(grasp(run.model, np.zeros(5)), [1.2, 0.0, 0.0])
