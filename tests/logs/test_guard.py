"""A file is looked at before this process opens it."""

import os
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from psmpc_cli.errors import LogError
from psmpc_cli.logs.guard import START, Worker, ensure_readable
from psmpc_cli.logs.read import read_log
from psmpc_cli.logs.seal import Seal, seal, seal_of
from psmpc_cli.logs.structure import ROOM, RefusedError
from psmpc_cli.logs.write import LogWriter

from .records import HEADER, record

Change = Callable[[h5py.File], object]

ANSWER = "import sys\nprint('ready', flush=True)\nfor line in sys.stdin:\n    "

CRASHED = "an HDF5 file that is cut off or damaged (HDF5 crashed or hung on it)"


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "log.h5"
    with LogWriter(path, HEADER) as log:
        for k in range(3):
            log.write(record(k))
    return path


def external(file: h5py.File) -> None:
    del file["time"]
    file.create_dataset("time", (3,), "f8", external=[("/etc/hostname", 0, 24)])


def virtual(file: h5py.File) -> None:
    layout = h5py.VirtualLayout((3,), "f8")
    layout[:] = h5py.VirtualSource("other.h5", "x", (3,))
    file.create_virtual_dataset("virtual", layout)


def nested(file: h5py.File) -> None:
    file.create_group("/".join("abcdefghij"))


def circle(file: h5py.File) -> None:
    file["stages/again"] = file["/"]


def huge(file: h5py.File) -> None:
    file.create_dataset("huge", (10**14,), "f8", chunks=(2**10,))


def bomb(file: h5py.File) -> None:
    file.create_dataset("bomb", data=np.zeros(2 * ROOM, "i1"), chunks=(2**20,), compression="gzip")


def attribute(name: str, value: object) -> Change:
    return lambda file: file.attrs.__setitem__(name, value)


def dataset(name: str, **how: object) -> Change:
    return lambda file: file.create_dataset(name, **how)


STRANGE: list[tuple[Change, str]] = [
    (lambda file: file.__setitem__("link", h5py.ExternalLink("other.h5", "/x")), "an external link at /link"),
    (lambda file: file.__setitem__("link", h5py.SoftLink("/time")), "a soft link at /link"),
    (external, "data in another file at /time"),
    (virtual, "a virtual dataset at /virtual"),
    (dataset("x", data=np.zeros(9), compression="lzf"), "data behind filter 32000 at /x"),
    (dataset("x", data=np.zeros(3, [("a", "f8")])), "neither numbers nor texts at /x"),
    (dataset("x", data=h5py.Empty("f8")), "a dataset without a size at /x"),
    (dataset("x", shape=(1,), maxshape=(None,), chunks=(2**24,), dtype="f8"), "a chunk of more than"),
    (dataset("x", shape=(10**6,), dtype=h5py.string_dtype()), "more than 20000 texts at /x"),
    (nested, "levels of groups"),
    (circle, "levels of groups"),
    (huge, "arrays of 8.0e+14 bytes in a file of"),
    (bomb, "arrays of 1.3e+08 bytes in a file of"),
    (lambda file: file.__setitem__("x", np.dtype("f8")), "neither a group nor a dataset at /x"),
    (attribute("x", h5py.Empty("f8")), "an empty attribute x at /"),
    (attribute("x", np.zeros(2, [("a", "f8")])), "an attribute x that is neither number nor text at /"),
]


@pytest.mark.parametrize("sealed", [False, True])
@pytest.mark.parametrize(("change", "found"), STRANGE, ids=[found for _, found in STRANGE])
def test_what_no_log_of_ours_has_is_refused_sealed_or_not(path: Path, change: Change, found: str, sealed: bool) -> None:
    with h5py.File(path, "r+") as file:
        change(file)
    if sealed:
        seal(path)
    before = path.read_bytes()
    with pytest.raises(RefusedError) as refused:
        ensure_readable(path)
    assert found in str(refused.value)
    assert path.read_bytes() == before


def test_a_run_that_ended_is_sealed_and_one_that_was_killed_is_not(path: Path, tmp_path: Path) -> None:
    ended = tmp_path / "ended.h5"
    with LogWriter(ended, HEADER) as log:
        log.write(record(0))
        log.finish(True, "done", 0.1, np.zeros(6), np.zeros(3))
    assert (seal_of(ended), seal_of(path)) == (Seal.OWN, Seal.NONE)
    assert read_log(ended).attributes["finished"]


@pytest.mark.parametrize("place", [0.0, 0.3, 0.7, 0.999])
def test_any_flipped_bit_breaks_the_seal_and_the_log_is_refused(path: Path, place: float) -> None:
    seal(path)
    content = bytearray(path.read_bytes())
    content[int(place * len(content))] ^= 1
    path.write_bytes(content)
    with pytest.raises(LogError, match=r"found (no HDF5 file|.* damaged \(it has changed since it was closed\))"):
        read_log(path)


def test_a_seal_of_somebody_else_is_one_but_not_ones_own(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seal(path)
    monkeypatch.setenv("PSMPC_CACHE", str(tmp_path / "another"))
    assert seal_of(path) is Seal.FOREIGN
    assert len(read_log(path).time) == 3


def test_without_a_key_no_seal_is_ones_own(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "seal.key").mkdir()
    monkeypatch.setenv("PSMPC_CACHE", str(tmp_path))
    seal(path)
    assert seal_of(path) is Seal.FOREIGN


def test_the_key_is_for_the_user_alone(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PSMPC_CACHE", str(tmp_path))
    seal(path)
    assert seal_of(path) is Seal.OWN
    assert (tmp_path / "seal.key").stat().st_mode & 0o077 == 0


def test_an_edit_with_hdf5_takes_the_seal_off(path: Path) -> None:
    seal(path)
    with h5py.File(path, "r+") as file:
        file.attrs["note"] = "of my own"
    assert seal_of(path) is Seal.NONE
    assert read_log(path).attributes["note"] == "of my own"


def test_a_program_that_has_the_file_open_to_write_suspends_the_seal(path: Path) -> None:
    seal(path)
    with h5py.File(path, "r+", locking=False) as file:
        file.flush()
        assert seal_of(path) is Seal.NONE
        assert len(read_log(path).time) == 3


def test_a_seal_is_put_on_once(path: Path) -> None:
    seal(path)
    once = path.read_bytes()
    seal(path)
    assert path.read_bytes() == once


@pytest.mark.parametrize("program", ["raise SystemExit", ANSWER + "import os; os.abort()", ANSWER + "sys.exit()"])
def test_a_process_that_ends_says_that_the_file_is_bad(path: Path, program: str) -> None:
    worker = Worker(program)
    assert worker.ask(str(path)) == CRASHED
    worker.close()


def test_a_process_that_hangs_is_ended(path: Path) -> None:
    worker = Worker(ANSWER + "import time; time.sleep(1000)", patience=0.01)
    assert worker.ask(str(path)) == CRASHED
    worker.close()


def test_a_file_is_asked_about_again_when_those_before_it_did_the_harm(path: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.h5"
    other.touch()
    worker = Worker("x = ''\n" + ANSWER + "x and sys.exit(); x = line; print('null', flush=True)")
    assert worker.ask(str(path)) is None
    assert worker.ask(str(other)) is None
    worker.close()


def test_the_process_is_not_started_again_for_every_file(path: Path) -> None:
    worker = Worker(START)
    assert [worker.ask(str(path)) for _ in range(3)] == [None] * 3
    worker.close()


def test_the_process_cannot_write(path: Path, tmp_path: Path) -> None:
    target = tmp_path / "written"
    write = f"from psmpc_cli.logs import probe; probe._limit(); open({str(target)!r}, 'wb', 0).write(b'x')"
    worker = Worker("import json, sys; sys.path[:] = json.loads(sys.argv[1])\n" + ANSWER + write)
    assert worker.ask(str(path)) == CRASHED
    worker.close()
    assert not target.exists() or not target.stat().st_size


def test_a_path_of_any_bytes_is_asked_about(path: Path) -> None:
    odd = path.with_name(os.fsdecode(b"\xff\n'\".h5"))
    path.rename(odd)
    assert len(read_log(odd).time) == 3
