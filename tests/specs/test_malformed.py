"""Every fault of a file is reported at once, with its position, its path and what was expected."""

from pathlib import Path

import pytest

from psmpc_cli.errors import SpecError
from psmpc_cli.specs.load import load_robot, load_task, parse_task

FOLDER = Path(__file__).parent / "malformed"
FILES = sorted(path.name for path in FOLDER.glob("*.yaml"))
ROBOT = load_robot("planar_dual_arm").robot_yaml


def heads(error: SpecError) -> list[str]:
    """Return the first line of every fault."""
    return [line for line in str(error).splitlines() if line[0] != " "]


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


TASK = """\
robot: planar_dual_arm
initial: {base: [0, 0, 0], arms: [0, 0, 0]}
skills: {move: {space: joint, weights: {base: [1, 1, 1], arms: [1, 1, 1]}}}
stages:
  - name: go
    skill: mov
    onset: bass
    target: {base: [0, 0, 0], arms: [0, 0, 0]}
    ends_when: {coordinates: [bas, arm_1.x, arm_1.1], tolerance: -1}
"""


def test_misspelt_coordinates_are_reported_whatever_is_wrong_beside_them() -> None:
    with pytest.raises(SpecError) as raised:
        parse_task(TASK, ROBOT.replace("mass: 30", "mass: -30"), "t")
    positions = [head.partition(": found")[0] for head in heads(raised.value)]
    assert positions == [
        "t:6:12: stages[0].skill",
        "t:7:12: stages[0].onset",
        "t:9:31: stages[0].ends_when.coordinates[0]",
        "t:9:66: stages[0].ends_when.tolerance",
        "t (robot):4:14: base.mass",
    ]
    assert "arm_1.1" in str(raised.value) and "base.theta" in str(raised.value)


def test_coordinates_of_the_other_space_are_reported_when_the_skill_is_known() -> None:
    with pytest.raises(SpecError) as raised:
        parse_task(TASK.replace("skill: mov\n", "skill: move\n"), ROBOT, "t")
    assert any('coordinates[1]: found the text "arm_1.x"' in head for head in heads(raised.value))
