"""References to files, names and mappings, and the texts behind them."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from psmpc_cli.errors import SpecError
from psmpc_cli.specs.library import built_ins
from psmpc_cli.specs.load import kind_of_reference, load_task, parse_task

ROBOT = load_task("transport").robot_yaml


TASK = load_task("transport").task_yaml


def write(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.parent.mkdir(exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return path


def test_built_in_task_is_the_paper_s() -> None:
    task = load_task("transport")
    assert task.spec.name == "transport"
    assert [stage.name for stage in task.spec.stages] == ["approach", "capture", "transport", "release"]
    assert [stage.priority for stage in task.spec.stages] == [1, 100, 1, 0.01]
    assert task.spec.stages[0].target["base"] == (-2, 2, math.radians(30))
    assert task.spec.skills["move"].weights.parts["arm_1"] == (100, 100, 10)
    assert task.robot.parts == {"base": 3, "arm_1": 3, "arm_2": 3}
    assert task.robot.limits["base"].velocity == ((-0.2, 0.2),) * 3


@pytest.mark.parametrize("name", built_ins("task"))
def test_built_in_tasks_load_and_have_the_editor_s_mode_line(name: str) -> None:
    assert load_task(name).task_yaml.startswith("# yaml-language-server: $schema=../docs/schema/task.json\n")


def test_robot_is_found_beside_the_task(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(tmp_path, "robots/heavy.yaml", ROBOT.replace("mass: 30", "mass: 300"))
    task = write(tmp_path, "tasks/mine.yaml", TASK.replace("planar_dual_arm", "../robots/heavy.yaml"))
    assert load_task(task).robot.base.mass == 300
    monkeypatch.chdir("/")
    assert load_task(str(task)).robot.base.mass == 300


def test_a_mapping_is_a_task() -> None:
    rest = {"base": (0, 0, 0), "arms": np.zeros(3)}
    mapping: dict[str, Any] = {
        "robot": "planar_dual_arm",
        "initial": rest,
        "skills": {"move": {"space": "joint", "weights": {"base": [1, 1, 1], "arms": [np.float64(2)] * 3}}},
        "stages": [{"name": "go", "skill": "move", "target": rest, "ends_when": {"coordinates": "all"}}],
    }
    task = load_task(mapping, set={"controller.nodes": 20})
    assert (task.spec.name, task.spec.controller.nodes) == ("task", 20)
    assert parse_task(task.task_yaml, task.robot_yaml, "task").digest == task.digest
    with pytest.raises(SpecError, match=r'^task:\d+:\d+: stages\[0\]\.skill: found the text "mve" \(did you mean'):
        load_task({**mapping, "stages": [{**mapping["stages"][0], "skill": "mve"}]})
    with pytest.raises(SpecError, match="expected numbers, texts"):
        load_task({**mapping, "seed": object()})


def test_a_robot_given_as_a_change_is_found_from_the_working_directory_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = built_ins("robot")["planar_dual_arm"].read_text(encoding="utf-8")
    (tmp_path / "mine.yaml").write_text(text.replace("name: planar_dual_arm", "name: mine"), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    assert load_task("transport", ["robot=mine.yaml"]).robot.name == "mine"
    with pytest.raises(SpecError, match="found no file"):
        load_task("transport", ["robot=other.yaml"])


def test_faults_of_task_and_robot_come_together(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write(
        tmp_path, "r.yaml", "name: r\nbase: {mass: -1, inertia: 1}\narms: {a: {mount: {position: [0, 0]}, links: []}}\n"
    )
    write(tmp_path, "t.yaml", TASK.replace("planar_dual_arm", "r.yaml").replace("priority: 100", "priority: 0"))
    with pytest.raises(SpecError) as raised:
        load_task("t.yaml")
    assert [line for line in str(raised.value).splitlines() if line[0] != " "] == [
        "t.yaml:21:15: stages[1].priority: found 0, expected a number greater than 0",
        "r.yaml:2:14: base.mass: found -1, expected a number greater than 0",
        "r.yaml:3:46: arms.a.links: found an empty list, expected a length of at least 1",
    ]


@pytest.mark.parametrize(
    ("reference", "reason"),
    [
        ("gone.yaml", 'found no file "gone.yaml", expected one of '),
        ("folder", "folder: found a directory, expected a YAML file"),
    ],
)
def test_robot_that_cannot_be_read_is_reported_where_the_task_names_it(
    reference: str, reason: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder").mkdir()
    write(tmp_path, "t.yaml", TASK.replace("robot: planar_dual_arm", f'robot: "{reference}"'))
    with pytest.raises(SpecError) as raised:
        load_task("t.yaml")
    assert str(raised.value).splitlines()[0].startswith(f"t.yaml:4:8: robot: {reason}")


@pytest.mark.parametrize(
    ("reference", "found"),
    [
        ("transprot", 'transprot: found no file "transprot" (did you mean "transport"?)'),
        ("no/such.yaml", 'no/such.yaml: found no file "no/such.yaml"'),
        ("\0", '\0: found no file "\\u0000"'),
    ],
)
def test_message_about_a_missing_task_has_the_built_in_names(reference: str, found: str) -> None:
    with pytest.raises(SpecError) as raised:
        load_task(reference)
    assert (
        str(raised.value)
        == f"{found}, expected one of {', '.join(built_ins('task'))}: a built-in task, or the path of a file"
    )


def test_digest_of_a_task_without_limits_of_forces_is_that_of_the_first_logs() -> None:
    """As computed before limits of forces were: logs of that time are still read."""
    robot = """
name: scout
base: {mass: 10, inertia: 1}
arms:
  arm: {mount: {position: [0.2, 0]}, links: [{mass: 1, inertia: 0.1, a: 0.3, b: 0.3}]}
"""
    task = """
robot: scout
initial: {base: [0, 0, 0], arm: [0]}
skills: {go: {space: joint, weights: {base: [1, 1, 1], arm: [1]}}}
stages:
  - {name: go, skill: go, target: {base: [1, 0, 0], arm: [0]}, ends_when: {coordinates: [base], tolerance: 0.1}}
"""
    digest = "084d0d8752c16c8c3fb27cc00a9893e6669e716f3a7ee6d9156ed7a29f2827bf"
    assert parse_task(task, robot, "task").digest == digest
    assert parse_task(f"{task}obstacles: []\n", robot, "task").digest == digest
    assert parse_task(f"{task}clearance: {{}}\n", robot, "task").digest != digest


POST = {"name": "post", "shape": {"sphere": 0.1}, "pose": [1, 1, 0]}


def test_clearance_and_obstacles_are_in_digests_and_texts_as_they_are_written() -> None:
    own = load_task("transport", {"obstacles": [POST], "clearance.except": [["arm_1", "post"]]})
    same = load_task("transport", {"obstacles": [POST], "clearance": {"except": [["arm_1", "post"]], "margin": 0.02}})
    others = [
        load_task("transport", {"obstacles": [POST], "clearance": {}}),
        load_task("transport", {"clearance": {}}),
        load_task("transport", {"obstacles": [{**POST, "velocity": [0.1, 0]}], "clearance": {}}),
        load_task("transport", {"obstacles": [POST], "stages.capture.clearance": {}}),
        load_task("transport"),
    ]
    assert own.digest == same.digest == parse_task(own.task_yaml, own.robot_yaml, "transport").digest
    assert len({own.digest, *(each.digest for each in others)}) == 6
    assert own.spec.model_dump(mode="json")["clearance"]["except"] == [["arm_1", "post"]]
    assert not {"clearance", "obstacles"} & set(load_task("transport").spec.model_dump(mode="json"))


def test_digest_is_of_the_content_not_of_the_text() -> None:
    task = load_task("transport")
    spelt = parse_task(TASK.replace("2e-3", "0.002").replace("onset: base", "onset: [base]"), ROBOT, "transport")
    heavier = parse_task(TASK, ROBOT.replace("mass: 30", "mass: 31"), "transport")
    swapped = ROBOT.replace("arm_1", "arm_0").replace("arm_2", "arm_1").replace("arm_0", "arm_2")
    held = load_task("transport", {"stages.release.ends_when.hold": "1 s"})
    assert spelt.digest == task.digest == load_task("transport", {"stages.release.ends_when.hold": 0}).digest
    assert len({task.digest, heavier.digest, held.digest, load_task("transport", ["seed=1"]).digest}) == 4
    assert parse_task(TASK, swapped, "transport").digest != task.digest


def test_kind_is_recognized_by_its_keys(tmp_path: Path) -> None:
    assert kind_of_reference("planar_dual_arm") == "robot"
    assert kind_of_reference("transport") == "task"
    assert kind_of_reference(write(tmp_path, "a.yaml", ROBOT)) == "robot"
    assert kind_of_reference(write(tmp_path, "b.yaml", "seed: 1")) == "task"
    assert kind_of_reference(write(tmp_path, "c.yaml", "a: [")) == "task"


@pytest.mark.parametrize("text", ["urdf: r.urdf\n", "name: r\nspace: spatial\n", "name: r\narmature: {arms: [1]}\n"])
def test_a_robot_file_needs_neither_base_nor_arms_to_be_one(tmp_path: Path, text: str) -> None:
    """Any key that tasks do not have tells a robot."""
    assert kind_of_reference(write(tmp_path, "mine.yaml", text)) == "robot"
    for task in ("seed: 3\n", "time_limit: 5\n", "limits: {}\n"):
        assert kind_of_reference(write(tmp_path, "mine.yaml", task)) == "task"
