"""Random tasks of the planar dual arm, drawn by seed, that nothing known beforehand stands against."""

from functools import cache
from typing import Any

import numpy as np
import yaml

from psmpc_cli.errors import SpecError
from psmpc_cli.ocp.feasibility import ensure_feasible
from psmpc_cli.robot.model import RobotModel, build_model
from psmpc_cli.specs.document import write
from psmpc_cli.specs.library import find, read_text
from psmpc_cli.specs.load import Task, load_robot, parse_task

ROBOT = "planar_dual_arm"
STAGES = (2, 4)
PRIORITIES = (1e-2, 1e2)
TOLERANCES = (1e-3, 1e-2)
SPEEDS = (0.5, 1.5)
BASE_WAY, JOINT_WAY = (0.7, 0.7, 0.6), 0.8
"""The farthest that the target of a stage is from the one before it [m, rad]."""

BASE_REACH, FIRST_JOINT, ELBOW = (3.0, 3.0, 2.5), 1.4, 2.5
"""How far from 0 targets may lie, inside the robot's limits [m, rad]."""

WEIGHTS = {
    "joint": {"base": [100, 100, 10], "arms": [100, 100, 10], "control": 0.03},
    "task": {"base": [100, 100, 100], "arms": [10, 10, 1], "control": 0.03},
}
"""Those of the built-in transport task."""

ENDS = (["base"], ["arms"], ["all"])
ATTEMPTS = 100


def draw_task(seed: int) -> Task:
    """Return the task of a seed: 2 to 4 stages in joint or task space, each within a few seconds of the one before.

    Targets in task space are poses of configurations within the limits. What `psmpc check` would still refuse is drawn
    again.

    Raises:
        SpecError: Every attempt was refused.
    """
    random = np.random.default_rng(seed)
    for attempt in range(ATTEMPTS):
        data = _task(random)
        robot_yaml = _robot_yaml(float(random.uniform(*SPEEDS)))
        try:
            task = parse_task(write(data), robot_yaml, f"random_{seed}")
            ensure_feasible(task)
        except SpecError:
            if attempt == ATTEMPTS - 1:
                raise
        else:
            return task
    raise AssertionError


def _task(random: np.random.Generator) -> dict[str, Any]:
    """Return a task as its YAML would have it."""
    count = int(random.integers(STAGES[0], STAGES[1], endpoint=True))
    Q = np.concatenate([np.zeros(3), random.uniform(-1.2, 1.2, 6)])
    initial, stages = _joint_target(Q), []
    for index in range(count):
        Q = _next(Q, random)
        space = str(random.choice(["joint", "task"]))
        last = index == count - 1
        stages.append(
            {
                "name": f"stage_{index + 1}",
                "skill": space,
                "priority": _rounded(_log_uniform(random, *PRIORITIES)),
                "target": _joint_target(Q) if space == "joint" else _task_target(Q),
                "ends_when": {
                    "coordinates": ["all"] if last else ENDS[int(random.integers(len(ENDS)))],
                    "tolerance": _rounded(_log_uniform(random, *TOLERANCES)),
                },
            }
        )
    return {
        "robot": ROBOT,
        "initial": initial,
        "skills": {space: {"space": space, "weights": weights} for space, weights in WEIGHTS.items()},
        "stages": stages,
    }


def _next(Q: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Return where the next stage leads from a configuration (n,)."""
    way = np.concatenate([BASE_WAY, np.full(6, JOINT_WAY)])
    reach = np.concatenate([BASE_REACH, np.tile([FIRST_JOINT, ELBOW, ELBOW], 2)])
    return np.asarray(np.clip(Q + random.uniform(-way, way), -reach, reach))


def _log_uniform(random: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(random.uniform(np.log(low), np.log(high))))


def _rounded(value: float) -> float:
    return float(f"{value:.3g}")


def _joint_target(Q: np.ndarray) -> dict[str, list[float]]:
    return _by_part(Q)


def _task_target(Q: np.ndarray) -> dict[str, list[float]]:
    return _by_part(np.asarray(_model().g(Q)).ravel())


def _by_part(values: np.ndarray) -> dict[str, list[float]]:
    """Return the rows of Q or xi (9,) by part; rounded, as people write them."""
    parts = zip(("base", "arm_1", "arm_2"), np.split(values, 3), strict=True)
    return {part: np.round(rows, 4).tolist() for part, rows in parts}


@cache
def _model() -> RobotModel:
    return build_model(load_robot(ROBOT))


def _robot_yaml(speed: float) -> str:
    """Return the robot's text with its velocity limits scaled."""
    data = yaml.safe_load(read_text(find("robot", ROBOT)))
    for limits in data["limits"].values():
        limits["velocity"] = [_rounded(speed * limit) for limit in limits["velocity"]]
    return write(data)
