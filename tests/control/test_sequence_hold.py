"""End conditions that must hold for a while, and the built-in inspection, whose stages have them."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from psmpc_cli.control.sequence import MovingSequence, detect, drop_met
from psmpc_cli.ocp.plan import resting_plan
from psmpc_cli.ocp.problem import StageCosts
from psmpc_cli.ocp.stage import Stage
from psmpc_cli.simulation.run import Experiment

from .short_transports import SHORT, run

Build = Callable[..., Experiment]

AT_TARGET = np.r_[-2.0, 2.0, np.pi / 6, np.zeros(15)]
HOLD = 0.5


@pytest.fixture
def holding(stages: tuple[Stage, ...]) -> tuple[Stage, ...]:
    return (replace(stages[0], hold=HOLD), *stages[1:])


def seen(states: list[np.ndarray], stages: tuple[Stage, ...], costs: StageCosts) -> MovingSequence:
    """The sequence after samples 0.1 s apart."""
    sequence = MovingSequence(0, np.zeros(0), 0.0)
    for k, x in enumerate(states):
        sequence = sequence.with_measurement(stages, costs, 0.1 * k, x)
    return sequence


def test_a_stage_ends_when_its_condition_was_met_long_enough(holding: tuple[Stage, ...], costs: StageCosts) -> None:
    for samples, over in ((5, False), (6, True)):
        sequence, now = seen([np.zeros(18), *[AT_TARGET] * samples], holding, costs), 0.1 * samples
        assert sequence.hold_left(holding, now) == pytest.approx(HOLD + 0.1 - now)
        assert bool(drop_met(sequence, holding, costs, now, AT_TARGET)[1]) is over


def test_a_break_begins_the_hold_again_and_keeps_the_next_stage_out(
    holding: tuple[Stage, ...], costs: StageCosts
) -> None:
    prediction = resting_plan(0.3, 4.0, 10, AT_TARGET)
    unbroken, broken = (seen([AT_TARGET, x, AT_TARGET, AT_TARGET], holding, costs) for x in (AT_TARGET, np.zeros(18)))
    assert (unbroken.met_since, broken.met_since) == (0.0, pytest.approx(0.2))
    longer = detect(unbroken, holding, costs, prediction, 10)
    assert longer is not None
    assert longer.instants.tolist() == pytest.approx([HOLD])
    assert detect(broken, holding, costs, prediction, 10) is None
    assert detect(seen([np.zeros(18)], holding, costs), holding, costs, prediction, 10) is None
    lost = longer.with_measurement(holding, costs, 0.4, np.zeros(18))
    assert (lost.count, lost.broken) == (1, True)


@pytest.mark.parametrize("kind", ["psmpc", "hard"])
def test_every_stage_of_a_run_is_held_before_it_ends(experiment_of: Build, kind: str) -> None:
    holds = [f"stages.{name}.ends_when.hold={HOLD}" for name in ("approach", "release")]
    experiment = experiment_of(*SHORT, *holds, f"controller.kind={kind}")
    samples, ending = run(experiment)
    assert ending.completed
    switches = dict([switch for sample in samples for switch in sample.command.switches] + list(ending.switches))
    for index in (0, 3):
        stage, end = experiment.problem.stages[index], switches[index]
        during = [s.command.x for s in samples if end - HOLD - 1e-9 <= s.command.time <= end - 1e-9]
        assert len(during) >= round(HOLD / 0.1)
        assert experiment.problem.costs.met(stage, np.array(during)).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("solver", "kind"),
    [("sqp", "psmpc"), ("sqp", "smpc"), ("sqp", "hard"), ("sqp", "htmpc"), ("fatrop", "psmpc"), ("fatrop", "htmpc")],
)
def test_the_inspection_succeeds(experiment_of: Build, solver: str, kind: str) -> None:
    nodes = "12" if kind == "htmpc" else "auto" if solver == "sqp" else "25"
    changes = (f"controller={{kind: {kind}, nodes: {nodes}}}", f"solver.kind={solver}", "log.shares=false")
    experiment = experiment_of(*changes, "time_limit=20", task="inspect")
    samples, ending = run(experiment)
    assert ending.completed
    assert not any("solve_failed" in sample.command.events for sample in samples)
    last = experiment.problem.stages[-1]
    assert np.abs(experiment.problem.costs.errors(last, ending.true[None])[0, 3:]).max() < np.radians(0.5) + 1e-5
