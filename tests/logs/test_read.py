import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from psmpc_cli.errors import LogError
from psmpc_cli.logs.read import read_log, read_plan
from psmpc_cli.logs.schema import FORMAT_VERSION
from psmpc_cli.logs.write import ROWS_IN_A_CHUNK, LogWriter

from .records import HEADER, LEAN, SAMPLE, record

SAMPLES = 3


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "log.h5"
    with LogWriter(path, HEADER) as log:
        for k in range(SAMPLES):
            log.write(record(k))
    return path


@pytest.fixture(scope="module")
def content(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("whole") / "log.h5"
    with LogWriter(path, HEADER) as log:
        log.write(record(0))
    return path.read_bytes()


def refusal(path: Path) -> str:
    with pytest.raises(LogError) as refused:
        read_log(path)
    assert refused.value.exit_code == 2
    assert "\n" not in str(refused.value)
    return str(refused.value)


def make_nothing(path: Path) -> None:
    """Leave it missing."""


def make_foreign(path: Path) -> None:
    h5py.File(path, "w").close()


REFUSED: list[tuple[str, Callable[[Path], object]]] = [
    ("found no such file", make_nothing),
    ("found a directory", Path.mkdir),
    ("found an empty file", Path.touch),
    ("found no HDF5 file", lambda path: path.write_text("robot: planar_dual_arm\n")),
    ("found an HDF5 file of another program", make_foreign),
    ("found no regular file", lambda path: path.symlink_to("/dev/null")),
]


@pytest.mark.parametrize(("found", "make"), REFUSED, ids=[found for found, _ in REFUSED])
def test_what_is_no_log_is_named(tmp_path: Path, found: str, make: Callable[[Path], object]) -> None:
    make(tmp_path / "log.h5")
    expected = f"{tmp_path / 'log.h5'}: {found}, expected a log written by psmpc simulate"
    assert refusal(tmp_path / "log.h5") == expected
    with pytest.raises(LogError) as refused:
        read_plan(tmp_path / "log.h5", "solution", 0)
    assert str(refused.value) == expected


def test_file_below_a_file_is_no_log(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    assert refusal(tmp_path / "file" / "log.h5").endswith(
        "found no such file, expected a log written by psmpc simulate"
    )


def test_other_version_is_named(path: Path) -> None:
    with h5py.File(path, "r+") as file:
        file.attrs["format_version"], file.attrs["psmpc_version"] = 99, "7.0"
    assert refusal(path) == (
        f"{path}: found log format 99, written by psmpc 7.0; this version reads format {FORMAT_VERSION}: "
        "read it with that version, or run the experiment again"
    )


@pytest.mark.parametrize("name", ["finished", "end_reason", "task_yaml", "robot_yaml", "task_name", "controller"])
def test_missing_attribute_is_named(path: Path, name: str) -> None:
    with h5py.File(path, "r+") as file:
        del file.attrs[name]
    assert refusal(path) == f"{path}: found no attribute {name}, expected a log written by psmpc simulate"


@pytest.mark.parametrize("name", ["time", "state/Q", "stage", "stages/name", "final/end_time", "monitors"])
def test_missing_dataset_is_damage(path: Path, name: str) -> None:
    with h5py.File(path, "r+") as file:
        del file[name]
    assert refusal(path).startswith(f"{path}: found an HDF5 file that is cut off or damaged (")


def test_a_log_from_before_basins_were_logged_is_read(path: Path) -> None:
    with h5py.File(path, "r+") as file:
        del file["window/basin"]
    log = read_log(path)
    assert "window/basin" not in log.columns
    assert len(log["window/first"]) == SAMPLES


@pytest.mark.parametrize("name", ["time", "state/Q", "ticks/F", "stages/name"])
def test_group_in_place_of_a_dataset_is_damage(path: Path, name: str) -> None:
    with h5py.File(path, "r+") as file:
        del file[name]
        file.create_group(name)
    assert refusal(path).startswith(f"{path}: found an HDF5 file that is cut off or damaged (")


@given(st.floats(0, 1, exclude_max=True))
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_log_that_is_cut_off_anywhere_is_refused(tmp_path: Path, content: bytes, part: float) -> None:
    path = tmp_path / "log.h5"
    path.write_bytes(content[: int(part * len(content))])
    message = refusal(path)
    assert any(f": found {what}" in message for what in ("an empty file", "no HDF5 file", "an HDF5 file that is cut"))


def test_a_row_that_a_kill_left_in_some_datasets_only_is_left_out(path: Path) -> None:
    with h5py.File(path, "r+") as file:
        for name in ("time", "state/Q", "solver/status"):
            file[name].resize(SAMPLES + 1, axis=0)
    log = read_log(path)
    assert {len(values) for values in log.columns.values()} == {SAMPLES}
    assert log.time[-1] == SAMPLE * (SAMPLES - 1)


def allocated(path: Path) -> int:
    """Where the space set aside in an HDF5 file ends, by its superblock [bytes]."""
    (end,) = struct.unpack_from("<Q", path.read_bytes(), 40)
    return int(end)


@pytest.mark.parametrize("held", [0, ROWS_IN_A_CHUNK])
@pytest.mark.parametrize("reason", ["", "interrupted"])
def test_a_kill_that_left_a_chunk_half_allocated_costs_that_chunk_only(tmp_path: Path, held: int, reason: str) -> None:
    path, header = tmp_path / "log.h5", replace(LEAN, attributes={**LEAN.attributes, "end_reason": reason})
    with LogWriter(path, header) as log:
        for k in range(held):
            log.write(record(k))
        before = allocated(path)
        log.write(record(held))
    content = bytearray(path.read_bytes())
    struct.pack_into("<Q", content, 40, before)
    path.write_bytes(content)
    if reason:
        assert refusal(path).startswith(f"{path}: found an HDF5 file that is cut off or damaged (")
    else:
        assert {len(values) for values in read_log(path).columns.values()} == {held}


def test_plans_may_not_be_there(tmp_path: Path) -> None:
    path = tmp_path / "log.h5"
    with LogWriter(path, LEAN) as log:
        log.write(record(0))
    with pytest.raises(LogError) as refused:
        read_plan(path, "solution", 0)
    assert str(refused.value) == f"{path}: holds no plans; expected a log of a task with log: {{plans: true}}"


@pytest.mark.parametrize("sample", [-1, SAMPLES])
def test_plan_of_a_sample_that_is_not_there_is_refused(path: Path, sample: int) -> None:
    with pytest.raises(LogError) as refused:
        read_plan(path, "solution", sample)
    assert str(refused.value) == f"{path}: found no sample {sample}; expected one from 0 to {SAMPLES - 1}"


def test_plan_of_an_empty_log_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "log.h5"
    LogWriter(path, HEADER).close()
    with pytest.raises(LogError, match="found no sample 0; it holds none"):
        read_plan(path, "solution", 0)
