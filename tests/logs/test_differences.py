from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from psmpc_cli.logs.differences import compare_logs
from psmpc_cli.logs.write import Header, LogWriter

from .records import HEADER, LEAN, record


def write(path: Path, samples: int, header: Header = HEADER) -> Path:
    with LogWriter(path, header) as writer:
        for k in range(samples):
            writer.write(record(k, length=7 + k))
    return path


@pytest.fixture
def logs(tmp_path: Path) -> tuple[Path, Path]:
    return write(tmp_path / "one.h5", 4), write(tmp_path / "other.h5", 4)


def test_equal_logs_do_not_differ(logs: tuple[Path, Path]) -> None:
    comparison = compare_logs(*logs)
    assert comparison.differences == ()
    assert comparison.compared > 50


def test_wall_times_are_not_compared(logs: tuple[Path, Path]) -> None:
    with h5py.File(logs[1], "r+") as file:
        file["solver/wall_time"][...] = 9.0
    assert compare_logs(*logs).differences == ()


def test_the_largest_difference_and_the_first_row_are_told(logs: tuple[Path, Path]) -> None:
    with h5py.File(logs[1], "r+") as file:
        file["state/Q"][1, 2] += 0.25
        file["state/Q"][3, 0] -= 0.5
        file["solver/status"][2] = b"failed"
        file["window/instants"][0, 0] = 7.0
    status, position, instants = compare_logs(*logs).differences
    assert (position.path, position.largest, position.row, position.units) == ("state/Q", 0.5, 1, "m, rad")
    assert (status.path, status.row, status.what) == ("solver/status", 2, "texts")
    assert np.isnan(status.largest)
    assert (instants.path, instants.row, instants.what) == ("window/instants", 0, "values only one of them has")


def test_logs_of_other_lengths_and_contents_differ(tmp_path: Path, logs: tuple[Path, Path]) -> None:
    longer = compare_logs(logs[0], write(tmp_path / "longer.h5", 5))
    assert {each.path: each.what for each in longer.differences}["state/Q"] == "shapes 4x3 and 5x3"
    lean = {each.path: each.what for each in compare_logs(logs[0], write(tmp_path / "lean.h5", 4, LEAN)).differences}
    assert lean["plan/solution"] == lean["ticks/F"] == "only the log has it"
    more = {each.path: each.what for each in compare_logs(tmp_path / "lean.h5", logs[0]).differences}
    assert more["plan/solution"] == "only the run has it"


def test_of_a_longer_log_the_first_samples_can_be_compared(tmp_path: Path) -> None:
    header = replace(HEADER, has=frozenset({"ticks"}))
    one, other = write(tmp_path / "one.h5", 4, header), write(tmp_path / "other.h5", 6, header)
    assert compare_logs(one, other, 4).differences == ()
    with h5py.File(other, "r+") as file:
        file["stages/priority"][0] = 8.0
    assert [each.path for each in compare_logs(one, other, 4).differences] == ["stages/priority"]
    assert compare_logs(one, other, 4, without=("stages/",)).differences == ()
