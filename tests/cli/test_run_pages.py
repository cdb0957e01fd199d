"""`psmpc view` and `psmpc report`: where their pages go, which runs they show, and what they reject."""

import base64
import json
import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from psmpc_cli.logs.run import read_run

from .command import Psmpc

NOISY = ("monte-carlo", "task.yaml", "--runs", "2", "--jobs", "1", "--no-figures", "-o", "study.h5")


def shown(page: str | Path) -> list[dict[str, Any]]:
    """The runs in a viewer's page."""
    data = re.search(r'<script id="data" type="application/json">(.*?)</script>', Path(page).read_text(), re.DOTALL)
    assert data is not None
    found: list[dict[str, Any]] = json.loads(data[1])
    return found


@pytest.mark.parametrize("kind", ["view", pytest.param("report", marks=pytest.mark.slow)])
def test_a_page_goes_beside_the_log_numbered_and_replaces_nothing_unasked(psmpc: Psmpc, ended: Path, kind: str) -> None:
    assert psmpc(kind, str(ended)).stdout == f"page: {ended.parent}/ended-{kind}.html\n"
    assert psmpc(kind, str(ended)).stdout == f"page: {ended.parent}/ended-{kind}-2.html\n"
    first = Path(f"ended-{kind}.html").read_text()
    Path("kept.html").write_text("kept")
    ran = psmpc(kind, str(ended), "-o", "kept.html")
    assert (ran.code, ran.stdout, Path("kept.html").read_text()) == (2, "", "kept")
    assert "--force" in ran.stderr
    assert psmpc(kind, str(ended), "-o", "kept.html", "--force").code == 2
    Path("kept.html").write_text(first + "<!-- edited -->")
    assert psmpc(kind, str(ended), "-o", "kept.html", "--force").code == 0
    assert "edited" not in Path("kept.html").read_text()
    assert "https://" not in Path("kept.html").read_text()


@pytest.mark.slow
def test_a_page_says_what_its_log_lacks(psmpc: Psmpc, ended: Path, part: Path) -> None:
    assert psmpc("view", str(part), "-o", "part.html").code == 0
    (run,) = shown("part.html")
    assert run["plans"]["Q"]["shape"][0] == run["Q"]["shape"][0] == 6
    assert any("unfinished" in note for note in run["notes"])
    assert psmpc("simulate", "task.yaml", "--set", "log.plans=false", "--view", "--no-figures", "-q").code == 0
    (run,) = shown("runs/task-view.html")
    assert run["plans"] is None
    assert any("no plans" in note for note in run["notes"])
    assert psmpc("view", str(ended), str(part), "-o", "both.html").code == 0
    assert len({run["name"] for run in shown("both.html")}) == 2


@pytest.mark.slow
def test_a_run_writes_its_page_names_it_and_opens_it(psmpc: Psmpc, monkeypatch: pytest.MonkeyPatch) -> None:
    opened = list[str]()
    monkeypatch.setattr("webbrowser.open", lambda address: opened.append(address) or True)
    short = ("simulate", "task.yaml", "--no-figures", "--set", "time_limit=0.3")
    assert psmpc(*short, "--view").stdout.splitlines()[-1] == "page: runs/task-view.html"
    assert opened == []
    assert psmpc(*short, "--open").stdout.splitlines()[-1] == "page: runs/task-2-view.html"
    assert opened == [Path("runs/task-2-view.html").resolve().as_uri()]


@pytest.mark.slow
def test_a_run_of_a_study_is_repeated_from_its_seed(psmpc: Psmpc, ended: Path) -> None:
    assert psmpc(*NOISY, "--set", "uncertainty.noise.position=1e-3").code == 0
    assert psmpc("view", "study.h5", "--run", "1", "-q").code == 0
    (again,) = shown("study-view.html")
    command = "simulate", "task.yaml", "--set", "uncertainty.noise.position=1e-3", "--set", "seed=1", "--no-figures"
    assert psmpc(*command, "-o", "one.h5").code == 0
    assert psmpc("view", "one.h5").code == 0
    assert again["Q"] == shown("one-view.html")[0]["Q"]
    assert again["plans"] is not None
    assert psmpc("plot", "study.h5", "--run", "1", "--only", "states").stdout == "study/1/states.png\n"
    for arguments, word in (
        (("study.h5",), "--run with 0 to 1"),
        (("study.h5", "--run", "2"), "0 to 1"),
        ((str(ended), "--run", "2"), "comparison"),
        (("task.yaml",), "no HDF5 file"),
    ):
        ran = psmpc("view", *arguments)
        assert (ran.code, ran.stdout) == (2, "")
        assert word in ran.stderr


@pytest.mark.slow
def test_a_comparison_offers_its_runs(psmpc: Psmpc) -> None:
    assert psmpc("compare", "task.yaml", "--jobs", "1", "--controllers", "psmpc,hard", "--no-figures", "-q").code == 0
    log = "runs/task-comparison.h5"
    assert psmpc("view", log).code == 0
    assert [run["name"] for run in shown("runs/task-comparison-view.html")] == ["PSMPC", "Hard switching"]
    assert psmpc("view", log, "--run", "hard").code == 0
    assert [run["name"] for run in shown("runs/task-comparison-view-2.html")] == ["Hard switching"]
    ran = psmpc("view", log, "--run", "smpc")
    assert (ran.code, "psmpc, hard" in ran.stderr) == (2, True)


@pytest.mark.slow
def test_an_object_with_a_mass_is_shown_as_logged_with_the_pull_on_its_grasps(psmpc: Psmpc) -> None:
    near = "initial={base: [-1.9, 1.9, 28 deg], arm_1: [45 deg, 30 deg, 60 deg], arm_2: [-45 deg, -30 deg, -60 deg]}"
    changes = [word for change in ("controller.nodes=10", "time_limit=3", near) for word in ("--set", change)]
    assert psmpc("simulate", "transport_grasp", *changes, "--no-figures", "--view").code == 0
    (run,) = shown("runs/transport_grasp-view.html")
    log = read_run("runs/transport_grasp.h5")
    assert log["grasp/closed"][-1].all()
    packed = np.frombuffer(base64.b64decode(run["object"]["pose"]["data"])).reshape(run["object"]["pose"]["shape"])
    assert packed[:-1, :2] == pytest.approx(log["object/pose"][:, :2])
    assert "Grasp" in [tab["name"] for tab in run["plots"]]


@pytest.mark.slow
def test_a_report_has_verdict_stages_figures_and_settings(psmpc: Psmpc, ended: Path) -> None:
    assert psmpc("report", str(ended), "-o", "report.html").code == 0
    page, run = ElementTree.parse("report.html").getroot(), read_run(ended)
    text = " ".join("".join(page.itertext()).split())
    assert "Mission succeeded" in text
    assert all(stage in text for stage in (*run.stage_names, "held", run.task.digest))
    assert str(run.attributes["task_yaml"]) in "".join(page.itertext())
    assert len(list(page.iter("img"))) == 9


@pytest.mark.slow
def test_a_report_leaves_out_what_is_in_no_row_of_a_table_as_the_summary_does(psmpc: Psmpc, ended: Path) -> None:
    assert psmpc("report", str(ended), "-o", "report.html").code == 0
    stages, *_ = ElementTree.parse("report.html").getroot().iter("table")
    headings = ["".join(cell.itertext()) for cell in next(stages.iter("tr"))]
    assert headings == ["stage", "priority", "actual start [s]", "ends [s]", "grippers apart [m]"]
    lines = psmpc("show", str(ended)).stdout.splitlines()
    assert lines[1].split() == " ".join(headings).split()
    remark = "imits of forces and accelerations: none declared: nothing bounds the largest values above"
    assert f"l{remark}" in lines and f"<p>L{remark}.</p>" in Path("report.html").read_text()
