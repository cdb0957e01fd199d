"""Monte Carlo studies of the small task."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from psmpc_cli.errors import InputError
from psmpc_cli.logs.read import read_log
from psmpc_cli.simulation.monte_carlo_runs import CRASHED, ENDED, WAITING, MonteCarloRuns, read_monte_carlo
from psmpc_cli.simulation.run import simulate
from psmpc_cli.simulation.summary import summarize
from psmpc_cli.specs.load import load_task
from psmpc_cli.studies import monte_carlo_run
from psmpc_cli.studies.monte_carlo import load_monte_carlo, run_monte_carlo
from psmpc_cli.studies.monte_carlo_file import RUN_QUANTITIES, MonteCarlo
from psmpc_cli.studies.sweep import SweepProgress

from ..there_and_back import TASK
from .here_calls import HereCalls

PAGE = Path(__file__).parents[2] / "docs" / "monte_carlo.md"
NOISE = "uncertainty.noise={position: 1e-3, angle: 1e-3}"


def study_of(folder: Path, runs: int, *changes: str) -> MonteCarlo:
    (folder / "task.yaml").write_text(TASK)
    return load_monte_carlo(str(folder / "task.yaml"), (NOISE, "seed=4", *changes), runs)


def made(folder: Path, study: MonteCarlo, resume: bool = False, most: int = 100) -> MonteCarloRuns:
    run_monte_carlo(study, folder / "study.h5", HereCalls(most), resume=resume)
    return read_monte_carlo(folder / "study.h5")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("study")


@pytest.fixture(scope="module")
def runs(folder: Path) -> MonteCarloRuns:
    """Three runs, of seeds 4 to 6."""
    return made(folder, study_of(folder, 3))


def test_a_run_is_recorded_as_the_same_seed_simulates(runs: MonteCarloRuns, folder: Path, tmp_path: Path) -> None:
    assert runs["seed"].tolist() == [4, 5, 6]
    simulate(load_task(folder / "task.yaml", [NOISE, "seed=5"]), tmp_path / "log.h5")
    summary = summarize(read_log(tmp_path / "log.h5"))
    assert summary.end_errors is not None
    assert runs["end_time"][1] == summary.duration
    assert runs["final_error"][1] == summary.end_errors[1]
    assert runs["switch_time"][1].tolist() == [stage.switch_time for stage in summary.stages]
    assert runs["actual_start"][1].tolist() == [stage.actual_start for stage in summary.stages]
    assert runs["velocity_margin"][1] == {limit.kind: limit.margin for limit in summary.limits}["velocity"]
    assert runs["monitor_margin"][1].tolist() == [summary.monitors[0].margin]
    assert runs["control_effort"][1] == summary.control_effort
    assert (runs["succeeded"][1], runs["fallbacks"][1]) == (summary.succeeded, summary.fallbacks)


def test_runs_differ(runs: MonteCarloRuns) -> None:
    assert len(np.unique(runs["final_error"])) == len(np.unique(runs["control_effort"])) == 3


def test_a_monitor_that_does_not_hold_is_a_failure(tmp_path: Path) -> None:
    found = made(tmp_path, study_of(tmp_path, 1, "monitors[0].at_least=5"))
    assert found["completed"].tolist() == [1]
    assert found["succeeded"].tolist() == [0]
    assert found["monitor_margin"][0, 0] < 0
    assert found.why(0).endswith("monitor did not hold: far apart")


def test_a_time_limit_is_a_failure_with_a_reason(tmp_path: Path) -> None:
    found = made(tmp_path, study_of(tmp_path, 1, "time_limit=0.3", "monitors=[]"))
    assert not found.succeeded.any()
    assert found.why(0) == "time limit of 0.3 s reached"
    assert np.isnan(found.end_time).all()
    assert found["end_time"][0] == pytest.approx(0.3)
    assert not found.monitors


@pytest.fixture
def crashing(monkeypatch: pytest.MonkeyPatch) -> Iterator[pytest.MonkeyPatch]:
    """Every run of seed 5 raises."""
    build = monte_carlo_run.build_experiment

    def build_or_raise(loaded: object) -> object:
        if loaded.spec.seed == 5:
            raise ZeroDivisionError("by zero")
        return build(loaded)

    monkeypatch.setattr(monte_carlo_run, "build_experiment", build_or_raise)
    yield monkeypatch


def test_a_crash_ends_nothing_and_is_tried_again(
    tmp_path: Path, crashing: pytest.MonkeyPatch, runs: MonteCarloRuns
) -> None:
    study, told = study_of(tmp_path, 3), list[SweepProgress]()
    run_monte_carlo(study, tmp_path / "study.h5", HereCalls(), watch=told.append)
    found = read_monte_carlo(tmp_path / "study.h5")
    assert found["status"].tolist() == [ENDED, CRASHED, ENDED]
    assert found.why(1) == "crashed: ZeroDivisionError: by zero"
    assert found.failed.tolist() == [False, True, False]
    assert [progress.failed for progress in told] == [0, 0, 1, 1]
    crashing.undo()
    again = made(tmp_path, study, resume=True)
    assert_same(again, runs)
    assert again["failure"].tolist() == [""] * 3


def assert_same(found: MonteCarloRuns, wanted: MonteCarloRuns) -> None:
    """All but wall times is alike."""
    for name, quantity in wanted.results.quantities.items():
        if name not in ("run_time", "wall_time"):
            np.testing.assert_array_equal(found[name], quantity.values, name)


def test_a_stopped_study_goes_on_to_the_same_end(tmp_path: Path, runs: MonteCarloRuns) -> None:
    study = study_of(tmp_path, 3)
    with pytest.raises(KeyboardInterrupt):
        made(tmp_path, study, most=1)
    assert read_monte_carlo(tmp_path / "study.h5")["status"].tolist() == [ENDED, WAITING, WAITING]
    assert_same(made(tmp_path, study, resume=True), runs)


def test_a_study_goes_on_with_more_runs_and_refuses_fewer(tmp_path: Path, runs: MonteCarloRuns) -> None:
    made(tmp_path, study_of(tmp_path, 2))
    first = read_monte_carlo(tmp_path / "study.h5")["run_time"]
    found = made(tmp_path, study_of(tmp_path, 3), resume=True)
    assert_same(found, runs)
    assert found["run_time"][:2].tolist() == first.tolist()
    assert [path.name for path in tmp_path.glob("*study*")] == ["study.h5"]
    with pytest.raises(InputError, match="has 3 runs, found --runs 2, expected at least as many"):
        made(tmp_path, study_of(tmp_path, 2), resume=True)


def test_another_task_is_not_gone_on_with(folder: Path, runs: MonteCarloRuns) -> None:
    with pytest.raises(InputError, match="holds another study: found seed 4, this one has 9; give the same task"):
        made(folder, study_of(folder, 3, "seed=9"), resume=True)
    with pytest.raises(InputError, match="found no file"):
        made(folder / "nowhere", study_of(folder, 3), resume=True)


@pytest.mark.parametrize("changes", [(), ("uncertainty.delay=1",), ("uncertainty={mass: 0, noise: {position: 0}}",)])
def test_a_task_without_random_numbers_is_refused(tmp_path: Path, changes: tuple[str, ...]) -> None:
    (tmp_path / "task.yaml").write_text(TASK)
    with pytest.raises(InputError, match="nothing random below uncertainty, all runs would be alike"):
        load_monte_carlo(str(tmp_path / "task.yaml"), changes, 3)


def test_a_seed_that_leaves_no_room_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="found seed 9223372036854775806, expected at most"):
        study_of(tmp_path, 3, f"seed={2**63 - 2}")


def test_the_command_repeats_a_run(runs: MonteCarloRuns, folder: Path) -> None:
    assert runs.command(2) == f"psmpc simulate {folder / 'task.yaml'} --set '{NOISE}' --set seed=4 --set seed=6"


def test_the_lost_have_their_reason(tmp_path: Path) -> None:
    study = study_of(tmp_path, 1)

    class Lost(HereCalls):
        def each(self, function, items, lost):
            yield 0, lost(items[0])

    run_monte_carlo(study, tmp_path / "study.h5", Lost())
    assert "ended from outside" in read_monte_carlo(tmp_path / "study.h5").why(0)


def test_the_page_has_every_quantity_of_a_run() -> None:
    _, begun, rest = PAGE.read_text(encoding="utf-8").partition(
        "<!-- runs -->\n| array | units | what |\n|---|---|---|\n"
    )
    found, ended, _ = rest.partition("<!-- end of runs -->")
    assert begun
    assert ended
    rows = ((f"`{quantity.name}`", quantity.units, quantity.long_name) for quantity in RUN_QUANTITIES)
    assert found == "".join(f"| {' | '.join(row)} |\n" for row in rows)
