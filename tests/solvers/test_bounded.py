"""Calls in processes of their own: what comes back, and how those end that do not return."""

import os
import signal
import time
from threading import Timer

import pytest

from psmpc_cli.errors import deferred_signals
from psmpc_cli.solvers.bounded import LONGEST_CALL, call_bounded


def never_returns() -> None:
    while True:
        pass


def fails() -> None:
    raise ValueError("found -1, expected 1")


def test_a_call_returns_what_the_function_does() -> None:
    large = bytes(1 << 20)  # longer than a pipe holds
    assert call_bounded(lambda: (large, os.getpid()), LONGEST_CALL)[0] == large


def test_a_call_raises_what_the_function_does() -> None:
    with pytest.raises(ValueError, match="found -1, expected 1"):
        call_bounded(fails, LONGEST_CALL)


def test_a_function_that_does_not_return_is_ended() -> None:
    with pytest.raises(TimeoutError, match=r"within 0.1 s of processor time"):
        call_bounded(never_returns, 0.1)


def test_a_function_that_waits_for_ever_is_ended() -> None:
    with pytest.raises(TimeoutError):
        call_bounded(lambda: time.sleep(600), 0.02)


def test_a_function_that_ends_its_process_ends_no_other() -> None:
    with pytest.raises(RuntimeError, match=f"signal {signal.SIGUSR1:d}"):
        call_bounded(lambda: os.kill(os.getpid(), signal.SIGUSR1), LONGEST_CALL)


def test_a_signal_ends_a_call_that_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("psmpc_cli.solvers.bounded.GRACE", 0.1)
    with deferred_signals():
        Timer(0.1, os.kill, (os.getpid(), signal.SIGTERM)).start()
        with pytest.raises(KeyboardInterrupt, match="terminated"):
            call_bounded(never_returns, LONGEST_CALL)
