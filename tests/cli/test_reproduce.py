"""The command end to end, on a transport of a few centimetres; claims and report have their own tests."""

import json
from pathlib import Path
from typing import Any

import pytest
import typer
from click.testing import Result
from typer.testing import CliRunner

from psmpc_cli.cli.reproduce import reproduce
from psmpc_cli.errors import InputError
from psmpc_cli.logs.results import read_results
from psmpc_cli.logs.run import read_comparison
from psmpc_cli.logs.schema import SWEEP
from psmpc_cli.studies.fronts import read_pareto
from psmpc_cli.studies.reproduce import METHODS
from psmpc_cli.studies.weights import sweep_cells

NEAR = (
    "controller.nodes=4",
    "controller.horizon=1.0",
    "plant={kind: ideal, low_level_rate: 100}",
    "stages.approach.target={base: [-0.06, 0.04, 0], arms: [0, 0, 0]}",
    "stages.capture.skill=move",
    "stages.capture.target={base: [-0.06, 0.04, 0], arms: [0.03, 0.02, 0]}",
    "stages.capture.ends_when={coordinates: all, tolerance: 0.01}",
    "stages.transport.target={base: [0, 0, 0], arms: [0.03, 0.02, 0]}",
    "stages.release.skill=move",
    "stages.release.target={base: [0, 0, 0], arms: [0, 0, 0]}",
    "time_limit=5",
)
"""All four stages within two seconds."""


def psmpc(*arguments: object) -> Result:
    app = typer.Typer()
    app.command()(reproduce)
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def near() -> list[str]:
    return ["--weights", "2x2", "--fronts", "3", *(word for change in NEAR for word in ("--set", change))]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("reproduce")


@pytest.fixture(scope="module")
def ran(folder: Path) -> Result:
    return psmpc("-o", folder / "out", "--json", folder / "claims.json", *near())


@pytest.fixture(scope="module")
def data(ran: Result, folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((folder / "claims.json").read_text())
    return found


def test_claims_that_do_not_hold_are_a_result(ran: Result, data: dict[str, Any]) -> None:
    assert ran.exit_code == 0, ran.output
    assert data["failed"] > 0


def test_it_leaves_a_report_and_the_logs_and_nothing_else(ran: Result, folder: Path) -> None:
    assert {path.name for path in (folder / "out").iterdir()} == {
        "report.html",
        "runs.h5",
        "weights.h5",
        "fronts.h5",
    }
    assert list(read_comparison(folder / "out" / "runs.h5")) == list(METHODS)


def test_the_table_has_every_claim_and_a_cause_for_each_that_fails(ran: Result, data: dict[str, Any]) -> None:
    failing = [claim for claim in data["claims"] if not claim["holds"]]
    assert all(f"\n{claim['id']} " in f"\n{ran.stdout}" for claim in data["claims"])
    assert all(f"{claim['id']} does not hold: {claim['statement']}" in ran.stdout for claim in failing)
    assert f"{data['held']} of {len(data['claims'])} claims hold" in ran.stdout


def test_the_report_says_the_same(ran: Result, data: dict[str, Any], folder: Path) -> None:
    report = (folder / "out" / "report.html").read_text(encoding="utf-8")
    assert f"{data['held']} of {len(data['claims'])} claims hold" in report
    assert all(f'id="{claim["id"]}"' in report for claim in data["claims"])


def test_the_changes_are_told(ran: Result, data: dict[str, Any], folder: Path) -> None:
    assert data["changes"] == list(NEAR)
    assert "--set controller.nodes=4" in (folder / "out" / "report.html").read_text(encoding="utf-8")


def test_the_sweep_of_the_weights_is_one_like_any_other(ran: Result, data: dict[str, Any], folder: Path) -> None:
    cells = sweep_cells(read_results(folder / "out" / "weights.h5", SWEEP))
    assert cells.omega.tolist() == [[1e-3, 1e-3], [1e3, 1e-3], [1e-3, 1e3], [1e3, 1e3]]
    assert not cells.waiting.any()
    assert data["weights"]["digest"] == cells.results.attributes["digest"]
    assert "--weights 2x2" in (folder / "out" / "report.html").read_text(encoding="utf-8")


def test_the_fronts_are_a_study_of_the_psmpc_run(ran: Result, data: dict[str, Any], folder: Path) -> None:
    results, log = read_pareto(folder / "out" / "fronts.h5"), read_comparison(folder / "out" / "runs.h5")["psmpc"]
    assert results.attributes["digest"] == log.attributes["digest"]
    assert set(results["instant"]) <= set(log.time)
    assert [sample["instant"] for sample in data["fronts"]["samples"]] == results["instant"].tolist()
    assert [claim["id"] for claim in data["claims"]][-2:] == ["fronts.with_ratio", "fronts.with_time"]
    report = (folder / "out" / "report.html").read_text(encoding="utf-8")
    assert "--fronts 3" in report
    assert "Fig. 7 of the paper" in report


def test_two_points_are_no_front(tmp_path: Path) -> None:
    refused = psmpc("-o", tmp_path / "out", "--fronts", "2")
    assert refused.exit_code == 2
    assert not (tmp_path / "out").exists()


def test_what_is_no_grid_of_weights_is_refused_before_the_runs(tmp_path: Path) -> None:
    refused = psmpc("-o", tmp_path / "out", "--weights", "many")
    assert isinstance(refused.exception, InputError)
    assert "25x25" in str(refused.exception)
    assert not (tmp_path / "out").exists()


def test_nothing_is_overwritten_unasked(ran: Result, folder: Path) -> None:
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    for arguments in (["-o", folder / "out"], ["-o", folder / "new", "--json", folder / "claims.json"]):
        refused = psmpc(*arguments, *near())
        assert isinstance(refused.exception, InputError)
        assert "--force" in str(refused.exception)
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before


@pytest.mark.slow
def test_strict_and_force(ran: Result, folder: Path) -> None:
    strict = psmpc("-o", folder / "out", *near(), "--strict", "--force", "--quiet")
    assert strict.exit_code == 1
    assert strict.output == ""
    assert (folder / "out" / "report.html").stat().st_size > 0


@pytest.mark.parametrize("changes", [["controller.kind=hard"], ["controller=smpc"]])
def test_the_controllers_are_not_for_choosing(tmp_path: Path, changes: list[str]) -> None:
    refused = psmpc("-o", tmp_path / "out", *(word for change in changes for word in ("--set", change)))
    assert isinstance(refused.exception, InputError)
    assert "controller.kind" in str(refused.exception)
    assert not (tmp_path / "out").exists()


def test_a_place_that_cannot_be_is_refused_before_the_runs(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    refused = psmpc("-o", tmp_path / "file" / "out", *near())
    assert isinstance(refused.exception, InputError)
    into_a_directory = psmpc("-o", tmp_path / "out", "--json", tmp_path, *near())
    assert isinstance(into_a_directory.exception, InputError)
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_ablations_join_the_report(tmp_path: Path) -> None:
    ran = psmpc("-o", tmp_path, "--json", tmp_path / "claims.json", "--ablations", *near())
    assert ran.exit_code == 0, ran.output
    ablations = json.loads((tmp_path / "claims.json").read_text())["ablations"]
    report = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert len(ablations) == 3
    for ablation in ablations:
        assert ablation["sentence"] in ran.stdout
        assert f"Ablation of the {ablation['name'].replace('_', ' ')}" in report
    figures = {f"ablation_{ablation['name']}.png" for ablation in ablations}
    assert {path.name for path in tmp_path.iterdir()} == {
        "report.html",
        "runs.h5",
        "weights.h5",
        "fronts.h5",
        "claims.json",
        *figures,
    }


def test_figures_of_ablations_are_not_overwritten_unasked(tmp_path: Path) -> None:
    (tmp_path / "ablation_pending_cost.png").write_text("kept")
    refused = psmpc("-o", tmp_path, "--ablations", *near())
    assert isinstance(refused.exception, InputError)
    assert [path.name for path in tmp_path.iterdir()] == ["ablation_pending_cost.png"]
