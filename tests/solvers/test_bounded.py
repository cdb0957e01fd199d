"""Calls in processes of their own: what comes back, and how those end that do not return."""

import gc
import os
import signal
import time
from threading import Timer

import pytest

from psmpc_cli.errors import deferred_signals
from psmpc_cli.solvers.bounded import LONGEST_CALL, BoundedCalls, processor_time


def never_returns() -> None:
    while True:
        pass


def fails() -> None:
    raise ValueError("found -1, expected 1")


def test_a_call_returns_what_the_function_does() -> None:
    large = bytes(1 << 20)  # longer than a pipe holds
    returned, process = BoundedCalls(lambda given: (given + large, os.getpid()))(LONGEST_CALL, large)
    assert returned == large + large
    assert process != os.getpid()


def test_calls_are_answered_by_one_copy_that_remembers_until_it_is_renewed() -> None:
    told: list[int] = []
    calls = BoundedCalls(lambda number: (told.append(number), os.getpid(), list(told))[1:])
    first, second = calls(LONGEST_CALL, 1), calls(LONGEST_CALL, 2)
    assert first[0] == second[0]
    assert (first[1], second[1], told) == ([1], [1, 2], [])
    calls.renew()
    third = calls(LONGEST_CALL, 3)
    assert third[0] != first[0]
    assert third[1] == [3]


def test_a_copy_ends_with_what_it_answers_for() -> None:
    calls = BoundedCalls(os.getpid)
    process = calls(LONGEST_CALL)
    del calls
    gc.collect()
    with pytest.raises(ProcessLookupError):
        os.kill(process, 0)


def test_a_call_raises_what_the_function_does() -> None:
    with pytest.raises(ValueError, match="found -1, expected 1"):
        BoundedCalls(fails)(LONGEST_CALL)


def test_processor_time_has_that_of_the_calls() -> None:
    def work(seconds: float) -> None:
        until = time.process_time() + seconds
        while time.process_time() < until:
            pass

    before = processor_time()
    BoundedCalls(work)(LONGEST_CALL, 0.2)
    assert processor_time() - before >= 0.2


def test_a_function_that_does_not_return_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("psmpc_cli.solvers.bounded.WAITING", 1e3)  # a busy machine gives it little time
    with pytest.raises(TimeoutError, match=r"within 0.1 s of processor time"):
        BoundedCalls(never_returns)(0.1)


def test_after_a_call_that_did_not_return_the_next_one_does() -> None:
    calls = BoundedCalls(lambda given: never_returns() if given else given)
    with pytest.raises(TimeoutError):
        calls(0.1, True)
    assert calls(0.1, False) is False


def test_a_function_that_waits_for_ever_is_ended() -> None:
    with pytest.raises(TimeoutError):
        BoundedCalls(lambda: time.sleep(600))(0.02)


def test_a_function_that_ends_its_process_ends_no_other() -> None:
    with pytest.raises(RuntimeError, match=f"signal {signal.SIGUSR1:d}"):
        BoundedCalls(lambda: os.kill(os.getpid(), signal.SIGUSR1))(LONGEST_CALL)


def test_a_signal_ends_a_call_that_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("psmpc_cli.solvers.bounded.GRACE", 0.1)
    with deferred_signals():
        Timer(0.1, os.kill, (os.getpid(), signal.SIGTERM)).start()
        with pytest.raises(KeyboardInterrupt, match="terminated"):
            BoundedCalls(never_returns)(LONGEST_CALL)
