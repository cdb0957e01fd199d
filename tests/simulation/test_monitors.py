from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from psmpc_cli.logs.read import Log
from psmpc_cli.simulation.monitors import Verdict, signal, verdicts
from psmpc_cli.specs.load import Task
from psmpc_cli.specs.task import MonitorSpec

POSES = tuple(f"{part}.{axis}" for part in ("base", "arm_1", "arm_2") for axis in ("x", "y", "theta"))
SAMPLE = 0.5


def log_of(stage: Sequence[int], **positions: Sequence[tuple[float, float]]) -> Log:
    """A log that holds what monitors look at: the current stage, and where the frames are."""
    xi = np.zeros((len(stage), len(POSES)))
    for name, points in positions.items():
        xi[:, POSES.index(f"{name}.x") : POSES.index(f"{name}.x") + 2] = np.reshape(points, (-1, 2))
    time = SAMPLE * np.arange(len(stage))
    columns = {"time": time, "window/first": np.array(stage, int), "pose/xi": xi}
    stages = {"name": np.array(["approach", "capture", "transport", "release"])}
    return Log(Path("log.h5"), {}, columns, stages, (), POSES, {}, {}, {}, False)


def monitor(
    bounds: Mapping[str, float], quantity: str = "distance", of: Sequence[str] = ("arm_1", "arm_2")
) -> MonitorSpec:
    about = {"name": "m", "quantity": quantity, "of": list(of), "during": "transport"}
    return MonitorSpec.model_validate({**about, **bounds})


def verdict(transport: Task, log: Log, *monitors: MonitorSpec) -> Verdict:
    (found,) = verdicts(transport.spec.model_copy(update={"monitors": monitors}), log)
    return found


def apart(*distances: float) -> Log:
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
    transport: Task,
    bounds: dict[str, float],
    distances: tuple[float, ...],
    held: bool,
    margin: float,
    broken_at: float,
) -> None:
    found = verdict(transport, apart(*distances), monitor(bounds))
    assert found.held is held
    assert found.margin == pytest.approx(margin)
    assert found.broken_at == pytest.approx(broken_at, nan_ok=True)


def test_a_bound_that_is_just_met_holds(transport: Task) -> None:
    found = verdict(transport, apart(0, 1.0, 1.0, 0), monitor({"at_most": 1.0}))
    assert found.held
    assert found.margin == 0.0


def test_a_stage_without_samples_is_not_judged(transport: Task) -> None:
    for log in (log_of([0, 1, 1]), log_of([])):
        found = verdict(transport, log, monitor({"at_most": 1.0}))
        assert not found.held
        assert np.isnan(found.margin)
        assert np.isnan(found.broken_at)


@pytest.mark.parametrize("quantity", ["distance", "speed"])
def test_one_sample_is_enough(transport: Task, quantity: str) -> None:
    of = ("arm_1", "arm_2")[: 2 if quantity == "distance" else 1]
    found = verdict(
        transport, log_of([2], arm_1=[(3.0, 4.0)], arm_2=[(3.0, 3.5)]), monitor({"at_most": 0.6}, quantity, of)
    )
    assert found.held
    assert found.margin == pytest.approx(0.1 if quantity == "distance" else 0.6)


def test_a_signal_that_is_not_a_number_breaks_its_bound(transport: Task) -> None:
    found = verdict(transport, apart(0, 1.0, np.nan, 1.0, 0), monitor({"at_most": 2.0}))
    assert not found.held
    assert found.broken_at == 1.0


def test_every_monitor_is_judged_in_order(transport: Task) -> None:
    tight, loose = monitor({"at_most": 0.1}), monitor({"at_most": 9.0}).model_copy(update={"name": "loose"})
    spec = transport.spec.model_copy(update={"monitors": (tight, loose)})
    assert [(v.name, v.held) for v in verdicts(spec, apart(0, 1, 1, 0))] == [("m", False), ("loose", True)]


def test_distance_of_one_frame_is_to_the_base() -> None:
    log = log_of([2, 2], base=[(1.0, 1.0), (1.0, 1.0)], arm_1=[(4.0, 5.0), (1.0, 3.0)])
    assert signal(monitor({"at_most": 1.0}, of=["arm_1"]), log).tolist() == [5.0, 2.0]


def test_speed_is_that_of_the_fastest_frame() -> None:
    still, moving = [(0.0, 0.0)] * 3, [(0.0, 0.0), (0.3, 0.4), (0.6, 0.8)]
    log = log_of([2, 2, 2], arm_1=still, arm_2=moving)
    assert signal(monitor({"at_most": 1.0}, "speed", ["arm_1"]), log).tolist() == [0.0] * 3
    assert signal(monitor({"at_most": 1.0}, "speed", ["arm_1", "arm_2"]), log) == pytest.approx([1.0] * 3)


@given(st.lists(st.floats(0, 10), min_size=1, max_size=8), st.floats(0, 10), st.floats(0, 3))
def test_the_margin_is_the_smallest_and_tells_whether_it_held(
    transport: Task, distances: list[float], most: float, rise: float
) -> None:
    found = verdict(transport, apart(0, *distances, 0), monitor({"at_most": most, "above_start_at_most": rise}))
    assert found.margin == pytest.approx(min(min(most, distances[0] + rise) - d for d in distances))
    assert found.held is (found.margin >= 0)
    assert np.isnan(found.broken_at) == found.held
