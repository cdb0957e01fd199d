"""Every fault of a file is reported at once, with its position, its path and what was expected.

`malformed.yaml` is a table of faults: what is changed in a file without faults, and what the report says. Twelve files
in `malformed/` have their whole report beside them.
"""

from pathlib import Path
from typing import Any

import pytest
import yaml

from psmpc_cli.errors import SpecError
from psmpc_cli.specs.load import load_robot, load_task

HERE = Path(__file__).parent
TABLE = yaml.safe_load((HERE / "malformed.yaml").read_text(encoding="utf-8"))
EXAMPLES = sorted((HERE / "malformed").glob("*.yaml"))


def load(path: Path) -> object:
    """Load a file by what its name says it is."""
    is_robot = path.name.startswith("robot_") and path.stem != "robot_for_a_task"
    return load_robot(path.name) if is_robot else load_task(path.name)


def patched(row: dict[str, Any]) -> str:
    """The text of a row: that of its base with lines replaced, or its own."""
    if "text" in row:
        return str(row["text"])
    lines = TABLE["bases"][row["base"]].split("\n")
    for change in reversed(row["patch"]):
        first = change["from"] - 1
        lines[first : first + change["remove"]] = change["put"].split("\n") if "put" in change else []
    return "\n".join(lines)


@pytest.mark.parametrize("row", TABLE["faults"], ids=[row["name"] for row in TABLE["faults"]])
def test_faults_are_reported_where_they_are(
    row: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / f"{row['name']}.yaml"
    path.write_text(patched(row), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SpecError) as raised:
        load(path)
    report = str(raised.value)
    first = path.name if all("at" in fault for fault in row["reports"]) else ""
    heads = [line for line in report.splitlines() if first and line.startswith(f"{first}:")]
    assert len(heads) == (len(row["reports"]) if first else 0), report
    for fault in row["reports"]:
        where = f"{path.name}:{fault['at']}: {fault['path']}" if "at" in fault else ""
        assert any(head.startswith(where) and fault["says"] in head for head in heads or [report]), report


@pytest.mark.parametrize("name", TABLE["bases"])
def test_the_files_that_are_patched_have_no_fault(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / f"{'robot_' if name == 'one_arm' else ''}{name}.yaml"
    path.write_text(TABLE["bases"][name], encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    load(path)


@pytest.mark.parametrize("path", EXAMPLES, ids=[path.stem for path in EXAMPLES])
def test_a_report_is_whole(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(path.parent)
    with pytest.raises(SpecError) as raised:
        load(path)
    assert str(raised.value) + "\n" == path.with_suffix(".txt").read_text(encoding="utf-8")
