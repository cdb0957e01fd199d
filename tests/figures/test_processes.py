"""Calls that several processes share: each is made once, and errors and signals are as in one process."""

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from psmpc_cli.figures.processes import make_calls

SHARED = """
import os, signal, sys, time
from functools import partial
from pathlib import Path
from psmpc_cli.errors import InputError
from psmpc_cli.figures.processes import make_calls

folder = Path(sys.argv[1])
parent = os.getpid()
os.sched_getaffinity = lambda process: {{0, 1}}

def call(number):
    time.sleep(0.05)
    {body}
    with (folder / str(number)).open("a") as file:
        file.write(f"{{os.getpid()}}\\n")

make_calls([partial(call, number) for number in range(8)])
"""
"""A program whose calls note their process; its main process has no other thread, as tests have."""


def run_shared(folder: Path, body: str = "pass") -> tuple[subprocess.CompletedProcess[str], dict[str, list[str]]]:
    """Run the program with this in each of its calls; return how it ended, and the processes that made each call."""
    program = [sys.executable, "-c", SHARED.format(body=body), str(folder)]
    ended = subprocess.run(program, capture_output=True, text=True, timeout=60, check=False)
    return ended, {path.name: path.read_text().split() for path in folder.iterdir()}


linux = pytest.mark.skipif(sys.platform != "linux", reason="only Linux forks")


@linux
def test_two_processes_make_each_call_once(tmp_path: Path) -> None:
    ended, makers = run_shared(tmp_path)
    assert (ended.returncode, ended.stderr) == (0, "")
    assert sorted(makers) == [str(number) for number in range(8)]
    assert all(len(processes) == 1 for processes in makers.values())
    assert len({processes[0] for processes in makers.values()}) == 2


@linux
@pytest.mark.parametrize("culprit", ["==", "!="], ids=["in this process", "elsewhere"])
def test_an_error_of_any_process_is_raised_here_and_ends_all(tmp_path: Path, culprit: str) -> None:
    body = f"""
    if number == 7 or number > 1 and os.getpid() {culprit} parent:
        raise InputError(f"call {{number}} in {{os.getpid() == parent}}")"""
    ended, makers = run_shared(tmp_path, body.strip())
    assert ended.returncode == 1
    assert ended.stderr.count("Traceback") == 1
    assert "InputError: call" in ended.stderr
    assert "7" not in makers


@linux
def test_calls_of_a_process_that_was_killed_are_made_here(tmp_path: Path) -> None:
    ended, makers = run_shared(tmp_path, "os.getpid() == parent or os.kill(os.getpid(), signal.SIGKILL)")
    assert (ended.returncode, ended.stderr) == (0, "")
    assert sorted(makers) == [str(number) for number in range(8)]
    assert len({process for processes in makers.values() for process in processes}) == 1


@linux
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_all_processes_after_their_present_call(tmp_path: Path, number: signal.Signals) -> None:
    body = f"number == 2 and os.kill(parent, {int(number)})"
    program = f"import signal\nsignal.signal({int(number)}, lambda *_: (print('ended'), sys.exit(9)))\n"
    code = SHARED.format(body=body).replace("make_calls([", f"{program}make_calls([")
    ended = subprocess.run([sys.executable, "-c", code, str(tmp_path)], capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stdout, ended.stderr) == (9, "ended\n", "")
    made = {path.name for path in tmp_path.iterdir()}
    assert {"0", "1", "2"} <= made
    assert len(made) < 8


def test_beside_other_threads_all_calls_are_made_in_this_process(tmp_path: Path) -> None:
    found: list[int] = []
    until = threading.Event()
    beside = threading.Thread(target=until.wait)
    beside.start()
    try:
        make_calls([lambda: found.append(os.getpid())] * 3)
    finally:
        until.set()
        beside.join()
    assert found == [os.getpid()] * 3
