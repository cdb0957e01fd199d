"""Robots of one size with more and more joints, made of the planar dual arm, each with a small task of two stages."""

import math
from collections.abc import Mapping

import numpy as np

from psmpc_cli.robot.model import build_model
from psmpc_cli.specs.document import Data, write
from psmpc_cli.specs.load import Task, load_robot, parse_task
from psmpc_cli.specs.robot import Arm, RobotSpec

PATTERN = "planar_dual_arm"
"""Whose base, arm and limits the robots have."""

BASE_GOAL, BENT = (1.0, 0.4, 0.3), 0.5
"""Where the base goes [m, rad], and what the joints of an arm are bent by together [rad]."""


def robot_with(arms: int, joints: int) -> dict[str, Data]:
    """Return a robot as YAML has it: so many arms around the base, the length and mass of each shared by its joints."""
    pattern = load_robot(PATTERN).spec
    arm = next(iter(pattern.arms.values()))
    shoulder = math.hypot(*arm.mount.position)
    angles = [2 * math.pi * k / arms for k in range(arms)]
    return {
        "name": f"arms_{arms}_joints_{joints}",
        "base": {"mass": pattern.base.mass, "inertia": pattern.base.inertia},
        "arms": {
            f"arm_{k + 1}": {
                "mount": {"position": [shoulder * math.cos(angle), shoulder * math.sin(angle)], "angle": angle},
                "links": _links(arm, joints),
            }
            for k, angle in enumerate(angles)
        },
        "limits": {"base": {"velocity": [0.2] * 3}, "arms": {"velocity": [0.15] * joints}},
    }


def _links(arm: Arm, joints: int) -> list[Data]:
    """Return equal, even rods that are together as long and as heavy as an arm."""
    length = sum(link.a + link.b for link in arm.links) / joints
    mass = sum(link.mass for link in arm.links) / joints
    rod = {"mass": mass, "inertia": mass * length**2 / 12, "a": length / 2, "b": length / 2}
    return [dict(rod) for _ in range(joints)]


def task_with(arms: int, joints: int, nodes: int) -> Task:
    """Return the task of such a robot: its base goes somewhere, then its arms reach for poses seen from there."""
    robot = robot_with(arms, joints)
    names = [f"arm_{k + 1}" for k in range(arms)]
    task: dict[str, Data] = {
        "robot": PATTERN,
        "initial": {"base": [0.0] * 3, **{name: [0.0] * joints for name in names}},
        "controller": {"horizon": 4.0, "nodes": nodes},
        "solver": {"kind": "sqp"},
        "plant": {"kind": "ideal"},
        "log": {"shares": False},
        "skills": {
            "move": {"space": "joint", "weights": _weights([100.0, 100.0, 10.0], names, [100.0] * joints)},
            "reach": {"space": "task", "weights": _weights([100.0] * 3, names, [10.0, 10.0, 1.0])},
        },
        "stages": [
            {
                "name": "go",
                "skill": "move",
                "target": {"base": list(BASE_GOAL), **{name: [0.0] * joints for name in names}},
                "ends_when": {"coordinates": ["base"], "tolerance": 2e-3},
            },
            {
                "name": "reach",
                "skill": "reach",
                "priority": 100.0,
                "target": _poses(robot, names, joints),
                "ends_when": {"coordinates": ["base"], "tolerance": 2e-3},
            },
        ],
    }
    return parse_task(write(task), write(robot), str(robot["name"]))


def _weights(base: list[Data], names: list[str], arm: list[Data]) -> dict[str, Data]:
    return {"base": base, **dict.fromkeys(names, arm), "control": 0.03}


def _poses(robot: Mapping[str, Data], names: list[str], joints: int) -> dict[str, Data]:
    """Return the poses of base and end-effectors with the base at its goal and the arms bent."""
    model = build_model(RobotSpec.model_validate(robot))
    Q = np.r_[BASE_GOAL, np.full(len(names) * joints, BENT / joints)]
    xi = np.asarray(model.g(Q)).ravel()
    return {part: [float(value) for value in xi[rows]] for part, rows in model.pose_rows.items()}
