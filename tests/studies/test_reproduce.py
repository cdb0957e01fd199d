import json
import re
from pathlib import Path
from typing import Any

import pytest

from psmpc_cli.errors import InputError, SpecError
from psmpc_cli.specs.load import load_task
from psmpc_cli.studies.judge import Reproduction
from psmpc_cli.studies.reproduce import METHODS, claims_json, load_variants, load_weights_sweep
from psmpc_cli.studies.weights import sweep_cells

from ..made_up_fronts import made_up_fronts
from ..made_up_sweep import made_up_sweep
from .hand_made import hand_made

ENDS = {"htmpc": (10.1, 17.7, 27.8, 34.0), "smpc": (10.0, 14.8, 24.8, float("nan")), "psmpc": (10.2, 13.0, 23.0, 28.8)}


ONE_STAGE = (
    "stages=[{name: go, skill: move, target: {base: [-0.1, 0, 0], arms: [0, 0, 0]}, ends_when: {coordinates: base}}]",
    "object=null",
    "monitors=[]",
    "published={}",
)


@pytest.fixture
def made(tmp_path: Path) -> Reproduction:
    """Of hand-made runs, a made-up sweep and made-up fronts."""
    weights = sweep_cells(made_up_sweep(tmp_path / "weights.h5", "3x3", failed=(1,)))
    fronts = made_up_fronts(tmp_path / "fronts.h5", failed=(1,))
    runs = {method: hand_made(ends, method=method) for method, ends in ENDS.items()}
    return Reproduction(runs, weights, fronts, ("x=1",))


@pytest.fixture
def data(made: Reproduction) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(claims_json(made, "now"))
    return found


@pytest.fixture
def claims(data: dict[str, Any]) -> dict[str, dict[str, Any]]:
    return {claim["id"]: claim for claim in data["claims"]}


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


def test_without_fronts_the_json_has_none(made: Reproduction) -> None:
    data = json.loads(claims_json(Reproduction(made.runs, made.weights, None), "now"))
    assert data["fronts"] is None
    assert [claim["holds"] for claim in data["claims"] if claim["id"].startswith("fronts")] == [False, False]


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
    with pytest.raises(InputError, match="found 1 stages, expected 4"):
        load_variants(ONE_STAGE)
    with pytest.raises(SpecError, match="nodse"):
        load_variants(["controller.nodse=7"])
    with pytest.raises(SpecError):
        load_variants(["stages.capture.target.arm_1=[9, 9, 0]"])


def test_the_json_has_null_for_what_never_happened(claims: dict[str, dict[str, Any]]) -> None:
    assert claims["htmpc.t2"] == {
        "id": "htmpc.t2",
        "statement": "capture ends at t2 = 17.2 s",
        "source": "section IV-C",
        "unit": "s",
        "published": 17.2,
        "reproduced": 17.7,
        "difference": pytest.approx(0.5),
        "tolerance": pytest.approx(0.86),
        "holds": True,
        "earlier": False,
        "cause": None,
    }
    assert claims["order.t_end"]["reproduced"] == [28.8, 34.0]
    assert claims["smpc.starts_early"]["reproduced"] == []
    assert claims["psmpc.t_end"]["earlier"] is True
    assert claims["smpc.mission"]["unit"] is None
    assert claims["psmpc.t1_real.once_seen"]["cause"].count("; ") == 2


def test_the_json_counts(data: dict[str, Any]) -> None:
    assert data["held"] == sum(claim["holds"] for claim in data["claims"])
    assert data["held"] + data["failed"] == len(data["claims"]) == 33
    assert data["changes"] == ["x=1"]


def test_the_page_on_it_documents_every_key_of_the_json(data: dict[str, Any]) -> None:
    text = (Path(__file__).parents[2] / "docs" / "reproduce.md").read_text(encoding="utf-8")
    rows = [line.partition("|")[2].partition("|")[0] for line in text.splitlines() if line.startswith("| `")]
    documented = {key for row in rows for key in re.findall(r"`(\w+)`", row)}
    assert documented == set(data) | set(data["claims"][0])
