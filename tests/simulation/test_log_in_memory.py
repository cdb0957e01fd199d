from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from psmpc_cli.logs.read import read_log
from psmpc_cli.simulation.log_in_memory import NOWHERE, run_in_memory
from psmpc_cli.simulation.run import run
from psmpc_cli.simulation.setup import build_experiment
from psmpc_cli.simulation.summary import summarize
from psmpc_cli.specs.load import load_task

from ..there_and_back import TASK

NOISY = "uncertainty.noise={position: 1e-3, velocity: 1e-3}"


@pytest.mark.parametrize(
    "changes", [(), (NOISY,), ("controller.kind=htmpc", "time_limit=0.3"), ("controller.offset_free=true", NOISY)]
)
def test_the_log_of_a_run_is_the_one_it_would_have_written(tmp_path: Path, changes: tuple[str, ...]) -> None:
    (tmp_path / "task.yaml").write_text(TASK)
    loaded = load_task(tmp_path / "task.yaml", ["log.shares=false", *changes])
    run(loaded, tmp_path / "run.h5")
    written, (found, ending) = read_log(tmp_path / "run.h5"), run_in_memory(build_experiment(loaded))
    assert found.path == NOWHERE
    assert ending.time == written.final["time"]
    assert found.columns.keys() == written.columns.keys()
    for path, values in written.columns.items():
        if "wall_time" not in path and values.dtype.kind == "f":
            np.testing.assert_array_equal(found[path], values, path)
    for name, values in written.final.items():
        np.testing.assert_array_equal(found.final[name], values, name)
    same = replace(found, columns={**found.columns, **{p: written[p] for p in written.columns if "wall_time" in p}})
    assert repr(summarize(same)) == repr(summarize(written))
