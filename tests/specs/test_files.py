import os
from pathlib import Path

import pytest

from psmpc_cli.errors import SpecError
from psmpc_cli.specs.library import LARGEST_FILE as LARGEST
from psmpc_cli.specs.library import read_text
from psmpc_cli.specs.load import load_task


def refusal_of(path: Path) -> str:
    with pytest.raises(SpecError) as raised:
        read_text(path)
    return str(raised.value)


def test_text_is_read_with_or_without_byte_order_mark(tmp_path: Path) -> None:
    path = tmp_path / "task.yaml"
    path.write_bytes(b"\xef\xbb\xbfname: \xc2\xb0\n")
    assert read_text(path) == "name: °\n"
    path.write_bytes(b"name: a\r\n")
    assert read_text(path) == "name: a\r\n"


def test_directory_is_refused(tmp_path: Path) -> None:
    assert refusal_of(tmp_path) == f"{tmp_path}: found a directory, expected a YAML file"


def test_named_pipe_is_refused_without_waiting_for_a_writer(tmp_path: Path) -> None:
    path = tmp_path / "pipe.yaml"
    os.mkfifo(path)
    assert refusal_of(path) == f"{path}: found a named pipe, expected a YAML file"


@pytest.mark.parametrize("device", ["/dev/zero", "/dev/null", "/dev/full"])
def test_device_is_refused(device: str) -> None:
    assert refusal_of(Path(device)) == f"{device}: found a device, expected a YAML file"


def test_giant_is_refused_unread(tmp_path: Path) -> None:
    path = tmp_path / "giant.yaml"
    with path.open("wb") as file:
        file.truncate(10**12)
    assert refusal_of(path) == f"{path}: found 1000000000000 bytes, expected a YAML file of at most {LARGEST}"


def test_file_that_grows_beyond_its_announced_size_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "growing.yaml"
    path.write_bytes(b"#" * (LARGEST + 1))
    small = (tmp_path / "small.yaml").write_bytes(b"") or os.stat(tmp_path / "small.yaml")
    monkeypatch.setattr(Path, "stat", lambda self, **options: small)
    assert refusal_of(path) == f"{path}: found more than {LARGEST} bytes, expected a YAML file of at most so many"


def test_missing_and_unreadable_files_are_refused_with_the_reason(tmp_path: Path) -> None:
    missing = tmp_path / "missing.yaml"
    assert refusal_of(missing) == (
        f"{missing}: found no readable file (No such file or directory), expected a YAML file"
    )
    (tmp_path / "file").touch()
    below = tmp_path / "file" / "task.yaml"
    assert refusal_of(below) == f"{below}: found no readable file (Not a directory), expected a YAML file"
    with pytest.raises(SpecError, match=r"found no readable file \(File name too long\), expected a YAML file"):
        load_task(tmp_path / ("long" * 100))


@pytest.mark.skipif(os.geteuid() == 0, reason="nothing is forbidden to root")
def test_forbidden_file_is_refused_with_the_reason(tmp_path: Path) -> None:
    path = tmp_path / "forbidden.yaml"
    path.touch(mode=0)
    assert refusal_of(path) == f"{path}: found no readable file (Permission denied), expected a YAML file"
