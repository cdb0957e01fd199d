"""Robots whose thrusters say where their plumes are, and a task that brings one in front of a panel."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from psmpc_cli.specs.library import find
from psmpc_cli.specs.load import Task, load_task

PLUME = {"angle": "20 deg", "length": "1.5 m"}

AHEAD = (2, 3)
"""Numbers of the thrusters whose plumes leave along +x: those that brake."""

CANTED = tuple(
    {"position": [0.25, y], "direction": [-0.5, turn], "force": 10, "shortest_pulse": 0.1, "specific_impulse": 60}
    for y, turn in ((0.24, -0.866), (-0.24, 0.866))
)
"""Thrusters that brake as well, and whose plumes leave at 60 degrees to +x, to both sides."""

FOLDED = {"arm_1": ["60 deg", "-110 deg", "-40 deg"], "arm_2": ["-60 deg", "110 deg", "40 deg"]}


def robot_in(folder: Path, plume: Mapping[str, Any] | None = PLUME, canted: bool = True) -> Path:
    """Write the platform with a plume at each of its thrusters."""
    robot = yaml.safe_load(find("robot", "thruster_platform").read_text())
    thrusters = [*robot["thrusters"], *(CANTED if canted else ())]
    robot |= {
        "name": "plumed",
        "thrusters": [{**each, **({"plume": dict(plume)} if plume else {})} for each in thrusters],
    }
    path = folder / "plumed.yaml"
    path.write_text(yaml.safe_dump(robot))
    return path


def before_a_panel(folder: Path, robot: Path | None = None, **changes: Any) -> Task:
    """The platform flies to a place one metre from a panel that it faces, and stops there."""
    stage = {
        "name": "fly",
        "skill": "move",
        "target": {"base": [1.2, 0, 0], **FOLDED},
        "ends_when": {"coordinates": "base", "tolerance": 0.02},
    }
    task: dict[str, Any] = {
        "robot": str(robot or robot_in(folder)),
        "plumes": "avoided",
        "initial": {"base": [0, 0, 0], **FOLDED},
        "controller": {"horizon": 8, "nodes": 20},
        "obstacles": [{"name": "panel", "shape": {"box": [0.2, 0.6]}, "pose": [2.2, 0, 0]}],
        "skills": {"move": {"space": "joint", "weights": {"base": [100, 100, 100], "arms": 3 * [10], "control": 10}}},
        "stages": [stage],
        "time_limit": 15,
        "log": {"ticks": True},
    }
    return load_task({key: value for key, value in {**task, **changes}.items() if value is not None})
