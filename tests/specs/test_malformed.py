"""Every fault of a file is reported at once, with its position, its path and what was expected."""

from pathlib import Path

import pytest

from psmpc_cli.errors import SpecError
from psmpc_cli.specs.load import load_robot, load_task

FOLDER = Path(__file__).parent / "malformed"
FILES = sorted(path.name for path in FOLDER.glob("*.yaml"))


def test_there_are_many_and_each_has_its_report() -> None:
    assert len(FILES) >= 80
    assert [name.removesuffix(".yaml") for name in FILES] == sorted(path.stem for path in FOLDER.glob("*.txt"))


@pytest.mark.parametrize("name", FILES)
def test_malformed_file_has_the_report_beside_it(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(FOLDER)
    load = load_robot if name.startswith("robot_") and name != "robot_for_a_task.yaml" else load_task
    with pytest.raises(SpecError) as raised:
        load(name)
    assert str(raised.value) + "\n" == (FOLDER / name).with_suffix(".txt").read_text(encoding="utf-8")
