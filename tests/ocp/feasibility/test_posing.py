from itertools import pairwise

import numpy as np
import pytest

from psmpc_cli.ocp.feasibility.checks import remarks
from psmpc_cli.ocp.feasibility.forecast import forecast_configurations, forecast_stages
from psmpc_cli.ocp.feasibility.posing import Posing, posings
from psmpc_cli.specs.document import dotted
from psmpc_cli.specs.load import load_task

POSED = {
    "stages.approach.target.arm_1": ["45 deg", "30 deg", "60 deg"],
    "stages.approach.target.arm_2": ["-45 deg", "-30 deg", "-60 deg"],
}
"""Where Capture of `transport` needs the arms."""

WAY = np.radians(60) / 0.15
"""Time of the slowest joint from stretched arms to there at its largest velocity [s]."""

SAMPLE = 0.1
"""How long a stage lasts at least [s]."""


def advice(task: str = "transport", **changes: object) -> list[Posing]:
    """The advice about a built-in task with changes, whose paths have __ for dots."""
    loaded = load_task(task, {path.replace("__", "."): value for path, value in changes.items()})
    forecasts = forecast_stages(loaded)
    stages = [each.stage for each in forecasts]
    return list(posings(loaded, forecasts[0].model, stages, forecast_configurations(loaded, forecasts)))


def test_approach_of_transport_is_advised_to_pose_the_arms_for_capture() -> None:
    (found,) = advice()
    assert (found.stage, found.arms) == (0, ("arm_1", "arm_2"))
    np.testing.assert_allclose(np.degrees(found.Q[3:]), [45, 30, 60, -45, -30, -60], atol=0.1)
    np.testing.assert_allclose(found.Q[:3], [-2, 2, np.radians(30)])
    assert found.time == pytest.approx(WAY, abs=0.01)
    assert (found.lead, found.saved) == (4.0, pytest.approx(WAY - 4.0 - SAMPLE, abs=0.01))


def test_the_remark_has_the_posture_as_a_target_has_it() -> None:
    task = load_task("transport")
    (remark,) = remarks(task, forecast_stages(task))
    assert dotted(remark.path) == "stages[0].target"
    assert "arm_1: [45 deg, 30 deg, 60 deg], arm_2: [-45 deg, -30 deg, -60 deg]" in remark.message
    assert "6.98 s at the speed limits" in remark.message


def test_no_advice_is_given_once_it_is_followed() -> None:
    task = load_task("transport", POSED)
    assert remarks(task, forecast_stages(task)) == []


def test_arms_that_hold_an_object_are_not_advised_to_move() -> None:
    """Transport's arms are far from where Release needs them; without an object in them that is said."""
    released = {"stages__transport__target__arm_1": [0, 0, 0], "stages__transport__target__arm_2": [0, 0, 0]}
    bare = {"object": None, "monitors": []}
    elsewhere = {"stages__release__target__arm_1": [0.65, 0.85, "135 deg"]}
    assert [each.stage for each in advice(**released, **elsewhere)] == [0]
    assert [each.stage for each in advice(**released, **elsewhere, **bare)] == [0, 2]


def test_a_controller_that_looks_ahead_moves_the_arms_before_the_stage_ends() -> None:
    (alone,) = advice(controller__kind="hard", by_controller={})
    assert (alone.lead, alone.saved) == (0.0, pytest.approx(WAY - SAMPLE, abs=0.01))
    saved = [advice(controller__horizon=horizon)[0].saved for horizon in (2.0, 3.0, 4.0)]
    assert [after - before for before, after in pairwise(saved)] == pytest.approx([-1.0, -1.0], abs=1e-3)
    assert advice(controller__horizon=8.0) == []


def test_in_a_short_stage_the_arms_are_posed_as_far_as_they_come() -> None:
    """The base flies 1 m at 0.2 m/s. Held, the arms move for the last 4 s of that; posed, for all 5 s."""
    (found,) = advice(initial__base=[-1, 2, "30 deg"])
    assert found.saved == pytest.approx(1.0, abs=0.01)


def test_arms_that_are_still_on_their_way_go_on_without_a_stop() -> None:
    """After the first of 5 s no joint is where it is held, so that it need not be told to go further."""
    half_way = ["25 deg", "20 deg", "50 deg"]
    there = ["-45 deg", "-30 deg", "-60 deg"]
    changes = {
        "initial": {"base": [-1, 2, "30 deg"], "arm_1": [0, 0, 0], "arm_2": there},
        "stages__approach__target__arm_1": half_way,
        "stages__approach__target__arm_2": there,
        "limits": {"arms": {"acceleration": [0.1, 0.1, 0.1]}},
    }
    assert advice(**changes) == []


def test_a_base_that_may_move_helps_to_take_the_poses() -> None:
    (alone,) = advice()
    (together,) = advice(stages__capture__ends_when__coordinates=["arm_1", "arm_2"])
    assert 0.5 < together.saved < alone.saved - 0.5


@pytest.mark.parametrize(("goal", "sign"), [([0, 0, 0], -1), ([-4, 4, "60 deg"], 1)], ids=["flies back", "flies on"])
def test_a_base_that_does_not_rest_at_the_switch_has_to_if_it_flies_back(goal: list[object], sign: int) -> None:
    """From 0.2 m/s at 0.2 m/s^2 that takes 0.5 s. With the arms held it does so while Capture waits for them."""
    slow = {"limits": {"base": {"acceleration": [0.2, 0.2, 0.2]}}, "object": None, "monitors": []}
    found = advice(**slow, stages__transport__target__base=goal)[0]
    assert found.saved == pytest.approx(WAY - 4.0 - SAMPLE + sign * (0.5 - SAMPLE), abs=0.01)
    at_rest = advice(**slow, stages__transport__target__base=goal, stages__approach__ends_when__velocity=0.01)[0]
    assert at_rest.saved == pytest.approx(WAY - 4.0 - SAMPLE, abs=0.01)


def test_of_several_postures_the_nearest_is_advised() -> None:
    """A motion that reaches straight for the pose from here ends on the other branch of the elbow, farther away."""
    task = load_task("transport", {"stages.approach.target.arm_2": ["27 deg", "15 deg", "-5 deg"]})
    led_to = forecast_configurations(task, forecast_stages(task))[2][6:]
    (found,) = advice(stages__approach__target__arm_2=["27 deg", "15 deg", "-5 deg"])
    held = np.radians([27, 15, -5])
    assert np.abs(found.Q[6:] - held).max() < np.abs(led_to - held).max() - 0.1
    np.testing.assert_allclose(np.degrees(found.Q[6:]), [-45, -30, -60], atol=0.1)


def test_a_joint_has_to_gain_its_speed_and_to_lose_it() -> None:
    (found,) = advice(limits={"arms": {"acceleration": [0.1, 0.1, 0.1]}})
    assert found.time == pytest.approx(WAY + 0.15 / 0.1, abs=0.01)


@pytest.mark.parametrize(
    "changes",
    [
        {"skills__move__weights__arm_1": [0, 0, 0], "skills__move__weights__arm_2": [0, 0, 0]},
        {"skills__move__weights__arm_2": [0, 0, 0]},
        {"skills__move__weights__arm_2": [0, 0, 0], "stages__approach__target__arm_2": 3 * ["-10 deg"]},
        {"stages__approach__ends_when__coordinates": ["base", "arm_1", "arm_2"]},
        {"stages__capture__ends_when__coordinates": ["base"]},
        {"stages__capture__dwell": 8.0},
        {"stages__capture__ends_when": None, "stages__capture__at": 20.0},
        {"stages__approach__clearance": {"margin": 0.01}},
        {"obstacles": [{"name": "post", "shape": {"sphere": 0.1}, "pose": [3, 0, 0], "velocity": [0.01, 0]}]},
        {"monitors": [{"name": "still", "quantity": "speed", "of": "arm_1", "during": "approach", "at_most": 1.0}]},
        {"initial__base": [-2, 2, "30 deg"]},
    ],
    ids=[
        "not held",
        "an arm that is not held takes as long",
        "and so it does wherever its target is",
        "asked for",
        "not waited for",
        "the next stage is long anyway",
        "the next stage ends at a time",
        "clearance",
        "something moves",
        "monitor",
        "no time to pose",
    ],
)
def test_no_advice_where_nothing_is_gained_or_the_posture_is_meant(changes: dict[str, object]) -> None:
    assert advice(**changes) == []


@pytest.mark.parametrize("task", ["catch_drifting", "catch_tumbling", "servicing", "float_and_reach", "inspect"])
def test_no_advice_about_other_tasks(task: str) -> None:
    """Their objects move, their arms carry, or the base reacts to them."""
    assert advice(task) == []
