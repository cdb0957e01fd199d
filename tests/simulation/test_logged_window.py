from pathlib import Path

import numpy as np
import pytest

from psmpc_cli.errors import InputError, LogError
from psmpc_cli.logs.run import Run
from psmpc_cli.ocp.window import parameter_vector
from psmpc_cli.simulation.logged_window import ensure_sample, logged_sequences, logged_solve
from psmpc_cli.simulation.setup import Experiment, build_experiment

from .logged import there_and_back


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return there_and_back(tmp_path_factory.mktemp("run"), "stages[1].priority=3")


@pytest.fixture(scope="module")
def experiment(log: Run) -> Experiment:
    return build_experiment(log.task)


def test_sequences_are_those_of_the_log(log: Run, experiment: Experiment) -> None:
    found = logged_sequences(log, experiment)
    assert [each.sequence.first for each in found] == log["window/first"].tolist()
    assert [each.sequence.count for each in found] == log["window/count"].tolist()
    switches = [switch for each in found for switch in each.switches]
    assert [(switch.stage, switch.time) for switch in switches] == [(0, log.stages["switch_time"][0])]
    assert {each.sequence.entered for each in found} == {0.0, log.stages["switch_time"][0]}


def test_a_window_gives_the_parameters_it_was_taken_from(log: Run, experiment: Experiment) -> None:
    for sample in (0, 4, len(log.time) - 1):
        solve = logged_solve(log, experiment, logged_sequences(log, experiment)[sample].sequence, sample)
        rebuilt = parameter_vector(solve.nlp, solve.window, solve.plan.instants)
        np.testing.assert_array_equal(rebuilt, solve.parameters)
        np.testing.assert_array_equal(solve.plan.instants, log["window/instants"][sample][: len(solve.plan.instants)])
        assert solve.outcome.usable


def test_the_solve_of_another_window_is_refused(log: Run, experiment: Experiment) -> None:
    sequences = logged_sequences(log, experiment)
    with pytest.raises(LogError, match="the plan of sample 4 is not one of the window"):
        logged_solve(log, experiment, sequences[-1].sequence, 4)


def test_samples_that_are_not_there_are_refused(log: Run, tmp_path: Path) -> None:
    for sample in (-1, len(log.time)):
        with pytest.raises(InputError, match=f"found no sample {sample}; expected one from 0 to {len(log.time) - 1}"):
            ensure_sample(log, sample)
    with pytest.raises(LogError, match="holds no plans"):
        ensure_sample(there_and_back(tmp_path, "log.plans=false", samples=2), 0)
