"""Compiled libraries: cached, compiled again where they are broken, None where there is no compiler."""

import ctypes
import logging
import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from psmpc_cli.native.library import cache_directory, find_compiler, library

TWICE = "double twice(double x) { return 2 * x; }"

IN_A_PROCESS = "import sys; from psmpc_cli.native.library import library; print(library(sys.argv[1], 'numbers'))"


@pytest.fixture
def directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache."""
    monkeypatch.setenv("PSMPC_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def counting_compiler(folder: Path) -> tuple[str, Path]:
    """A compiler that leaves a line in a file whenever it makes a library."""
    counter, script = folder / "made.txt", folder / "counting_cc"
    command = " ".join(find_compiler())
    script.write_text(f'#!/bin/sh\ncase "$*" in *-shared*) echo made >> {counter};; esac\nexec {command} "$@"\n')
    script.chmod(script.stat().st_mode | stat.S_IXUSR)
    counter.touch()
    return str(script), counter


def twice(path: Path | None, x: float) -> float:
    assert path is not None
    function = ctypes.CDLL(str(path)).twice
    function.restype = ctypes.c_double
    return float(function(ctypes.c_double(x)))


def test_a_library_contains_what_its_source_says(directory: Path) -> None:
    path = library(TWICE, "numbers")
    assert twice(path, 2.25) == 4.5
    assert path is not None
    assert path.parent == directory
    assert path.name.startswith("numbers-")


def test_a_cached_library_is_compiled_once_and_reported_once(
    directory: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    command, counter = counting_compiler(tmp_path)
    monkeypatch.setenv("CC", command)
    with caplog.at_level(logging.INFO, "psmpc_cli.native"):
        assert library(TWICE, "numbers") == library(TWICE, "numbers")
        library(TWICE.replace("2 *", "3 *"), "numbers")
    assert counter.read_text().split() == ["made"] * 2
    assert [record.levelname for record in caplog.records] == ["INFO"]
    assert "compiling" in caplog.text
    assert str(directory) in caplog.text


@pytest.mark.parametrize("damage", [b"", b"no library"], ids=["empty", "overwritten"])
def test_a_broken_entry_is_compiled_again(directory: Path, damage: bytes) -> None:
    path = library(TWICE, "numbers")
    assert path is not None
    whole = path.read_bytes()
    path.unlink()  # it is loaded: what is written over it must be another file
    path.write_bytes(damage)
    subprocess.run([sys.executable, "-c", IN_A_PROCESS, TWICE], check=True)
    assert len(path.read_bytes()) == len(whole)


def test_several_processes_at_once_get_the_same_library(directory: Path) -> None:
    started = [
        subprocess.Popen([sys.executable, "-c", IN_A_PROCESS, TWICE], stdout=subprocess.PIPE, text=True)
        for _ in range(4)
    ]
    found = {process.communicate()[0].strip() for process in started}
    assert found == {str(library(TWICE, "numbers"))}
    assert os.listdir(directory) == [Path(*found).name]


@pytest.mark.parametrize(
    ("compiler", "source", "reason"),
    [("/no/such/compiler", TWICE, "no C compiler"), ("", "double twice(", "failed")],
    ids=["no compiler", "it fails"],
)
def test_without_a_library_the_reason_is_reported(
    directory: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    compiler: str,
    source: str,
    reason: str,
) -> None:
    monkeypatch.setenv("CC", f"{compiler}{directory.parent.name}" if compiler else "")  # reported once a program
    with caplog.at_level(logging.INFO, "psmpc_cli.native"):
        assert library(source, "numbers") is None
        assert library(source, "numbers") is None
    assert caplog.text.count(reason) == 1


def test_a_cache_that_cannot_be_written_is_replaced_by_a_temporary_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("PSMPC_CACHE", str(tmp_path / "file" / "below"))
    assert cache_directory() == cache_directory()
    assert twice(library(TWICE, "numbers"), 1.0) == 2.0


def test_the_cache_is_where_the_system_keeps_caches(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("PSMPC_CACHE", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_directory() == tmp_path / "psmpc"
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert cache_directory() == tmp_path / ".cache" / "psmpc"
