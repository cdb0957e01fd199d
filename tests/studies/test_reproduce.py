import json
import re
from math import nan
from pathlib import Path
from typing import Any

import pytest

from psmpc_cli.errors import InputError, SpecError
from psmpc_cli.logs.comparison import merge_logs
from psmpc_cli.logs.run import read_comparison, read_run
from psmpc_cli.specs.load import load_task
from psmpc_cli.studies.claims import Claim, Finding
from psmpc_cli.studies.reproduce import (
    METHODS,
    Reproduction,
    as_data,
    find_fronts,
    judge_claims,
    load_variants,
    load_weights_sweep,
)
from psmpc_cli.studies.weights import sweep_cells

from ..made_up_fronts import made_up_fronts
from ..made_up_sweep import made_up_sweep
from .there_and_back_run import run_there_and_back


def finding(published: Any, reproduced: Any, holds: bool = False, **more: Any) -> Finding:
    claim = Claim(id="a.b", statement="a happens", source="section IV", rule="time", reads=(), published=published)
    return Finding(claim, reproduced, holds, **more)


NEVER = finding(1.0, nan, unit="s", tolerance=0.8, cause=("one thing", "another"))
FINDINGS = (
    NEVER,
    finding(10.0, 8.0, True, unit="s", difference=-2.0, tolerance=0.8, earlier=True, cause=("earlier",)),
    finding((1.0, 2.0), (2.0, 1.5), unit="s", cause=("so",)),
    finding(("a", "b"), ("a",), cause=("b",)),
    finding("fails", "fails", True),
)


@pytest.fixture
def reproduction(tmp_path: Path) -> Reproduction:
    """Of a made-up sweep and made-up fronts, with findings to choose."""
    weights = sweep_cells(made_up_sweep(tmp_path / "weights.h5", "3x3", failed=(1,)))
    return Reproduction(("x=1",), {}, weights, made_up_fronts(tmp_path / "fronts.h5", failed=(1,)), FINDINGS)


@pytest.fixture
def data(reproduction: Reproduction) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(json.dumps(as_data(reproduction, "now"), allow_nan=False))
    return found


def test_the_runs_differ_in_the_controller_alone() -> None:
    tasks = load_variants(["controller.nodes=7"])
    assert tuple(tasks) == METHODS
    assert [task.spec.controller.kind for task in tasks.values()] == list(METHODS)
    assert {task.spec.controller.nodes for task in tasks.values()} == {7}
    own = {task.spec.model_copy(update={"controller": None}).model_dump_json() for task in tasks.values()}
    assert len(own) == 1


def test_the_sweep_takes_the_changes_that_are_about_how_tasks_are_run() -> None:
    changes = ["controller.nodes=7", "plant={kind: ideal}", "stages.transport.priority=3", "time_limit=5"]
    sweep = load_weights_sweep(changes, "3x3")
    spec, own = sweep.task.spec, load_task("approach_capture").spec
    assert (spec.controller.nodes, spec.plant.kind) == (7, "ideal")
    assert (spec.stages, spec.time_limit) == (own.stages, own.time_limit)
    assert len(sweep.cells) == 9
    assert sweep.cells[0] == ("stages[0].priority=0.001", "stages[1].priority=0.001")
    assert sweep.cells[-1] == ("stages[0].priority=1000.0", "stages[1].priority=1000.0")


def test_the_sweep_is_in_the_json(data: dict[str, Any]) -> None:
    assert data["weights"]["failed_cells"] == 1
    assert data["weights"]["sampling"] == "3x3"
    assert data["weights"]["recommended"] == pytest.approx(1e3)


def test_the_fronts_are_in_the_json(data: dict[str, Any]) -> None:
    assert data["fronts"]["stages"] == ["approach", "capture"]
    assert [sample["failed"] for sample in data["fronts"]["samples"]] == [0, 7, 0]
    assert data["fronts"]["samples"][1]["J_1"] is None


@pytest.mark.slow
def test_the_fronts_are_found_from_the_run_there_is(tmp_path: Path) -> None:
    merge_logs({"psmpc": run_there_and_back(tmp_path)}, tmp_path / "out" / "runs.h5")
    log = read_comparison(tmp_path / "out" / "runs.h5")["psmpc"]
    results = find_fronts(tmp_path / "out", log, 3, jobs=1)
    assert results is not None
    assert results["weighted_J_1"].shape == (5, 3)
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"runs.h5", "fronts.h5"}


def test_a_run_without_such_a_window_has_no_fronts_and_none_of_an_earlier_run(
    tmp_path: Path, reproduction: Reproduction
) -> None:
    log = read_run(run_there_and_back(tmp_path, "controller.kind=hard"))
    assert find_fronts(tmp_path, log, 3, force=True, jobs=1) is None
    assert not (tmp_path / "fronts.h5").exists()
    logs = dict.fromkeys(METHODS, log)
    judged = judge_claims(logs, reproduction.weights, None)
    fronts = [found for found in judged.findings if found.claim.group == "fronts"]
    assert [found.holds for found in fronts] == [False, False]
    assert as_data(judged, "now")["fronts"] is None


def test_the_runs_follow_starts_beyond_the_thresholds_of_the_task() -> None:
    task, (variant, *_) = load_task("transport"), load_variants().values()
    assert variant.spec.onset.epsilon == task.spec.onset.epsilon
    assert set(variant.spec.onset.series) > set(task.spec.onset.series)
    assert max(variant.spec.onset.series) >= 10.0


def test_the_runs_have_the_published_setting() -> None:
    controller = load_variants()["psmpc"].spec.controller
    assert (controller.horizon, controller.nodes) == (4.0, 100)


def test_a_file_of_the_same_name_does_not_stand_in_for_the_task(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "transport").write_text("robot: nobody")
    monkeypatch.chdir(tmp_path)
    assert load_variants()["smpc"].spec.name == "transport"


def test_what_does_not_fit_is_refused() -> None:
    with pytest.raises(InputError, match=r"controller\.kind"):
        load_variants(["controller.kind=hard"])
    with pytest.raises(InputError, match=r"log\.plans"):
        load_variants(["log.plans=false"])
    with pytest.raises(SpecError, match="nodse"):
        load_variants(["controller.nodse=7"])
    with pytest.raises(SpecError):
        load_variants(["stages.capture.target.arm_1=[9, 9, 0]"])


def test_the_json_has_no_number_that_is_none(data: dict[str, Any]) -> None:
    assert data["claims"][0] == {
        "id": "a.b",
        "statement": "a happens",
        "source": "section IV",
        "unit": "s",
        "published": 1.0,
        "reproduced": None,
        "difference": None,
        "tolerance": 0.8,
        "holds": False,
        "earlier": False,
        "cause": "one thing; another",
    }


def test_the_json_counts_and_keeps_lists(data: dict[str, Any]) -> None:
    assert (data["held"], data["failed"]) == (2, 3)
    assert data["claims"][2]["published"] == [1.0, 2.0]
    assert data["claims"][3]["reproduced"] == ["a"]
    assert data["claims"][4]["cause"] is None
    assert data["claims"][1]["earlier"] is True
    assert data["changes"] == ["x=1"]


def test_the_page_on_it_documents_every_key_of_the_json(data: dict[str, Any]) -> None:
    text = (Path(__file__).parents[2] / "docs" / "reproduce.md").read_text(encoding="utf-8")
    rows = [line.partition("|")[2].partition("|")[0] for line in text.splitlines() if line.startswith("| `")]
    documented = {key for row in rows for key in re.findall(r"`(\w+)`", row)}
    assert documented == set(data) | set(data["claims"][0])
