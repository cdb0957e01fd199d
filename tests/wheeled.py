"""Robots with reaction wheels, and tasks in which these turn them."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from psmpc_cli.specs.library import find
from psmpc_cli.specs.load import Task, load_task

TWO_WHEELS = (
    {"inertia": 0.01, "torque": 0.4, "momentum": 2.0, "initial": 0.5},
    {"inertia": 0.02, "torque": 0.3, "momentum": 3.0, "initial": -0.8},
)
"""Of a planar robot; they do not store the same, so that something is left that adds up to nothing."""

PYRAMID = tuple(
    {"axis": axis, "inertia": 1e-3, "torque": 0.02, "momentum": 0.3, "initial": at_first}
    for axis, at_first in zip(
        ([1, 0, 0.7], [-1, 0, 0.7], [0, 1, 0.7], [0, -1, 0.7]), (0.1, -0.05, 0.02, 0), strict=True
    )
)
"""Of a spatial robot: four about axes of which any three span space, that spin at first."""


def robot_in(folder: Path, built_in: str, wheels: object, **changes: object) -> Path:
    """Write a built-in robot with wheels, and other changes of its keys."""
    source = find("robot", built_in)
    robot = yaml.safe_load(source.read_text())
    if "urdf" in robot:
        robot["urdf"] = str(source.parent / robot["urdf"])
    robot |= {"name": "wheeled", "wheels": list(wheels) if isinstance(wheels, tuple) else wheels, **changes}
    path = folder / "wheeled.yaml"
    path.write_text(yaml.safe_dump(robot))
    return path


def planar_in(folder: Path, changes: Mapping[str, Any] | None = None, **of_wheels: float) -> Task:
    """Both hands reach poses and fold again, while wheels hold and turn the base."""
    wheels = tuple({**wheel, **of_wheels} for wheel in TWO_WHEELS)
    task = {
        "robot": str(robot_in(folder, "planar_dual_arm", wheels)),
        "mobility": "attitude",
        "initial": {"base": [0, 0, 0], "arm_1": [0.3, 0.3, 0.3], "arm_2": [-0.3, -0.3, -0.3]},
        "controller": {"nodes": 20, "horizon": 6},
        "skills": {
            "reach": {"space": "task", "weights": {"base": [0, 0, 100], "arms": [100, 100, 10], "control": 0.3}},
            "fold": {"space": "joint", "weights": {"base": [0, 0, 30], "arms": [30, 30, 30], "control": 0.3}},
        },
        "limits": {"arms": {"force": [56, 28, 12]}},
        "stages": [
            {
                "name": "reach",
                "skill": "reach",
                "target": {"base": [0, 0, 0.2], "arm_1": [1.382, 0.387, 0.6], "arm_2": [-1.394, 0.368, -0.3]},
                "ends_when": {"coordinates": ["arms"], "tolerance": 5e-3},
            },
            {
                "name": "fold",
                "skill": "fold",
                "priority": 0.1,
                "target": {"base": [0, 0, -0.2], "arm_1": [0.3, 0.3, 0.3], "arm_2": [-0.3, -0.3, -0.3]},
                "ends_when": {"coordinates": ["arms", "base.theta"], "tolerance": 1e-2, "velocity": 5e-3},
            },
        ],
        "time_limit": 30,
    }
    return load_task(task, changes or {})


def spatial_in(folder: Path, changes: Mapping[str, Any] | None = None, **of_wheels: float) -> Task:
    """A small arm looks at a point, then wheels turn the base, in `turn_and_look` with wheels that spin at first."""
    wheels = tuple({**wheel, **of_wheels} for wheel in PYRAMID)
    robot = robot_in(folder, "free_flyer_arm", wheels)
    return load_task("turn_and_look", {"robot": str(robot), **(changes or {})})


TURNS = {"space": "joint", "mobility": "attitude"}


def changing_in(folder: Path, changes: Mapping[str, Any] | None = None, **of_wheels: float) -> Task:
    """Thrusters move the base, then wheels turn it, then nothing does, and thrusters bring it back."""
    wheels = tuple({**wheel, **of_wheels} for wheel in PYRAMID)
    weights = {"base": [10, 10, 10, 10, 10, 10], "arm": [1, 1, 1], "control": 0.1}
    home: list[object] = [0, 0.5, 0.5]

    def pose(x: float, rpy: list[float]) -> dict[str, object]:
        return {"position": [x, 0, 0], "attitude": {"rpy": rpy}}

    task = {
        "robot": str(robot_in(folder, "free_flyer_arm", wheels)),
        "initial": {"base": {"position": [0, 0, 0]}, "arm": home},
        "initial_velocity": {"base": [0.01, 0, 0, 0.02, 0.01, -0.03]},
        "controller": {"nodes": 15, "horizon": 5},
        "skills": {
            "go": {"space": "joint", "weights": weights},
            "turn": {**TURNS, "weights": {**weights, "base": [0, 0, 0, 10, 10, 10]}},
            "look": {"space": "point", "mobility": "free-floating", "weights": {"arm": [10, 10], "control": 0.1}},
        },
        "limits": {"base": {"force": [2, 2, 2, 0.1, 0.1, 0.1]}, "arm": {"force": [0.6, 0.6, 0.6]}},
        "stages": [
            {
                "name": "go",
                "skill": "go",
                "target": {"base": pose(0.1, [0, 0, 0.2]), "arm": home},
                "ends_when": {"coordinates": ["base"], "tolerance": 0.02, "velocity": 0.01},
            },
            {
                "name": "turn",
                "skill": "turn",
                "priority": 0.3,
                "target": {"base": pose(0, [0.3, 0.2, -0.4]), "arm": home},
                "ends_when": {"coordinates": ["base.rx", "base.ry", "base.rz"], "tolerance": 0.02},
            },
            {
                "name": "look",
                "skill": "look",
                "priority": 0.3,
                "target": {"arm": [1, 2, 1]},
                "ends_when": {"coordinates": ["arm"], "tolerance": 0.02},
            },
            {
                "name": "back",
                "skill": "go",
                "priority": 0.3,
                "target": {"base": pose(0, [0, 0, 0]), "arm": home},
                "ends_when": {"coordinates": ["base"], "tolerance": 0.02, "velocity": 0.01},
            },
        ],
        "time_limit": 40,
    }
    return load_task(task, changes or {})
