"""Compiled libraries: cached, compiled again where they are broken, None where there is no compiler."""

import ctypes
import logging
import os
import stat
import subprocess
import sys
import time
from pathlib import Path

import pytest

from psmpc_cli.native.library import (
    CompilationError,
    Library,
    cache_directory,
    compile_all,
    describe_compiler,
    find_compiler,
    library,
)

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
    with caplog.at_level(logging.INFO, "psmpc_cli"):
        assert library(TWICE, "numbers") == library(TWICE, "numbers")
        library(TWICE.replace("2 *", "3 *"), "numbers")
    assert counter.read_text().split() == ["made"] * 2
    compiling = f"compiling solver and plant code with counting_cc (once, kept in {directory})"
    assert [record.getMessage() for record in caplog.records] == [
        f"{compiling}: {ended} of 1 libraries" for ended in (0, 1, 0, 1)
    ]


def test_several_libraries_are_compiled_with_their_number_and_the_time_left(
    directory: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    command, _ = counting_compiler(tmp_path)
    monkeypatch.setenv("CC", command)
    library(TWICE, "numbers")
    wanted = [Library(TWICE.replace("2 *", f"{k} *"), "numbers") for k in (2, 3, 4)]
    caplog.clear()
    with caplog.at_level(logging.INFO, "psmpc_cli"):
        assert compile_all(wanted)
    assert [record.getMessage().rpartition("): ")[2].partition(", about")[0] for record in caplog.records] == [
        "0 of 2 libraries",
        "1 of 2 libraries",
        "2 of 2 libraries",
    ]


@pytest.mark.parametrize("damage", [b"", b"no library"], ids=["empty", "overwritten"])
def test_a_broken_entry_is_compiled_again(directory: Path, damage: bytes) -> None:
    path = library(TWICE, "numbers")
    assert path is not None
    whole = path.read_bytes()
    path.unlink()  # it is loaded: what is written over it must be another file
    path.write_bytes(damage)
    subprocess.run([sys.executable, "-c", IN_A_PROCESS, TWICE], check=True)
    assert len(path.read_bytes()) == len(whole)


IS_ONE = f"{IN_A_PROCESS}; import os; assert len(os.listdir(os.environ['PSMPC_CACHE'])) == 1"


@pytest.mark.parametrize("share", [0.0, 0.3, 0.9])
def test_a_library_that_was_cut_off_is_compiled_again(directory: Path, share: float) -> None:
    """To load it would end the process with SIGBUS."""
    path = library(TWICE, "numbers")
    assert path is not None
    content = path.read_bytes()
    path.unlink()
    path.write_bytes(content[: int(share * len(content))])
    path.chmod(0o700)
    subprocess.run([sys.executable, "-c", IS_ONE, TWICE], check=True)
    assert path.read_bytes() == content


def test_a_library_without_the_expected_functions_is_compiled_again(directory: Path) -> None:
    """Another library stands under the name, whole, as its own digest says."""
    path, other = library(TWICE, "numbers"), library(TWICE.replace("twice", "thrice"), "numbers")
    assert path is not None
    assert other is not None
    key = path.stem.rpartition("-")[0]
    other.rename(directory / f"{key}-{other.stem.rpartition('-')[2]}{other.suffix}")
    path.unlink()
    found = library(TWICE, "numbers", symbols=["twice"])
    assert twice(found, 3.0) == 6.0
    assert [Path(name) for name in os.listdir(directory)] == [Path(path.name)]


@pytest.mark.parametrize("mode", [0o770, 0o707])
def test_a_cache_that_others_may_write_to_is_not_used(
    directory: Path, mode: int, caplog: pytest.LogCaptureFixture
) -> None:
    directory.mkdir()
    directory.chmod(mode)
    with caplog.at_level(logging.INFO, "psmpc_cli"):
        path = library(TWICE, "numbers")
    assert twice(path, 1.0) == 2.0
    assert not os.listdir(directory)
    assert f"{directory} belongs to or may be written by somebody else" in caplog.text


def test_a_library_that_others_may_write_or_that_is_a_link_is_not_loaded(directory: Path, tmp_path: Path) -> None:
    path = library(TWICE, "numbers")
    assert path is not None
    inode = path.stat().st_ino
    path.chmod(0o777)
    assert library(TWICE, "numbers") == path
    assert path.stat().st_ino != inode
    path.rename(tmp_path / "elsewhere")
    path.symlink_to(tmp_path / "elsewhere")
    assert library(TWICE, "numbers") == path
    assert not path.is_symlink()


def test_a_source_without_the_expected_functions_gives_no_library(
    directory: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.INFO, "psmpc_cli"):
        assert library(TWICE, "numbers", symbols=["twice", "thrice"]) is None
    assert "no library with twice, thrice" in caplog.text


def test_the_compiler_of_a_package_is_used_where_there_is_no_other(
    directory: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """A package of the name of `ziglang`, which stands for it, since that has 100 MB."""
    package, (program, *_) = tmp_path / "packages" / "ziglang", find_compiler()
    package.mkdir(parents=True)
    (package / "__init__.py").touch()
    call = f"os.environ['PATH'] = {os.environ['PATH']!r}; os.execv({program!r}, [{program!r}, *sys.argv[2:]])"
    (package / "__main__.py").write_text(f"import os, sys; assert sys.argv[1] == 'cc'; {call}")
    monkeypatch.syspath_prepend(package.parent)
    monkeypatch.setenv("PYTHONPATH", str(package.parent))
    monkeypatch.delenv("CC", raising=False)
    assert find_compiler()[0] == program
    monkeypatch.setenv("PATH", str(tmp_path))
    with caplog.at_level(logging.INFO, "psmpc_cli"):
        assert twice(library(TWICE, "numbers", symbols=["twice"]), 2.0) == 4.0
    assert "zig cc" in caplog.text
    monkeypatch.setenv("CC", "/no/such/compiler")
    with pytest.raises(CompilationError):
        find_compiler()


def test_libraries_that_nobody_used_for_90_days_go(directory: Path) -> None:
    old, new = library(TWICE, "numbers"), library(TWICE.replace("2", "3"), "numbers")
    assert old is not None
    assert new is not None
    foreign, left = directory / f"not-ours{old.suffix}", directory / ".making-killed"
    foreign.touch()
    left.mkdir()
    (left / "source.c").touch()
    for path, days in ((old, 91), (new, 89), (foreign, 1000), (left, 91)):
        os.utime(path, (time.time() - days * 24 * 3600,) * 2)
    library(TWICE.replace("2", "4"), "numbers")
    assert (old.exists(), new.exists(), foreign.exists(), left.exists()) == (False, True, True, False)
    assert library(TWICE.replace("2", "3"), "numbers") == new
    assert time.time() - new.stat().st_mtime < 3600


def test_several_processes_at_once_get_the_same_library(directory: Path) -> None:
    started = [
        subprocess.Popen([sys.executable, "-c", IN_A_PROCESS, TWICE], stdout=subprocess.PIPE, text=True)
        for _ in range(4)
    ]
    found = {process.communicate()[0].strip() for process in started}
    assert found == {str(library(TWICE, "numbers"))}
    assert os.listdir(directory) == [Path(*found).name]


@pytest.mark.parametrize("command", ['"', "cc '", '""'])
def test_a_compiler_that_is_no_command_is_named(command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", command)
    with pytest.raises(CompilationError, match="no C compiler: CC is "):
        find_compiler()


def test_a_compiler_may_print_anything(
    directory: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    program = tmp_path / "compiler"
    program.write_bytes(b"#!/bin/sh\nprintf '\\377\\033[31m 1.2\\n'\nprintf 'error: \\377\\n' >&2\nexit ${FAILS:-0}\n")
    program.chmod(0o755)
    monkeypatch.setenv("CC", str(program))
    assert describe_compiler() == "\ufffd\\x1b[31m 1.2"
    monkeypatch.setenv("FAILS", "1")
    with caplog.at_level(logging.INFO, "psmpc_cli"):
        assert library(TWICE, "numbers") is None
    assert "compiler failed: error: \ufffd" in caplog.text


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
    with caplog.at_level(logging.INFO, "psmpc_cli"):
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


def test_of_several_processes_one_compiles(directory: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The others wait for it."""
    command, counter = counting_compiler(tmp_path)
    monkeypatch.setenv("CC", command)
    cache_directory()
    processes = [subprocess.Popen([sys.executable, "-c", IN_A_PROCESS, TWICE]) for _ in range(3)]
    assert [process.wait() for process in processes] == [0, 0, 0]
    assert counter.read_text().split() == ["made"]
    assert len(os.listdir(directory)) == 1
