import numpy as np
import pytest

from psmpc_cli.ocp.problem import build_stages
from psmpc_cli.ocp.stage import Stage
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
