"""An arm of six joints on a heavy free-flying base, and a mission in which its gripper carries an object.

Lengths, masses and the cylinders that its links are taken for follow those which Universal Robots publish for the UR10e
(UniversalRobots/Universal_Robots_ROS2_Description, config/ur10e/physical_parameters.yaml). The base is our own.
"""

from typing import Any

import numpy as np
import yaml

from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.load import Task, parse_task
from psmpc_cli.specs.robots.robot import SpatialRobot

HEIGHT = 0.5
"""From the centre of the base to the first joint's frame [m]."""


def _link(along: str, about: str, at: list[float], mass: float, radius: float, length: float) -> dict[str, Any]:
    """A link that is a solid cylinder along an axis of its frame, from the joint on, which turns about another one."""
    axis = "xyz".index(along)
    inertia = [mass * (3 * radius**2 + length**2) / 12] * 3
    inertia[axis] = mass * radius**2 / 2
    centre = [0.0, 0.0, 0.0]
    centre[axis] = length / 2
    joint = {"axis": [float(each == about) for each in "xyz"], "position": at}
    return {"joint": joint, "mass": mass, "centre_of_mass": centre, "inertia": inertia}


def robot(armature: float) -> dict[str, Any]:
    """The robot with an armature [kg m^2] at each joint."""
    links = [
        _link("z", "z", [0, 0, HEIGHT], 7.369, 0.075, 0.178),
        _link("x", "y", [0, 0, 0.181], 13.051, 0.075, 0.612),
        _link("x", "y", [0.613, 0, 0], 3.989, 0.075, 0.57155),
        _link("y", "y", [0.571, 0.174, 0], 2.1, 0.075, 0.12),
        _link("z", "z", [0, 0, 0], 1.98, 0.075, 0.12),
        _link("y", "y", [0, 0, 0.12], 0.615, 0.045, 0.05),
    ]
    return {
        "name": "six_joint_arm",
        "space": "spatial",
        "base": {"mass": 1000, "inertia": [170, 170, 170]},
        "arms": {"arm": {"links": links, "tool": {"position": [0, 0.117, 0]}}},
        "limits": {"arm": {"velocity": [0.5] * 6}},
        "armature": {"arm": [armature] * 6},
    }


TAKE = [0.3, 0.5, 0.9, -1.4, 1.2, 0.4]
CARRY = [-0.5, -0.2, 1.3, -1.1, 0.7, 1.0]
"""Joint angles where the gripper closes on the object, and where it carries it to [rad]."""

REACH = 0.2
"""From the gripper to the centre of the object [m]."""

SHAPE = 0.3, 0.4, 0.3
"""Of the object, a solid cuboid [m]."""


def mission(armature: float, load: float | None, *changes: str) -> Task:
    """A mission of two stages: to the object, and with it to elsewhere, at rest.

    Args:
        armature: Of each joint [kg m^2].
        load: Mass of the object [kg]; None for the same motion with nothing in the gripper.
        changes: Keys of the task to change.
    """
    written = robot(armature)
    model = RobotModel(SpatialRobot.model_validate(written))
    rest = {"base": {"position": [0, 0, 0]}}
    at_rest = {"coordinates": ["all"], "tolerance": 5e-3, "velocity": 5e-3}
    stages = [
        {"name": name, "skill": "move", "target": {**rest, "arm": Q}, "ends_when": at_rest}
        for name, Q in (("take", TAKE), ("carry", CARRY))
    ]
    task: dict[str, Any] = {
        "robot": "six_joint_arm",
        "initial": {**rest, "arm": [0.0] * 6},
        "controller": {"nodes": 12},
        "plant": {"step": 1e-4},
        "skills": {"move": {"space": "joint", "weights": {"base": [100] * 6, "arm": [30] * 6, "control": 0.03}}},
        "limits": {"base": {"acceleration": [0.2] * 6}, "arm": {"acceleration": [0.5] * 6}},
        "stages": stages,
        "log": {"shares": False},
    }
    if load is not None:
        x, y, z = (each**2 / 12 for each in SHAPE)
        tool = model.poses(np.r_[model.neutral[:7], TAKE])[1]
        pose = model.space.composed(tool, np.array([0, REACH, 0, 1, 0, 0, 0]))
        task["object"] = {
            "shape": list(SHAPE),
            "pose": {"position": list(map(float, pose[:3])), "attitude": {"quaternion": list(map(float, pose[3:]))}},
            "mass": load,
            "inertia": [load * (y + z), load * (x + z), load * (x + y)],
            "taken_by": "take",
            "grasp": {
                "at": {"arm": {"position": [0, -REACH, 0]}},
                "envelope": {"position": 0.05, "angle": "5 deg", "velocity": 0.05, "angular_velocity": "5 deg"},
                "stiffness": [1e5, 1e4],
                "known": True,
            },
        }
    return parse_task(yaml.safe_dump(task), yaml.safe_dump(written), "six_joint_arm", changes)
