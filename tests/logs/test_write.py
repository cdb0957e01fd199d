import os
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from psmpc_cli.errors import InputError, LogError, RunError
from psmpc_cli.logs.conditions import LEVELS
from psmpc_cli.logs.run import Run, read_run
from psmpc_cli.logs.schema import columns
from psmpc_cli.logs.write import BETWEEN_WRITES, ROWS_IN_A_CHUNK, Header, LogWriter

from ..limited_disk import files_of_at_most
from .synthetic_samples import COORDINATES, HEADER, LEAN, POSES, SAMPLE, STAGES, TICKS, Row, record

END = {"end_time": SAMPLE * 4, "Q": np.arange(3.0), "Qdot": np.arange(3.0) + 3, "xi": np.arange(3.0)}
FINAL = {f"final/{name}": value for name, value in END.items()}
STAGE_TIMES = {"switch_time": np.arange(4.0), "actual_start": np.arange(4.0) / 2, "early": np.array([0, 1, 0, 1])}
STAGE_TIMES["actual_start_by_epsilon"] = np.arange(8.0).reshape(4, 2)


def write(path: Path, records: Sequence[Row], header: Header = HEADER) -> Run:
    path.unlink(missing_ok=True)
    with LogWriter(path, header) as log:
        for one in records:
            log.write(one)
        log.finish(True, "d met its end condition", FINAL)
    return read_run(path)


def assert_same_rows(log: Run, records: Sequence[Row]) -> None:
    for column in columns("time"):
        if column.path not in log or column.ragged:
            continue
        path, values = column.path, log[column.path]
        assert len(values) == len(records)
        np.testing.assert_array_equal(values, np.array([one[path] for one in records]).reshape(values.shape))


windows = st.integers(0, 3).flatmap(lambda first: st.tuples(st.just(first), st.integers(1, 4 - first)))
records = st.lists(st.tuples(windows, st.integers(0, 20), st.integers(0, 30)), max_size=6).map(
    lambda rows: [record(k, first, count, *lengths) for k, ((first, count), *lengths) in enumerate(rows)]
)


@given(records)
@settings(max_examples=6, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_what_is_written_is_read_back(tmp_path: Path, made: list[Row]) -> None:
    log = write(tmp_path / "log.h5", made)
    assert_same_rows(log, made)
    for k, one in enumerate(made):
        for name in ("guess", "guess_multipliers", "parameters", "solution"):
            np.testing.assert_array_equal(log.plan(name, k), one[f"plan/{name}"])
    assert len(log.ticks["time"]) == TICKS * len(made)
    for name in ("time", "Q", "Qdot", "F"):
        written = [x for one in made for x in np.ravel(one[f"ticks/{name}"])]
        np.testing.assert_array_equal(log[f"ticks/{name}"].ravel(), written)


def test_header_and_ending_are_read_back(tmp_path: Path) -> None:
    log = write(tmp_path / "log.h5", [record(0)])
    assert (log.coordinates, tuple(log["pose_coordinate"]), log.stage_names) == (COORDINATES, POSES, STAGES)
    assert log.stages["priority"].tolist() == [1.0, 100.0, 1.0, 0.01]
    assert log.stages["epsilon"].tolist() == [1e-3, 1e-1]
    assert log.has_plans
    assert (log.attributes["finished"], log.attributes["end_reason"]) == (True, "d met its end condition")
    assert log.attributes["task_yaml"] == "not: a task"
    assert log.final["time"] == 0.4
    assert [log.final[name].tolist() for name in ("Q", "v", "xi")] == [[0, 1, 2], [3, 4, 5], [0, 1, 2]]


def test_stage_times_are_read_back(tmp_path: Path) -> None:
    with LogWriter(tmp_path / "log.h5", LEAN) as log:
        log.update({f"stages/{name}": values for name, values in STAGE_TIMES.items()})
    stages = read_run(tmp_path / "log.h5").stages
    for name, values in STAGE_TIMES.items():
        np.testing.assert_array_equal(stages[name], values)


def test_monitors_are_unknown_until_they_are_judged(tmp_path: Path) -> None:
    monitors = write(tmp_path / "log.h5", []).monitors
    assert len(monitors["name"]) == 2
    assert monitors["held"].tolist() == [-1, -1]
    assert np.isnan(monitors["margin"]).all()


def test_a_long_task_text_fits(tmp_path: Path) -> None:
    path, text = tmp_path / "log.h5", "stages: []\n" * 100_000
    LogWriter(path, replace(LEAN, attributes={**LEAN.attributes, "task_yaml": text})).close()
    assert read_run(path).attributes["task_yaml"] == text


@pytest.mark.parametrize("samples", [0, 3])
def test_every_dataset_describes_itself(tmp_path: Path, samples: int) -> None:
    path, seen = tmp_path / "log.h5", []
    write(path, [record(k, count=2, multipliers=4) for k in range(samples)], replace(HEADER, has=HEADER.has | {LEVELS}))

    def check(name: str, item: h5py.Group | h5py.Dataset) -> None:
        if not isinstance(item, h5py.Dataset):
            return
        seen.append(name)
        for key in ("units", "long_name"):
            assert isinstance(item.attrs[key], str), name
            assert item.attrs[key], name
        for dimension, length in zip(item.dims, item.shape, strict=True):
            if not item.is_scale:
                assert len(dimension) == 1, name
                assert len(dimension[0]) == length, name

    with h5py.File(path) as file:
        file.visititems(check)
    assert {column.path for column in columns("time") if column.only in HEADER.has} < set(seen)
    assert {"time", "stages/epsilon", "final/Q", "monitors/held", "plan/solution", "ticks/F", "levels/cost"} < set(seen)


@pytest.mark.slow
@pytest.mark.parametrize("samples", [0, 3])
def test_xarray_opens_a_log_as_a_tree(tmp_path: Path, samples: int) -> None:
    xarray = pytest.importorskip("xarray")
    pytest.importorskip("h5netcdf")
    path = tmp_path / "log.h5"
    log = write(path, [record(k, count=2) for k in range(samples)], replace(HEADER, has=HEADER.has | {LEVELS}))
    with xarray.open_datatree(path, engine="h5netcdf") as tree:
        tree.load()
        assert tree["state/Q"].dims == ("time", "coordinate")
        assert tree["state/Q"].sel(coordinate="arm_1.1").values.tolist() == log["state/Q"][:, 2].tolist()
        assert tree["window/instants"].sel(stage="b").dims == ("time",)
        assert tree["ticks/F"].sizes == {"tick": TICKS * samples, "coordinate": len(COORDINATES)}
        assert tree["stages/actual_start_by_epsilon"].sel(stage="a", epsilon=0.1).shape == ()
        assert tree["monitors/held"].sel(name="object held") == -1
        assert tree["final/end_time"] == SAMPLE * 4
        assert tree["plan/solution"].dims == ("time", "solution_element")


def test_the_first_row_is_in_the_file_at_once_and_others_half_a_second_later(tmp_path: Path) -> None:
    path, made = tmp_path / "log.h5", [record(k, count=1 + k % 3, length=5 + k) for k in range(5)]
    with LogWriter(path, HEADER) as log:
        log.update({"stages/switch_time": np.arange(4.0)})
        for one in made[:3]:
            log.write(one)
        assert_same_rows(read_run(path), made[:1])
        time.sleep(BETWEEN_WRITES)
        log.write(made[3])
        written = read_run(path)
        assert_same_rows(written, made[:4])
        assert written.attributes["finished"] is np.False_
        assert written.stages["switch_time"].tolist() == [0, 1, 2, 3]
        np.testing.assert_array_equal(written.plan("solution", 3), made[3]["plan/solution"])
        log.write(made[4])
    assert_same_rows(read_run(path), made)


def test_a_log_that_was_removed_is_written_again(tmp_path: Path) -> None:
    path, made = tmp_path / "log.h5", [record(0), record(1)]
    with LogWriter(path, LEAN) as log:
        log.write(made[0])
        path.unlink()
        log.write(made[1])
    assert_same_rows(read_run(path), made)


def test_rows_beyond_a_chunk_are_kept(tmp_path: Path) -> None:
    path, count = tmp_path / "log.h5", ROWS_IN_A_CHUNK + 2
    with LogWriter(path, LEAN) as log:
        for k in range(count):
            log.write(record(k))
    assert_same_rows(read_run(path), [record(k) for k in range(count)])


def test_force_replaces_what_a_link_points_to(tmp_path: Path) -> None:
    path, link = tmp_path / "log.h5", tmp_path / "latest.h5"
    write(path, [record(0)])
    link.symlink_to(path)
    with LogWriter(link, LEAN, force=True):
        pass
    assert link.is_symlink()
    assert not len(read_run(path).time)


def test_no_link_that_stands_beside_a_log_is_followed(tmp_path: Path) -> None:
    path, other = tmp_path / "log.h5", tmp_path / "other"
    other.write_text("mine")
    (tmp_path / f".{path.name}.{os.getpid()}.part").symlink_to(other)  # a name that could be guessed
    write(path, [record(0)])
    assert other.read_text() == "mine"
    assert path.stat().st_mode == other.stat().st_mode


def test_no_room_for_a_log_leaves_none(tmp_path: Path) -> None:
    path = tmp_path / "log.h5"
    with files_of_at_most(10_000), pytest.raises(InputError) as refused:
        LogWriter(path, HEADER)
    assert str(refused.value) == f"{path} cannot be written: File too large"
    assert not path.exists()


def test_no_room_for_a_record_ends_the_run_and_keeps_the_log(tmp_path: Path) -> None:
    path, made = tmp_path / "log.h5", [record(k, length=30) for k in range(100)]
    room = write(tmp_path / "short.h5", made[:1]).path.stat().st_size
    with files_of_at_most(room), pytest.raises(RunError) as refused, LogWriter(path, HEADER) as log:
        time.sleep(BETWEEN_WRITES)
        for one in made:
            log.write(one)
    assert str(refused.value) == (
        f"{path} cannot be written any further, it holds the run as last written: File too large"
    )
    assert refused.value.exit_code == 3
    assert_same_rows(read_run(path), made[:1])
    assert sorted(each.name for each in tmp_path.iterdir()) == ["log.h5", "short.h5"]


def test_a_flipped_bit_in_a_number_is_noticed(tmp_path: Path) -> None:
    path, made = tmp_path / "log.h5", [record(k) for k in range(4)]
    log, content = write(path, made), path.read_bytes()
    for name in ("time", "state/Q", "ticks/F", "stages/priority", "final/Q"):
        damaged = bytearray(content)
        damaged[content.index(log[name].tobytes())] ^= 1
        path.write_bytes(damaged)
        with pytest.raises(LogError, match="damaged"):
            read_run(path)
