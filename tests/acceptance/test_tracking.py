"""The tracking task in closed loop on a coarse mesh: how near base and end-effectors stay to what they follow."""

from collections.abc import Callable

import numpy as np
import pytest

from psmpc_cli.logs.schema import Sample
from psmpc_cli.simulation.run import Experiment

from ..control.short_transports import run

COARSE = ("controller.nodes=12", "plant.kind=ideal", "log.plans=false")

Run = tuple[Experiment, list[Sample], np.ndarray]


@pytest.fixture(scope="module")
def tracked(experiment_of: Callable[..., Experiment]) -> Run:
    """The run, and the instants at which its stages ended."""
    experiment = experiment_of(*COARSE, task="tracking")
    records, ending = run(experiment)
    assert ending.completed
    switches = [switch for record in records for switch in record.command.switches]
    ends = dict([*switches, *((switch.stage, switch.time) for switch in ending.switches)])
    return experiment, records, np.array([ends[i] for i in range(3)])


def errors(tracked: Run) -> tuple[np.ndarray, np.ndarray]:
    """Times since the trajectory began (K,) [s], and xi less what it should be (K, m) [m, rad]."""
    experiment, records, ends = tracked
    during = [record for record in records if ends[0] <= record.command.time <= ends[1]]
    since = np.array([record.command.time for record in during]) - ends[0]
    xi = np.array([record.metrics["pose/xi"] for record in during])
    return since, xi - experiment.problem.stages[1].wanted(since)


def test_trajectory_is_followed(tracked: Run) -> None:
    since, error = errors(tracked)
    assert len(since) >= 160
    distance = {name: np.hypot(*error[:, rows][:, :2].T) for name, rows in tracked[0].problem.model.pose_rows.items()}
    rms = {name: float(np.sqrt(np.mean(values**2))) for name, values in distance.items()}
    assert rms["arm_1"] < 3e-3
    assert rms["arm_2"] < 0.01
    assert rms["base"] < 0.01
    assert all(values.max() < 0.05 for values in distance.values())
    assert np.abs(error[:, 2::3]).max() < 0.1


def test_stage_ends_as_soon_as_its_trajectory_is_over(tracked: Run) -> None:
    _, _, ends = tracked
    assert 16 - 1e-6 <= ends[1] - ends[0] <= 16.1


def test_next_stage_is_seen_before_and_its_instant_stays(tracked: Run) -> None:
    """Under a reference that stretched with the mesh the instant would slide along with the end of the horizon."""
    _, records, ends = tracked
    seen = np.array(
        [
            record.command.switch_times[0]
            for record in records
            if record.command.sequence.first == 1 and len(record.command.switch_times)
        ]
    )
    assert len(seen) >= 30
    np.testing.assert_allclose(seen, ends[1], atol=0.05)


def test_no_window_fails(tracked: Run) -> None:
    assert not any({"solve_failed", "braking"} & record.command.events for record in tracked[1])
