from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from psmpc_cli.control.window_solver import WindowSolver

from psmpc_cli.control import Command
from psmpc_cli.control.controller import SwitchingController
from psmpc_cli.logs.schema import Sample
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.ocp.window import Window
from psmpc_cli.simulation.loop import Ending, closed_loop
from psmpc_cli.simulation.setup import Experiment
from psmpc_cli.solvers import Outcome

QUICK = ("controller.nodes=8", "plant.kind=ideal", "log.plans=false")
SHORT = (
    *QUICK,
    "stages.approach.target.base=[-0.3, 0.3, 5 deg]",
    "stages.capture.target.base=[-0.3, 0.3, 5 deg]",
    "stages.capture.target.arm_1=[1.1, 0.5, 20 deg]",
    "stages.capture.target.arm_2=[-1.7, 0.1, -10 deg]",
    "stages.transport.target.base=[-0.2, 0.2, 0 deg]",
    "stages.transport.target.arm_1=[5 deg, 5 deg, 5 deg]",
    "stages.transport.target.arm_2=[-5 deg, -5 deg, -5 deg]",
    "stages.release.target.base=[-0.2, 0.2, 0 deg]",
    "stages.release.target.arm_1=[1.25, 0.4, 10 deg]",
    "stages.release.target.arm_2=[-1.65, 0.0, -10 deg]",
    "monitors=[]",
)


def run(experiment: Experiment) -> tuple[list[Sample], Ending]:
    records, samples = [], closed_loop(experiment)
    while True:
        try:
            records.append(next(samples))
        except StopIteration as stop:
            return records, stop.value


class Unreliable(WindowSolver):
    """Fails the solves whose number is listed, as a solver that does not converge would."""

    def __init__(self, windows: WindowSolver, failing: Callable[[float], bool]) -> None:
        super().__init__(windows.task, windows.model, windows.costs)
        self._compiled, self.failing = windows._compiled, failing

    def solve(self, window: Window, *rest: object):
        solved = super().solve(window, *rest)
        if self.failing(window.start):
            return replace(solved, solution=replace(solved.solution, outcome=Outcome.ITERATION_LIMIT))
        return solved


def with_failures(experiment: Experiment, failing: Callable[[float], bool]) -> Experiment:
    controller = experiment.controller
    windows = Unreliable(controller.windows, failing)
    return replace(experiment, controller=SwitchingController(controller.spec, controller.stages, windows))


def test_smpc_is_psmpc_with_equal_priorities(experiment_of: Callable[..., Experiment]) -> None:
    equal = [f"stages.{name}.priority=1" for name in ("approach", "capture", "transport", "release")]
    smpc, _ = run(experiment_of(*SHORT, "controller.kind=smpc"))
    psmpc, _ = run(experiment_of(*SHORT, *equal))
    assert len(smpc) == len(psmpc) > 20
    for one, other in zip(smpc, psmpc, strict=True):
        np.testing.assert_array_equal(np.r_[one.Q, one.Qdot, one.u], np.r_[other.Q, other.Qdot, other.u])
        np.testing.assert_array_equal(one.instants, other.instants)


def test_scaling_all_priorities_changes_nothing(experiment_of: Callable[..., Experiment]) -> None:
    scaled = zip(("approach", "capture", "transport", "release"), (64, 6400, 64, 0.64), strict=True)
    once, _ = run(experiment_of(*SHORT))
    again, _ = run(experiment_of(*SHORT, *(f"stages.{name}.priority={omega}" for name, omega in scaled)))
    np.testing.assert_array_equal([r.command.x[:9] for r in once], [r.command.x[:9] for r in again])


def test_hard_switching_never_looks_past_the_current_stage(experiment_of: Callable[..., Experiment]) -> None:
    records, ending = run(experiment_of(*SHORT, "controller.kind=hard"))
    assert ending.completed
    assert all(len(record.command.instants) == 0 for record in records)
    assert not any(record.metrics.presence for record in records)


def test_several_switches_fall_into_one_window(experiment_of: Callable[..., Experiment]) -> None:
    records, ending = run(experiment_of(*SHORT))
    assert ending.completed
    assert max(len(record.command.instants) for record in records) == 2
    times = [switch for record in records for switch in record.command.switches] + [
        (s.stage, s.time) for s in ending.switches
    ]
    assert [stage for stage, _ in times] == [0, 1, 2, 3]
    assert np.all(np.diff([time for _, time in times]) > 0)


@pytest.mark.parametrize("guess", [0.2, 0.9, 3.9])
def test_the_optimal_instant_does_not_depend_on_the_guess(
    experiment_of: Callable[..., Experiment], decisions: list[Command], guess: float
) -> None:
    """The pending cost makes the instant the earliest at which the condition can be met."""
    decision = next(d for d in decisions if len(d.plan.instants) == 1 and d.plan.instants[0] - d.plan.start < 1.4)
    windows = experiment_of("controller.nodes=20").controller.windows
    window = decision.solution.window
    solved = windows.solve(window, decision.prediction, np.array([window.start + guess]))
    assert solved.solution.outcome.usable
    assert solved.plan.instants[0] == pytest.approx(decision.plan.instants[0], abs=1e-3)


def test_a_failed_solve_falls_back_to_the_shifted_plan(experiment_of: Callable[..., Experiment]) -> None:
    records, ending = run(with_failures(experiment_of(*SHORT), lambda now: 0.45 < now < 0.95))
    fallen = [record for record in records if "solve_failed" in record.command.events]
    assert [round(record.command.time, 1) for record in fallen] == [0.5, 0.6, 0.7, 0.8, 0.9]
    assert all(record.command.outcome.name.lower() == "iteration_limit" for record in fallen)
    before = next(record for record in records if round(record.command.time, 1) == 0.4)
    np.testing.assert_allclose(fallen[0].instants, before.instants)
    assert ending.completed


def test_when_the_plan_is_used_up_the_robot_brakes_to_rest_and_the_run_stops(
    experiment_of: Callable[..., Experiment],
) -> None:
    records, ending = run(with_failures(experiment_of(*QUICK), lambda now: now > 0.95))
    assert ending.stuck
    assert not ending.completed
    assert "braked to rest" in ending.reason
    assert np.abs(ending.x[9:]).max() < 1e-9
    braking = [record.command.time for record in records if "braking" in record.command.events]
    assert 0.9 + 4.0 - 0.15 <= braking[0] <= 0.9 + 4.0


def test_nothing_to_fall_back_to_at_the_first_sample_leaves_the_robot_at_rest(
    experiment_of: Callable[..., Experiment],
) -> None:
    records, ending = run(with_failures(experiment_of(*QUICK), lambda now: True))
    assert ending.stuck
    assert all(np.all(record.command.x[:9] == 0) for record in records)


def test_an_append_that_cannot_be_solved_is_postponed(experiment_of: Callable[..., Experiment]) -> None:
    experiment = experiment_of(*SHORT)
    controller = experiment.controller

    class NoLongWindows(Unreliable):
        def solve(self, window: Window, *rest: object):
            self.failing = lambda now: len(window.stages) > 1 and now < 0.95
            return super().solve(window, *rest)

    windows = NoLongWindows(controller.windows, lambda now: False)
    records, ending = run(
        replace(experiment, controller=SwitchingController(controller.spec, controller.stages, windows))
    )
    postponed = [record for record in records if "postponed" in record.command.events and record.command.time < 0.95]
    assert postponed
    assert all(
        record.command.outcome.name.lower() in ("optimal", "feasible") and len(record.command.instants) == 0
        for record in postponed
    )
    assert ending.completed


def test_a_solve_of_the_same_stages_is_warm(decisions: list[Command]) -> None:
    """Without an append or a drop every solve starts from the last solution, moved in time."""
    for before, after in pairwise(decisions):
        stages, stages_before = ([s.index for s in d.solution.window.stages] for d in (after, before))
        assert after.solved.guess.warm == (stages == stages_before)


def test_the_warm_start_is_the_shifted_plan(decisions: list[Command]) -> None:
    before, after = decisions[5], decisions[6]
    plan: Plan = after.prediction
    np.testing.assert_allclose(plan.states_at(np.array([2.0])), before.plan.states_at(np.array([2.0])), atol=1e-9)
