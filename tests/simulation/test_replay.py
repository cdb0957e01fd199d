from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from psmpc_cli.errors import LogError, SpecError
from psmpc_cli.logs.run import Run
from psmpc_cli.logs.schema import FORMAT_VERSION, OLDEST_FORMAT
from psmpc_cli.simulation.replay import continue_run, replay, rerun

from ..short_runs import there_and_back


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return there_and_back(tmp_path_factory.mktemp("run"))


def window_with_a_switch(log: Run) -> int:
    return int(np.argmax(log["window/count"] == 2))


@pytest.mark.slow
@pytest.mark.parametrize("solver", ["fatrop", "ipopt"])
def test_the_same_solver_repeats_the_log(tmp_path: Path, solver: str) -> None:
    log = there_and_back(tmp_path, f"solver.kind={solver}", samples=6)
    for sample in range(6):
        again = replay(log, sample)
        assert again.largest <= 1e-6
        assert (again.same_solver, again.remarks) == (True, ())
        assert again.solution.iterations == log["solver/iterations"][sample]
        assert len(again.iterations) >= again.solution.iterations + 1
        assert again.iterations[0].split()[:2] == ["iter", "objective"]


def test_our_own_solver_repeats_the_log_and_shows_its_iterations(tmp_path: Path) -> None:
    log = there_and_back(tmp_path, "solver.kind=sqp", "stages.go.priority=50", samples=6)
    for sample in range(6):
        again = replay(log, sample)
        assert again.largest == 0.0
        rows = [line.split() for line in again.iterations]
        assert rows[0] == ["iter", "objective", "inf_pr", "||d||", "alpha", "qp"]
        assert [int(row[0]) for row in rows[1:]] == list(range(log["solver/iterations"][sample] + 1))
        objective = float(rows[-1][1]) * max(again.logged.window.omega)
        assert objective == pytest.approx(log["solver/objective"][sample], rel=1e-8)


@pytest.mark.parametrize("repeat", [lambda log: replay(log, 0), rerun, continue_run])
def test_logs_of_an_older_format_are_not_repeated(log: Run, repeat: Callable[[Run], object]) -> None:
    older = replace(log, attributes={**log.attributes, "format_version": OLDEST_FORMAT})
    with pytest.raises(LogError, match=f"found log format {OLDEST_FORMAT}, expected {FORMAT_VERSION} to repeat"):
        repeat(older)


def test_objective_instants_and_control_are_compared(log: Run) -> None:
    sample = window_with_a_switch(log)
    compared = {name: logged for name, (logged, _) in replay(log, sample).compared.items()}
    assert list(compared)[:2] == ["objective J", "go ends [s]"]
    assert compared["objective J"] == log["solver/objective"][sample]
    assert compared["go ends [s]"] == log["window/instants"][sample, 0]
    controls = [compared[f"control of {name}"] for name in log.coordinates]
    np.testing.assert_allclose(controls, log["control/u"][sample], atol=1e-12)


def test_another_solver_finds_the_same_optimum(log: Run) -> None:
    again = replay(log, window_with_a_switch(log), "ipopt")
    assert not again.same_solver
    assert 0 < again.largest < 1e-3


def test_settings_that_another_solver_does_not_have_are_left_out(tmp_path: Path) -> None:
    """A deadline, which fatrop cannot keep, and the gradient as printed."""
    log = there_and_back(tmp_path, "solver={kind: adjoint, gradient: printed, deadline: 10}", samples=2)
    assert replay(log, 1).largest <= 1e-6
    assert replay(log, 1, "adjoint").same_solver
    assert replay(log, 1, "fatrop").largest < 1e-3


def test_a_solver_that_does_not_exist_is_refused(log: Run) -> None:
    with pytest.raises(
        SpecError, match=r'--solver simplex: solver\.kind: found the text "simplex", expected one of sqp'
    ):
        replay(log, 0, "simplex")


def test_a_failed_solve_fails_again_and_the_replay_says_so(tmp_path: Path) -> None:
    log = there_and_back(tmp_path, "solver.max_iterations=1", samples=2)
    again = replay(log, 1)
    assert again.solution.outcome is again.logged.outcome
    assert again.largest == 0.0
    assert again.remarks == (
        "the solve failed and the plan before it went on: compared is the last iterate of the failed solve",
    )


def test_of_levels_the_first_is_replayed(tmp_path: Path) -> None:
    again = replay(there_and_back(tmp_path, "controller.kind=htmpc", samples=2), 1)
    assert again.largest <= 1e-6
    assert "the log of HTMPC holds the window of its first level alone, that of go" in again.remarks[0]


def test_a_window_that_was_postponed_is_explained(tmp_path: Path) -> None:
    """The first stage is seen to end from far off, but cannot end within so short a horizon."""
    changes = ("stages.go.ends_when.tolerance=1e-3", "controller.horizon=0.5", "controller.detection_margin=60")
    log = there_and_back(tmp_path, *changes, samples=4)
    postponed = np.flatnonzero(log["events/postponed"])
    assert len(postponed)
    again = replay(log, int(postponed[0]))
    assert again.remarks[0].startswith("back was seen, but the window with it had no solution")
    assert again.largest <= 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("nodes", ["12", "auto"])
def test_windows_over_a_stage_before_and_after_its_end_are_repeated(tmp_path: Path, nodes: str) -> None:
    changes = ("controller.kind=hard", "controller.one_stage=free_end", f"controller.nodes={nodes}", "solver.kind=sqp")
    log = there_and_back(tmp_path, *changes)
    planned = np.flatnonzero(np.isfinite(log["window/instants"][:, 0]))
    assert len(planned)
    assert (log["window/nodes_after_end"][planned] > 0).all()
    for sample in range(len(log.time)):
        again = replay(log, sample)
        assert again.largest == 0.0
        ends = [name for name in again.compared if name.endswith("ends [s]")]
        assert ends == (["go ends [s]"] if sample in planned else [])
