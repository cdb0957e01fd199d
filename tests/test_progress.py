"""How far long work has come, and how long it takes yet."""

import time

import pytest

from psmpc_cli import progress
from psmpc_cli.progress import Progress, Work, duration


def test_work_tells_its_parts_and_the_time_left_at_their_pace(monkeypatch: pytest.MonkeyPatch) -> None:
    told = list[Progress]()
    now = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    work = Work("runs", 4, told.append, "weights")
    now[0] += 10
    work.advance("first")
    now[0] += 4
    work.wait()  # not yet again
    now[0] += 8
    work.wait()
    now[0] += 60
    work.wait()
    work.advance(failed=True)
    now[0] += 1
    work.advance()
    work.advance()
    assert [str(each) for each in told] == [
        "weights: 0 of 4 runs",
        "weights: 1 of 4 runs, first done, about 30 s left",
        "weights: 1 of 4 runs, first done, about 18 s left",
        "weights: 1 of 4 runs, first done",
        "weights: 2 of 4 runs, 1 failed, about 1 min 22 s left",
        "weights: 3 of 4 runs, 1 failed, about 28 s left",
        "weights: 4 of 4 runs, 1 failed",
    ]
    assert [each.is_due for each in told] == [True, True, False, False, True, True, True]
    assert told[-1].elapsed == 83


def test_small_parts_are_not_worth_a_line_each() -> None:
    told = list[Progress]()
    work = Work("samples", 2, told.append, small_parts=True)
    work.advance()
    Work("libraries", 1, told.append, small_parts=True, announced=True)
    assert [each.is_due for each in told] == [False, False, True]


def test_work_without_parts_says_so() -> None:
    assert str(Progress("runs", 0)) == "no runs are left"


def test_long_work_is_logged_unless_it_has_a_watcher(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO", progress.__name__)
    Work("stages", 2, title="planning routes").advance()
    assert [record.getMessage().partition(", about")[0] for record in caplog.records] == [
        "planning routes: 0 of 2 stages",
        "planning routes: 1 of 2 stages",
    ]


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0.4, "0 s"), (59.6, "1 min 0 s"), (125, "2 min 5 s"), (3600, "1 h 0 min"), (7384, "2 h 3 min")],
)
def test_times_have_their_two_largest_units(seconds: float, text: str) -> None:
    assert duration(seconds) == text
