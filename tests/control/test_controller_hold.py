"""End conditions that must hold for a while, and the built-in inspection, whose stages have them."""

from collections.abc import Callable

import numpy as np
import pytest

from psmpc_cli.simulation.run import Experiment

from .short_transports import SHORT, run

Build = Callable[..., Experiment]


HOLD = 0.5


@pytest.mark.parametrize("kind", ["psmpc", "hard"])
def test_every_stage_of_a_run_is_held_before_it_ends(experiment_of: Build, kind: str) -> None:
    holds = [f"stages.{name}.ends_when.hold={HOLD}" for name in ("approach", "release")]
    experiment = experiment_of(*SHORT, *holds, f"controller.kind={kind}")
    samples, ending = run(experiment)
    assert ending.completed
    switches = dict([switch for sample in samples for switch in sample.command.switches] + list(ending.switches))
    for index in (0, 3):
        stage, end = experiment.problem.stages[index], switches[index]
        during = [s.command.state for s in samples if end - HOLD - 1e-9 <= s.command.time <= end - 1e-9]
        assert len(during) >= round(HOLD / 0.1)
        assert experiment.problem.costs.met(stage, np.array(during)).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("solver", "kind"),
    [("sqp", "psmpc"), ("sqp", "hard"), ("sqp", "htmpc"), ("fatrop", "psmpc")],
)
def test_the_inspection_succeeds(experiment_of: Build, solver: str, kind: str) -> None:
    nodes = "auto" if (solver, kind) == ("sqp", "psmpc") else "12"
    changes = (f"controller={{kind: {kind}, nodes: {nodes}}}", f"solver.kind={solver}", "log.shares=false")
    experiment = experiment_of(*changes, "time_limit=20", task="inspect")
    samples, ending = run(experiment)
    assert ending.completed
    assert not any("solve_failed" in sample.command.events for sample in samples)
    last = experiment.problem.stages[-1]
    assert np.abs(experiment.problem.costs.errors(last, ending.true_state[None])[0, 3:]).max() < np.radians(0.5) + 1e-5
