"""The rules on runs: what holds of runs as published, and what of runs that stopped or failed."""

from dataclasses import replace
from math import inf, nan
from typing import Any

import pytest

from psmpc_cli.paper.claims import load_claims
from psmpc_cli.paper.missions import MISSION_RULES, Mission, Missions, judge_missions

from .synthetic_runs import STAGES

CLAIMS = {claim.id: claim for claim in load_claims() if claim.rule in MISSION_RULES}


def mission(ends: tuple[float, ...], early: dict[int, float], broken_at: float = nan) -> Mission:
    """A whole run in which these stages, numbered from 0, start early."""
    starts = (0.0, *ends[:-1])
    return Mission(
        stages=STAGES,
        starts=tuple(early.get(stage, start) for stage, start in enumerate(starts)),
        ends=ends,
        succeeded=broken_at != broken_at,
        broken_at=broken_at,
        horizon=4.0,
        sample_time=0.1,
    )


AS_PUBLISHED = {
    "htmpc": mission((9.7, 17.2, 27.3, 35.4), {}),
    "smpc": mission((10.3, 15.1, 25.0, 31.0), {1: 8.8, 2: 15.0, 3: 23.3}, broken_at=24.1),
    "psmpc": mission((10.3, 13.8, 24.4, 31.3), {1: 6.3}),
}


def stopped(whole: Mission, count: int) -> Mission:
    """The run as it is known when so many stages have ended: the next one may have started, early or not."""
    return replace(
        whole,
        starts=tuple(start if stage <= count else nan for stage, start in enumerate(whole.starts)),
        ends=tuple(end if stage < count else nan for stage, end in enumerate(whole.ends)),
        succeeded=False,
        broken_at=whole.broken_at if whole.broken_at < (0.0, *whole.ends)[count] else nan,
    )


def held(missions: Missions) -> set[str]:
    return {name for name, claim in CLAIMS.items() if judge_missions(claim, missions).holds}


def changed(method: str, **changes: Any) -> Missions:
    return {**AS_PUBLISHED, method: replace(AS_PUBLISHED[method], **changes)}


def test_runs_as_published_meet_all_claims() -> None:
    assert held(AS_PUBLISHED) == set(CLAIMS)


FIRST = {"htmpc.t1", "smpc.t1", "smpc.t1_real", "psmpc.t1_real"}
SECOND = FIRST | {"htmpc.t2", "smpc.t2", "psmpc.t2", "psmpc.t1_real.once_seen"}
THIRD = SECOND | {"htmpc.t3", "psmpc.t3", "psmpc.t2_real.on_time"}
LOST = {"smpc.mission", "smpc.starts_early", "smpc.released_early"}


@pytest.mark.parametrize(("count", "expected"), [(0, set()), (1, FIRST), (2, SECOND), (3, THIRD | LOST)])
def test_of_runs_that_stopped_hold_the_claims_on_what_they_came_to(count: int, expected: set[str]) -> None:
    assert held({method: stopped(whole, count) for method, whole in AS_PUBLISHED.items()}) == expected


@pytest.mark.parametrize("name", ["smpc.t1_real", "psmpc.t1_real", "psmpc.t1_real.once_seen", "order.t1_real"])
def test_nothing_is_known_of_a_start_before_the_end_of_a_stage_that_never_ended(name: str) -> None:
    started = {
        method: replace(stopped(whole, 0), starts=whole.starts, succeeded=True)
        for method, whole in AS_PUBLISHED.items()
    }
    assert not judge_missions(CLAIMS[name], started).holds


def test_a_stage_that_begins_on_time_and_does_not_end_shows_nothing() -> None:
    begun = {"psmpc": stopped(AS_PUBLISHED["psmpc"], 2)}
    assert begun["psmpc"].starts[2] == begun["psmpc"].ends[1]
    assert not judge_missions(CLAIMS["psmpc.t2_real.on_time"], begun).holds


@pytest.mark.parametrize("method", ["smpc", "psmpc"])
def test_a_floor_takes_that_all_stages_have_ended(method: str) -> None:
    finding = judge_missions(CLAIMS[f"{method}.floor"], {method: stopped(AS_PUBLISHED[method], 3)})
    assert not finding.holds
    assert finding.reproduced == pytest.approx(2.3 if method == "smpc" else 0.0)


def test_a_mission_that_stops_has_neither_succeeded_nor_failed() -> None:
    finding = judge_missions(CLAIMS["smpc.mission"], {"smpc": stopped(AS_PUBLISHED["smpc"], 2)})
    assert (finding.holds, finding.reproduced) == (False, "stops")
    ended = replace(AS_PUBLISHED["smpc"], broken_at=nan)  # a monitor was not judged
    assert judge_missions(CLAIMS["smpc.mission"], {"smpc": ended}).holds


def test_an_order_takes_that_missions_succeed_which_are_published_to() -> None:
    names = {name for name in CLAIMS if name.startswith("order.")}
    for method, others in (("psmpc", {"order.t1"}), ("htmpc", {"order.t1_real"})):
        failed = changed(method, succeeded=False, broken_at=20.0)
        assert names & held(failed) == others


def test_earlier_than_published_counts_if_the_mission_succeeded() -> None:
    early = {"ends": (9.0, 12.0, 20.0, 25.0), "starts": (0.0, 5.0, 12.0, 20.0)}
    times = {"psmpc.t2", "psmpc.t3", "psmpc.t_end", "psmpc.t1_real"}
    assert times <= held(changed("psmpc", **early))
    assert not times & held(changed("psmpc", **early, succeeded=False, broken_at=18.0))
    assert not times & held({**AS_PUBLISHED, "psmpc": stopped(changed("psmpc", **early)["psmpc"], 3)})


@pytest.mark.parametrize("broken_at", [23.2, 25.0, inf, nan])
def test_the_object_is_lost_between_the_start_of_release_and_the_end_of_transport(broken_at: float) -> None:
    assert "smpc.released_early" not in held(changed("smpc", broken_at=broken_at))
