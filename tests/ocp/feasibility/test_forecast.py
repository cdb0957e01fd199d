"""What is known of stages before a run: whether arms reach their poses, and how early each stage can end."""

import numpy as np
import pytest

from psmpc_cli.ocp.feasibility.forecast import forecast_stages
from psmpc_cli.specs.load import load_task

from ... import free_flyer


def test_reach_is_known_where_the_target_asks_for_poses_and_a_base() -> None:
    reaches = [forecast.reaches for forecast in forecast_stages(load_task("transport"))]
    assert [list(reach) for reach in reaches] == [[], ["arm_1", "arm_2"], [], ["arm_1", "arm_2"]]
    np.testing.assert_allclose([reach.distance for reach in reaches[3].values()], 1.2)
    free = ["skills.reach.weights.base=[0, 0, 0]", "stages.capture.ends_when.coordinates=arms"]
    assert forecast_stages(load_task("transport", free))[1].reaches == {}


WAY, BACK = (2 - 2e-3) / 0.2, (2 - 3.1e-3) / 0.2
"""How long the base takes to the object and back at its largest velocity, the tolerances taken off [s]."""


@pytest.mark.parametrize(
    ("task", "changes", "expected"),
    [
        ("transport", [], [WAY, WAY, WAY + BACK, WAY + BACK]),
        ("transport", ["stages.approach.ends_when.hold=1.5"], [WAY + 1.5]),
        ("transport", ["stages.approach.dwell=20"], [20]),
        ("transport", ["limits={base: {velocity: [0.1, 0.2, 0.2]}}"], [2 * WAY]),
        ("tracking", ["stages.unfold.dwell=20"], [20, 36]),
    ],
    ids=["at the limits", "held", "dwelling", "slower", "along a trajectory"],
)
def test_a_stage_ends_no_earlier_than_its_slowest_coordinate_dwell_and_trajectory(
    task: str, changes: list[str], expected: list[float]
) -> None:
    ends = [forecast.earliest_end for forecast in forecast_stages(load_task(task, changes))]
    np.testing.assert_allclose(ends[: len(expected)], expected)


@pytest.mark.parametrize(
    ("change", "seconds"),
    [
        ("controller.nodes=12", (2 * np.pi / 3 - np.sqrt(3) * 5e-3) / (0.3 * np.sqrt(3))),
        (
            "stages.fly.target.base.attitude={axis: [0, 0, 1], angle: 270 deg}",
            (np.pi / 2 - np.sqrt(3) * 5e-3) / (0.3 * np.sqrt(3)),
        ),
        ("initial.base.position=[0.3, 0.2, 2.7]", (3 - 5e-3) / 0.2),
        (
            "limits={base: {acceleration: [0.02, 0.02, 0.02, 0.05, 0.05, 0.05]}}",
            (2 * np.pi / 3 - np.sqrt(3) * 5e-3) / (0.3 * np.sqrt(3)) + 3,
        ),
        ("limits={base: {acceleration: [0.001, 1, 1, 1, 1, 1]}}", np.sqrt(2 * (0.3 - 5e-3) / 0.001)),
    ],
    ids=["turn", "the short way", "flight", "up to speed", "never up to speed"],
)
def test_a_spatial_base_turns_and_flies_no_faster_than_its_limits(change: str, seconds: float) -> None:
    assert forecast_stages(free_flyer.turning(120, change))[0].earliest_end == pytest.approx(seconds)
