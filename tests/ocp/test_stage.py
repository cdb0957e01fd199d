import numpy as np
import pytest

from psmpc_cli.ocp.problem import build_problem, build_stages
from psmpc_cli.ocp.stage import PlaceOnObject, Stage
from psmpc_cli.robot.free_body import FreeBody
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.load import load_task

TRACKING = load_task("tracking")


def turning(model: RobotModel, degrees: list[float], *changes: str) -> Stage:
    """A stage whose base turns through some angles [deg]."""
    rows = ", ".join(f"[0, 0, {angle} deg]" for angle in degrees)
    still = ", ".join("[0, 0, 0]" for _ in degrees)
    target = f"{{times: {list(range(len(degrees)))}, base: [{rows}], arms: [{still}]}}"
    task = load_task("transport", [f"stages.approach.target={target}", *changes])
    return build_stages(task.spec, task.robot, model)[0]


@pytest.mark.parametrize(("dwell", "least"), [(0, 16), (3, 16), (20, 20)])
def test_stage_lasts_as_long_as_its_trajectory(dwell: float, least: float, model: RobotModel) -> None:
    task = load_task("tracking", [f"stages.trace.dwell={dwell}"])
    assert build_stages(task.spec, task.robot, model)[1].end.dwell == least


@pytest.mark.parametrize(
    ("given_angles", "meant"),
    [
        ([170, -170, -100], [170, 190, 260]),
        ([350, 340, 10], [-10, -20, 10]),
        ([0, 120, 240, 360], [0, 120, 240, 360]),
        ([0, 120, 240, 0, 120], [0, 120, 240, 360, 480]),
    ],
)
def test_every_row_of_angles_is_nearest_to_the_row_before(
    given_angles: list[float], meant: list[float], model: RobotModel
) -> None:
    nearest = turning(model, given_angles)
    np.testing.assert_allclose(np.degrees(nearest.reference.points[:, 2]), meant, atol=1e-9)
    np.testing.assert_array_equal(nearest.target, nearest.reference.points[-1])
    exact = turning(model, given_angles, "stages.approach.angles=exact")
    np.testing.assert_allclose(np.degrees(exact.reference.points[:, 2]), given_angles, atol=1e-9)


def test_the_stage_after_a_trajectory_counts_angles_from_its_last_row(model: RobotModel) -> None:
    rows = "base: [[0, 0, 0], [0, 0, 120 deg], [0, 0, 240 deg]], arms: [[0, 0, 0], [0, 0, 0], [0, 0, 0]]"
    task = load_task("transport", [f"stages.approach.target={{times: [0, 1, 2], {rows}}}"])
    after = build_stages(task.spec, task.robot, model)[1]
    assert np.degrees(after.target[2]) == pytest.approx(390)  # 30 deg, from 240


IN_THE_PLANE = FreeBody(20.0, [3.0]), np.array([0.5, 3.0, 0.3]), np.array([0.01, -0.02, 0.03])
IN_SPACE = (
    FreeBody(20.0, [3.0, 2.0, 4.0]),
    np.array([0.5, 3.0, 1.0, 0.8, 0.0, 0.6, 0.0]),
    np.array([0.01, -0.02, 0.01, 0, 0.03, 0]),
)


@pytest.mark.parametrize(
    ("body", "pose", "v", "inside", "moving"),
    [
        (*IN_THE_PLANE, np.array([0.2, -2.0, 0.1]), np.array([0.01, 0.04, 0.0])),
        (*IN_SPACE, np.array([-2.0, 0.1, 0.4, 1.0, 0.0, 0.0, 0.0]), np.array([0.04, 0.0, 0.01, 0.0, 0.0, 0.0])),
    ],
    ids=["in the plane", "in space"],
)
def test_who_floats_from_a_place_to_the_object_is_beside_it_when_they_meet(
    body: FreeBody, pose: np.ndarray, v: np.ndarray, inside: np.ndarray, moving: np.ndarray
) -> None:
    """It keeps its velocity; the object turns about a principal axis."""
    duration = 25.0
    space = body.space
    place, velocity = PlaceOnObject(body, inside, met_in=duration).pose_and_velocity(pose, v, moving)
    arrived = np.array(space.integrate(place, duration * velocity))
    met, v_met = body.predicted(pose, v, duration)
    beside = inside.copy()
    beside[: space.dimension] += duration * moving[: space.dimension]
    np.testing.assert_allclose(space.pose_error(arrived, space.composed(met, beside)), 0, atol=1e-12)
    np.testing.assert_allclose(velocity[space.rotation], space.carried_rate(met, v_met, inside)[space.rotation])


def test_a_place_that_nobody_leaves_floating_moves_rigidly_with_the_object() -> None:
    body, pose, v = IN_THE_PLANE
    inside = np.array([0.2, -2.0, 0.1])
    place, velocity = PlaceOnObject(body, inside).pose_and_velocity(pose, v, np.zeros(3))
    np.testing.assert_array_equal(place, body.space.composed(pose, inside))
    later, _ = PlaceOnObject(body, inside).pose_and_velocity(*body.predicted(pose, v, 1e-6), np.zeros(3))
    np.testing.assert_allclose((later - place) / 1e-6, velocity, atol=1e-7)


def test_rates_at_the_end_are_along_the_axes_of_the_object() -> None:
    """Of those that the end condition leaves out nothing is lost: the object may have turned them into the others."""
    coordinates = {"stages.approach.ends_when.coordinates": ["base.x"], "stages.approach.ends_when.tolerance": 0.01}
    rates = {"stages.approach.ends_when.velocity": 0.002, "stages.approach.target.base": {"object": [0, -1.978, 0]}}
    task = load_task("capture_floating", {**coordinates, **rates})
    approach = build_problem(task).stages[0].unplaced_copy()
    placed = approach.at_object(np.array([0.0, 3.0, np.pi / 2]), np.zeros(3))
    np.testing.assert_allclose(placed.end.target_rates, [-0.03])
