from pathlib import Path

import h5py
import numpy as np
import pytest

from psmpc_cli.errors import InputError, LogError
from psmpc_cli.logs.comparison import Difference, compare_runs, save_comparison
from psmpc_cli.logs.run import read_comparison, read_run
from psmpc_cli.logs.write import Header, LogWriter

from .synthetic_samples import FINAL, HEADER, LEAN, read_all, record


def test_every_log_comes_back_as_it_was_and_in_order(merged: Path, logs: dict[str, Path]) -> None:
    found = read_comparison(merged)
    assert list(found) == list(logs)
    for name, log in found.items():
        alone = read_run(logs[name])
        assert {**log.attributes} == {**alone.attributes}
        assert log.arrays.keys() == alone.arrays.keys()
        for path, values in alone.arrays.items():
            np.testing.assert_array_equal(log[path], values)


def test_every_dataset_keeps_its_dimensions_and_attributes(merged: Path, logs: dict[str, Path]) -> None:
    with h5py.File(merged) as file:
        for name, path in logs.items():
            with h5py.File(path) as alone:
                places: list[str] = []
                alone.visit(places.append)
                for place in places:
                    same_dataset(alone[place], file[f"runs/{name}/{place}"], f"/runs/{name}")


def test_a_run_can_be_saved_as_the_log_it_was(merged: Path, logs: dict[str, Path], tmp_path: Path) -> None:
    read_comparison(merged)["smpc"].save(tmp_path / "out.h5")
    with h5py.File(tmp_path / "out.h5") as file, h5py.File(logs["smpc"]) as alone:
        assert dict(file.attrs) == dict(alone.attrs)
        places: list[str] = []
        alone.visit(places.append)
        for place in places:
            same_dataset(alone[place], file[place], "")
    assert differences(logs["smpc"], tmp_path / "out.h5") == ()


def same_dataset(one: h5py.Dataset | h5py.Group, other: h5py.Dataset | h5py.Group, root: str) -> None:
    if isinstance(one, h5py.Group):
        return
    assert one.is_scale == other.is_scale
    assert (one.chunks, one.compression, one.dtype) == (other.chunks, other.compression, other.dtype)
    assert {name: one.attrs[name] for name in ("units", "long_name")} == {
        name: other.attrs[name] for name in ("units", "long_name")
    }
    scales = [[scale.name for scale in dimension.values()] for dimension in one.dims]
    assert [[scale.name for scale in dimension.values()] for dimension in other.dims] == [
        [root + name for name in names] for names in scales
    ]


def test_a_comparison_that_lost_a_run_is_refused(merged: Path) -> None:
    with h5py.File(merged, "r+") as file:
        del file["runs/hard"]
    with pytest.raises(LogError, match="attribute runs: found the groups"):
        read_comparison(merged)


def test_nothing_is_overwritten_without_force(merged: Path, logs: dict[str, Path]) -> None:
    before = merged.read_bytes()
    with pytest.raises(InputError, match="exists already"):
        save_comparison(read_all(logs), merged)
    assert merged.read_bytes() == before
    save_comparison({"hard": read_run(logs["hard"])}, merged, force=True)
    assert list(read_comparison(merged)) == ["hard"]
    assert [path.name for path in merged.parent.iterdir()] == [merged.name]


def write(path: Path, samples: int, header: Header = HEADER, ended: bool = True) -> Path:
    with LogWriter(path, header) as writer:
        for k in range(samples):
            writer.write(record(k, length=7 + k))
        if ended:
            writer.finish(True, "done", FINAL)
    return path


@pytest.fixture
def pair(tmp_path: Path) -> tuple[Path, Path]:
    return write(tmp_path / "one.h5", 4), write(tmp_path / "other.h5", 4)


def differences(log: Path, again: Path) -> tuple[Difference, ...]:
    return compare_runs(read_run(log), read_run(again)).differences


def test_equal_logs_do_not_differ(pair: tuple[Path, Path]) -> None:
    comparison = compare_runs(*map(read_run, pair))
    assert comparison.differences == ()
    assert comparison.compared > 50


def test_wall_times_are_not_compared(pair: tuple[Path, Path]) -> None:
    with h5py.File(pair[1], "r+") as file:
        file["solver/wall_time"][...] = 9.0
    assert differences(*pair) == ()


def test_the_largest_difference_and_the_first_row_are_told(pair: tuple[Path, Path]) -> None:
    with h5py.File(pair[1], "r+") as file:
        file["state/Q"][1, 2] += 0.25
        file["state/Q"][3, 0] -= 0.5
        file["solver/status"][2] = b"failed"
        file["window/instants"][0, 0] = 7.0
    status, position, switch_times = differences(*pair)
    assert (position.path, position.largest, position.row, position.units) == ("state/Q", 0.5, 1, "m, rad")
    assert (status.path, status.row, status.what) == ("solver/status", 2, "texts")
    assert np.isnan(status.largest)
    assert (switch_times.path, switch_times.row, switch_times.what) == (
        "window/instants",
        0,
        "values only one of them has",
    )


def test_logs_of_other_lengths_and_contents_differ(tmp_path: Path, pair: tuple[Path, Path]) -> None:
    longer = {each.path: each.what for each in differences(pair[0], write(tmp_path / "longer.h5", 5))}
    assert longer["state/Q"] == "shapes 4x3 and 5x3"
    lean = {each.path: each.what for each in differences(pair[0], write(tmp_path / "lean.h5", 4, LEAN))}
    assert lean["plan/solution"] == lean["ticks/F"] == "only the log has it"
    more = {each.path: each.what for each in differences(tmp_path / "lean.h5", pair[0])}
    assert more["plan/solution"] == "only the run has it"


def test_of_a_log_that_was_cut_short_the_rows_it_has_are_compared(tmp_path: Path) -> None:
    one, other = write(tmp_path / "one.h5", 4, ended=False), write(tmp_path / "other.h5", 6)
    with h5py.File(other, "r+") as file:
        file["stages/switch_time"][0] = 8.0
    assert differences(one, other) == ()
    with h5py.File(other, "r+") as file:
        file["ticks/F"][3, 0] = 8.0
    assert [(each.path, each.row) for each in differences(one, other)] == [("ticks/F", 3)]
