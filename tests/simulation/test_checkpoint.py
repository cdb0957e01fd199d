"""A closed loop goes on from a checkpoint as if nothing had happened."""

import pickle
from collections.abc import Callable
from itertools import islice

import numpy as np
import pytest

from psmpc_cli.simulation.checkpoint import Checkpoint
from psmpc_cli.simulation.loop import simulate
from psmpc_cli.simulation.setup import Experiment

COARSE = ("controller.nodes=10", "log.shares=false")


@pytest.mark.parametrize(("changes", "sample"), [(("controller.kind=psmpc",), 64), (("controller.kind=htmpc",), 3)])
def test_a_fresh_experiment_goes_on_exactly(
    experiment_of: Callable[..., Experiment], changes: tuple[str, ...], sample: int
) -> None:
    marks: list[Checkpoint] = []
    whole = list(islice(simulate(experiment_of(*COARSE, *changes), mark=marks.append), sample + 4))
    sent = pickle.loads(pickle.dumps(marks[sample]))
    rest = list(islice(simulate(experiment_of(*COARSE, *changes), sent), 4))
    for before, after in zip(whole[sample:], rest, strict=True):
        assert after.time == before.time
        assert after.presence == before.presence
        assert after.energy_error == before.energy_error
        for name in ("Q", "Qdot", "u", "F", "instants", "momentum_error"):
            np.testing.assert_array_equal(getattr(after, name), getattr(before, name))


def test_a_checkpoint_stays_what_it_was_while_the_run_goes_on(experiment_of: Callable[..., Experiment]) -> None:
    marks: list[Checkpoint] = []
    samples = simulate(experiment_of(*COARSE), mark=marks.append)
    next(samples)
    before = pickle.dumps(marks[0])
    list(islice(samples, 3))
    assert pickle.dumps(marks[0]) == before
