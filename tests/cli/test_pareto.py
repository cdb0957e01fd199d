"""The command itself; what it finds is tested with the studies, what it draws with the figures."""

from collections.abc import Callable
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from psmpc_cli.cli.pareto import pareto
from psmpc_cli.cli.plot import plot
from psmpc_cli.errors import InputError, LogError, PsmpcError, SpecError
from psmpc_cli.logs.run import read_run
from psmpc_cli.studies.fronts import read_pareto

from ..there_and_back import TASK

QUICK = ("--points", "3", "--at", "0.3,0.5", "--method", "weighted-sum", "--jobs", "1")


def called(command: Callable[..., None], *arguments: object) -> str:
    """What a command writes; raises what it raises."""
    app = typer.Typer()
    app.command()(command)
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    if isinstance(result.exception, PsmpcError):
        raise result.exception
    assert result.exit_code == 0, result.output
    return result.stdout


@pytest.fixture(scope="module")
def task(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("task") / "small.yaml"
    path.write_text(TASK)
    return path


@pytest.fixture(scope="module")
def studied(task: Path) -> tuple[Path, str]:
    """A study of the task's run, which is kept, and what the command said."""
    said = called(pareto, task, *QUICK, "-o", task.parent / "study.h5", "--log", task.parent / "run.h5")
    return task.parent / "study.h5", said


def test_a_row_a_sample_and_how_the_fronts_move(studied: tuple[Path, str]) -> None:
    path, said = studied
    heading, *rows = said.splitlines()
    for word in ("T0 [s]", "t_s [s]", "J_1 [s]", "J_2 [s]", "hypervolume", "dominated"):
        assert word in heading
    assert [row.split()[0] for row in rows[:2]] == ["0.30", "0.50"]
    assert "with growing omega_2/omega_1 the optimum moves to the upper left at 2 of 2 instants" in said
    assert f"results: {path}" in said


def test_results_and_figures_are_there(studied: tuple[Path, str]) -> None:
    path, said = studied
    results = read_pareto(path)
    assert results["weighted_J_1"].shape == (2, 3)
    assert results.attributes["task_name"] == "small"
    assert [figure.name for figure in path.with_suffix("").iterdir()] == ["front.png"]
    assert f"1 figures in {path.with_suffix('')}" in said


def test_the_log_of_the_run_is_kept_and_can_be_studied_in_turn(studied: tuple[Path, str], tmp_path: Path) -> None:
    log = studied[0].with_name("run.h5")
    assert read_run(log).plans
    called(pareto, log, *QUICK, "--no-figures", "-o", tmp_path / "again.h5", "-q")
    again, first = read_pareto(tmp_path / "again.h5"), read_pareto(studied[0])
    assert (again["weighted_J_1"] == first["weighted_J_1"]).all()
    assert [path.name for path in tmp_path.iterdir()] == ["again.h5"]


def test_a_logged_task_is_not_changed(studied: tuple[Path, str]) -> None:
    log = studied[0].with_name("run.h5")
    with pytest.raises(InputError, match="it is studied as it ran, without --set and --log"):
        called(pareto, log, "--set", "controller.nodes=3")


def test_quiet_says_nothing(task: Path, tmp_path: Path) -> None:
    arguments = (task, *QUICK, "--no-figures", "-q", "-o", tmp_path / "study.h5", "--set", "controller.nodes=3")
    assert called(pareto, *arguments) == ""
    assert read_pareto(tmp_path / "study.h5").attributes["nodes"] == 3


def test_nothing_is_overwritten_unasked(studied: tuple[Path, str], task: Path) -> None:
    path, _ = studied
    before = path.read_bytes()
    with pytest.raises(InputError, match="exists already"):
        called(pareto, task, *QUICK, "-o", path)
    with pytest.raises(InputError, match="exists already"):
        called(pareto, task, *QUICK, "-o", path.with_name("new.h5"), "--log", path.with_name("run.h5"))
    assert path.read_bytes() == before
    assert not path.with_name("new.h5").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--at", "soon"), "--at: found 'soon'"),
        (("--method", "guess"), "--method: found 'guess'"),
        (("--stages", "2,1"), "--stages: found '2,1'"),
        (("--points", "1"), "--points: found 1"),
        (("--set", "controller.kind=smpc"), "found controller.kind smpc"),
    ],
)
def test_bad_input_is_found_out_before_the_run(
    task: Path, tmp_path: Path, arguments: tuple[str, str], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        called(pareto, task, *arguments, "-o", tmp_path / "study.h5")
    assert not list(tmp_path.iterdir())


def test_an_unknown_task_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SpecError, match="nowhere"):
        called(pareto, "nowhere", "-o", tmp_path / "study.h5")


def test_plot_knows_a_study_by_itself(studied: tuple[Path, str], tmp_path: Path) -> None:
    path, _ = studied
    written = called(plot, path, "-o", tmp_path, "--format", "svg").splitlines()
    assert written == [str(tmp_path / "front.svg")]
    with pytest.raises(InputError, match="no figure 'states', expected one of front"):
        called(plot, path, "-o", tmp_path, "--only", "states")
    with pytest.raises(InputError, match="a pareto is not animated, but the log of a run is"):
        called(plot, path, "-o", tmp_path, "--animate")


def test_what_is_no_study_is_refused_by_name(studied: tuple[Path, str]) -> None:
    with pytest.raises(LogError, match="found a run, expected a pareto"):
        read_pareto(studied[0].with_name("run.h5"))
