from typing import Any

import pytest

from psmpc_cli.paper.claims import APART, HEADINGS, Claim, Finding, load_claims
from psmpc_cli.paper.judge import RULES
from psmpc_cli.paper.missions import MISSION_RULES
from psmpc_cli.specs.load import load_task

from .synthetic_runs import hand_made, reproduced

CLAIMS = {claim.id: claim for claim in load_claims()}


def test_the_names_of_claims_stay() -> None:
    assert len(CLAIMS) == len(load_claims()) == 34
    assert {name for name, claim in CLAIMS.items() if claim.rule != "time"} == {
        *("setting.horizon", "setting.nodes", "htmpc.mission", "smpc.mission", "psmpc.mission"),
        *("smpc.starts_early", "smpc.floor", "smpc.released_early", "psmpc.floor", "psmpc.t1_real.once_seen"),
        *("psmpc.t2_real.on_time", "psmpc.t3_real.on_time", "order.t_end", "order.t2", "order.t1_real", "order.t1"),
        *("weights.trend", "weights.floor", "weights.settles", "weights.chosen"),
        *("fronts.with_ratio", "fronts.with_time", "grasp.delivered"),
    }
    assert all(claim.id == claim.reads[0] for claim in CLAIMS.values() if claim.rule == "time")


def test_claims_that_cannot_fail_and_our_own_stand_apart() -> None:
    apart = {kind: {name for name, claim in CLAIMS.items() if claim.apart == kind} for kind in APART}
    assert apart == {
        "input": {"setting.horizon", "setting.nodes"},
        "definition": {"smpc.floor", "psmpc.floor", "weights.floor"},
        "ours": {"grasp.delivered"},
    }


def test_claims_agree_with_each_other() -> None:
    assert {claim.rule for claim in CLAIMS.values()} == {*RULES, *MISSION_RULES}
    for claim in CLAIMS.values():
        assert (claim.topic is not None) == (claim.group in ("htmpc", "smpc", "psmpc"))
        if claim.rule == "order":
            assert claim.published == tuple(CLAIMS[name].published for name in claim.reads)
            assert list(claim.published) == sorted(claim.published)
        if claim.rule in ("time", "setting", "settles"):
            assert f"{claim.published:g}" in claim.statement


def test_the_task_prints_the_same_published_values() -> None:
    published = load_task("transport").spec.published
    made = reproduced(**{method: hand_made() for method in published})
    for method, about in published.items():
        assert about.switch_time == made.published(method, starts=False)
        assert about.actual_start == made.published(method, starts=True)


def claim(published: Any, unit: Any = "s", **more: Any) -> Claim:
    return Claim(id="a.b", statement="a", source="IV", rule="time", reads=(), published=published, unit=unit, **more)


@pytest.mark.parametrize(
    ("finding", "texts"),
    [
        (
            Finding(claim(1.0), float("nan"), False, tolerance=0.8),
            ("a.b", "1.0 s", "never", "-", "0.80 s", "-", "no"),
        ),
        (
            Finding(claim(10.0), 8.0, True, -2.0, 0.8, True),
            ("a.b", "10.0 s", "8.0 s", "-2.00 s", "0.80 s", "-", "yes, earlier"),
        ),
        (
            Finding(claim((1.0, 2.0)), (2.0, 1.5), False),
            ("a.b", "1.0 s < 2.0 s", "2.0 s >= 1.5 s", "-", "exact", "-", "no"),
        ),
        (Finding(claim(("a", "b"), ""), ("a",), False), ("a.b", "a, b", "a", "-", "exact", "-", "no")),
        (
            Finding(claim("fails", "", searched=(5, 9)), "fails", True),
            ("a.b", "fails", "fails", "-", "exact", "5 of 9", "yes"),
        ),
    ],
)
def test_a_finding_is_a_row(finding: Finding, texts: tuple[str, ...]) -> None:
    assert finding.row == texts
    assert len(HEADINGS) == len(texts)
