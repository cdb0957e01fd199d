"""The paper's robot on a base of six degrees of freedom does under the transport task what it does in the plane."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from psmpc_cli.simulation.run import simulate
from psmpc_cli.specs.load import Task, load_task


def urdf_of(planar: Task) -> str:
    """The planar robot as a URDF: all joints turn about z."""
    robot: Any = planar.robot

    def link(name: str, mass: float, inertia: float, x: float = 0.0) -> str:
        moments = f'ixx="{inertia}" iyy="{inertia}" izz="{inertia}" ixy="0" ixz="0" iyz="0"'
        inner = f'<origin xyz="{x} 0 0"/><mass value="{mass}"/><inertia {moments}/>'
        return f'<link name="{name}"><inertial>{inner}</inertial></link>'

    def joint(name: str, kind: str, parent: str, place: tuple[float, float], angle: float) -> str:
        origin = f'<origin xyz="{place[0]!r} {place[1]!r} 0" rpy="0 0 {angle!r}"/><axis xyz="0 0 1"/>'
        return f'<joint name="to_{name}" type="{kind}"><parent link="{parent}"/><child link="{name}"/>{origin}</joint>'

    parts = [link("base", robot.base.mass, robot.base.inertia)]
    for arm_name, arm in robot.arms.items():
        parent, place, angle = "base", arm.mount.position, arm.mount.angle
        for number, each in enumerate(arm.links, start=1):
            name = f"{arm_name}_{number}"
            parts += [link(name, each.mass, each.inertia, each.a), joint(name, "continuous", parent, place, angle)]
            parent, place, angle = name, (each.a + each.b, 0.0), 0.0
        parts += [f'<link name="{arm_name}"/>', joint(arm_name, "fixed", parent, place, arm.tool.angle)]
    return f'<robot name="in_space">{"".join(parts)}</robot>'


def in_space(planar: Task, folder: Path) -> Task:
    """The planar task with poses, weights and limits in space."""
    (folder / "robot.urdf").write_text(urdf_of(planar))
    spec, given = planar.spec, planar.spec.model_dump(mode="json", include={"controller", "onset"})

    def pose(numbers: Any) -> dict[str, Any]:
        x, y, angle = numbers
        return {"position": [x, y, 0], "attitude": {"axis": [0, 0, 1], "angle": angle}}

    def six(numbers: Any) -> list[Any]:
        return [numbers[0], numbers[1], numbers[1], numbers[2], numbers[2], numbers[2]]

    limits: dict[str, Any] = {}
    for part, own in planar.robot.limits.items():
        limits[part] = own.model_dump(mode="json", exclude_none=True)
        if part == "base":
            limits[part] = {key: six(limits[part][key]) for key in ("velocity", "acceleration") if key in limits[part]}
    skills: dict[str, Any] = {}
    for name, skill in spec.skills.items():
        parts = skill.weights.parts
        weights = {part: six(w) if part == "base" or skill.space == "task" else list(w) for part, w in parts.items()}
        skills[name] = {"space": skill.space, "weights": {**weights, "control": skill.weights.control}}
    stages = []
    for stage in spec.stages:
        poses = ("base", *planar.robot.arms) if spec.skills[stage.skill].space == "task" else ("base",)
        target: Any = stage.target
        aims = {part: pose(aim) if part in poses else list(aim) for part, aim in target.items()}
        kept = stage.model_dump(mode="json", include={"name", "skill", "priority", "ends_when", "onset"})
        stages.append({**kept, "target": aims})
    robot = folder / "robot.yaml"
    tips = ", ".join(f"{arm}: {{tip: {arm}}}" for arm in planar.robot.arms)
    robot.write_text(f"urdf: robot.urdf\nbase: base\narms: {{{tips}}}\nlimits: {limits}\n".replace("None", "null"))
    initial = {part: pose(at) if part == "base" else list(at) for part, at in spec.initial.items()}
    return load_task({**given, "robot": str(robot), "initial": initial, "skills": skills, "stages": stages})


@pytest.mark.slow
def test_the_mission_is_the_planar_one(tmp_path: Path) -> None:
    planar = load_task("transport", {"controller.nodes": 25})
    flat, space = simulate(planar), simulate(in_space(planar, tmp_path))
    np.testing.assert_allclose(space.stages["switch_time"], flat.stages["switch_time"], rtol=0, atol=1e-3)
    np.testing.assert_allclose(space.stages["actual_start"], flat.stages["actual_start"], rtol=0, atol=0.1 + 1e-9)
    assert np.abs(space.Q[:, [2, 4, 5]]).max() < 1e-12
