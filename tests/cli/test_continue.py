from pathlib import Path

import numpy as np

from psmpc_cli.logs.run import read_run

from .command import Psmpc


def test_an_interrupted_run_is_finished(psmpc: Psmpc, part: Path) -> None:
    ran = psmpc("simulate", "--continue", "part.h5", "--no-figures")
    assert ran.code == 0
    assert ran.stderr.splitlines()[0].split()[:2] == ["0.5", "s"]
    assert ran.stdout.splitlines()[-1] == "log: part.h5"
    log = read_run(part)
    assert log.attributes["finished"] is np.True_
    assert log.stages["switch_time"][-1] == log.final["time"]
    again = psmpc("simulate", "--continue", "part.h5", "--no-figures")
    assert (again.code, again.stdout) == (2, "")
    assert "this run has ended (back met its end condition), so there is nothing to continue" in again.stderr
