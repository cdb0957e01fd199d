import pytest

from psmpc_cli.specs.load import load_task
from psmpc_cli.studies.claims import (
    FloorClaim,
    Moment,
    OrderClaim,
    ReleaseClaim,
    StartClaim,
    TimeClaim,
    moment_of,
    published_claims,
)
from psmpc_cli.studies.published import Published, load_published


@pytest.fixture(scope="module")
def published() -> Published:
    return load_published()


def test_every_published_time_is_a_claim(published: Published) -> None:
    claims = [claim for claim in published_claims(published) if isinstance(claim, TimeClaim)]
    told = {str(claim.moment): claim.published for claim in claims}
    assert told == {f"{run}.{symbol}": t for run, about in published.runs.items() for symbol, t in about.times.items()}
    assert told["htmpc.t_end"] == 35.4
    assert told["smpc.t1_real"] == 8.8
    assert len(told) == 11


def test_every_claim_has_a_name_of_its_own(published: Published) -> None:
    names = [claim.id for claim in published_claims(published)]
    assert len(set(names)) == len(names)


def test_the_qualitative_claims_are_there(published: Published) -> None:
    names = {claim.id for claim in published_claims(published)}
    missions = {"htmpc.mission", "smpc.mission", "smpc.released_early", "psmpc.mission"}
    starts = {"smpc.starts_early", "psmpc.t1_real.once_seen", "psmpc.t2_real.on_time", "psmpc.t3_real.on_time"}
    orders = {"order.t_end", "order.t2", "order.t1_real", "order.t1"}
    assert missions | starts | orders | {"smpc.floor", "psmpc.floor"} <= names


def test_symbols_name_ends_and_the_starts_of_the_stages_after_them(published: Published) -> None:
    assert moment_of(published, "smpc.t2") == Moment("smpc", "t2", "capture", "end")
    assert moment_of(published, "smpc.t2_real") == Moment("smpc", "t2_real", "transport", "start")


def test_claims_on_starts_speak_of_the_end_they_are_about(published: Published) -> None:
    claims = {claim.id: claim for claim in published_claims(published)}
    on_time, release = claims["psmpc.t3_real.on_time"], claims["smpc.released_early"]
    assert isinstance(on_time, StartClaim)
    assert isinstance(release, ReleaseClaim)
    assert (on_time.start.stage, on_time.end.stage) == ("release", "transport")
    assert (release.start.stage, release.end.stage) == ("release", "transport")
    floor = claims["smpc.floor"]
    assert isinstance(floor, FloorClaim)
    assert [(start.stage, end.stage) for start, end in floor.pairs] == [
        ("capture", "approach"),
        ("transport", "capture"),
        ("release", "transport"),
    ]


def test_orders_hold_in_what_is_published(published: Published) -> None:
    for claim in published_claims(published):
        if isinstance(claim, OrderClaim):
            assert list(claim.published) == sorted(claim.published)


def test_the_task_prints_the_same_published_values(published: Published) -> None:
    for run, about in load_task("transport").spec.published.items():
        told = {moment_of(published, f"{run}.{symbol}"): time for symbol, time in published.runs[run].times.items()}
        ends = {moment.stage: time for moment, time in told.items() if moment.event == "end"}
        starts = {moment.stage: time for moment, time in told.items() if moment.event == "start"}
        assert about.switch_time == ends
        assert about.actual_start == starts
