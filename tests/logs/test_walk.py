"""What no log or study holds is rejected before anything of it is read."""

import os
import subprocess
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from h5py import h5d, h5p, h5s, h5t, h5z

from psmpc_cli.errors import LogError
from psmpc_cli.logs.comparison import save_comparison
from psmpc_cli.logs.results import Quantity, new_results, read_results
from psmpc_cli.logs.run import read_comparison, read_run
from psmpc_cli.logs.schema import SWEEP
from psmpc_cli.logs.write import LogWriter

from ..cli.command import PROGRAM
from .synthetic_samples import HEADER, record

Change = Callable[[h5py.File], object]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A log of three samples."""
    path = tmp_path / "log.h5"
    with LogWriter(path, HEADER) as log:
        for k in range(3):
            log.write(record(k))
    return path


def replaced(name: str, **how: object) -> Change:
    """Create a dataset in place of another."""

    def change(file: h5py.File) -> None:
        del file[name]
        file.create_dataset(name, **how)

    return change


def linked(name: str, target: object) -> Change:
    """Put a link or an object in place of a dataset."""

    def change(file: h5py.File) -> None:
        del file[name]
        file[name] = target(file) if callable(target) else target

    return change


def attributed(name: str, value: object, dtype: object = None) -> Change:
    """Set an attribute of the log."""
    return lambda file: file.attrs.create(name, value(file) if callable(value) else value, dtype=dtype)


def virtual(file: h5py.File) -> None:
    values = h5py.VirtualLayout((3, 3), "f8")
    values[...] = h5py.VirtualSource("other.h5", "x", (3, 3))
    del file["control/u"]
    file.create_virtual_dataset("control/u", values)


def filtered(file: h5py.File) -> None:
    storage = h5p.create(h5p.DATASET_CREATE)
    storage.set_chunk((3,))
    storage.set_filter(32_100, h5z.FLAG_OPTIONAL, (1,))
    del file["time"]
    h5d.create(file.id, b"time", h5t.IEEE_F64LE, h5s.create_simple((3,)), storage)


LARGE = {"chunks": (1000,), "dtype": "f8"}

REJECTED: dict[str, tuple[Change, str]] = {
    "soft link": (linked("time", h5py.SoftLink("/stages/priority")), "/time: found a soft link"),
    "external link": (linked("state/Q", h5py.ExternalLink("other.h5", "/x")), "/state/Q: found an external link"),
    "cycle": (linked("state/Q", lambda file: file["state"]), "/state/Q/.*: found a group"),
    "type": (linked("time", np.dtype("f8")), "/time: found a type"),
    "external storage": (
        replaced("time", shape=(3,), dtype="f8", external=[("other.bin", 0, h5s.UNLIMITED)]),
        "/time: found external storage, expected values in the file itself",
    ),
    "virtual": (virtual, "/control/u: found a virtual dataset"),
    "filter": (filtered, "/time: found filter 32100"),
    "sparse": (replaced("time", shape=(10**9,), **LARGE), "/time: found 8000.* bytes up to here, expected at most"),
    "beyond 2^63": (replaced("time", shape=(2**62,), **LARGE), "/time: found .* bytes up to here"),
    "texts": (replaced("stage", shape=(10**7,), dtype=h5py.string_dtype(), chunks=(1000,)), "/stage: found .* bytes"),
    "chunks": (replaced("time", shape=(3,), maxshape=(None,), dtype="f8", chunks=(10**8,)), "/time: found .* bytes"),
    "no values": (linked("final/end_time", h5py.Empty("f8")), "/final/end_time: found no values"),
    "references": (replaced("time", data=[], dtype=h5py.ref_dtype), "/time: found values of type object"),
    "compound": (replaced("time", data=np.zeros(3, "f8,i4")), "/time: found values of type"),
    "unknown": (lambda file: file.create_dataset("state/extra", data=1.0), "/state/extra: found .*docs/log.md"),
    "shape": (replaced("state/Q", data=np.zeros((3, 4))), r"/state/Q: .*\(3, 4\).* expected .* shape \(3, 3\)"),
    "dimensions": (replaced("time", data=np.zeros((3, 1))), r"/time: .*shape \(3, 1\)"),
    "kind of number": (replaced("events/appended", data=np.zeros(3)), "/events/appended: .* expected .* type i1"),
    "number for text": (replaced("stages/name", data=np.zeros(4)), "/stages/name: .* expected .* type text"),
    "part of the plans": (lambda file: file.__delitem__("plan/guess"), "guess"),
    "time that stands": (lambda file: file["time"].__setitem__(2, 0.1), "/time: found times that do not rise"),
    "time that is none": (lambda file: file["time"].__setitem__(2, np.nan), "/time: found times that do not rise"),
    "stage beyond": (lambda file: file["window/first"].__setitem__(0, 4), "/window/first: found an index"),
    "length beyond": (lambda file: file["plan/guess_length"].__setitem__(0, 8), "/plan/guess_length: found an index"),
    "attribute's kind": (attributed("finished", "yes"), "attribute finished: found 'yes', expected a bool"),
    "bytes for text": (attributed("end_reason", b"\xff"), "can't encode"),
    "attribute's shape": (attributed("finished", [True, False]), "attribute finished: found values of type bool"),
    "attribute of two": (attributed("more", np.zeros((), "f8,i4")), "attribute more: found values of type"),
    "attribute's reference": (attributed("more", lambda file: file.ref, h5py.ref_dtype), "attribute more: found"),
    "attribute without value": (attributed("stuck", h5py.Empty("f8")), "attribute stuck: found no value"),
    "attributes": (lambda file: file.attrs.update({f"{k}": k for k in range(15_001)}), "/: found 150.. attributes"),
}
"""Changes of a log, and what the message says."""


@pytest.mark.parametrize("case", REJECTED)
def test_what_no_log_holds_is_rejected_with_its_place(path: Path, case: str) -> None:
    change, words = REJECTED[case]
    with h5py.File(path, "r+") as file:
        change(file)
    with pytest.raises(LogError, match=words) as rejected:
        read_run(path)
    assert str(rejected.value).startswith(f"{path}: ")
    assert "\n" not in str(rejected.value)


@pytest.mark.parametrize("name", ["..", "."])
def test_runs_of_a_comparison_are_not_named_as_folders_elsewhere(path: Path, name: str) -> None:
    save_comparison({"one": read_run(path)}, path, force=True)
    with h5py.File(path, "r+") as file:
        file.attrs["runs"] = [name]
        if name == "..":
            file["runs"].move("one", name)
    with pytest.raises(LogError, match="attribute runs"):
        read_comparison(path)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (linked("start", h5py.ExternalLink("other.h5", "/x")), "/start: found an external link"),
        (replaced("row", shape=(10**9,), **LARGE), "/row: found .* bytes"),
        (lambda file: file.create_group("more"), "/more: found"),
        (replaced("row", data=np.zeros(0)), "/row|/start"),
    ],
)
def test_what_no_study_holds_is_rejected(tmp_path: Path, change: Change, words: str) -> None:
    start = Quantity("start", ("row",), np.zeros(2), "s", "actual start")
    row = Quantity("row", ("row",), np.array([10.0, 20.0]), "1", "number of the row")
    new_results(tmp_path / "study.h5", SWEEP, {}, [start, row]).create()
    with h5py.File(tmp_path / "study.h5", "r+") as file:
        change(file)
    with pytest.raises(LogError, match=words):
        read_results(tmp_path / "study.h5", SWEEP)


def test_texts_that_all_take_the_room_of_a_long_one_are_rejected(tmp_path: Path) -> None:
    names = np.array(["a" * 50_000] + ["b"] * 9_999, object)
    reason = Quantity("reason", ("row",), names, "1", "why")
    row = Quantity("row", ("row",), np.arange(10_000), "1", "number of the row")
    new_results(tmp_path / "study.h5", SWEEP, {}, [row, reason]).create()
    with pytest.raises(LogError, match="/reason: found texts that take"):
        read_results(tmp_path / "study.h5", SWEEP)


def test_a_pipe_behind_a_dataset_is_not_opened(path: Path) -> None:
    os.mkfifo(path.with_name("pipe"))
    with h5py.File(path, "r+") as file:
        outside = [(str(path.with_name("pipe")), 0, h5s.UNLIMITED)]
        replaced("final/end_time", shape=(1,), dtype="f8", external=outside)(file)
    ran = subprocess.run([*PROGRAM, "show", str(path)], capture_output=True, text=True, timeout=60)  # else for ever
    assert (ran.returncode, ran.stdout) == (2, "")
    assert "/final/end_time: found external storage" in ran.stderr
