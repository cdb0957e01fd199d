import json
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from psmpc_cli.errors import InputError, SpecError
from psmpc_cli.paper.departures import PRINTED, SHIPPED
from psmpc_cli.paper.judge import Reproduction
from psmpc_cli.paper.reproduce import METHODS, claims_json, load_grasps, load_variants, load_weights_sweep
from psmpc_cli.specs.controller import AS_PRINTED
from psmpc_cli.specs.load import load_task
from psmpc_cli.studies.sweep import SweepCells

from ..synthetic_fronts import synthetic_fronts
from ..synthetic_sweep import synthetic_sweep
from .synthetic_runs import grasped, hand_made

ENDS = {"htmpc": (10.1, 17.7, 27.8, float("nan")), "smpc": (10.0, 14.8, 24.8, 29.1), "psmpc": (10.2, 13.0, 23.0, 28.8)}


ONE_STAGE = (
    "stages=[{name: go, skill: move, target: {base: [-0.1, 0, 0], arms: [0, 0, 0]}, ends_when: {coordinates: base}}]",
    "object=null",
    "monitors=[]",
    "published={}",
)


@pytest.fixture
def made(tmp_path: Path) -> Reproduction:
    """Of hand-made runs, a made-up sweep and made-up fronts."""
    weights = SweepCells(synthetic_sweep(tmp_path / "weights.h5", "3x3", failed=(1,)))
    fronts = synthetic_fronts(tmp_path / "fronts.h5", failed=(1,))
    runs = {method: hand_made(ends, method=method) for method, ends in ENDS.items()}
    return Reproduction(runs, weights, fronts, ("x=1",), grasps={"smpc": grasped(0.08), "psmpc": grasped()})


def test_inputs_are_not_judged_and_definitions_are(made: Reproduction) -> None:
    assert {"smpc.floor", "setting.nodes"}.isdisjoint(finding.claim.id for finding in made.failing)
    runs = {**made.runs, "smpc": hand_made((10.0, 14.8, float("nan"), float("nan")), method="smpc")}
    vars(runs["smpc"])["task"] = load_task("transport", ["controller.nodes=20"])
    changed = replace(made, runs=runs)
    failing = {finding.claim.id: finding for finding in changed.failing}
    assert "setting.nodes" not in failing
    assert "transport did not end: time limit of 60 s reached" in failing["smpc.floor"].cause
    assert changed.count("input") == (1, 2)
    assert changed.count("definition") == (1, 3)  # a cell of the sweep has failed, too
    assert "not counted: 1 of 2 on inputs, 1 of 3 from definitions, 1 of 1 of our own" in changed.outcome


@pytest.fixture
def data(made: Reproduction) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(claims_json(made, "now"))
    return found


@pytest.mark.parametrize(("onset", "followed"), [("control", 10.0), ("closeness", 0.9)])
def test_the_runs_differ_in_the_controller_alone_and_follow_more_thresholds(onset: str, followed: float) -> None:
    one_setting = [f"onset={{kind: {onset}}}", "by_controller={}"]
    tasks, own = load_variants(one_setting), load_task("transport", one_setting).spec
    assert {method: task.spec.controller.kind for method, task in tasks.items()} == {name: name for name in METHODS}
    first, *others = (task.spec.model_copy(update={"controller": None}).model_dump_json() for task in tasks.values())
    assert all(other == first for other in others)
    for task in tasks.values():
        assert (task.spec.controller.horizon, task.spec.controller.nodes) == (4.0, 100)
        assert task.spec.onset.epsilon == own.onset.epsilon
        assert set(task.spec.onset.series) >= {*own.onset.series, followed}


def test_the_sweep_takes_the_changes_that_are_about_how_tasks_are_run() -> None:
    changes = ["controller.nodes=7", "plant={kind: ideal}", "stages.transport.priority=3", "time_limit=5"]
    sweep = load_weights_sweep(changes, "3x3")
    spec, own = sweep.task.spec, load_task("approach_capture").spec
    assert (spec.controller.nodes, spec.plant.kind) == (7, "ideal")
    assert (spec.stages, spec.time_limit) == (own.stages, own.time_limit)
    assert len(sweep.cells) == 9
    assert sweep.cells[0] == ("stages[0].priority=0.001", "stages[1].priority=0.001")
    assert sweep.cells[-1] == ("stages[0].priority=1000.0", "stages[1].priority=1000.0")


def test_as_printed_the_runs_the_sweep_and_the_grasps_are() -> None:
    tasks = [*load_variants(task=PRINTED).values(), load_weights_sweep((), "3x3", task=PRINTED).task]
    assert all(task.spec.onset.epsilon == 1e-4 for task in tasks)
    for task in (*tasks, *load_grasps(task=PRINTED).values()):
        assert {key: getattr(task.spec.controller, key) for key in AS_PRINTED} == AS_PRINTED
        assert task.spec.solver.kind == "fatrop"
    sweep = tasks[-1].spec
    assert sweep.stages[0].ends_when is not None and sweep.stages[0].ends_when.coordinates == ("all",)
    assert sweep.controller.multistart == 1
    assert 1e-4 in sweep.onset.series  # which is what is judged
    assert load_variants(["controller.nodes=7"], PRINTED)["smpc"].spec.controller.nodes == 7
    with pytest.raises(SpecError, match=r'found "pending_cost" beside as_printed: true'):
        load_variants(["controller.pending_cost=1"], PRINTED)


def test_keys_of_the_swept_task_may_be_changed_besides() -> None:
    own = load_weights_sweep(["controller.nodes=7"], "3x3", ["onset={kind: control, epsilon: 1e-4}"]).task.spec
    assert (own.onset.kind, own.onset.epsilon, own.controller.nodes) == ("control", 1e-4, 7)


def test_the_json_has_both_tasks(made: Reproduction) -> None:
    alone, both = (json.loads(claims_json(made, "now", printed)) for printed in (None, made))
    assert alone["as_printed"] is None and alone["task"] == SHIPPED
    assert both["as_printed"] == {key: value for key, value in alone.items() if key != "as_printed"}


def test_a_file_of_the_same_name_does_not_stand_in_for_the_task(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "transport").write_text("robot: nobody")
    monkeypatch.chdir(tmp_path)
    assert load_variants()["smpc"].spec.name == "transport"


def test_the_grasps_take_the_controller_and_the_solver_of_the_changes() -> None:
    tasks = load_grasps(["controller.nodes=7", "plant={kind: ideal}", "stages.transport.priority=3"])
    assert {name: task.spec.controller.kind for name, task in tasks.items()} == {"smpc": "smpc", "psmpc": "psmpc"}
    own = load_task("transport_grasp").spec
    assert all(task.spec.controller.nodes == 7 for task in tasks.values())
    assert all(task.spec.plant == own.plant for task in tasks.values())
    assert all(task.spec.stages[2].priority == own.stages[2].priority for task in tasks.values())


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (["controller.kind=hard"], r"controller\.kind"),
        (["log.plans=false"], r"log\.plans"),
        (ONE_STAGE, "found 1 stages, expected 4"),
        (["controller.nodse=7"], "nodse"),
        (["stages.capture.target.arm_1=[9, 9, 0]"], "arm_1"),
    ],
)
def test_what_does_not_fit_is_rejected(changes: Sequence[str], message: str) -> None:
    with pytest.raises((InputError, SpecError), match=message):
        load_variants(changes)


def test_the_json_has_everything_and_null_for_what_is_unknown(made: Reproduction, data: dict[str, Any]) -> None:
    claims = {claim["id"]: claim for claim in data["claims"]}
    counted = [claim for claim in claims.values() if claim["apart"] is None]
    assert data["held"] == sum(claim["holds"] for claim in counted)
    assert data["held"] + data["failed"] == len(counted) == len(claims) - 6
    assert (claims["grasp.delivered"]["holds"], claims["grasp.delivered"]["apart"]) == (True, "ours")
    assert claims["setting.nodes"]["apart"] == "input"
    assert claims["htmpc.t_end"] == {
        "id": "htmpc.t_end",
        "statement": "release ends at t_end = 35.4 s",
        "source": "section IV-C",
        "unit": "s",
        "apart": None,
        "published": 35.4,
        "searched": None,
        "reproduced": None,
        "difference": None,
        "tolerance": pytest.approx(1.77),
        "holds": False,
        "earlier": False,
        "cause": "release did not end: time limit of 60 s reached",
    }
    assert claims["order.t_end"]["reproduced"] == [28.8, None]
    assert claims["smpc.starts_early"]["reproduced"] == []
    assert claims["psmpc.t_end"]["earlier"] is True
    assert claims["smpc.mission"]["unit"] is None
    assert claims["smpc.mission"]["searched"] == [580, 612]
    assert claims["fronts.with_time"]["cause"].count("; ") == 3
    assert data["changes"] == ["x=1"]
    assert (data["weights"]["failed_cells"], data["weights"]["sampling"]) == (1, "3x3")
    assert data["weights"]["recommended"] == pytest.approx(100.0)
    assert data["fronts"]["stages"] == ["approach", "capture"]
    assert [sample["failed"] for sample in data["fronts"]["samples"]] == [0, 7, 0]
    assert data["fronts"]["samples"][1]["J_1"] is None
    assert json.loads(claims_json(replace(made, fronts=None), "now"))["fronts"] is None


def test_the_page_on_it_documents_every_key_of_the_json(data: dict[str, Any]) -> None:
    text = (Path(__file__).parents[2] / "docs" / "claims.md").read_text(encoding="utf-8")
    rows = [line.partition("|")[2].partition("|")[0] for line in text.splitlines() if line.startswith("| `")]
    documented = {key for row in rows for key in re.findall(r"`(\w+)`", row)}
    assert documented == set(data) | set(data["claims"][0])
