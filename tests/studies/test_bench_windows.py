from itertools import pairwise

import numpy as np
import pytest

from psmpc_cli.ocp.plan import shift
from psmpc_cli.simulation.setup import Experiment
from psmpc_cli.studies.bench_windows import Recorded, distinct, record_windows

from .small_bench import recorded_run, small_task

Run = tuple[Experiment, list[Recorded]]


@pytest.fixture(scope="module")
def run() -> Run:
    return recorded_run()


def test_windows_before_at_and_after_the_append_are_kept(run: Run) -> None:
    _, windows = run
    assert [(recorded.phase, recorded.stages) for recorded in windows] == [("before", 1), ("at", 2), ("after", 2)]
    assert np.diff([recorded.window.start for recorded in windows]) == pytest.approx([0.1, 0.1])
    assert [len(recorded.instants) for recorded in windows] == [0, 1, 1]


def test_a_window_can_be_solved_again_from_what_is_kept(run: Run) -> None:
    """What a sample came to is what the next one starts from."""
    experiment, windows = run
    for recorded, after in pairwise(windows):
        window, before = recorded.window, recorded.before
        prediction = shift(before.plan, window.start, window.horizon, window.x0)
        again = experiment.controller.windows.solve(window, prediction, recorded.instants, before)
        assert np.array_equal(again.solution.z, after.before.solution.z)


def test_the_run_ends_when_there_are_enough_appends() -> None:
    samples: list[int] = []
    record_windows(small_task(), None, lambda: samples.append(1))
    whole = len(samples)
    record_windows(small_task(), 1, lambda: samples.append(1))
    assert 0 < len(samples) - whole < whole


def test_windows_that_are_one_problem_are_kept_once(run: Run) -> None:
    """With equal priorities the run of SMPC is that of PSMPC."""
    _, windows = run
    _, of_smpc = recorded_run("controller.kind=smpc")
    kept = distinct([*windows, *of_smpc])
    assert kept == windows


def test_other_priorities_make_other_windows_of_several_stages(run: Run) -> None:
    _, windows = run
    _, others = recorded_run("stages[1].priority=5")
    kept = distinct([*windows, *others])
    assert [recorded.stages for recorded in kept] == [1, 2, 2, 2, 2]
