"""Missions that begin with the hands at their grasps on an object, which may drift otherwise than the task says."""

from collections.abc import Mapping
from typing import Any

from psmpc_cli.specs.load import Task, load_task

POSTURE = {"arm_1": ["45 deg", "30 deg", "60 deg"], "arm_2": ["-45 deg", "-30 deg", "-60 deg"]}

LEAN = {
    "controller.nodes": 12,
    "log.shares": False,
    "initial": {"base": [-2, 2, "30 deg"], **POSTURE},
    "object.motion": {"linear": [0, 0], "angular": 0},
    "object.grasp.stiffness": [1e3, 1e2],
    "plant": {"low_level_rate": 200, "step": 1e-3},
}

UNKNOWN_DRIFT = {"uncertainty.object": {"linear": 0.12}, "seed": 1}
"""8.7 cm/s, against 5 cm/s of the envelope: grippers that close at once miss the object."""

AGAIN = {"stages.capture.if_missed": {"back_to": "approach", "times": 2}}


def near_capture(*changes: Mapping[str, Any]) -> Task:
    """Return the task whose grippers are to close at once."""
    merged = {key: value for each in (LEAN, *changes) for key, value in each.items()}
    return load_task("catch_drifting", merged)
