"""What a controller knows of an object: its motion, where targets relative to it are, when grippers are to close."""

from dataclasses import replace

import numpy as np
import pytest

from psmpc_cli.control.identification.tracking import FilteredObject, Grip, gain_of_velocity, to_be_closed
from psmpc_cli.ocp.problem import build_problem
from psmpc_cli.robot.free_body import FreeBody, velocity_of
from psmpc_cli.specs.load import load_task
from psmpc_cli.specs.object import MotionSpec, ObjectBody

from ...ocp.transport_windows import sequence_of

DRIFTING = load_task("catch_drifting", {"controller.nodes": 12})


OBJECT = DRIFTING.spec.body


def spatial() -> ObjectBody:
    motion = MotionSpec.model_construct(linear=(0.01, 0, 0), angular=(0, 0, 0))
    return replace(OBJECT, pose=(1, 2, 3, 1, 0, 0, 0), inertia=(2.0, 3.0, 4.0), motion=motion)


def test_without_measurements_the_motion_is_the_tasks() -> None:
    pose, v = FilteredObject.of(OBJECT).at(10.0)
    assert pose == pytest.approx([-2.489 + 0.2, 2.847, np.radians(50)])
    assert v == pytest.approx([0.02, 0, np.radians(2)])


@pytest.mark.parametrize("turns", [0.0, 2 * np.pi])
def test_measured_poses_correct_the_motion(turns: float) -> None:
    estimate, v = FilteredObject.of(OBJECT), np.array([-0.01, 0.015, -0.03])
    for k in range(100):
        pose = np.array(OBJECT.pose) + 0.1 * k * v + [0, 0, turns * (k % 2)]
        estimate = estimate.with_measurement(0.1 * k, pose)
    estimate = estimate.with_measurement(9.95, np.full(3, np.nan))
    assert estimate.at(12.0)[1] == pytest.approx(v, abs=1e-6)
    assert estimate.at(12.0)[0] == pytest.approx(np.array(OBJECT.pose) + 12 * v, abs=1e-5)


@pytest.mark.parametrize("alpha", [0.12, 0.5])
def test_a_smaller_gain_leaves_less_noise_in_the_velocity(alpha: float) -> None:
    """The variance of an alpha-beta filter's velocity (Benedict and Bordner, 1962), over some 200 of its memories."""
    rng, T, sigma = np.random.default_rng(0), 0.1, 1e-3
    estimate = FilteredObject.of(OBJECT, alpha)
    velocities = []
    for k in range(4000):
        pose = OBJECT.pose + T * k * velocity_of(OBJECT) + sigma * rng.standard_normal(3)
        estimate = estimate.with_measurement(T * k, pose)
        velocities.append(estimate.velocity - velocity_of(OBJECT))
    beta = gain_of_velocity(alpha)
    expected = sigma * np.sqrt(2 * beta**2 / (alpha * (4 - 2 * alpha - beta))) / T
    assert np.sqrt(np.mean(np.square(velocities))) == pytest.approx(expected, rel=0.1)


def test_measured_attitudes_correct_the_motion() -> None:
    body, true = (
        FreeBody(20.0, [2.0, 3.0, 4.0]),
        (np.array([1, 2, 3, 1, 0, 0, 0.0]), np.array([0, 0, 0, 0.02, -0.01, 0.03])),
    )
    estimate = FilteredObject.of(spatial())
    for k in range(200):
        pose = body.predicted(*true, 0.1 * k)[0]
        estimate = estimate.with_measurement(0.1 * k, np.r_[pose[:3], pose[3:] * (-1) ** k])
    assert estimate.at(22.0)[1] == pytest.approx(body.predicted(*true, 22.0)[1], abs=1e-4)


@pytest.mark.parametrize("task", ["catch_drifting", "catch_tumbling"])
def test_a_held_object_is_where_its_gripper_has_it_however_that_accelerates(task: str) -> None:
    problem = build_problem(load_task(task))
    model = problem.model
    space = model.space
    gripper = next(iter(problem.body.grasp.at))
    rng = np.random.default_rng(2)
    start = np.array(space.integrate(space.neutral, 0.3 * rng.normal(size=model.n)))
    acceleration = rng.normal(size=model.n)
    estimate = FilteredObject.of(problem.body)
    inside = space.relative(estimate.pose, Grip.of(model, gripper, start, np.zeros(model.n)).pose)
    step = 1e-5

    def pose_at(Q: np.ndarray) -> np.ndarray:
        return np.asarray(space.composed(Grip.of(model, gripper, Q, np.zeros(model.n)).pose, inside))

    Q = start
    for k in range(40):
        v = 0.1 * k * acceleration
        estimate = estimate.with_measurement(0.1 * k, pose_at(Q), Grip.of(model, gripper, Q, v))
        before = Q
        Q = np.array(space.integrate(Q, 0.1 * v))
    ahead = pose_at(np.array(space.integrate(before, step * v)))
    behind = pose_at(np.array(space.integrate(before, -step * v)))
    np.testing.assert_allclose(space.pose_error(estimate.pose, pose_at(before)), 0.0, atol=1e-9)
    np.testing.assert_allclose(estimate.velocity, space.pose_error(ahead, behind) / (2 * step), atol=1e-5)
    free = estimate.with_measurement(4.0, None)
    assert free is estimate


@pytest.mark.parametrize(
    ("first", "switch_times", "closed"),
    [
        (0, [], [False] * 4),
        (0, [0.5, 2.015], [False, False, True, True]),
        (1, [2.01], [False, True, True, True]),
        (2, [], [True] * 4),
        (1, [2.0, 2.02], [True, True, False, False]),
        (3, [], [False] * 4),
    ],
)
def test_grippers_close_and_open_at_planned_switches(first: int, switch_times: list[float], closed: list[bool]) -> None:
    holding = build_problem(DRIFTING).held_stages
    sequence = sequence_of(first, switch_times)
    assert to_be_closed(holding, sequence, 2.0 + 0.01 * np.arange(4)).tolist() == closed
