from dataclasses import replace
from math import isnan
from pathlib import Path

import numpy as np
import pytest

from psmpc_cli.logs.read import Log, read_log
from psmpc_cli.studies.claims import Moment
from psmpc_cli.studies.evidence import gather_evidence

from ..figures.made_up import Story, write_story


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Log:
    """A run in which Capture starts early."""
    return read_log(write_story(tmp_path_factory.mktemp("logs") / "run.h5", Story()))


def moment(stage: str, event: str) -> Moment:
    return Moment("psmpc", "t", stage, "end" if event == "end" else "start")


def test_times_are_those_of_the_log(log: Log) -> None:
    evidence = gather_evidence(log)
    assert evidence.time_of(moment("capture", "end")) == 13.0
    assert evidence.time_of(moment("capture", "start")) == 6.4
    assert evidence.regular_start("capture") == 10.0
    assert evidence.regular_start("approach") == 0.0
    assert isnan(evidence.time_of(moment("docking", "end")))
    assert isnan(evidence.regular_start("docking"))


def test_settings_are_those_of_the_task(log: Log) -> None:
    evidence = gather_evidence(log)
    assert (evidence.horizon, evidence.nodes, evidence.sample_time, evidence.epsilon) == (4.0, 100, 0.1, 0.1)


def test_stages_near_their_targets_as_they_end(log: Log) -> None:
    nearness = gather_evidence(log).nearness
    assert set(nearness) == {"approach", "capture", "transport", "release"}
    assert nearness["approach"].at(0.0) > 100
    for stage, end in (("approach", 10.0), ("release", 29.6)):
        assert nearness[stage].at(end) < nearness[stage].at(end - 3.0)
    assert nearness["release"].at(29.6) < 1.0


def test_velocity_limits_bound_the_ends(log: Log) -> None:
    earliest = gather_evidence(log).earliest_ends
    assert 9.9 < earliest["approach"] <= 10.0
    assert list(earliest.values()) == sorted(earliest.values())


def test_an_onset_is_what_a_stage_added_while_it_waited(log: Log) -> None:
    presence = np.full_like(log["window/presence"], np.nan)
    waits = (log.time > 6.0) & (log.time < 8.0)
    presence[waits, 1] = log.time[waits] - 6.0
    postponed = np.zeros_like(log["events/postponed"])
    postponed[[0, np.flatnonzero(waits)[0] - 1]] = 1
    window = {"window/first": np.zeros_like(log["window/first"]), "window/count": np.ones_like(log["window/count"])}
    window["window/count"][0] = 2  # what is postponed there is the stage after the next
    columns = {**log.columns, **window, "window/presence": presence, "events/postponed": postponed}
    onsets = gather_evidence(replace(log, columns=columns)).onsets
    assert set(onsets) == {"capture"}
    onset = onsets["capture"]
    assert onset.time == pytest.approx(log.time[waits])
    assert onset.largest() == pytest.approx(float(log.time[waits][-1] - 6.0))
    assert onset.largest(before=float(onset.time[0])) == 0.0
    assert set(onset.starts) == {0.1, 0.01}
    assert onset.postponed == 1


def test_a_run_that_was_killed_has_evidence_too(tmp_path: Path) -> None:
    evidence = gather_evidence(read_log(write_story(tmp_path / "killed.h5", Story(last=11.0))))
    assert evidence.time_of(moment("approach", "end")) == 10.0
    assert isnan(evidence.time_of(moment("release", "end")))
    assert evidence.nearness["capture"].time[-1] <= 11.0
