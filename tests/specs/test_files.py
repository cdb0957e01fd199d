"""Files as texts, and what is said of those that cannot be read."""

import os
from pathlib import Path

import pytest

from psmpc_cli.errors import SpecError
from psmpc_cli.specs.files import LARGEST_FILE, read_text
from psmpc_cli.specs.load import load_robot


def test_text_is_read_with_or_without_byte_order_mark(tmp_path: Path) -> None:
    path = tmp_path / "task.yaml"
    path.write_bytes(b"\xef\xbb\xbfname: \xc2\xb0\n")
    assert read_text(path) == "name: °\n"
    path.write_bytes(b"name: a\r\n")
    assert read_text(path) == "name: a\r\n"


def test_a_file_is_read_as_far_as_its_size_says() -> None:
    """Files of the kernel have the size 0 and may never end."""
    assert Path("/proc/self/environ").read_bytes()
    assert read_text(Path("/proc/self/environ")) == ""


def test_a_link_to_itself_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("loop.yaml").symlink_to("loop.yaml")
    Path("gone.yaml").symlink_to("nowhere.yaml")
    for name, reason in (
        ("loop.yaml", "Too many levels of symbolic links"),
        ("gone.yaml", "No such file or directory"),
    ):
        with pytest.raises(SpecError, match=rf"{name}: found no readable file \({reason}\)"):
            load_robot(name)


def test_a_directory_in_the_place_of_a_urdf_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("meshes").mkdir()
    Path("robot.yaml").write_text("name: r\nurdf: meshes\n")
    with pytest.raises(SpecError, match=r'robot\.yaml:2:7: urdf: found the directory "meshes", expected a URDF file'):
        load_robot("robot.yaml")


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
