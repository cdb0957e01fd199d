import csv
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner, Result

from psmpc_cli.cli.run import show
from psmpc_cli.errors import InputError, LogError
from psmpc_cli.logs.write import LogWriter
from psmpc_cli.simulation.run import header, simulate
from psmpc_cli.simulation.setup import build_experiment
from psmpc_cli.specs.load import load_task

from ..made_up_fronts import made_up_fronts
from ..made_up_sweep import made_up_sweep

CHANGES = ("controller.nodes=5", "plant.kind=ideal", "time_limit=1", "log.plans=false")


def invoke(*arguments: str | Path) -> Result:
    app = typer.Typer()
    app.command()(show)
    return CliRunner().invoke(app, list(map(str, arguments)))


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("runs") / "log.h5"
    simulate(load_task("transport", CHANGES), path)
    return path


def test_the_summary_is_printed_again(log: Path) -> None:
    result = invoke(log)
    assert result.exit_code == 0
    lines = result.stdout.splitlines()
    assert lines[0] == "mission failed: time limit of 1 s reached, after 1.0 s"
    assert [line.split()[0] for line in lines[1:6]] == ["stage", "approach", "capture", "transport", "release"]
    assert lines[3].split() == ["capture", "100", "-", "6.3", "13.8"]
    assert " ".join(lines[-2].split()) == "monitor: object held not judged"
    assert lines[-1] == f"log: {log}"
    assert result.stderr == ""


def test_a_run_that_was_killed_at_once_has_a_summary(tmp_path: Path) -> None:
    path = tmp_path / "log.h5"
    LogWriter(path, header(build_experiment(load_task("transport", CHANGES)))).close()
    lines = invoke(path, "--verbose").stdout.splitlines()
    words = [" ".join(line.split()) for line in lines]
    assert "solve time none" in words
    assert "drift of momentum / energy balance - N s / - J" in words
    assert lines[0] == "mission not finished: the run was killed, or goes on, after 0.0 s"


def test_tables_are_exported(log: Path, tmp_path: Path) -> None:
    result = invoke(log, "--csv", tmp_path / "tables")
    assert result.exit_code == 0
    assert result.stdout.splitlines() == [str(tmp_path / "tables" / name) for name in ("samples.csv", "stages.csv")]
    with (tmp_path / "tables" / "samples.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["time [s]"]) for row in rows] == pytest.approx([0.1 * k for k in range(10)])
    again = invoke(log, "--csv", tmp_path / "tables")
    assert isinstance(again.exception, InputError)
    assert again.exception.exit_code == 2
    assert invoke(log, "--csv", tmp_path / "tables", "--force").exit_code == 0


def test_what_is_no_log_is_refused(log: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.h5"
    cut.write_bytes(log.read_bytes()[:5000])
    for path, found in ((cut, "an HDF5 file that is cut off or damaged"), (tmp_path / "none.h5", "no such file")):
        result = invoke(path)
        assert isinstance(result.exception, LogError)
        assert result.exception.exit_code == 2
        assert str(result.exception).startswith(f"{path}: found {found}")
        assert result.stdout == ""


def test_a_sweep_is_shown_as_a_table_and_not_exported(tmp_path: Path) -> None:
    path = tmp_path / "sweep.h5"
    made_up_sweep(path, "3")
    assert invoke(path).stdout.splitlines()[-1] == f"sweep: {path}"
    refused = invoke(path, "--csv", tmp_path / "tables")
    assert isinstance(refused.exception, InputError)
    assert "holds a sweep" in str(refused.exception)


def test_pareto_fronts_are_shown_as_a_table_with_how_they_move_and_not_exported(tmp_path: Path) -> None:
    path = tmp_path / "pareto.h5"
    made_up_fronts(path, failed=(1,))
    result = invoke(path)
    assert result.exit_code == 0, result.output
    heading, *rows = result.stdout.splitlines()
    assert heading.split()[:4] == ["T0", "[s]", "t_s", "[s]"]
    assert [row.split()[0] for row in rows[:3]] == ["6.50", "7.50", "8.50"]
    assert [row.split()[-1] for row in rows[:3]] == ["0", "7", "0"]
    assert any("upper left at 2 of 3 instants" in row for row in rows)
    assert any("moves to the unknown (2 of 2)" in row for row in rows)
    assert rows[-1] == f"results: {path}"
    refused = invoke(path, "--csv", tmp_path / "tables")
    assert isinstance(refused.exception, InputError)
    assert "holds a pareto" in str(refused.exception)
