"""Tasks of the small free-flyer: missions in space that take a few seconds."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from psmpc_cli.robot.model import load_robot
from psmpc_cli.specs.load import Task, load_task

Array = NDArray[np.float64]


def attitude(axis: list[float], degrees: float) -> dict[str, Any]:
    """An attitude as a task writes it."""
    return {"axis": (np.array(axis) / np.linalg.norm(axis)).tolist(), "angle": f"{degrees} deg"}


def turning(degrees: float, *changes: str) -> Task:
    """The small free-flyer turns about (1, 1, 1), flies half a metre and unfolds its arm."""
    pose = {"position": [0.3, 0.2, -0.3], "attitude": attitude([1, 1, 1], degrees)}
    weights = {"base": [100] * 6, "arm": [10] * 3, "control": 0.1}
    arms = ([0, 0, 0], ["40 deg", "-30 deg", "60 deg"])
    ends = {"coordinates": ["base"], "tolerance": 5e-3}, {"coordinates": ["all"], "tolerance": 5e-3}
    return load_task(
        {
            "robot": "free_flyer_arm",
            "initial": {"base": {"position": [0, 0, 0]}, "arm": [0, 0, 0]},
            "controller": {"nodes": 12},
            "skills": {"move": {"space": "joint", "weights": weights}},
            "stages": [
                {"name": "fly", "skill": "move", "target": {"base": pose, "arm": arms[0]}, "ends_when": ends[0]},
                {
                    "name": "unfold",
                    "skill": "move",
                    "priority": 10,
                    "target": {"base": pose, "arm": arms[1]},
                    "ends_when": ends[1],
                },
            ],
        },
        changes,
    )


GOAL = np.r_[0.3, 0.2, -0.3, 0.5, 0.5, 0.5, 0.5, 0.4, -0.3, 0.5]
"""Where the arm of `reaching` is at a pose it can reach: Q (10,), 120 deg about (1, 1, 1)."""


def pose(numbers: Array) -> dict[str, Any]:
    """A pose (7,) as a task writes it."""
    return {"position": numbers[:3].tolist(), "attitude": {"quaternion": numbers[3:].tolist()}}


def reaching(*changes: str) -> Task:
    """The small free-flyer goes to GOAL, reaches a pose there, and points at a point: a skill of each kind."""
    base, tip = (pose(each) for each in load_robot("free_flyer_arm").poses(GOAL))
    point = (GOAL[:3] + Rotation.from_quat(GOAL[[4, 5, 6, 3]]).apply([2.0, 0.5, 0.3])).tolist()
    weights = {space: {"base": [100] * 6, "arm": arm, "control": 0.1} for space, arm in KINDS.items()}
    ends = {"coordinates": ["base", "arm"], "tolerance": 5e-3}
    reach = {"name": "reach", "skill": "task", "priority": 10, "target": {"base": base, "arm": tip}}
    look = {"name": "look", "skill": "point", "priority": 10, "target": {"base": base, "arm": point}}
    task = {
        "robot": "free_flyer_arm",
        "initial": {"base": {"position": [0, 0, 0]}, "arm": [0, 0, 0]},
        "controller": {"nodes": 12},
        "skills": {space: {"space": space, "weights": weights[space]} for space in KINDS},
        "stages": [
            {
                "name": "fly",
                "skill": "joint",
                "target": {"base": base, "arm": [0, 0, 0]},
                "ends_when": {**ends, "coordinates": ["base"]},
            },
            {**reach, "ends_when": {**ends, "hold": 0.5}},
            {**look, "ends_when": {**ends, "tolerance": 0.01, "velocity": 0.02}},
        ],
    }
    return load_task(task, changes)


KINDS = {"joint": [10] * 3, "task": [100] * 6, "point": [10] * 2}
"""Weights of the arm by the kind of a skill."""
