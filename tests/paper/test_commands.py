"""`psmpc reproduce` end to end, on a transport of a few centimetres; claims and report have their own tests."""

import html
import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner, Result

from psmpc_cli.cli.app import app
from psmpc_cli.logs.results import read_results
from psmpc_cli.logs.run import read_comparison
from psmpc_cli.logs.schema import PARETO, SWEEP
from psmpc_cli.paper.departures import PRINTED, SHIPPED
from psmpc_cli.paper.reproduce import METHODS
from psmpc_cli.studies.sweep import SweepCells

from ..cli.command import Psmpc, command_line
from ..cli.conftest import coarse_figures

__all__ = ["coarse_figures"]

pytestmark = pytest.mark.slow

NEAR = (
    "controller.nodes=4",
    "controller.horizon=1.0",
    "controller.sample_time=0.2",
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

SMALL = ("--weights", "2x2", "--fronts", "3", "--jobs", "1", *(word for change in NEAR for word in ("--set", change)))

FILES = {"report.html", "runs.h5", "weights.h5", "fronts.h5", "grasps.h5"}


def reproduce(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["reproduce", *map(str, arguments), *SMALL])


@pytest.fixture
def psmpc(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Psmpc:
    """The command line in this process, in a folder of the test's own."""
    monkeypatch.chdir(tmp_path)
    return command_line(monkeypatch, capsys)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("reproduce")


@pytest.fixture(scope="module")
def ran(folder: Path) -> Result:
    return reproduce("-o", folder / "out", "--ablations", "--json", folder / "claims.json")


@pytest.fixture(scope="module")
def data(ran: Result, folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((folder / "claims.json").read_text())
    return found


def test_claims_that_do_not_hold_are_a_result_with_a_cause(ran: Result, data: dict[str, Any]) -> None:
    assert ran.exit_code == 0, ran.output
    assert data["failed"] > 0
    failing = [claim for claim in data["claims"] if not claim["holds"]]
    counted = data["held"] + data["failed"]
    assert counted == sum(claim["apart"] is None for claim in data["claims"])
    assert all(f"\n{claim['id']} " in f"\n{ran.stdout}" for claim in data["claims"])
    assert all(f"{claim['id']} does not hold: {claim['statement']}" in ran.stdout for claim in failing)
    assert ran.stdout.startswith(f"{data['held']} of {counted} claims hold; not counted: ")


def test_report_and_results_say_the_same(ran: Result, data: dict[str, Any], folder: Path) -> None:
    figures = {f"ablation_{ablation['name']}.png" for ablation in data["ablations"]}
    assert {path.name for path in (folder / "out").iterdir()} == {*FILES, *figures}
    report = (folder / "out" / "report.html").read_text(encoding="utf-8")
    assert f"{data['held']} of {data['held'] + data['failed']} claims hold; not counted: " in report
    assert all(f'id="{claim["id"]}"' in report for claim in data["claims"])
    assert data["changes"] == list(NEAR)
    for words in ("--set controller.nodes=4", "--weights 2x2", "--fronts 3"):
        assert words in report
    runs = read_comparison(folder / "out" / "runs.h5")
    assert list(runs) == list(METHODS)
    cells = SweepCells(read_results(folder / "out" / "weights.h5", SWEEP))
    assert cells.omega.tolist() == [[1e-3, 1e-3], [1e3, 1e-3], [1e-3, 1e3], [1e3, 1e3]]
    assert data["weights"]["digest"] == cells.results.attributes["digest"]
    fronts = read_results(folder / "out" / "fronts.h5", PARETO)
    assert fronts.attributes["digest"] == runs["psmpc"].attributes["digest"]
    assert [sample["instant"] for sample in data["fronts"]["samples"]] == fronts["instant"].tolist()


def test_every_number_of_the_ablations_is_printed_and_in_the_report(
    ran: Result, data: dict[str, Any], folder: Path
) -> None:
    ablations = data["ablations"]
    report = (folder / "out" / "report.html").read_text(encoding="utf-8")
    assert len(ablations) == 3
    assert all(f"\n{name} " in ran.stdout for ablation in ablations for name in ablation["numbers"])
    assert all(name in html.unescape(report) for ablation in ablations for name in ablation["numbers"])
    assert all(f"With and without the {ablation['name'].replace('_', ' ')}" in report for ablation in ablations)


@pytest.fixture(scope="module")
def again(ran: Result, folder: Path) -> Result:
    """A second run into the same folder, of both tasks."""
    words = ("--as-printed", "--json", folder / "out" / "new.json", "--set", "solver.kind=sqp", "--strict", "--force")
    return reproduce("-o", folder / "out", *words)


def test_a_new_report_takes_the_place_of_the_old_one_and_strictly_claims_must_hold(again: Result, folder: Path) -> None:
    assert again.exit_code == 1, again.output
    assert json.loads((folder / "out" / "new.json").read_text())["ablations"] == []
    report = (folder / "out" / "report.html").read_text(encoding="utf-8")
    assert "With and without" not in report
    assert {path.name for path in (folder / "out").iterdir()} >= {*FILES, "new.json"}


def test_as_printed_both_tasks_are_judged_and_both_counts_are_printed(again: Result, folder: Path) -> None:
    data = json.loads((folder / "out" / "new.json").read_text())
    tables = {SHIPPED: data, PRINTED: data["as_printed"]}
    for task, table in tables.items():
        assert table["task"] == task
        assert f"\n{task}: {table['held']} of {table['held'] + table['failed']} claims hold; " in again.stdout
    assert data["digests"] != data["as_printed"]["digests"]
    assert data["weights"]["digest"] != data["as_printed"]["weights"]["digest"]
    assert {path.name for path in (folder / "out" / PRINTED).iterdir()} == FILES
    for into, task in ((folder / "out", SHIPPED), (folder / "out" / PRINTED, PRINTED)):
        assert read_comparison(into / "runs.h5")["psmpc"].task.spec.name == task
        report = (into / "report.html").read_text(encoding="utf-8")
        assert f"<dd><code>{task}</code></dd>" in report
        assert ("--as-printed" in report) == (task == PRINTED)


def test_what_does_not_fit_the_task_as_printed_is_said_before_anything_is_run(psmpc: Psmpc, tmp_path: Path) -> None:
    ran = psmpc("reproduce", "-o", tmp_path / "none", "--as-printed", "--set", "controller.pending_cost=0.5")
    assert ran.code == 2
    assert 'found "pending_cost" beside as_printed: true' in ran.stderr
    assert not (tmp_path / "none").exists()
