"""What `psmpc check` says of stages in which nothing pushes the robot."""

import numpy as np
import pytest

from psmpc_cli.ocp.feasibility.checks import remarks
from psmpc_cli.ocp.feasibility.drift import Drift, drifts
from psmpc_cli.ocp.feasibility.forecast import forecast_stages
from psmpc_cli.specs.document import dotted
from psmpc_cli.specs.load import load_task

from ...docking import docking


def drifts_of(*changes: str) -> list[Drift]:
    task = load_task("capture_floating", changes)
    return list(drifts(task, forecast_stages(task)))


def test_a_stage_that_ends_in_motion_says_how_the_next_one_drifts() -> None:
    """Arms alike at both ends: the centre of mass moves as the base, 75 cm at 3 cm/s, known to 2 and 5 mm/s."""
    coast, capture = drifts_of()
    assert (coast.stage.name, capture.stage.name) == ("coast", "capture")
    np.testing.assert_allclose(coast.velocity, [0, 0.03], atol=1e-9)
    np.testing.assert_allclose(coast.displacement, [0, 0.75], atol=1e-9)
    assert coast.spread == pytest.approx(np.hypot(0.002, 0.005))
    assert coast.nearest_after == pytest.approx(25)
    assert coast.miss == 0
    assert not len(capture.displacement)


def test_a_target_on_an_object_moves_with_it() -> None:
    """The robot leaves for an object that comes at 1 cm/s with 3 cm/s relative to it, and is there 75 cm later."""
    coast, _ = drifts_of("object.motion={linear: [0, -0.01], angular: 0}")
    np.testing.assert_allclose(coast.velocity, [0, 0.03], atol=1e-9)
    assert coast.nearest_after == pytest.approx(25)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("stages.approach.ends_when.moving.base=[0, -0.04, 0]", "drifts away from it at 0.04 m/s"),
        ("stages.approach.ends_when.moving.base=[0.04, 0, 0]", "drifts at 0.04 m/s"),
        ("stages.approach.ends_when.moving=null", "drifts at 0 m/s"),
        ("stages.approach.ends_when={coordinates: [base]}", 'end of "approach" at any velocity of the base'),
        ("stages.approach.ends_when={coordinates: [base.x], velocity: 0.01}", "at any velocity of the base"),
        ("stages.approach.ends_when={momentum: {linear: 0.1}}", "drifts at 0 m/s"),
    ],
)
def test_momentum_that_does_not_lead_there_is_remarked(change: str, words: str) -> None:
    """The place is 1 m away, further than arms that move can shift the robot's centre of mass."""
    away = "stages.approach.target.base={object: [0, -1.978, 0], met_in: 25 s}"
    task = load_task("capture_floating", [away, change, "stages.coast.ends_when.tolerance.base=0.1"])
    (remark,) = (each for each in remarks(task, forecast_stages(task)) if "nothing pushes it" in each.message)
    assert dotted(remark.path) == "stages[0].ends_when"
    assert words in remark.message


def test_a_mount_leaves_no_momentum() -> None:
    task = docking({"stages.leave.mobility": "free-floating"})
    (leave,) = drifts(task, forecast_stages(task))
    assert (leave.speed, leave.spread) == (0, 0)
    assert leave.miss == pytest.approx(0.1 - np.hypot(0.02, 0.02))
