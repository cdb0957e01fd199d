import shutil
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from psmpc_cli.errors import InputError, LogError, RunError
from psmpc_cli.logs.comparison import extract_log, merge_logs, read_comparison
from psmpc_cli.logs.read import kind_of, read_log
from psmpc_cli.logs.schema import COMPARISON, RUN
from psmpc_cli.logs.write import LogWriter

from .records import HEADER, LEAN, record

FINAL = {"final/end_time": 0.3, "final/Q": np.zeros(3)}


@pytest.fixture
def logs(tmp_path: Path) -> dict[str, Path]:
    """A log with everything in it, a lean one, and one with levels; not in the order of the alphabet."""
    paths = {name: tmp_path / f"{name}.h5" for name in ("smpc", "hard", "htmpc")}
    for path, header in zip(paths.values(), (HEADER, LEAN, replace(LEAN, has=frozenset({"levels"}))), strict=True):
        with LogWriter(path, header) as log:
            for k in range(3):
                log.write(record(k))
            log.finish(True, "done", FINAL)
    return paths


@pytest.fixture
def merged(tmp_path: Path, logs: dict[str, Path]) -> Path:
    path = tmp_path / "runs" / "comparison.h5"
    merge_logs(logs, path)
    return path


def test_every_log_comes_back_as_it_was_and_in_order(merged: Path, logs: dict[str, Path]) -> None:
    found = read_comparison(merged)
    assert list(found) == list(logs)
    for name, log in found.items():
        alone = read_log(logs[name])
        assert {**log.attributes} == {**alone.attributes}
        for part in ("columns", "stages", "final", "monitors", "ticks"):
            assert getattr(log, part).keys() == getattr(alone, part).keys()
            for path, values in getattr(alone, part).items():
                np.testing.assert_array_equal(getattr(log, part)[path], values)


def test_every_dataset_keeps_its_dimensions_and_attributes(merged: Path, logs: dict[str, Path]) -> None:
    with h5py.File(merged) as file:
        for name, path in logs.items():
            with h5py.File(path) as alone:
                places: list[str] = []
                alone.visit(places.append)
                for place in places:
                    same_dataset(alone[place], file[f"runs/{name}/{place}"], f"/runs/{name}")


def test_a_run_can_be_taken_out_as_the_log_it_was(merged: Path, logs: dict[str, Path], tmp_path: Path) -> None:
    extract_log(merged, "smpc", tmp_path / "out.h5")
    with h5py.File(tmp_path / "out.h5") as file, h5py.File(logs["smpc"]) as alone:
        assert dict(file.attrs) == dict(alone.attrs)
        places: list[str] = []
        alone.visit(places.append)
        for place in places:
            same_dataset(alone[place], file[place], "")
    assert read_log(tmp_path / "out.h5").plans == read_log(logs["smpc"]).plans
    with pytest.raises(LogError, match="found no run psmpc, expected one of"):
        extract_log(merged, "psmpc", tmp_path / "none.h5")
    with pytest.raises(InputError, match="cannot be written"):
        extract_log(merged, "smpc", tmp_path / "nowhere" / "out.h5")


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


def test_the_kind_tells_files_apart(merged: Path, logs: dict[str, Path], tmp_path: Path) -> None:
    unsaid = Path(shutil.copy(logs["hard"], tmp_path / "unsaid.h5"))
    with h5py.File(unsaid, "r+") as file:
        del file.attrs["kind"]
    assert [kind_of(path) for path in (merged, logs["hard"], unsaid)] == [COMPARISON, RUN, RUN]
    with pytest.raises(LogError, match="found a comparison of several runs, expected the log of one"):
        read_log(merged)
    with pytest.raises(LogError, match="found the log of one run, expected a comparison"):
        read_comparison(unsaid)


def test_a_comparison_that_lost_a_run_is_refused(merged: Path) -> None:
    with h5py.File(merged, "r+") as file:
        del file["runs/hard"]
    with pytest.raises(LogError, match="damaged"):
        read_comparison(merged)


def test_nothing_is_overwritten_without_force(merged: Path, logs: dict[str, Path]) -> None:
    before = merged.read_bytes()
    with pytest.raises(InputError, match="exists already"):
        merge_logs(logs, merged)
    assert merged.read_bytes() == before
    merge_logs({"hard": logs["hard"]}, merged, force=True)
    assert list(read_comparison(merged)) == ["hard"]
    assert [path.name for path in merged.parent.iterdir()] == [merged.name]


def test_nothing_is_left_of_a_comparison_that_could_not_be_written(
    tmp_path: Path, logs: dict[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "comparison.h5"
    logs["hard"].write_bytes(logs["hard"].read_bytes()[:3000])
    with pytest.raises(InputError, match=r"comparison\.h5 cannot be written"):
        merge_logs(logs, path)
    full = shutil.disk_usage(tmp_path)._replace(free=10)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: full)
    with pytest.raises(RunError, match="no space left"):
        merge_logs(logs, path)
    assert not list(tmp_path.glob("comparison*"))
