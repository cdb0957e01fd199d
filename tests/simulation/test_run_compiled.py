"""Solver and plant as compiled C: decided before the first sample, logged, and of no consequence for the results."""

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from psmpc_cli.ocp.problem import build_problem
from psmpc_cli.simulation.recorder import header
from psmpc_cli.simulation.run import Experiment, closed_loop, libraries_for, simulate
from psmpc_cli.specs.load import load_task

COARSE = ("controller.nodes=10", "solver.kind=sqp", "log.shares=false")


@pytest.fixture(scope="module", autouse=True)
def cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """A cache of these tests' own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PSMPC_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.mark.slow
def test_a_mission_is_the_same_with_and_without_a_compiler() -> None:
    """Its end conditions on poses are curved, which both methods for programs count in."""
    changes = ("controller.nodes=25", "solver.kind=sqp", "log.shares=false", "time_limit=14")
    runs = [simulate(load_task("transport", [*changes, f"solver.compiled={each}"])) for each in ("true", "false")]
    fast, slow = runs
    assert [bool(run.attributes["compiled"]) for run in runs] == [True, False]
    np.testing.assert_allclose(fast.stages["switch_time"], slow.stages["switch_time"], rtol=0, atol=1e-6)
    until = 80  # samples, in which the first switch is planned
    assert fast["window/count"][:until].max() == 2
    np.testing.assert_allclose(fast["window/instants"][:until], slow["window/instants"][:until], rtol=0, atol=1e-6)
    np.testing.assert_allclose(fast.Q[:until], slow.Q[:until], rtol=0, atol=1e-5)
    assert fast["solver/iterations"].sum() == slow["solver/iterations"].sum()


@pytest.mark.slow
def test_a_controller_compiles_nothing_once_it_is_built(tmp_path: Path) -> None:
    """In a process of its own, whose cache is empty: what was built before would serve here."""
    script = """
import os
from psmpc_cli import load_task
from psmpc_cli.control import Controller, State
from psmpc_cli.robot.motion import over_ticks
import numpy as np
controller = Controller(load_task("transport", ["controller.nodes=12"]))
built = sorted(os.listdir(os.environ["PSMPC_CACHE"]))
state = State(np.zeros(9), np.zeros(9))
widest = 0
for k in range(130):
    command = controller.step(0.1 * k, state)
    Q, v = over_ticks(controller.problem.model.space, state.Q, state.v, command.u, command.tick)
    state = State(Q[-1], v[-1])
    widest = max(widest, command.sequence.count)
assert widest == 2
assert built and sorted(os.listdir(os.environ["PSMPC_CACHE"])) == built
"""
    environment = {**os.environ, "PSMPC_CACHE": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_the_log_says_whether_compiled_code_ran(experiment_of: Callable[..., Experiment]) -> None:
    for changes, compiled in (((), True), (("solver.compiled=false",), False), (("plant.kind=ideal",), False)):
        assert header(experiment_of("solver.kind=fatrop", *changes)).attributes["compiled"] is compiled


def test_without_a_compiler_nothing_of_a_run_is_compiled(
    experiment_of: Callable[..., Experiment], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CC", "/no/such/compiler")
    experiment = experiment_of(*COARSE)
    assert not experiment.compiled
    assert len(list(islice(closed_loop(experiment), 2))) == 2


@pytest.mark.slow
def test_what_a_task_needs_is_compiled_before_its_first_sample(
    experiment_of: Callable[..., Experiment], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A disturbed plant is another library than an undisturbed one."""
    monkeypatch.setenv("PSMPC_CACHE", str(tmp_path))
    kinds = ("solver.kind=fatrop", "plant.kind=rk4")
    for count, more in enumerate(((), ("uncertainty.mass=0.1",)), start=1):
        assert experiment_of(*kinds, *more).compiled
        assert len(list(tmp_path.iterdir())) == count
    assert experiment_of("solver.kind=sqp", "plant.kind=ideal").compiled
    assert len(list(tmp_path.iterdir())) > 2


def test_another_load_compiles_nothing() -> None:
    """Masses and grasps are numbers that the rows of forces and the plant take."""
    heavier = {"object.mass": 25, "object.inertia": 3, "object.grasp.at.arm_1": [0.64, 0.01, "134 deg"]}
    needed = [
        {library.source for library in libraries_for(build_problem(load_task("transport_grasp", changes)))}
        for changes in ({}, heavier)
    ]
    assert needed[0] == needed[1]
