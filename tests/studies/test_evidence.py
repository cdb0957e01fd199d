from dataclasses import replace
from math import isnan
from pathlib import Path

import numpy as np
import pytest

from psmpc_cli.logs.run import Run, read_run
from psmpc_cli.studies.claims import RunEvidence, gather_run

from ..figures.made_up import Story, write_story
from .hand_made import evidence


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A run in which Capture starts early."""
    return read_run(write_story(tmp_path_factory.mktemp("logs") / "run.h5", Story()))


def time_of(symbol: str, found: RunEvidence) -> float:
    return evidence(psmpc=found).moment(f"psmpc.{symbol}").time


def test_times_are_those_of_the_log(log: Run) -> None:
    found = gather_run(log)
    assert time_of("t2", found) == 13.0
    assert time_of("t1_real", found) == 6.4
    start = evidence(psmpc=found).moment("psmpc.t1_real")
    assert (start.stage, start.event) == ("capture", "start")
    assert evidence(psmpc=found).end_before(start).time == 10.0
    assert found.regular_start("capture") == 10.0
    assert found.regular_start("approach") == 0.0
    assert isnan(found.regular_start("docking"))


def test_settings_are_those_of_the_task(log: Run) -> None:
    found = gather_run(log)
    assert (found.horizon, found.nodes, found.sample_time, found.epsilon) == (4.0, 100, 0.1, 0.1)


def test_stages_near_their_targets_as_they_end(log: Run) -> None:
    errors = gather_run(log).errors
    assert set(errors) == {"approach", "capture", "transport", "release"}
    assert errors["approach"][1][0] > 100
    for stage, end in (("approach", 10.0), ("release", 29.6)):
        before, then = np.interp([end - 3.0, end], *errors[stage])
        assert then < before
    assert errors["release"][1][-1] < 1.0


def test_velocity_limits_bound_the_ends(log: Run) -> None:
    earliest = gather_run(log).earliest_ends
    assert 9.9 < earliest["approach"] <= 10.0
    assert list(earliest.values()) == sorted(earliest.values())


def test_an_onset_is_what_a_stage_added_while_it_waited(log: Run) -> None:
    presence = np.full_like(log["window/presence"], np.nan)
    waits = (log.time > 6.0) & (log.time < 8.0)
    presence[waits, 1] = log.time[waits] - 6.0
    postponed = np.zeros_like(log["events/postponed"])
    postponed[[0, np.flatnonzero(waits)[0] - 1]] = 1
    window = {"window/first": np.zeros_like(log["window/first"]), "window/count": np.ones_like(log["window/count"])}
    window["window/count"][0] = 2  # what is postponed there is the stage after the next
    arrays = {**log.arrays, **window, "window/presence": presence, "events/postponed": postponed}
    onsets = gather_run(replace(log, arrays=arrays)).onsets
    assert set(onsets) == {"capture"}
    onset = onsets["capture"]
    assert onset.time == pytest.approx(log.time[waits])
    assert onset.largest() == pytest.approx(float(log.time[waits][-1] - 6.0))
    assert onset.largest(before=float(onset.time[0])) == 0.0
    assert set(onset.starts) == {0.1, 0.01}
    assert onset.postponed == 1


def test_a_run_that_was_killed_has_evidence_too(tmp_path: Path) -> None:
    found = gather_run(read_run(write_story(tmp_path / "killed.h5", Story(last=11.0))))
    assert time_of("t1", found) == 10.0
    assert isnan(time_of("t_end", found))
    assert found.errors["capture"][0][-1] <= 11.0
