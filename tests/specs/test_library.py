"""Built-in files, and files as texts."""

import os
from pathlib import Path

import pytest

from psmpc_cli.errors import SpecError
from psmpc_cli.specs.library import LARGEST_FILE, read_text


def test_text_is_read_with_or_without_byte_order_mark(tmp_path: Path) -> None:
    path = tmp_path / "task.yaml"
    path.write_bytes(b"\xef\xbb\xbfname: \xc2\xb0\n")
    assert read_text(path) == "name: °\n"
    path.write_bytes(b"name: a\r\n")
    assert read_text(path) == "name: a\r\n"


def test_what_is_no_readable_file_is_rejected_with_the_reason(tmp_path: Path) -> None:
    large, missing = tmp_path / "large.yaml", tmp_path / "missing.yaml"
    os.mkfifo(tmp_path / "pipe")
    with large.open("wb") as file:
        file.truncate(10**12)
    reasons = {
        tmp_path: "a directory, expected a YAML file",
        Path("/dev/zero"): "no regular file, expected a YAML file",
        tmp_path / "pipe": "no regular file, expected a YAML file",
        large: f"1000000000000 bytes, expected a YAML file of at most {LARGEST_FILE}",
        missing: "no readable file (No such file or directory), expected a YAML file",
        large / "task.yaml": "no readable file (Not a directory), expected a YAML file",
    }
    for path, reason in reasons.items():
        with pytest.raises(SpecError) as raised:
            read_text(path)
        assert str(raised.value) == f"{path}: found {reason}"
