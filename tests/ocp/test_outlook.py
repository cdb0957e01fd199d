import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from psmpc_cli.ocp.feasibility import look_ahead
from psmpc_cli.specs.load import load_task

TRANSPORT = load_task("transport")


def test_earliest_ends_of_the_transport() -> None:
    ends = [outlook.earliest_end for outlook in look_ahead(TRANSPORT)]
    way = (2 - 2e-3) / 0.2
    back = (2 - 4e-3) / 0.2
    np.testing.assert_allclose(ends, [way, way, way + back, way + back])


@settings(max_examples=30)
@given(st.floats(-4, 4), st.floats(-4, 4), st.floats(0.01, 0.2), st.floats(0, 30))
def test_stage_ends_no_earlier_than_its_slowest_coordinate_and_its_dwell(
    x: float, y: float, v: float, dwell: float
) -> None:
    overrides = [
        f"limits={{base: {{velocity: [{v}, {v}, {v}]}}}}",
        f"stages.approach.target.base=[{x}, {y}, 0]",
        f"stages.approach.dwell={dwell}",
    ]
    least = max(max(abs(x), abs(y)) - 2e-3, 0.0) / v
    assert look_ahead(load_task("transport", overrides))[0].earliest_end == pytest.approx(max(least, dwell))


def test_reach_is_known_where_the_target_asks_for_poses_and_a_base() -> None:
    reaches = [outlook.reaches for outlook in look_ahead(TRANSPORT)]
    assert [list(reach) for reach in reaches] == [[], ["arm_1", "arm_2"], [], ["arm_1", "arm_2"]]
    np.testing.assert_allclose([reach.distance for reach in reaches[3].values()], 1.2)
    free = ["skills.reach.weights.base=[0, 0, 0]", "stages.capture.ends_when.coordinates=arms"]
    assert look_ahead(load_task("transport", free))[1].reaches == {}


def test_instants_and_dwells_carry_over_to_later_stages() -> None:
    timed = ["stages.approach.dwell=12", "stages.capture.dwell=2"]
    ends = [outlook.earliest_end for outlook in look_ahead(load_task("transport", timed))]
    np.testing.assert_allclose(ends, [12, 14, 14 + (2 - 4e-3) / 0.2, 14 + (2 - 4e-3) / 0.2])


def test_stage_does_not_end_before_its_trajectory() -> None:
    unfold, trace, stow = look_ahead(load_task("tracking"))
    assert trace.earliest_end == pytest.approx(unfold.earliest_end + 16)
    assert stow.earliest_end >= trace.earliest_end
