"""Signals that are deferred; whole commands that a signal ends have tests in tests/cli."""

import signal
from collections.abc import Iterator
from threading import Thread
from types import FrameType

import pytest

from psmpc_cli.errors import Interruption, deferred_signals


@pytest.fixture
def received() -> Iterator[list[int]]:
    """Signals that reach the program, which would end it otherwise."""
    found = list[int]()

    def keep(number: int, frame: FrameType | None) -> None:
        found.append(number)

    before = {number: signal.signal(number, keep) for number in (signal.SIGINT, signal.SIGTERM)}
    yield found
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize(("number", "word"), [(signal.SIGINT, "interrupted"), (signal.SIGTERM, "terminated")])
def test_a_signal_is_raised_where_it_is_checked_for(received: list[int], number: int, word: str) -> None:
    with deferred_signals() as interruption:
        interruption.raise_if_signalled()
        signal.raise_signal(number)
        assert interruption.exit_code == 128 + number
        with pytest.raises(KeyboardInterrupt, match=word):
            interruption.raise_if_signalled()
    assert received == []


def test_a_signal_that_was_not_checked_for_comes_at_the_end(received: list[int]) -> None:
    with deferred_signals():
        signal.raise_signal(signal.SIGTERM)
        assert received == []
    assert received == [signal.SIGTERM]


def test_a_second_signal_that_is_no_repetition_is_not_deferred(
    received: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    now = 0.0
    monkeypatch.setattr("time.monotonic", lambda: now)
    with deferred_signals() as interruption:
        signal.raise_signal(signal.SIGINT)
        now = 0.05
        signal.raise_signal(signal.SIGINT)
        assert received == []
        now = 0.4
        signal.raise_signal(signal.SIGINT)
        assert received == [signal.SIGINT]
        with pytest.raises(KeyboardInterrupt):
            interruption.raise_if_signalled()


def test_inside_another_use_the_outer_one_keeps_signals(received: list[int]) -> None:
    with deferred_signals() as outer, deferred_signals() as inner:
        assert inner is outer


def test_another_thread_defers_nothing(received: list[int]) -> None:
    found = list[Interruption]()

    def use() -> None:
        with deferred_signals() as interruption:
            found.append(interruption)

    before = signal.getsignal(signal.SIGINT)
    thread = Thread(target=use)
    thread.start()
    thread.join()
    assert found[0].number == 0
    assert signal.getsignal(signal.SIGINT) is before
