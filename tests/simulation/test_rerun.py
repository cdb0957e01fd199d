from pathlib import Path

import h5py
import pytest

from psmpc_cli.errors import LogError
from psmpc_cli.logs.read import read_log
from psmpc_cli.logs.write import LogWriter
from psmpc_cli.simulation.rerun import rerun, unequal_conditions
from psmpc_cli.simulation.run import header
from psmpc_cli.simulation.setup import build_experiment
from psmpc_cli.simulation.summary import task_of

from .logged import there_and_back


@pytest.mark.parametrize(("controller", "samples"), [("psmpc", None), ("htmpc", 5)])
def test_a_run_repeated_is_equal_in_every_dataset(tmp_path: Path, controller: str, samples: int | None) -> None:
    log = there_and_back(tmp_path, f"controller.kind={controller}", samples=samples)
    comparison = rerun(log, tmp_path / "again.h5")
    assert comparison is not None
    assert comparison.differences == ()
    assert comparison.compared > 50


def test_what_another_machine_computed_otherwise_is_found(tmp_path: Path) -> None:
    log = there_and_back(tmp_path, samples=4)
    with h5py.File(log.path, "r+") as file:
        file["state/Q"][2, 0] += 1e-9
    comparison = rerun(log, tmp_path / "again.h5")
    assert comparison is not None
    (difference,) = comparison.differences
    assert (difference.path, difference.row, difference.units) == ("state/Q", 2, "m, rad")
    assert difference.largest == pytest.approx(1e-9, rel=1e-6)


def test_an_interruption_leaves_nothing_to_compare(tmp_path: Path) -> None:
    def stop(progress: object) -> None:
        raise KeyboardInterrupt

    assert rerun(there_and_back(tmp_path, samples=3), tmp_path / "again.h5", watch=stop) is None


def test_conditions_under_which_runs_may_differ_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    log = there_and_back(tmp_path, samples=1)
    assert unequal_conditions(log) == ()
    with h5py.File(log.path, "r+") as file:
        file.attrs["casadi_version"] = "1.0"
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    monkeypatch.setattr("os.cpu_count", lambda: 4)
    versions, threads = unequal_conditions(read_log(log.path))
    assert versions.startswith("casadi 1.0 wrote the log, this is ")
    assert threads.startswith("OMP_NUM_THREADS is not 1")


def test_a_log_without_samples_is_refused(tmp_path: Path) -> None:
    about = header(build_experiment(task_of(there_and_back(tmp_path, samples=1))))
    LogWriter(tmp_path / "empty.h5", about).close()
    with pytest.raises(LogError, match="holds no samples"):
        rerun(read_log(tmp_path / "empty.h5"), tmp_path / "again.h5")
