from pathlib import Path

import pytest

from psmpc_cli.specs import library
from psmpc_cli.specs.library import built_ins, shown


def test_built_ins_of_a_source_tree() -> None:
    assert built_ins("robot").keys() >= {"planar_dual_arm"}
    assert built_ins("task").keys() >= {"transport", "approach_capture"}


def test_built_ins_of_an_installed_package_are_in_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    inside = tmp_path / "psmpc_cli" / "builtin" / "tasks"
    inside.mkdir(parents=True)
    (inside / "own.yaml").touch()
    monkeypatch.setattr(library, "__file__", str(tmp_path / "psmpc_cli" / "specs" / "library.py"))
    assert built_ins("task") == {"own": inside / "own.yaml"}


def test_paths_are_shown_as_the_user_sees_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert shown(tmp_path / "a" / "b.yaml") == str(Path("a/b.yaml"))
    assert shown(Path("../c.yaml")) == str(Path("../c.yaml"))
    assert shown(tmp_path.parent / "d.yaml") == str(tmp_path.parent / "d.yaml")
