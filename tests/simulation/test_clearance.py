"""Distances of parts that keep clear, measured at every tick of a sample."""

import numpy as np
import pytest

from psmpc_cli.logs.run import Run
from psmpc_cli.ocp.constraints.clearance import distance_rows, groups
from psmpc_cli.ocp.problem import build_problem
from psmpc_cli.simulation.clearance import ClearanceMeter, clearance_header
from psmpc_cli.simulation.run import simulate
from psmpc_cli.specs.load import load_task

POST = {"name": "post", "shape": {"sphere": 0.1}, "pose": [-1, 1.2, 0], "velocity": [0.05, 0]}
CHANGES = {
    "controller.nodes": 8,
    "time_limit": 2,
    "plant.low_level_rate": 100,
    "log": {"ticks": True, "shares": False, "plans": False},
    "obstacles": [POST],
    "clearance": {"margin": 0.02},
}


@pytest.fixture(scope="module")
def run() -> Run:
    """Two seconds of a flight beside a post that moves."""
    return simulate(load_task("transport", CHANGES))


def test_the_smallest_distance_of_a_sample_is_that_of_its_ticks(run: Run) -> None:
    """Where the post is at a tick follows from its velocity, and the distances from the logged state there."""
    pairs = groups(run.problem.spec, run.problem.model, 0)["post"].pairs
    time = run["ticks/time"]
    X = np.hstack([run["ticks/Q"], run["ticks/Qdot"]])
    poses = np.array(POST["pose"]) + np.outer(time, [0.05, 0, 0])
    argument = np.hstack([np.zeros((len(time), 1)), poses])
    apart = distance_rows(run.problem.model, pairs).value(X, argument, rows=len(X))[0]
    columns = [str(pair) for pair in run["clearance/pair"]]
    sample_of = np.searchsorted(run.time, time + 1e-9, side="right") - 1
    for name in {f"{first} - {second}" for first, second in pairs.names}:
        own = [row for row, pair in enumerate(pairs.pair_of_row) if " - ".join(pairs.names[pair]) == name]
        nearest = apart[:, own].min(axis=1)
        by_tick = np.array([nearest[sample_of == sample].min() for sample in range(len(run.time))])
        at_end = nearest[np.searchsorted(sample_of, np.arange(1, len(run.time)))]  # the first tick of the next sample
        logged = run["clearance/distance"][:, columns.index(name)]
        assert logged[:-1] == pytest.approx(np.minimum(by_tick[:-1], at_end), abs=1e-9)


def test_margins_are_those_of_the_stage(run: Run) -> None:
    changes = {**CHANGES, "clearance": None, "stages.capture.clearance": {"margin": 0.1}}
    changes["stages.transport.clearance"] = {"margin": 0.05, "except": [["base", "post"]]}
    meter = ClearanceMeter(build_problem(load_task("transport", changes)))
    of_base = meter.pairs.index(("base", "post"))
    of_arm = meter.pairs.index(("arm_1.3", "post"))
    np.testing.assert_equal(meter.margins[:, of_base], [np.nan, 0.1, np.nan, np.nan])
    np.testing.assert_equal(meter.margins[:, of_arm], [np.nan, 0.1, 0.05, np.nan])
    assert run["clearance/margin"] == pytest.approx(run["clearance/distance"] - 0.02)


def test_pairs_are_named_in_the_order_of_their_columns(run: Run) -> None:
    names = clearance_header(run.problem)
    assert names["clearance/pair"] == tuple(run["clearance/pair"])
    assert names["clearance/point"] == ("first.x", "first.y", "first.z", "second.x", "second.y", "second.z")
