"""Tours: random missions of a planar and of a spatial robot with two unequal arms, for `missions.py`; nothing is held.

A tour has five to seven stages. In turn the base flies to a place, then one arm works there: its hand reaches a pose,
or points at a point. A tour of an odd number of stages ends with a flight in which the arms are folded, too. Stages end
as soon as what they are for is done: flights by the base, reaching and pointing by the arm. As drawn, an arm without
work is wanted folded.
"""

from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.load import load_robot

Changes = dict[str, Any]

ROBOTS = Path(__file__).parent / "tours"
ARMS = ("long", "short")
FOLDED = {
    "plane": {"long": [0.8, -1.9, -0.4], "short": [-0.8, 1.9, 0.4]},
    "space": {"long": [0.4, 1.0, -0.5, 1.6, 0.6, 1.0, 0.0], "short": [-0.4, 1.0, 0.5, 1.6, -0.6, 1.0, 0.0]},
}
"""Joints of arms without work [rad]."""

BENT = {
    "plane": ([-1.2, 0.5, -1.0], [1.2, 1.8, 1.0]),
    "space": ([-0.8, 0.3, -0.8, 0.6, -0.8, 0.3, -0.8], [0.8, 1.4, 0.8, 1.8, 0.8, 1.4, 0.8]),
}
"""Between which joints arms work [rad]; planar elbows bend to the side on which they are folded."""


def tour(space: str) -> Changes:
    """Return a task without start and stages: `plane` or `space`."""
    size, joints = (3, 3) if space == "plane" else (6, 7)
    of_base = [100] * size
    return {
        "robot": str(ROBOTS / f"{space}.yaml"),
        "controller": {"kind": "psmpc", "horizon": 4.0, "sample_time": 0.1},
        "skills": {
            "move": {"space": "joint", "weights": {"base": of_base, "arms": [30] * joints, "control": 1}},
            "reach": {"space": "task", "weights": {"base": of_base, "arms": [30] * size, "control": 1}},
            "point": {"space": "point", "weights": {"base": of_base, "arms": [30] * (size // 3), "control": 1}},
        },
    }


def draw_tour(rng: np.random.Generator, space: str) -> Changes:
    """Draw where a tour begins and its stages."""
    model = RobotModel(load_robot(ROBOTS / f"{space}.yaml"))
    folded = FOLDED[space]
    base = np.eye(1, model.nq - sum(map(len, folded.values())), 3)[0] if space == "space" else np.zeros(3)
    stages: list[Changes] = []
    count = int(rng.integers(5, 8))
    while len(stages) < count:
        base = next_place(rng, base)
        is_last = len(stages) + 1 == count
        stages.append(
            {
                "name": f"fly_{len(stages) + 1}",
                "skill": "move",
                "priority": 1,
                "target": {"base": as_target(base), **folded},
                "ends_when": {"coordinates": ["all" if is_last else "base"], "tolerance": 0.01},
                "onset": "base",
            }
        )
        if not is_last:
            stages.append(work(rng, model, space, base, len(stages) + 1))
    start = {arm: (np.array(joints) + rng.uniform(-0.3, 0.3, len(joints))).tolist() for arm, joints in folded.items()}
    return {
        "initial": {"base": as_target(np.eye(1, len(base), 3)[0] if space == "space" else np.zeros(3)), **start},
        "stages": stages,
    }


def next_place(rng: np.random.Generator, base: np.ndarray) -> np.ndarray:
    """Return a pose of the base 0.6 to 1.8 m and up to 60 degrees from another one."""
    distance = rng.uniform(0.6, 1.8)
    turn = rng.uniform(-np.pi / 3, np.pi / 3)
    way = rng.normal(size=2 if len(base) == 3 else 3)
    place = distance * way / np.linalg.norm(way)
    if len(base) == 3:
        return base + np.append(place, turn)
    axis = rng.normal(size=3)
    attitude = rotation(base[3:]) * Rotation.from_rotvec(turn * axis / np.linalg.norm(axis))
    return np.concatenate([base[:3] + place, attitude.as_quat()[[3, 0, 1, 2]]])


def work(rng: np.random.Generator, model: RobotModel, space: str, base: np.ndarray, number: int) -> Changes:
    """Return a stage in which an arm reaches a pose, or points at a point, from a place of the base."""
    arm = ARMS[rng.integers(2)]
    other = ARMS[1 - ARMS.index(arm)]
    joints = rng.uniform(*BENT[space])
    if space == "plane":
        joints[1] *= np.sign(FOLDED[space][arm][1])
    poses = poses_of(model, base, {**FOLDED[space], arm: joints})
    points = rng.random() < 0.3
    away = rng.uniform(1.0, 3.0)
    target = {arm: ahead(poses[arm], away)} if points else {each: as_target(poses[each]) for each in (arm, other)}
    return {
        "name": f"{'point' if points else 'reach'}_{number}",
        "skill": "point" if points else "reach",
        "priority": 100,
        "target": {"base": as_target(base), **target},
        "ends_when": {"coordinates": [arm], "tolerance": 0.01},
        "onset": arm,
    }


def poses_of(model: RobotModel, base: np.ndarray, joints: Changes) -> dict[str, np.ndarray]:
    """Return the poses of the end-effectors, (3,) or (7,), with the base and the joints somewhere."""
    poses = model.poses(np.concatenate([base, *(joints[arm] for arm in ARMS)]))
    return dict(zip(ARMS, poses[1:], strict=True))


def ahead(pose: np.ndarray, distance: float) -> list[float]:
    """Return a point on the x-axis of a pose [m]."""
    if len(pose) == 3:
        return [float(pose[0] + distance * np.cos(pose[2])), float(pose[1] + distance * np.sin(pose[2]))]
    return (pose[:3] + rotation(pose[3:]).apply([distance, 0.0, 0.0])).tolist()


def as_target(pose: np.ndarray) -> Any:
    """Return a pose (3,) or (7,) as a task has it."""
    if len(pose) == 3:
        return pose.tolist()
    return {"position": pose[:3].tolist(), "attitude": {"quaternion": pose[3:].tolist()}}


def rotation(quaternion: np.ndarray) -> Rotation:
    """Return the rotation of a quaternion (w, x, y, z)."""
    return Rotation.from_quat(np.roll(quaternion, -1))
