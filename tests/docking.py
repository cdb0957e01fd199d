"""A task in which a mount holds the base in one stage."""

from typing import Any

from psmpc_cli.specs.load import Task, load_task

BESIDE = {"arm_1": ["20 deg", "60 deg", "40 deg"], "arm_2": ["-20 deg", "-60 deg", "-40 deg"]}
FOLDED = {"arm_1": ["60 deg", "2.2 deg", "72.8 deg"], "arm_2": ["-60 deg", "-2.2 deg", "-72.8 deg"]}


def docking(changes: dict[str, Any] | None = None) -> Task:
    """A robot with thrusters flies to its mount, folds its arms while that holds it, and leaves."""
    ends = {"coordinates": ["base"], "tolerance": 0.02, "velocity": 5e-3}
    of_joints = {"arm_1": [100, 100, 10], "arm_2": [100, 100, 10], "control": 4}
    task = {
        "robot": "thruster_platform",
        "initial": {"base": [0, -0.03, 0], **BESIDE},
        "controller": {"nodes": 12, "horizon": 6},
        "plant": {"kind": "rk4", "low_level_rate": 200},
        "time_limit": 40,
        "skills": {
            "fly": {"space": "joint", "weights": {"base": [100, 100, 10], **of_joints}},
            "fold": {"space": "joint", "weights": of_joints},
        },
        "stages": [
            {"name": "dock", "skill": "fly", "target": {"base": [0, 0, 0], **BESIDE}, "ends_when": ends},
            {
                "name": "fold",
                "skill": "fold",
                "mobility": "fixed",
                "target": FOLDED,
                "ends_when": {"coordinates": ["arms"], "tolerance": 0.05, "velocity": 0.05},
            },
            {"name": "leave", "skill": "fly", "target": {"base": [0, -0.1, 0], **FOLDED}, "ends_when": ends},
        ],
        "log": {"ticks": True, "shares": False},
    }
    return load_task(task, changes or {})
