import json
import re
from math import nan
from pathlib import Path
from typing import Any

import pytest

from psmpc_cli.errors import InputError, SpecError
from psmpc_cli.logs.comparison import merge_logs, read_comparison
from psmpc_cli.logs.read import read_log
from psmpc_cli.simulation.sweep_cells import sweep_cells
from psmpc_cli.specs.load import load_task
from psmpc_cli.studies.claim_table import HEADINGS, as_data, cells, shown
from psmpc_cli.studies.claims import Claim
from psmpc_cli.studies.findings import Finding
from psmpc_cli.studies.reproduce import (
    METHODS,
    JudgedClaim,
    Reproduction,
    add_fronts,
    judge_pareto,
    judge_sweep,
    load_variants,
    load_weights_sweep,
)

from ..made_up_fronts import made_up_fronts
from ..made_up_sweep import made_up_sweep
from .there_and_back_run import run_there_and_back

CLAIM = Claim("a.b", "a", "times", "a happens", "section IV")

NEVER = JudgedClaim(CLAIM, Finding(1.0, nan, "s", nan, 0.8, False, cause=("one thing", "another")))
EARLIER = JudgedClaim(CLAIM, Finding(10.0, 8.0, "s", -2.0, 0.8, True, True, ("earlier",)))
ORDER = JudgedClaim(CLAIM, Finding((1.0, 2.0), (2.0, 1.5), "s", nan, 0.0, False, cause=("so",)))
STARTS = JudgedClaim(CLAIM, Finding(("a", "b"), ("a",), "", nan, 0.0, False, cause=("b",)))
HOLDS = JudgedClaim(CLAIM, Finding("fails", "fails", "", nan, 0.0, True))


def table(*judged: JudgedClaim) -> dict[str, Any]:
    data: dict[str, Any] = json.loads(json.dumps(as_data(Reproduction(("x=1",), {}, judged), "now"), allow_nan=False))
    return data


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
    assert sweep.stages == (0, 1)
    assert (sweep.sampling.omega.min(), sweep.sampling.omega.max()) == (1e-3, 1e3)


def test_the_sweep_is_in_the_json(tmp_path: Path) -> None:
    cells = sweep_cells(made_up_sweep(tmp_path / "weights.h5", "3x3", failed=(1,)))
    found = as_data(judge_sweep(Reproduction((), {}, ()), cells), "now")
    assert found["weights"]["failed_cells"] == 1
    assert found["weights"]["sampling"] == "3x3"
    assert found["weights"]["recommended"] == pytest.approx(1e3)
    assert [claim["id"].partition(".")[0] for claim in found["claims"]] == ["weights"] * 4


def test_the_fronts_are_in_the_json(tmp_path: Path) -> None:
    results = made_up_fronts(tmp_path / "fronts.h5", failed=(1,))
    found = json.loads(json.dumps(as_data(judge_pareto(Reproduction((), {}, ()), results), "now"), allow_nan=False))
    assert found["fronts"]["stages"] == ["approach", "capture"]
    assert [sample["failed"] for sample in found["fronts"]["samples"]] == [0, 7, 0]
    assert found["fronts"]["samples"][1]["J_1"] is None
    assert [claim["id"] for claim in found["claims"]] == ["fronts.with_ratio", "fronts.with_time"]


def test_the_fronts_are_found_from_the_run_there_is(tmp_path: Path) -> None:
    merge_logs({"psmpc": run_there_and_back(tmp_path)}, tmp_path / "out" / "runs.h5")
    reproduction = Reproduction((), read_comparison(tmp_path / "out" / "runs.h5"), ())
    found = add_fronts(reproduction, tmp_path / "out", 3, jobs=1)
    assert found.fronts is not None
    assert found.fronts["weighted_J_1"].shape == (5, 3)
    assert len(found.judged) == 2
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"runs.h5", "fronts.h5"}


def test_a_run_without_such_a_window_has_no_fronts_and_none_of_an_earlier_run(tmp_path: Path) -> None:
    made_up_fronts(tmp_path / "fronts.h5")
    log = read_log(run_there_and_back(tmp_path, "controller.kind=hard"))
    found = add_fronts(Reproduction((), {"psmpc": log}, ()), tmp_path, 3, force=True, jobs=1)
    assert found.fronts is None
    assert [judged.finding.holds for judged in found.judged] == [False, False]
    assert as_data(found, "now")["fronts"] is None
    assert not (tmp_path / "fronts.h5").exists()


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


def test_the_json_has_no_number_that_is_none() -> None:
    (claim,) = table(NEVER)["claims"]
    assert claim == {
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


def test_the_json_counts_and_keeps_lists() -> None:
    data = table(NEVER, EARLIER, ORDER, STARTS, HOLDS)
    assert (data["held"], data["failed"]) == (2, 3)
    assert data["claims"][2]["published"] == [1.0, 2.0]
    assert data["claims"][3]["reproduced"] == ["a"]
    assert data["claims"][4]["cause"] is None
    assert data["claims"][1]["earlier"] is True
    assert data["changes"] == ["x=1"]


def test_the_page_on_it_documents_every_key_of_the_json() -> None:
    text = (Path(__file__).parents[2] / "docs" / "reproduce.md").read_text(encoding="utf-8")
    rows = [line.partition("|")[2].partition("|")[0] for line in text.splitlines() if line.startswith("| `")]
    documented = {key for row in rows for key in re.findall(r"`(\w+)`", row)}
    data = table(HOLDS)
    assert documented == set(data) | set(data["claims"][0])


@pytest.mark.parametrize(
    ("judged", "texts"),
    [
        (NEVER, ("a.b", "1.0 s", "never", "-", "0.80 s", "no")),
        (EARLIER, ("a.b", "10.0 s", "8.0 s", "-2.00 s", "0.80 s", "yes, earlier")),
        (ORDER, ("a.b", "1.0 s < 2.0 s", "2.0 s >= 1.5 s", "-", "exact", "no")),
        (STARTS, ("a.b", "a, b", "a", "-", "exact", "no")),
        (HOLDS, ("a.b", "fails", "fails", "-", "exact", "yes")),
    ],
)
def test_a_claim_is_a_row(judged: JudgedClaim, texts: tuple[str, ...]) -> None:
    assert cells(judged) == dict(zip(HEADINGS, texts, strict=True))


def test_values_are_shown_with_as_many_digits_as_they_need() -> None:
    assert [shown(value, "s") for value in (9.7, 10.14, 10.0)] == ["9.7 s", "10.14 s", "10.0 s"]
    assert [shown(value, "") for value in (100.0, 8.0)] == ["100", "8"]
    assert shown((), "") == "none"
