"""Calls in processes of this machine, some of which are killed.

What is called stands inside the tests, so that it goes to the processes by value: they know no tests.
"""

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from psmpc_cli.errors import RunError
from psmpc_cli.studies import parallel
from psmpc_cli.studies.parallel import Calls, LocalCalls

Fatal = Callable[[int], int]


def fatal_once(note: Path) -> Fatal:
    """A call that doubles its item; item 2 kills its process the first time, which the note tells."""

    def call(item: int) -> int:
        if item == 2 and not note.exists():
            note.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return 2 * item

    return call


def fatal_for(*culprits: int) -> Fatal:
    """A call that doubles its item; some items kill their process every time."""

    def call(item: int) -> int:
        if item in culprits:
            os.kill(os.getpid(), signal.SIGKILL)
        return 2 * item

    return call


def minus(item: int) -> int:
    return -item


def made(calls: Calls, function: Fatal, count: int = 6) -> dict[int, int]:
    """The result of each item; none comes twice."""
    found = list(calls.each(function, range(count), minus))
    assert len(dict(found)) == len(found)
    return dict(found)


def doubled(*, but: tuple[int, ...] = (), count: int = 6) -> dict[int, int]:
    return {item: -item if item in but else 2 * item for item in range(count)}


@pytest.mark.parametrize("jobs", [1, 2])
def test_every_item_gets_its_result(jobs: int) -> None:
    assert made(LocalCalls(jobs), fatal_for()) == doubled()
    assert list(LocalCalls(jobs).each(fatal_for(), [])) == []


def test_each_process_has_one_thread() -> None:
    def threads(item: int) -> str:
        return os.environ["OMP_NUM_THREADS"]

    assert dict(LocalCalls(2).each(threads, range(2))) == {0: "1", 1: "1"}


@pytest.mark.skipif(os.name == "nt", reason="signals cannot be blocked there")
def test_ctrl_c_reaches_no_process_from_its_first_instruction_on() -> None:
    def blocked(item: int) -> bool:
        return signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ())

    assert dict(LocalCalls(2).each(blocked, range(4))) == dict.fromkeys(range(4), True)
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())


def test_a_killed_process_costs_no_result(tmp_path: Path) -> None:
    note = tmp_path / "note"
    assert made(LocalCalls(2), fatal_once(note)) == doubled()
    assert note.exists()


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first process that is killed raises suspicion: ending and starting them takes its time."""
    monkeypatch.setattr(parallel, "PATIENCE", 1)


@pytest.mark.usefixtures("impatient")
def test_calls_that_kill_their_process_every_time_are_found_out_and_the_others_go_on() -> None:
    assert made(LocalCalls(2), fatal_for(1, 4)) == doubled(but=(1, 4))


@pytest.mark.usefixtures("impatient")
def test_a_loss_ends_work_that_takes_none() -> None:
    with pytest.raises(RunError, match="--jobs"):
        list(LocalCalls(2).each(fatal_for(0), range(2)))


@pytest.mark.parametrize("jobs", [1, 2])
def test_what_a_call_raises_comes_through(jobs: int) -> None:
    def refuse(item: int) -> int:
        raise ArithmeticError("no such luck")

    with pytest.raises(ArithmeticError, match="no such luck"):
        made(LocalCalls(jobs), refuse)


@pytest.mark.parametrize("jobs", [1, 2])
def test_no_call_is_made_in_this_process_and_no_more_than_asked_for_at_once(jobs: int, tmp_path: Path) -> None:
    def call(item: int) -> tuple[int, int]:
        mine = tmp_path / str(item)
        mine.touch()
        time.sleep(0.05)
        at_once = len(list(tmp_path.iterdir()))
        mine.unlink()
        return os.getpid(), at_once

    found = [result for _, result in LocalCalls(jobs).each(call, range(8))]
    assert os.getpid() not in {process for process, _ in found}
    assert max(at_once for _, at_once in found) <= jobs


def test_results_come_before_all_calls_are_made(tmp_path: Path) -> None:
    def call(item: int) -> None:
        (tmp_path / str(item)).touch()

    next(LocalCalls(1).each(call, range(500)))
    assert len(list(tmp_path.iterdir())) < 500


def test_work_that_is_left_ends_without_a_word() -> None:
    def call(item: int) -> None:
        time.sleep(0.1)

    results = LocalCalls(2).each(call, range(20))
    next(results)
    results.close()
