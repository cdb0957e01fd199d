"""`psmpc check`, `init` and `schema`."""

import json
import re
from pathlib import Path
from typing import Any

import pytest

import psmpc_cli
from psmpc_cli.errors import SpecError
from psmpc_cli.specs.library import built_ins, find, json_schema
from psmpc_cli.specs.load import load_robot, load_task

from ..plumed import robot_in
from .command import Psmpc


def words(text: str) -> list[str]:
    """Lines of a table with single spaces."""
    return [" ".join(line.split()) for line in text.splitlines()]


def test_a_valid_task_is_a_table(psmpc: Psmpc) -> None:
    ran = psmpc("check", "transport")
    assert (ran.code, ran.stderr) == (0, "")
    lines = words(ran.stdout)
    assert lines[0].startswith("OK: task transport")
    assert lines[1].startswith("transport: ")
    assert lines[3] == "stage part target ends within distance of reach not before"
    assert lines[4].split()[:2] == ["approach", "base"]
    assert any(line.startswith("reach (task) arm_1 -1.9334, 3.1677 m, 165 deg") for line in lines)
    assert any("1.036 of 1.200 m" in line for line in lines)


def test_check_prints_joints_and_end_effector_of_every_arm_at_every_target(psmpc: Psmpc) -> None:
    lines = words(psmpc("check", "transport").stdout)
    assert "at the target of arm joints end-effector" in lines
    assert "transport arm_1 45, 45, 60 deg 0.480348, 0.953553 m, 150 deg" in lines
    assert any(line.startswith("capture arm_1 45, 30, 60 deg -1.9334, 3.1677 m, 165 deg") for line in lines)


def test_check_prints_how_large_a_load_is_that_the_low_level_law_does_not_know(psmpc: Psmpc) -> None:
    light = ("--set", "object.mass=5", "--set", "object.inertia=0.67")
    unknown = " ".join(psmpc("check", "transport_grasp", *light, "--set", "object.grasp.known=false").stdout.split())
    found = "load over the robot's inertia 0.577 in a motion mostly of arm_{}.2, where transport leads"
    assert any(found.format(arm) in unknown for arm in (1, 2)), "the arms mirror each other"
    assert "object.grasp.known: found" not in unknown
    assert "load over the robot's inertia" not in psmpc("check", "transport_grasp").stdout


def test_a_valid_robot_is_a_table_without_empty_columns(psmpc: Psmpc) -> None:
    lines = words(psmpc("check", "planar_dual_arm").stdout)
    assert "base 30 0 0 1.35" in lines
    assert "arm_2.1 revolute base at -0.3 0 m, 180 deg 4.2 0.25 0 0.35" in lines
    assert "coordinate position velocity" in lines  # there are no limits of accelerations
    assert "base.theta -180 to 180 deg -0.2 to 0.2 rad/s" in lines


def test_check_prints_limits_of_forces_where_there_are_any(psmpc: Psmpc) -> None:
    lines = words(psmpc("check", "transport", "--set", "limits={base: {force: [6, 20, [-1, 2]]}}").stdout)
    at = lines.index("coordinate limit of force, of robot and task")
    assert lines[at + 1 : at + 5] == ["base.x -6 to 6 N", "base.y -20 to 20 N", "base.theta -1 to 2 N m", ""]
    assert not any("limit of force" in line for line in words(psmpc("check", "transport").stdout))


def test_check_prints_how_fast_wheels_turn_a_robot(psmpc: Psmpc) -> None:
    """About z they store 0.139 N m s; at 17.2 deg/s the robot has 0.0815 of them."""
    lines = words(psmpc("check", "turn_and_look").stdout)
    at = lines.index("turn about wheels give wheels store so it turns at most at limit of velocity, takes")
    rows = [line.split() for line in lines[at + 1 : at + 4]]
    assert [row[0] for row in rows] == ["rx", "ry", "rz"]
    assert lines[at + 3].startswith("rz 0.0462 N m 0.139 N m s ")
    for row in rows:
        stores, fastest, limit, takes = float(row[4]), float(row[8]), float(row[10]), float(row[12])
        assert limit == 17.2 and takes < stores and fastest > limit
    floating = ("--set", "mobility=free-flying", "--set", "skills.turn.weights.control=1")
    assert "wheels store" not in psmpc("check", "turn_and_look", *floating).stdout


def test_check_says_where_no_delay_is_looked_for(psmpc: Psmpc) -> None:
    late = ("--set", "uncertainty={delay: 0.1 s}")
    said = {
        ("thrust_and_reach", late): "delay taken for none: pulses of thrusters cannot be told from one",
        ("thrust_and_reach", (*late, "--set", "controller.delay=0.1 s")): "delay known as 0.1 s",
        ("float_and_reach", late): "delay estimated",
    }
    for (task, options), text in said.items():
        assert text in " ".join(psmpc("check", task, *options).stdout.split())


def test_check_prints_which_stages_avoid_plumes(psmpc: Psmpc, tmp_path: Path) -> None:
    obstacle = "obstacles=[{name: post, shape: {sphere: 0.1}, pose: [5, 5, 0]}]"
    options = ("--set", f"robot={robot_in(tmp_path)}", "--set", obstacle, "--set", "stages.reach.plumes=avoided")
    lines = words(psmpc("check", "thrust_and_reach", *options).stdout)
    assert sum("plumes avoided" in line for line in lines) == 1
    assert next(i for i, line in enumerate(lines) if line.startswith("reach")) < next(
        i for i, line in enumerate(lines) if "plumes avoided" in line
    )
    assert "shut at the target, because of plumes: reach none" in lines


def test_armatures_are_in_the_table_of_a_robot(psmpc: Psmpc, tmp_path: Path) -> None:
    text = (Path(__file__).parents[2] / "robots" / "free_flyer_arm.yaml").read_text()
    sliding = text.replace("axis: [0, 1, 0]", "kind: prismatic, axis: [0, 1, 0]", 1)
    sliding = sliding.replace("[-100 deg, 100 deg]", "[0, 8 m]")
    (tmp_path / "geared.yaml").write_text(f"{sliding}armature: {{arm: [0.05, 2.5, 0]}}\n")
    lines = words(psmpc("check", "geared.yaml").stdout)
    assert lines[0].startswith("OK: robot ")
    assert lines[3].endswith("inertia [kg m^2] armature")
    for line, end in zip(lines[5:8], ("0.05 kg m^2", "2.5 kg", " 0"), strict=True):
        assert line.endswith(end), line
    assert "arm.2 0 to 8 m -0.3 to 0.3 m/s" in lines


def test_everything_of_a_task_is_in_its_table(psmpc: Psmpc, tmp_path: Path) -> None:
    changes = (
        "priorities.compare=[[trace, unfold, 90], [trace, stow, 100], [unfold, stow, 1]]",
        "uncertainty.mass=0.1",
        "uncertainty.noise.angle=2e-3",
        "uncertainty.delay=0.2 s",
        "uncertainty.payload=null",
        "controller.delay=0.1",
    )
    ran = psmpc("check", "tracking", *(word for change in changes for word in ("--set", change)))
    assert ran.code == 0, ran.stderr
    assert "priorities from 3 comparisons: consistency ratio 0.0012, acceptable up to 0.1" in ran.stdout
    assert "uncertain, seed 0, delay known as 0.1 s:" in ran.stdout
    for key in ("uncertainty.mass: 0.1 (", "uncertainty.noise.angle: 0.002 (", "uncertainty.delay: 0.2 ("):
        assert f"  {key}" in ran.stdout
    assert "payload" not in ran.stdout
    assert "follows 16 s" in ran.stdout
    text = (tmp_path / "task.yaml").read_text().replace("target: {base: [0.1", "dwell: 2\n    target: {base: [0.1")
    (tmp_path / "dwell.yaml").write_text(text.replace("ends_when: {coordinates: [base], tolerance: 0.005}", "at: 3", 1))
    lines = words(psmpc("check", "dwell.yaml").stdout)
    assert any(line.startswith("go base 0.1, 0 m, 0 deg at 3 s") for line in lines)
    assert any("at least 2 s" in line for line in lines)


def test_a_remark_is_printed_but_no_error(psmpc: Psmpc, tmp_path: Path) -> None:
    text = load_task("transport").task_yaml.replace("base: [-2, 2, 30 deg]", "base: [-2, -2, 30 deg]", 1)
    (tmp_path / "odd.yaml").write_text(text)
    ran = psmpc("check", "odd.yaml")
    assert ran.code == 0
    assert "odd.yaml:22:20: stages[1].target.base: found the base 4 m from" in ran.stdout


@pytest.mark.parametrize("tolerance", [1e-8, -1.0])
def test_gradients_are_audited(psmpc: Psmpc, monkeypatch: pytest.MonkeyPatch, tolerance: float) -> None:
    monkeypatch.setattr("psmpc_cli.simulation.gradient_audit.AD_TOLERANCE", tolerance)
    ran = psmpc("check", "task.yaml", "--gradients")
    assert ran.code == (0 if tolerance > 0 else 1), ran.stdout
    (row,) = [line for line in words(ran.stdout) if line.startswith("go to back")]
    assert row.split()[-1] == ("yes" if tolerance > 0 else "NO")


@pytest.mark.slow
@pytest.mark.parametrize("file", ["task.yaml", "planar_dual_arm", "free_flyer_arm"])
def test_a_scenario_or_robot_is_drawn(psmpc: Psmpc, file: str) -> None:
    drawn = "scenario" if file == "task.yaml" else "robot"
    assert psmpc("check", file, "--figure", "a.svg").stdout.splitlines()[-1] == f"{drawn}: a.svg"
    assert Path("a.svg").stat().st_size > 0
    assert psmpc("check", file, "--figure", "a.svg").code == 2
    assert psmpc("check", file, "--figure", "a.svg", "--force").code == 0


def test_every_built_in_is_copied_and_loads_to_the_same(psmpc: Psmpc) -> None:
    ran = psmpc("init", "new/project")
    assert ran.code == 0
    folder = Path("new/project")
    assert sorted(ran.stdout.split()) == sorted(str(path) for path in folder.rglob("*") if path.is_file())
    for name in built_ins("task"):
        copied = load_task(folder / "tasks" / f"{name}.yaml")
        assert copied.spec.model_copy(update={"robot": load_task(name).spec.robot}) == load_task(name).spec
    for name in built_ins("robot"):
        assert load_robot(folder / "robots" / f"{name}.yaml") == load_robot(name)
    for path in (*folder.glob("robots/*.yaml"), *folder.glob("tasks/*.yaml")):
        schema = path.read_text().splitlines()[0].partition("$schema=")[2]
        assert (path.parent / schema).resolve().is_file()
    assert psmpc("init", "new/project").code == 2
    assert psmpc("init", "new/project", "--force").code == 0


def test_schemas_are_printed(psmpc: Psmpc) -> None:
    for kind in ("robot", "task"):
        assert json.loads(psmpc("schema", kind).stdout) == json_schema(kind)
    assert json.loads(psmpc("schema").stdout) == {"robot": json_schema("robot"), "task": json_schema("task")}


def test_the_help_has_the_commands_by_what_they_are_for_and_cuts_no_text(psmpc: Psmpc) -> None:
    whole = psmpc("--help").stdout
    assert [line for line in whole.splitlines() if line[:1].isalpha()][2:] == [
        "Run:",
        "Study:",
        "Look:",
        "Help:",
        "Examples:",
        "Built-in tasks:",
    ]
    assert all(re.search(rf"\b{name}\b", whole.partition("Built-in tasks:")[2]) for name in built_ins("task"))
    assert len(re.findall(r"^  psmpc ", whole, re.MULTILINE)) == 2
    text = whole.partition("Run:")[2]
    assert "..." not in text
    assert "Print the JSON Schema of robot and task descriptions" in " ".join(text.split())


def test_built_in_tasks_and_robots_are_listed_with_what_they_show(psmpc: Psmpc) -> None:
    found = words(psmpc("tasks").stdout)
    assert "transport planar_dual_arm On-orbit transport with four stages" in found
    assert "dual_arm_servicer space left, right 14" in found
    assert sum(line.split()[0] in built_ins("task") for line in found if line) == len(built_ins("task"))


def test_check_prints_a_urdf_s_bodies_limits_and_what_was_assumed(psmpc: Psmpc) -> None:
    found = psmpc("check", "dual_arm_servicer").stdout
    for words in (
        "spatial, 20 degrees of freedom, 182 kg",
        "left.7",
        "-170 to 170 deg",
        '"left_tool" has no <inertial>',
    ):
        assert words in found


@pytest.mark.slow
def test_check_prints_the_object_its_grasps_and_its_destination(psmpc: Psmpc) -> None:
    found = " ".join(psmpc("check", "catch_drifting").stdout.split())
    for words in (
        "mass 20 kg",
        "pose at the start -2.489, 2.847 m, 30 deg",
        "drift 0.02 0 m/s, 2 deg/s",
        "taken at the end of capture",
        "let go at the beginning of release",
        "grasp of arm_2 -0.6415, 0 m, -135 deg",
        "stiffness of a grasp 10000 N/m, 1000 N m/rad, damping ratio 1",
        "a grasp holds pull 12 N, filtered over 0.2 s",
        "destination 0, 0.978 m, 0 deg",
        "destination within 0.005 0.005 m, 1 deg",
        "speed at the destination at most 0.03 m/s",
    ):
        assert words in found
    in_space = " ".join(psmpc("check", "catch_tumbling").stdout.split())
    assert "inertia 0.6 0.4 0.5 kg m^2" in in_space
    assert "drift 0.004 -0.008 0.004 m/s, 0.6 1.2 1.2 deg/s" in in_space
    assert "pose at the start 2.5, 0.7, 0 m, turned by 30 deg about 0.6 0 0.8" in in_space
    assert "destination 1.5, 0, -0.4 m, turned by 0 deg destination within" in in_space
    drawn_alone = psmpc("check", "transport").stdout
    assert "taken" in drawn_alone
    assert "mass" not in drawn_alone.partition("object")[2]


def test_check_prints_obstacles_clearance_and_what_the_robot_is_made_of(psmpc: Psmpc) -> None:
    obstacles = (
        "obstacles=[{name: post, shape: {sphere: 0.1}, pose: [4, 4, 0]},"
        " {name: wall, shape: {half_space: [0, 1]}, pose: [0, -4, 0], velocity: [0, 0.1]},"
        " {name: rod, shape: {capsule: [0.05, 1]}, pose: [5, 5, 30 deg]},"
        " {name: crate, shape: {box: [1, 0.5]}, pose: [6, 5, 0]}]"
    )
    clearance = ("clearance={except: [[arm_1, wall]]}", "stages.capture.clearance={margin: 0.01, hard: true}")
    ran = psmpc("check", "transport", *(word for each in (obstacles, *clearance) for word in ("--set", each)))
    assert (ran.code, ran.stderr) == (0, "")
    lines = words(ran.stdout)
    at = lines.index("clearance")
    assert lines[at + 1 : at + 7] == [
        "obstacle post sphere of radius 0.1 m at 4, 4 m, 0 deg",
        "obstacle wall half-space with normal 0 1 at 0, -4 m, 0 deg, moves at 0 0.1 m/s",
        "obstacle rod capsule of radius 0.05 m about 1 m at 5, 5 m, 30 deg",
        "obstacle crate box of 1 x 0.5 m at 6, 5 m, 0 deg",
        "at least 20 mm, soft, but not arm_1 - wall",
        "in capture 10 mm, hard",
    ]
    assert lines[at + 7].startswith("robot 9 capsules fitted to its joints: base 1, arm_1.1 1, ")
    assert "clearance" not in words(psmpc("check", "transport").stdout)


def test_check_prints_how_many_capsules_a_robot_is_made_of(psmpc: Psmpc, tmp_path: Path) -> None:
    fitted = (
        "shape: 9 capsules fitted to its joints: base 1, arm_1.1 1, arm_1.2 1, arm_1.3 2, arm_2.1 1, arm_2.2 1, arm_2.3"
    )
    assert any(line.startswith(fitted) for line in words(psmpc("check", "planar_dual_arm").stdout))
    own = tmp_path / "own.yaml"
    geometry = (
        "geometry: {base: [{shape: {sphere: 0.4}}, {shape: {sphere: 0.2}}], arm_1.2: [{shape: {capsule: [0.05, 0.4]}}]}"
    )
    own.write_text(f"{find('robot', 'planar_dual_arm').read_text()}\n{geometry}\n")
    assert "shape: 3 capsules from its file: base 2, arm_1.2 1" in words(psmpc("check", str(own)).stdout)


def test_check_advises_to_pose_arms_for_the_next_stage_and_is_silent_once_it_is_done(
    psmpc: Psmpc, tmp_path: Path
) -> None:
    scenario = tmp_path / "scenario.svg"
    ran = psmpc("check", "transport", "--figure", str(scenario))
    assert ran.code == 0
    remark = ran.stdout.partition("probably not meant:\n")[2]
    arms = {"arm_1": "[45 deg, 30 deg, 60 deg]", "arm_2": "[-45 deg, -30 deg, -60 deg]"}
    assert all(f"{arm}: {joints}" in remark for arm, joints in arms.items())
    changes = (("--set", f"stages.approach.target.{arm}={joints}") for arm, joints in arms.items())
    followed = psmpc("check", "transport", *(word for each in changes for word in each))
    assert (followed.code, "probably not meant" in followed.stdout) == (0, False)


def test_check_remarks_on_a_target_that_touches(psmpc: Psmpc) -> None:
    changes = ("obstacles=[{name: post, shape: {sphere: 0.1}, pose: [-1.93, 3.17, 0]}]", "clearance={}")
    ran = psmpc("check", "transport", *(word for each in changes for word in ("--set", each)))
    assert ran.code == 0
    remark = ran.stdout.partition("probably not meant:\n")[2]
    assert "stages[1].target: found arm_1.3 and post " in remark and "mm deep in each other" in remark


@pytest.mark.parametrize(
    "changes",
    [
        {"initial.base": [-50, 2, 0]},
        {"initial_velocity": {"base": [9, 0, 0]}},
        {"stages.approach.target.base": [40, 2, 0], "stages.transport.target.base": [0, 40, 0]},
        {"stages.capture.target.arm_1": [9, 9, 0]},
        {"limits.base.velocity": [0, 0, 0]},
        {"controller.nodes": 1},
    ],
)
def test_check_and_python_reject_the_same(psmpc: Psmpc, changes: dict[str, Any]) -> None:
    with pytest.raises(SpecError) as caught:
        psmpc_cli.load_task("transport", [f"{path}={json.dumps(value)}" for path, value in changes.items()])
    words = (word for path, value in changes.items() for word in ("--set", f"{path}={json.dumps(value)}"))
    ran = psmpc("check", "transport", *words)
    assert ran.code == 2
    count, _, problems = ran.stderr.strip().partition("\n")
    assert problems == str(caught.value).strip()
    assert int(count.split()[0]) == sum(not line.startswith(" ") for line in problems.splitlines())
