"""Commands that a signal ends, in processes of their own: the exit code, the message, and what they leave."""

import os
import re
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from pathlib import Path

import numpy as np
import pytest

from psmpc_cli.logs.files import kind_of
from psmpc_cli.logs.results import Results, read_results
from psmpc_cli.logs.run import read_run
from psmpc_cli.studies.runner import SHARED, WAITING

from .command import PROGRAM, Psmpc

pytestmark = pytest.mark.slow

Start = Callable[..., subprocess.Popen[str]]

SIGNALS = [(signal.SIGINT, 130, "interrupted"), (signal.SIGTERM, 143, "terminated")]


@pytest.fixture
def start(psmpc: Psmpc, tmp_path: Path) -> Iterator[Start]:
    """Start a command in a process group of its own, in the folder of the test; it is gone at the end."""
    with ExitStack() as processes:

        def run(*arguments: str) -> subprocess.Popen[str]:
            command = [*PROGRAM, *arguments]
            kept = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
            process = subprocess.Popen(command, cwd=tmp_path, start_new_session=True, text=True, **kept)
            processes.enter_context(process)
            processes.callback(process.kill)
            return process

        yield run


def finish(process: subprocess.Popen[str]) -> tuple[int, str, str]:
    """Wait for a command; return its exit code and what it wrote from now on."""
    out, err = process.communicate(timeout=120)
    assert "Traceback" not in err
    return process.returncode, out, err


def wait_for(process: subprocess.Popen[str], beginning: str) -> None:
    """Read the progress of a command up to a line."""
    assert process.stderr is not None
    assert any(line.startswith(beginning) for line in process.stderr)


@pytest.mark.parametrize(("number", "code", "reason"), SIGNALS)
def test_an_interrupted_run_leaves_log_summary_and_figures(
    start: Start, number: signal.Signals, code: int, reason: str
) -> None:
    process = start("simulate", "transport", "-o", "log.h5", "--set", "controller.nodes=5")
    wait_for(process, "  0.0 s  approach")
    process.send_signal(number)
    found, out, _ = finish(process)
    log = read_run(Path("log.h5"))
    assert (found, bool(log.attributes["finished"]), log.attributes["end_reason"]) == (code, False, reason)
    assert out.startswith(f"Mission not finished: {reason}, after {log.time[-1]:.1f} s\n")
    assert Path("log/states.png").exists()


def processes_of(session: int) -> set[int]:
    """The processes of a session, zombies left out."""
    found = set()
    for status in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            number, _, rest = status.read_text().partition(" ")
            state, _, _, of, *_ = rest.rpartition(")")[2].split()
            if int(of) == session and state != "Z":
                found.add(int(number))
    return found


def renders(number: int) -> bool:
    """Return whether a process is one that loky started for calls."""
    with suppress(OSError):
        return b"LokyProcess" in Path(f"/proc/{number}/cmdline").read_bytes()
    return False


MEASURED_TIMES = ("cell_time", "wall_time", "solve_time_median", "solve_time_largest")
"""Quantities of studies that are another in every run."""

STUDIES = {
    "monte-carlo": ("monte-carlo", "task.yaml", "--runs", "4", "--set", "uncertainty.noise.position=1e-3"),
    "sweep": ("sweep-weights", "3x3", "task.yaml"),
}
"""A study of four runs, and one of nine cells in five runs."""


@pytest.fixture
def undisturbed(psmpc: Psmpc, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Results]:
    """The results of a study that nothing ended; each is made once."""

    def results(study: str) -> Results:
        path = tmp_path_factory.getbasetemp() / f"undisturbed-{study}.h5"
        if not path.exists():
            assert psmpc(*STUDIES[study], "--no-figures", "-o", str(path), "--jobs", "1").code == 0
        return read_results(path, kind_of(path))

    return results


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="processes are looked for there")
@pytest.mark.parametrize(
    ("study", "runs", "line"),
    [("monte-carlo", 4, "1 of 4 runs"), ("sweep", 5, "0 of 5 runs"), ("sweep", 5, "2 of 5 runs")],
    ids=["monte-carlo", "sweep that begins", "sweep"],
)
def test_a_killed_study_leaves_no_process_and_keeps_every_run_that_has_ended_to_be_completed(
    start: Start, psmpc: Psmpc, undisturbed: Callable[[str], Results], study: str, runs: int, line: str
) -> None:
    """Processes that are left would hold the standard output for ever."""
    words = (*STUDIES[study], "--no-figures")
    process = start(*words, "-o", "killed.h5", "--jobs", "2")
    wait_for(process, line)
    process.kill()
    killed = time.monotonic()
    _, err = process.communicate(timeout=5)  # until the last of them has closed its end of the pipes
    while processes_of(process.pid) and time.monotonic() < killed + 5:
        time.sleep(0.1)
    assert not processes_of(process.pid)
    ended = max(int(found) for found in re.findall(r"^(\d+) of ", f"{line}\n{err}", re.MULTILINE))
    status = results_of("killed.h5")["status"]
    computed = np.count_nonzero((status != WAITING) & (status != SHARED))
    assert ended <= computed < runs
    resumed = psmpc(*words, "-o", "killed.h5", "--jobs", "1", "--resume")
    assert resumed.code == 0
    assert resumed.stderr.startswith(f"0 of {runs - computed} runs")
    one, other = results_of("killed.h5"), undisturbed(study)
    assert one.quantities.keys() == other.quantities.keys()
    times = {f"{of}{measured}" for of in ("", "reference_") for measured in MEASURED_TIMES}
    for name in one.quantities.keys() - times:
        np.testing.assert_array_equal(one[name], other[name], err_msg=name)


def results_of(name: str) -> Results:
    """The results of a study."""
    return read_results(Path(name), kind_of(Path(name)))


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="processes are looked for there")
def test_no_process_of_a_killed_film_is_left(start: Start, psmpc: Psmpc) -> None:
    assert psmpc("simulate", "task.yaml", "-o", "log.h5", "--no-figures").code == 0
    process = start("plot", "log.h5", "--render", "-o", "out")
    while process.poll() is None and not any(map(renders, processes_of(process.pid))):
        time.sleep(0.01)
    time.sleep(1.0)
    process.kill()
    killed = time.monotonic()
    while processes_of(process.pid) and time.monotonic() < killed + 5:
        time.sleep(0.1)
    assert process.wait() == -signal.SIGKILL
    assert not processes_of(process.pid)


RUN, SWEEP_ALONE = ("simulate",), ("sweep-weights", "2x2", "--jobs", "1")


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="which signals a process catches is read there")
@pytest.mark.parametrize(
    ("command", "delay"),
    [*((RUN, delay) for delay in (0.0, 0.9, 2.0)), (SWEEP_ALONE, 1.4)],
    ids=lambda value: value if isinstance(value, float) else value[0],
)
def test_ctrl_c_at_any_moment_gives_one_message_and_loses_nothing(
    start: Start, tmp_path: Path, command: tuple[str, ...], delay: float
) -> None:
    """While it imports, solves, starts processes, writes, draws, or has just ended."""
    process = start(*command, "task.yaml", "-o", "out.h5")
    status, caught = Path(f"/proc/{process.pid}/status"), 0
    while not caught >> signal.SIGTERM - 1 & 1:
        caught = int(re.search(r"SigCgt:\s*(\w+)", status.read_text())[1], 16)
    time.sleep(delay)
    os.killpg(process.pid, signal.SIGINT)
    code, out, err = finish(process)
    told = out.count("Mission not finished: interrupted") + err.count("psmpc: interrupted")
    assert (code, told) in ((130, 1), (0, 0))
    assert all(path.name in ("task.yaml", "out.h5", "out") for path in tmp_path.iterdir())
    if (tmp_path / "out.h5").exists():
        assert kind_of(tmp_path / "out.h5") in ("run", "sweep")


def test_ctrl_c_ends_a_sweep_that_can_be_resumed(start: Start) -> None:
    process = start(*STUDIES["sweep"], "--jobs", "2", "--no-figures", "-o", "sweep.h5")
    wait_for(process, "1 of 5 runs")
    os.killpg(process.pid, signal.SIGINT)
    code, _, err = finish(process)
    assert code == 130
    assert err.splitlines()[-1] == "psmpc: interrupted; sweep.h5 holds what was done: continue with --resume"
    assert WAITING in results_of("sweep.h5")["status"]


def test_a_signal_ends_a_comparison_that_leaves_nothing(start: Start, tmp_path: Path) -> None:
    process = start("compare", "task.yaml", "--jobs", "2", "-o", "a.h5")
    assert process.stderr is not None and any("1 of 4 runs" in line for line in process.stderr)
    process.send_signal(signal.SIGTERM)
    found, _, err = finish(process)
    assert (found, err.splitlines()[-1]) == (143, "psmpc: terminated; no comparison was written")
    assert [path.name for path in tmp_path.iterdir()] == ["task.yaml"]
