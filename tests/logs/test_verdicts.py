"""Monitors: their signals, and when their bounds hold."""

from collections.abc import Mapping, Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from psmpc_cli.logs.verdicts import Arrays, Verdict, judge_monitor, monitored_signal
from psmpc_cli.report.texts import describe_verdict
from psmpc_cli.specs.task import MonitorSpec

POSES = tuple(f"{part}.{axis}" for part in ("base", "arm_1", "arm_2") for axis in ("x", "y", "theta"))
SAMPLE = 0.5


def log_of(stage: Sequence[int], **positions: Sequence[tuple[float, float]]) -> Arrays:
    """The datasets that monitors use: the current stage, and the positions of the frames."""
    xi = np.zeros((len(stage), len(POSES)))
    for name, points in positions.items():
        xi[:, POSES.index(f"{name}.x") : POSES.index(f"{name}.x") + 2] = np.reshape(points, (-1, 2))
    time = SAMPLE * np.arange(len(stage))
    names = {
        "stages/name": np.array(["approach", "capture", "transport", "release"]),
        "pose_coordinate": np.array(POSES),
    }
    return {"time": time, "window/first": np.array(stage, int), "pose/xi": xi, **names}


def monitor(
    bounds: Mapping[str, float], quantity: str = "distance", of: Sequence[str] = ("arm_1", "arm_2")
) -> MonitorSpec:
    about = {"name": "m", "quantity": quantity, "of": list(of), "during": "transport"}
    return MonitorSpec.model_validate({**about, **bounds})


def verdict(log: Arrays, monitor: MonitorSpec) -> Verdict:
    return judge_monitor(monitor, log)


def apart(*distances: float) -> Arrays:
    """The grippers so far apart: before, during (all but the first and last sample) and after Transport."""
    stage = [1, *([2] * (len(distances) - 2)), 3]
    return log_of(stage, arm_1=[(1.0, d) for d in distances], arm_2=[(1.0, 0.0)] * len(distances))


BOUNDS = [
    ({"at_most": 1.0}, (9, 0.5, 0.9, 0.7, 9), True, 0.1, np.nan),
    ({"at_most": 1.0}, (0, 0.5, 1.2, 1.1, 0), False, -0.2, 1.0),
    ({"at_least": 1.0}, (0, 1.5, 1.3, 1.4, 0), True, 0.3, np.nan),
    ({"at_least": 1.0}, (9, 1.5, 1.3, 0.5, 9), False, -0.5, 1.5),
    ({"above_start_at_most": 0.25}, (0, 1.0, 0.1, 1.2, 9), True, 0.05, np.nan),
    ({"above_start_at_most": 0.25}, (9, 1.0, 1.5, 1.2, 0), False, -0.25, 1.0),
    ({"below_start_at_most": 0.25}, (0, 1.0, 5.0, 0.8, 0), True, 0.05, np.nan),
    ({"below_start_at_most": 0.25}, (0, 1.0, 0.5, 0.2, 2), False, -0.55, 1.0),
    ({"at_most": 2.0, "at_least": 0.9}, (0, 1.0, 1.5, 1.2, 9), True, 0.1, np.nan),
    ({"at_most": 2.0, "at_least": 0.9}, (0, 1.0, 1.5, 0.8, 9), False, -0.1, 1.5),
]


@pytest.mark.parametrize(("bounds", "distances", "held", "margin", "broken_at"), BOUNDS)
def test_bounds_hold_during_the_stage_alone(
    bounds: dict[str, float],
    distances: tuple[float, ...],
    held: bool,
    margin: float,
    broken_at: float,
) -> None:
    found = verdict(apart(*distances), monitor(bounds))
    assert found.held is held
    assert found.margin == pytest.approx(margin)
    assert found.broken_at == pytest.approx(broken_at, nan_ok=True)


def test_a_stage_without_samples_is_not_judged() -> None:
    for log in (log_of([0, 1, 1]), log_of([])):
        found = verdict(log, monitor({"at_most": 1.0}))
        assert not found.held
        assert np.isnan(found.margin)
        assert np.isnan(found.broken_at)


@pytest.mark.parametrize("quantity", ["distance", "speed"])
def test_one_sample_is_enough(quantity: str) -> None:
    of = ("arm_1", "arm_2")[: 2 if quantity == "distance" else 1]
    found = verdict(log_of([2], arm_1=[(3.0, 4.0)], arm_2=[(3.0, 3.5)]), monitor({"at_most": 0.6}, quantity, of))
    assert found.held
    assert found.margin == pytest.approx(0.1 if quantity == "distance" else 0.6)


def test_a_signal_that_is_not_a_number_breaks_its_bound() -> None:
    found = verdict(apart(0, 1.0, np.nan, 1.0, 0), monitor({"at_most": 2.0}))
    assert not found.held
    assert found.broken_at == 1.0


def test_distance_of_one_frame_is_to_the_base() -> None:
    log = log_of([2, 2], base=[(1.0, 1.0), (1.0, 1.0)], arm_1=[(4.0, 5.0), (1.0, 3.0)])
    assert monitored_signal(monitor({"at_most": 1.0}, of=["arm_1"]), log).tolist() == [5.0, 2.0]


def test_speed_is_that_of_the_fastest_frame() -> None:
    still, moving = [(0.0, 0.0)] * 3, [(0.0, 0.0), (0.3, 0.4), (0.6, 0.8)]
    log = log_of([2, 2, 2], arm_1=still, arm_2=moving)
    assert monitored_signal(monitor({"at_most": 1.0}, "speed", ["arm_1"]), log).tolist() == [0.0] * 3
    assert monitored_signal(monitor({"at_most": 1.0}, "speed", ["arm_1", "arm_2"]), log) == pytest.approx([1.0] * 3)


@given(st.lists(st.floats(0, 10), min_size=1, max_size=8), st.floats(0, 10), st.floats(0, 3))
def test_the_margin_is_the_smallest_and_tells_whether_it_held(distances: list[float], most: float, rise: float) -> None:
    found = verdict(apart(0, *distances, 0), monitor({"at_most": most, "above_start_at_most": rise}))
    assert found.margin == pytest.approx(min(min(most, distances[0] + rise) - d for d in distances))
    assert found.held is (found.margin >= 0)
    assert np.isnan(found.broken_at) == found.held


def clearance_monitor(of: Sequence[str], at_least: float = 0.1) -> MonitorSpec:
    about = {"name": "m", "quantity": "clearance", "of": of, "during": "go", "at_least": at_least}
    return MonitorSpec.model_validate(about)


def log_of_distances(distances: Mapping[str, Sequence[float]], stage: Sequence[int]) -> Arrays:
    """The datasets that monitors of clearances use: distances by pair, and the current stage."""
    return {
        "time": SAMPLE * np.arange(len(stage)),
        "window/first": np.array(stage),
        "stages/name": np.array(["go", "back"]),
        "pose/xi": np.zeros((len(stage), 0)),
        "pose_coordinate": np.zeros(0),
        "clearance/pair": np.array(list(distances)),
        "clearance/distance": np.array(list(distances.values())).T,
    }


DISTANCES = {
    "arm_1.2 - post": [0.5, 0.4, 0.0],
    "arm_10.2 - post": [0.2, 0.05, 0.0],
    "base - arm_1.3": [0.15, 0.3, 0.0],
    "object - arm_2.1": [np.nan, 0.7, 0.0],
}


@pytest.mark.parametrize(
    ("of", "margin", "broken_at"),
    [
        ((), -0.05, SAMPLE),
        (("arm_1", "post"), 0.3, np.nan),
        (("post", "arm_1.2"), 0.3, np.nan),
        (("arm_10", "post"), -0.05, SAMPLE),
        (("arm_1", "base"), 0.05, np.nan),
        (("arm_2", "object"), 0.6, np.nan),
    ],
)
def test_a_monitor_of_a_clearance_is_about_its_parts(of: Sequence[str], margin: float, broken_at: float) -> None:
    """An arm stands for its bodies, a part that may touch is left out, and another stage does not count."""
    found = judge_monitor(clearance_monitor(of), log_of_distances(DISTANCES, [0, 0, 1]))
    assert (found.margin, found.unit, found.held) == (pytest.approx(margin), "m", margin >= 0)
    assert found.broken_at == pytest.approx(broken_at, nan_ok=True)


def test_a_monitor_of_parts_that_are_never_measured_is_not_judged() -> None:
    only_touching = {"object - arm_2.1": [np.nan, np.nan]}
    for of in (("arm_1", "post"), ("object", "arm_2"), ()):
        found = judge_monitor(clearance_monitor(of), log_of_distances(only_touching, [0, 0]))
        assert (found.held, np.isnan(found.margin), np.isnan(found.broken_at)) == (False, True, True)
    without = {path: each for path, each in log_of([0, 0]).items() if not path.startswith("stages")}
    named = {**without, "stages/name": np.array(["go"])}
    assert describe_verdict(judge_monitor(clearance_monitor(()), named)) == "not judged"
