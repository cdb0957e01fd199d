"""What a run does when something goes wrong that it cannot help; faults.py wraps what goes wrong."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import count
from pathlib import Path

import numpy as np
import pytest

from psmpc_cli.errors import RunError
from psmpc_cli.logs.run import Run, read_run
from psmpc_cli.logs.summary import Summary
from psmpc_cli.simulation.run import simulate
from psmpc_cli.solvers.base import FEASIBLE
from psmpc_cli.specs.load import load_task

from ..short_runs import TASK
from .faults import Fault, Seen, during, injected, meaningless, not_converging, pushed, raising, unmeasured

LIMIT = 0.2
"""No rate of the robot may be larger [m/s, rad/s]."""

EVER = 1000


@dataclass(frozen=True)
class Faulty:
    """A run in which something went wrong."""

    log: Run
    summary: Summary
    seen: Seen
    stuck: bool

    @property
    def at_rest(self) -> bool:
        assert self.seen.state is not None
        return float(np.abs(self.seen.state[len(self.seen.state) // 2 :]).max()) < 1e-6


Start = Callable[..., Faulty]


@pytest.fixture(scope="module")
def faulty(tmp_path_factory: pytest.TempPathFactory) -> Start:
    """Run there and back with a fault, and return what came of it."""
    folder = tmp_path_factory.mktemp("faults")
    (folder / "task.yaml").write_text(TASK)
    numbers = count()

    def start(fault: Fault, *changes: str, path: Path | None = None) -> Faulty:
        path = path or folder / f"{next(numbers)}.h5"
        quick = ("solver.kind=sqp", "solver.compiled=false", "log.shares=false")
        with injected(fault) as seen:
            simulate(load_task(folder / "task.yaml", (*quick, *changes)), path)
        log = read_run(path)
        assert np.isfinite(log["state/Q"]).all()
        return Faulty(log, log.summary(), seen, bool(log.attributes["stuck"]))

    return start


@pytest.fixture(scope="module")
def untouched(faulty: Start) -> Faulty:
    """The same run without a fault."""
    return faulty(Fault())


def assert_goes_on(run: Faulty, like: Faulty) -> None:
    """The mission is done, no later than half a second after it would have been, and nothing is out of bounds."""
    assert run.summary.completed
    assert run.summary.duration <= like.summary.duration + 0.5
    assert run.seen.rates.max() <= LIMIT + 1e-3
    assert run.seen.forces.max() <= 1.1 * like.seen.forces.max()


def assert_brakes(run: Faulty, reason: str, after: float) -> None:
    """The robot is at rest by the end of the plan of that time [s], and the run has said why."""
    assert run.stuck
    assert not run.summary.completed
    assert run.at_rest
    assert run.summary.reason == f"{reason} and the plan was used up; the robot braked to rest"
    assert run.log["events/braking"].any()
    assert run.summary.duration <= after + 1.0 + 0.5 + 0.11
    assert run.seen.rates.max() <= LIMIT + 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("samples", [1, 5])
@pytest.mark.parametrize("entries", [(), (0,), (9,)])
def test_the_plan_is_used_for_what_is_not_measured(
    faulty: Start, untouched: Faulty, samples: int, entries: tuple[int, ...]
) -> None:
    run = faulty(unmeasured(during(0.3, samples), *entries))
    assert_goes_on(run, untouched)
    assert run.summary.unmeasured == samples
    np.testing.assert_allclose(run.log.time[run.log["events/unmeasured"] == 1], 0.3 + 0.1 * np.arange(samples))
    assert run.summary.failed_solves == 0
    # the plant is the one that was planned with, and a plan is its own within that at every sample
    np.testing.assert_allclose(run.log["state/Q"][:8], untouched.log["state/Q"][:8], atol=samples * FEASIBLE)


@pytest.mark.slow
@pytest.mark.parametrize("entries", [(), (9,)])
def test_without_a_measurement_the_robot_brakes_when_the_last_trusted_plan_ends(
    faulty: Start, caplog: pytest.LogCaptureFixture, entries: tuple[int, ...]
) -> None:
    run = faulty(unmeasured(during(0.3, EVER), *entries), "stages.go.target.base=[0.4, 0, 0]")
    assert_brakes(run, "the state was not measured", after=0.2)
    assert run.summary.unmeasured == len(run.log.time) - 3
    assert "0.30 s: the state was not measured; the plan's prediction is used for it" in caplog.messages
    assert caplog.messages[-1].endswith("the robot brakes to rest")


@pytest.mark.slow
def test_a_measurement_that_returns_ends_the_braking(faulty: Start) -> None:
    run = faulty(unmeasured(during(0.3, 11)), "stages.go.target.base=[0.4, 0, 0]", "time_limit=10")
    assert run.log["events/braking"].any()
    assert run.summary.completed


def test_a_run_that_never_measured_anything_does_not_begin(faulty: Start) -> None:
    with pytest.raises(RunError, match="nothing is measured at 0 s and there is no plan yet"):
        faulty(unmeasured(during(0.0, EVER)))


@pytest.mark.slow
@pytest.mark.parametrize("fault", [not_converging, raising, meaningless])
@pytest.mark.parametrize("samples", [1, 5])
def test_the_shifted_plan_goes_on_where_a_solver_fails(
    faulty: Start, untouched: Faulty, fault: Callable[..., Fault], samples: int
) -> None:
    run = faulty(fault(during(0.3, samples)))
    assert_goes_on(run, untouched)
    assert run.summary.failed_solves == samples
    statuses = set(run.log["solver/status"][run.log["events/solve_failed"] == 1].astype(str))
    assert statuses == {"iteration_limit" if fault is not_converging else "failed"}


@pytest.mark.slow
@pytest.mark.parametrize("fault", [not_converging, raising])
def test_a_solver_that_fails_for_long_leaves_the_robot_at_rest(faulty: Start, fault: Callable[..., Fault]) -> None:
    run = faulty(fault(during(0.3, 50)), "stages.go.target.base=[0.4, 0, 0]", "time_limit=10")
    assert_brakes(run, "no window could be solved", after=0.2)


def test_what_a_solver_raised_is_reported(faulty: Start, caplog: pytest.LogCaptureFixture) -> None:
    faulty(raising(during(0.3, 1)))
    assert "the solver raised RuntimeError: Error in Function::call for 'window': evaluation failed" in caplog.messages


@pytest.mark.slow
def test_a_level_that_raises_leaves_the_level_before_it(faulty: Start) -> None:
    run = faulty(raising(during(0.3, 2)), "controller.kind=htmpc", "solver.kind=fatrop")
    assert run.summary.completed
    assert run.summary.failed_solves == 2


@pytest.mark.slow
def test_one_iteration_a_sample_is_enough_for_a_deadline_that_is_always_missed(
    faulty: Start, untouched: Faulty
) -> None:
    run = faulty(Fault(), "solver.deadline=1e-6")
    assert_goes_on(run, untouched)
    assert set(run.log["solver/iterations"]) == {1}


@pytest.mark.slow
def test_a_robot_without_an_iteration_stays_where_it_is(faulty: Start) -> None:
    run = faulty(Fault(), "solver.kind=ipopt", "solver.deadline=1e-6")
    assert_brakes(run, "no window could be solved", after=0.0)
    assert set(run.log["solver/status"].astype(str)) == {"deadline"}
    assert run.seen.rates.max() == 0


WEAK = ("limits={base: {acceleration: [0.2, 0.2, 0.2]}}", "stages.go.target.base=[0.3, 0, 0]", "time_limit=12")
BLOW = pushed(1.7, x=-0.3)
"""Against the motion, with the switch in the window: the robot is on its way, and cannot be there in time any more."""


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["sqp", "fatrop"])
def test_a_stage_whose_end_is_out_of_reach_does_not_end_until_it_is_reached(faulty: Start, kind: str) -> None:
    run = faulty(BLOW, *WEAK, f"solver.kind={kind}")
    log, stages = run.log, run.log["window/count"]
    blow = int(np.argmin(np.abs(log.time - 1.7)))
    assert stages[blow - 1] == 2
    assert run.summary.completed
    assert (stages[blow:] == 1).any()
    switch = log.stages["switch_time"][0]
    assert np.abs(np.interp(switch, log.time, log["state/Q"][:, 0]) - 0.3) < 6e-3
    assert run.seen.rates.max() <= LIMIT + 0.3
    if kind == "sqp":
        assert run.summary.failed_solves == 0
        assert log["events/postponed"][blow]


@pytest.mark.slow
@pytest.mark.parametrize("rate", [1e12, np.inf, np.nan])
def test_a_motion_that_diverges_ends_the_run_before_its_numbers_lose_their_meaning(faulty: Start, rate: float) -> None:
    run = faulty(pushed(1.0, x=rate))
    assert run.stuck and not run.summary.completed
    assert run.summary.reason == "the motion diverged, faster than it can be simulated"
    assert run.log.final["time"] == run.log.time[-1] + 0.1 == pytest.approx(0.9)
    assert all(np.isfinite(run.log.final[name]).all() for name in ("Q", "v", "xi"))
