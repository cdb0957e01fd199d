from pathlib import Path

import h5py
import numpy as np
import pytest

from psmpc_cli.logs.read import read_log

from .on_a_log import COMPARISON, Psmpc, is_refused, part, psmpc

__all__ = ["part", "psmpc"]


def test_an_interrupted_run_is_finished(psmpc: Psmpc, part: Path) -> None:
    ran = psmpc("simulate", "--continue", "part.h5", "--no-figures")
    assert ran.code == 0
    assert ran.stderr.splitlines()[0].split()[:2] == ["0.5", "s"]
    assert ran.stdout.splitlines()[-1] == "log: part.h5"
    log = read_log(part)
    assert log.attributes["finished"] is np.True_
    assert log.stages["switch_time"][-1] == log.final["time"]
    again = psmpc("simulate", "--continue", "part.h5", "--no-figures")
    assert (again.code, again.stdout) == (2, "")
    assert "this run has ended (back met its end condition), so there is nothing to continue" in again.stderr


REFUSED = [
    (("simulate",), "found no task: expected a task file, a built-in name such as transport, or --continue LOG"),
    (("simulate", "task.yaml", "--continue", "part.h5"), "--continue goes on with the task in the log"),
    (("simulate", "--continue", "part.h5", "--plant", "rk4"), "--continue goes on with the task in the log"),
    (("simulate", "--continue", "none.h5"), "none.h5: found no such file"),
]


@pytest.mark.parametrize(("arguments", "message"), REFUSED, ids=[" ".join(arguments) for arguments, _ in REFUSED])
def test_bad_input_is_refused_in_one_message(
    psmpc: Psmpc, part: Path, arguments: tuple[str, ...], message: str
) -> None:
    before = part.read_bytes()
    assert is_refused(psmpc(*arguments), message)
    assert part.read_bytes() == before


def test_a_comparison_is_no_log(psmpc: Psmpc, part: Path) -> None:
    with h5py.File(part, "r+") as file:
        file.attrs["kind"] = "comparison"
    assert is_refused(psmpc("simulate", "--continue", "part.h5"), COMPARISON)
