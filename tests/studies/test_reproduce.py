import json
import re
from math import nan
from pathlib import Path
from typing import Any

import pytest

from psmpc_cli.errors import InputError, SpecError
from psmpc_cli.specs.load import load_task
from psmpc_cli.studies.claim_table import HEADINGS, as_data, cells, shown
from psmpc_cli.studies.claims import Claim
from psmpc_cli.studies.findings import Finding
from psmpc_cli.studies.reproduce import METHODS, JudgedClaim, Reproduction, load_variants

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
