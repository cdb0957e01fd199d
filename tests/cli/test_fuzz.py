"""Whatever stands on the command line, psmpc does it or refuses it in one message, and changes no file."""

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ..bad_input import LINES, RESULTS, judged, prepare, simulated, states, tidy
from ..fuzzing import fuzzing
from ..mutated_files import mutated_bytes, mutated_file
from ..mutated_text import mutated_line, mutated_settings

CHANGES = {"--force", "--continue"}
"""What lets psmpc change a file that is there."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("fuzz")
    prepare(folder)
    return folder


@pytest.fixture
def inside(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.chdir(folder)
    kept = states(folder)
    yield folder
    assert tidy(folder, kept) == []


@fuzzing(120)
@given(st.integers(0, 2**32))
def test_mutated_command_line_is_done_or_refused(inside: Path, seed: int) -> None:
    random = Random(seed)
    arguments = mutated_line(random.choice(LINES), random)
    if not CHANGES & set(arguments):
        kept = states(inside)
        assert judged(arguments).note == ""
        assert tidy(inside, kept) == []


@fuzzing(30)
@given(st.integers(0, 2**32))
def test_numbers_of_any_magnitude_are_refused_or_give_a_readable_log(inside: Path, seed: int) -> None:
    assert simulated(mutated_settings(Random(seed))).note == ""
    (inside / "new.h5").unlink(missing_ok=True)


@fuzzing(120)
@given(
    seed=st.integers(0, 2**32),
    name=st.sampled_from(RESULTS),
)
def test_mutated_file_is_shown_or_refused(inside: Path, seed: int, name: str) -> None:
    random, path = Random(seed), inside / "bad.h5"
    path.write_bytes((inside / name).read_bytes())
    if random.random() < 0.5:
        mutated_file(path, random)
    else:
        path.write_bytes(mutated_bytes(path.read_bytes(), random))
    assert judged(["show", "bad.h5"]).note == ""
    path.unlink()


@pytest.mark.parametrize("command", ["show", "plot", "rerun", "verify", "check"])
@pytest.mark.parametrize(
    "name", ["pipe", "zero", "loop", "nowhere", "folder", "empty.h5", "noise.h5", "", "a\x00b", "x" * 5000]
)
def test_what_is_no_file_is_refused_without_waiting(inside: Path, command: str, name: str) -> None:
    assert judged([command, name]).word == "refused"


def test_bytes_of_no_encoding_reach_the_terminal_as_escapes(inside: Path) -> None:
    command = [sys.executable, "-c", "from psmpc_cli.cli.main import main; main()", "show", b"\xff\xfe.h5"]
    root = str(Path(__file__).resolve().parents[2])
    ran = subprocess.run(command, capture_output=True, env={**os.environ, "PYTHONPATH": root}, check=False)
    assert ran.returncode == 2
    assert b"Traceback" not in ran.stderr
    assert ran.stderr.count(b"\n") == 1
