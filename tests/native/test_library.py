"""Compiled libraries: kept, made anew where they are broken, done without where there is no compiler."""

import ctypes
import logging
import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from psmpc_cli.native import library as libraries
from psmpc_cli.native.cache import cache_directory
from psmpc_cli.native.compiler import find_compiler
from psmpc_cli.native.library import library

TWICE = "double twice(double x) { return 2 * x; }"


@pytest.fixture
def directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache."""
    monkeypatch.setenv("PSMPC_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def counting_compiler(folder: Path) -> tuple[str, Path]:
    """A compiler that leaves a line in a file whenever it makes a library."""
    counter, script = folder / "made.txt", folder / "counting_cc"
    command = " ".join(find_compiler().command)
    script.write_text(f'#!/bin/sh\ncase "$*" in *-shared*) echo made >> {counter};; esac\nexec {command} "$@"\n')
    script.chmod(script.stat().st_mode | stat.S_IXUSR)
    counter.touch()
    return str(script), counter


def twice(path: Path | None, x: float) -> float:
    assert path is not None
    function = ctypes.CDLL(str(path)).twice
    function.restype = ctypes.c_double
    return float(function(ctypes.c_double(x)))


def test_a_library_holds_what_its_source_says(directory: Path) -> None:
    path = library(TWICE, "numbers")
    assert twice(path, 2.25) == 4.5
    assert path is not None
    assert path.parent == directory
    assert path.name.startswith("numbers-")


def test_a_kept_library_is_not_made_again(directory: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    command, counter = counting_compiler(tmp_path)
    monkeypatch.setenv("CC", command)
    assert library(TWICE, "numbers") == library(TWICE, "numbers")
    assert counter.read_text().split() == ["made"]


def test_source_and_flags_tell_libraries_apart(directory: Path) -> None:
    others = library(TWICE.replace("2 *", "3 *"), "numbers"), library(TWICE, "numbers", ("-O1",))
    assert len({library(TWICE, "numbers"), *others}) == 3
    assert twice(others[0], 1.0) == 3.0


@pytest.mark.parametrize("damage", [b"", b"no library"], ids=["empty", "overwritten"])
def test_a_broken_entry_is_made_again(directory: Path, damage: bytes) -> None:
    path = library(TWICE, "numbers")
    assert path is not None
    whole = path.read_bytes()
    path.unlink()  # it is loaded: what is written over it must be another file
    path.write_bytes(damage)
    assert library(TWICE, "numbers") == path
    assert len(path.read_bytes()) == len(whole)


def test_an_entry_without_its_checksum_is_made_again(directory: Path) -> None:
    path = library(TWICE, "numbers")
    assert path is not None
    checksum = path.with_suffix(".sha256")
    checksum.unlink()
    assert twice(library(TWICE, "numbers"), 1.0) == 2.0
    assert checksum.exists()


SEVERAL = "import sys; from psmpc_cli.native.library import library; print(library(sys.argv[1], 'numbers'))"


def test_several_processes_at_once_get_the_same_library(directory: Path) -> None:
    started = [
        subprocess.Popen([sys.executable, "-c", SEVERAL, TWICE], stdout=subprocess.PIPE, text=True) for _ in range(4)
    ]
    found = {process.communicate()[0].strip() for process in started}
    assert found == {str(library(TWICE, "numbers"))}
    (name,) = found
    assert sorted(os.listdir(directory)) == sorted([Path(name).name, Path(name).with_suffix(".sha256").name])


@pytest.mark.parametrize(
    ("compiler", "source", "said"),
    [("/no/such/compiler", TWICE, "no C compiler"), ("", "double twice(", "failed")],
    ids=["no compiler", "it fails"],
)
def test_without_a_library_there_is_none_and_one_line_says_why(
    directory: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    compiler: str,
    source: str,
    said: str,
) -> None:
    monkeypatch.setenv("CC", compiler)
    libraries._say_once.cache_clear()
    with caplog.at_level(logging.INFO, "psmpc_cli.native"):
        assert library(source, "numbers") is None
        assert library(source, "numbers") is None
    assert [record.levelname for record in caplog.records] == ["INFO"]
    assert said in caplog.text


def test_a_cache_that_cannot_be_written_is_replaced_for_this_program(
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
