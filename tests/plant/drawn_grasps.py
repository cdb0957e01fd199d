"""Planar robots, objects and grasps drawn at random: arms of 2 to 6 links, light and heavy, loads of 1 to 200 kg."""

from pathlib import Path
from typing import Any

import numpy as np
import yaml

from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.load import Task, load_robot, load_task

Array = np.ndarray


def _robot(random: np.random.Generator, arms: int, joints: int) -> dict[str, Any]:
    def link() -> dict[str, float]:
        mass = 10 ** random.uniform(-1, 1)
        length = random.uniform(0.1, 0.8)
        inertia = mass * length**2 * random.uniform(0.02, 0.15)
        return {"mass": float(mass), "inertia": float(inertia), "a": length / 2, "b": length / 2}

    base = 10 ** random.uniform(0.5, 2.3)
    mounts = [{"position": [0.3 - 0.6 * i, 0], "angle": np.pi * i} for i in range(arms)]
    drawn = {
        f"arm_{i + 1}": {"mount": mount, "links": [link() for _ in range(joints)], "tool": {"angle": 0}}
        for i, mount in enumerate(mounts)
    }
    return {"name": "drawn", "base": {"mass": float(base), "inertia": float(0.05 * base)}, "arms": drawn}


def _rotors(seed: int, joints: int) -> list[float]:
    """Draw armatures from 1 g m^2 to 1 kg m^2, from a stream of their own: what else a seed draws stays as it is."""
    random = np.random.default_rng([seed, 1])
    return [float(10 ** random.uniform(-3, 0)) for _ in range(joints)]


def _pose(xi: Array) -> list[float]:
    """The pose with its angle within half a turn."""
    x, y, angle = map(float, xi)
    return [x, y, float(np.arctan2(np.sin(angle), np.cos(angle)))]


def drawn_grasp(seed: int, folder: Path, geared: bool = False) -> tuple[Task, Array]:
    """Draw a task with a grasp, and a state in which its grippers are where they close, with small velocities.

    The joints of a `geared` robot have armatures.
    """
    random = np.random.default_rng(seed)
    arms = int(random.integers(1, 3))
    joints = int(random.integers(2, 7))
    robot = _robot(random, arms, joints)
    if geared:
        robot["armature"] = {"arms": _rotors(seed, joints)}
    path = folder / "drawn.yaml"
    path.write_text(yaml.safe_dump(robot))
    model = RobotModel(load_robot(path))
    Q = np.r_[np.zeros(3), random.uniform(-1.5, 1.5, arms * joints)]
    tips = model.poses(Q)[1:]
    centre = np.r_[tips[:, :2].mean(axis=0) + random.uniform(-0.3, 0.3, 2), 0.0]
    grips = {f"arm_{i + 1}": _pose(model.space.relative(tip, centre)) for i, tip in enumerate(tips)}
    mass = float(10 ** random.uniform(0, 2.3))
    other = random.uniform(-1.5, 1.5, arms * joints)
    initial = {"base": [0, 0, 0]}
    initial |= {f"arm_{i + 1}": other[i * joints : (i + 1) * joints].tolist() for i in range(arms)}
    wide = {"position": 0.1, "angle": 1.0, "velocity": 1.0, "angular_velocity": 2.0}
    grasp = {
        "at": grips,
        "envelope": wide,
        "stiffness": [float(10 ** random.uniform(2, 6)), float(10 ** random.uniform(0, 4))],
        "damping_ratio": float(random.choice([0.0, 0.3, 1.0, 2.0])),
    }
    end = {"coordinates": "all", "tolerance": 1}
    stage = {"name": "take", "skill": "move", "target": initial, "ends_when": end}
    weights = {"base": [1, 1, 1], "arms": [1] * joints}
    task = {
        "robot": str(path),
        "initial": initial,
        "skills": {"move": {"space": "joint", "weights": weights}},
        "stages": [stage],
        "object": {
            "shape": [0.5, 0.5],
            "pose": [float(x) for x in centre],
            "mass": mass,
            "inertia": float(mass * random.uniform(0.01, 0.2)),
            "taken_by": "take",
            "grasp": grasp,
        },
        "plant": {"kind": "rk4", "step": float(random.choice([1e-3, 5e-4, 2e-4]))},
    }
    return load_task(task), np.r_[Q, 0.02 * random.uniform(-1, 1, model.n)]
