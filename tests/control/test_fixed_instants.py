"""Time-dependent switching: stages that end at a given time, and windows whose instants are given."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from psmpc_cli.control.window_solver import SolvedWindow, WindowSolver

from psmpc_cli.control import Command
from psmpc_cli.logs.schema import Sample
from psmpc_cli.ocp.window import Bounds, bounds, pack_guess
from psmpc_cli.simulation.loop import Ending
from psmpc_cli.simulation.setup import Experiment
from psmpc_cli.solvers import Guess, Solution

from .test_controller import run

ELSEWHERE = 0.3
"""Where the solve with fixed instants starts: the states of a guess whose instants are so much later [s]."""

SHORT = (
    "controller.nodes=8",
    "plant.kind=ideal",
    "log.plans=false",
    "stages.approach.target.base=[-0.3, 0.3, 5 deg]",
    "stages.capture.target={base: [-0.3, 0.3, 5 deg], arm_1: [1.1, 0.5, 20 deg], arm_2: [-1.7, 0.1, -10 deg]}",
    "stages.transport.target={base: [-0.2, 0.2, 0], arm_1: [5 deg, 5 deg, 5 deg], arm_2: [-5 deg, -5 deg, -5 deg]}",
    "stages.release.target={base: [-0.2, 0.2, 0], arm_1: [1.25, 0.4, 10 deg], arm_2: [-1.65, 0.0, -10 deg]}",
    "monitors=[]",
)


def timed(**at: float) -> tuple[str, ...]:
    """Changes that give stages a fixed end."""
    return tuple(
        change for name, time in at.items() for change in (f"stages.{name}.ends_when=null", f"stages.{name}.at={time}")
    )


def switches(records: list[Sample], ending: Ending) -> dict[int, float]:
    during = {stage: time for record in records for stage, time in record.command.switches}
    return during | {switch.stage: switch.time for switch in ending.switches}


@pytest.fixture(scope="module")
def windows(experiment_of: Callable[..., Experiment]) -> WindowSolver:
    return experiment_of("controller.nodes=20").controller.windows


@pytest.fixture(scope="module", params=[0, 1, 2], ids=["approach", "capture", "transport"])
def optimum(request: pytest.FixtureRequest, decisions: list[Command]) -> SolvedWindow:
    """PSMPC's own optimum half way between the detection of a switch and the switch."""
    found = [
        d
        for d in decisions
        if len(d.plan.instants) == 1 and d.sequence.first == request.param and "appended" not in d.events
    ]
    return found[len(found) // 2].solved


def solve_fixed(windows: WindowSolver, optimum: SolvedWindow) -> Solution:
    """Solve the window again from another guess, its durations bounded to those of the optimum."""
    nlp, solver = windows.compiled_for(optimum.window)
    free, durations = bounds(nlp, optimum.window), nlp.layout.duration_index[0]
    lbx, ubx = free.lbx.copy(), free.ubx.copy()
    lbx[durations] = ubx[durations] = optimum.solution.z[durations]
    z = pack_guess(nlp, optimum.window, optimum.plan, optimum.plan.instants + ELSEWHERE, windows.costs)
    return solver.solve(Guess(z), optimum.parameters, Bounds(lbx, ubx, free.lbg, free.ubg))


def test_instants_fixed_at_the_optimum_give_the_optimal_cost(windows: WindowSolver, optimum: SolvedWindow) -> None:
    solution = solve_fixed(windows, optimum)
    assert solution.outcome.usable
    assert solution.objective == pytest.approx(optimum.solution.objective, rel=1e-6, abs=1e-6)


def test_other_instants_cost_more(windows: WindowSolver, optimum: SolvedWindow) -> None:
    """So the test above compares with what it must."""
    later = optimum.solution.z.copy()
    later[windows.compiled_for(optimum.window)[0].layout.duration_index[0]] += 0.1
    solution = solve_fixed(windows, replace(optimum, solution=replace(optimum.solution, z=later)))
    assert solution.outcome.usable
    assert solution.objective > optimum.solution.objective + 1e-3


def test_a_fixed_time_at_the_optimum_gives_the_optimal_cost(windows: WindowSolver, optimum: SolvedWindow) -> None:
    """`at` beside the end condition; the task files allow either, the window both."""
    timed_stage = replace(optimum.window.stages[0], at=float(optimum.plan.instants[0]))
    window = replace(optimum.window, stages=(timed_stage, *optimum.window.stages[1:]))
    solved = windows.solve(window, optimum.plan, optimum.plan.instants + ELSEWHERE)
    assert solved.solution.outcome.usable
    assert solved.plan.instants == pytest.approx(optimum.plan.instants, abs=1e-7)
    assert solved.solution.objective == pytest.approx(optimum.solution.objective, rel=1e-6, abs=1e-6)


def test_without_its_end_condition_a_fixed_time_can_only_cost_less(
    windows: WindowSolver, optimum: SolvedWindow
) -> None:
    stage = optimum.window.stages[0]
    timed_stage = replace(stage, at=float(optimum.plan.instants[0]), end_rows=(), tolerance=np.zeros(0))
    window = replace(optimum.window, stages=(timed_stage, *optimum.window.stages[1:]))
    solved = windows.solve(window, optimum.plan, optimum.plan.instants)
    assert solved.solution.outcome.usable
    assert solved.solution.objective <= optimum.solution.objective + 1e-7


@pytest.mark.parametrize("times", [(2.0, 4.0, 6.0), (1.234, 3.9995, 5.55), (2.0, 2.7, 3.1)])
def test_stages_end_at_their_fixed_times(
    experiment_of: Callable[..., Experiment], times: tuple[float, float, float]
) -> None:
    at = dict(zip(("approach", "capture", "transport"), times, strict=True))
    records, ending = run(experiment_of(*SHORT, *timed(**at)))
    assert ending.completed
    assert not any(record.command.events & {"solve_failed", "braking"} for record in records)
    ended = switches(records, ending)
    assert list(ended) == [0, 1, 2, 3]
    assert [ended[stage] for stage in range(3)] == pytest.approx(times, abs=1e-6)
    for record in records:
        known = np.array(times)[
            record.command.sequence.first : record.command.sequence.first + len(record.command.instants)
        ]
        np.testing.assert_allclose(record.command.instants, known, atol=1e-6)


def test_a_fixed_time_stands_beside_conditions(experiment_of: Callable[..., Experiment]) -> None:
    """The stages around it switch by state; it does so by time, whatever the state."""
    records, ending = run(experiment_of(*SHORT, *timed(capture=4.05)))
    ended = switches(records, ending)
    assert ending.completed
    assert ended[0] < ended[1] < ended[2] < ended[3]
    assert ended[1] == pytest.approx(4.05, abs=1e-6)


def test_a_fixed_time_that_passed_before_its_stage_ends_it_with_the_next_sample(
    experiment_of: Callable[..., Experiment],
) -> None:
    records, ending = run(experiment_of(*SHORT, *timed(capture=0.5)))
    ended = switches(records, ending)
    assert ending.completed
    assert ended[0] > 0.5
    assert ended[1] - ended[0] <= 0.1 + 1e-9


def test_hard_switching_holds_a_fixed_time_to_the_sample(experiment_of: Callable[..., Experiment]) -> None:
    at = {"approach": 2.0, "capture": 4.05, "transport": 6.0}
    records, ending = run(experiment_of(*SHORT, *timed(**at), "controller.kind=hard"))
    ended = switches(records, ending)
    assert [ended[stage] for stage in range(3)] == pytest.approx([2.0, 4.1, 6.0])
