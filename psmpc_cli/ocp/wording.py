"""How values of coordinates read in messages, and where in a task's file they stand."""

import numpy as np

from psmpc_cli.ocp.outlook import BASE
from psmpc_cli.ocp.stages import Stage
from psmpc_cli.specs.coordinates import labels
from psmpc_cli.specs.load import Task
from psmpc_cli.specs.messages import Path
from psmpc_cli.specs.robot import RobotSpec


def beyond(robot: RobotSpec, row: int, value: float, low: float, high: float, per: str = "") -> str:
    """Say that a coordinate is out of bounds."""
    name, found = labels(robot, "joint")[row], value_of(robot, row, value, per)
    return f"found {name} at {found}, expected within its limits {span_of(robot, row, low, high, per)}"


def value_of(robot: RobotSpec, row: int, value: float, per: str = "") -> str:
    """Write a value of Q with its unit, angles in degrees."""
    lengths = ("base.x", "base.y")
    return f"{value:.6g} m{per}" if labels(robot, "joint")[row] in lengths else f"{np.degrees(value):.6g} deg{per}"


def span_of(robot: RobotSpec, row: int, low: float, high: float, per: str = "") -> str:
    """Write a pair of bounds with their unit."""
    return f"[{value_of(robot, row, low, per)}, {value_of(robot, row, high, per)}]"


def path_of_row(task: Task, parts: Path, row: int, space: str, moment: int | None = None) -> Path:
    """Return where a row of Q or xi is in numbers by part; of a trajectory at the `moment`-th of its times."""
    part = labels(task.robot, "joint" if space == "joint" else "task")[row].rpartition(".")[0]
    sizes = task.robot.parts if space == "joint" else dict.fromkeys(task.robot.parts, BASE.stop)
    before = sum(size for name, size in sizes.items() if list(sizes).index(name) < list(sizes).index(part))
    return (*path_of_part(task, parts, part, moment), row - before)


def path_of_part(task: Task, parts: Path, part: str, moment: int | None = None) -> Path:
    """Return where the numbers of a part are, under its own name or under `arms`; of a trajectory at a moment."""
    own = (*parts, part)
    path = own if own in task.source.entries or part == "base" else (*parts, "arms")
    return path if moment is None else (*path, moment)


def target_path(stage: Stage) -> Path:
    """Return where a stage's target is."""
    return ("stages", stage.index, "target")


def moment_of(stage: Stage, index: int) -> int | None:
    """Return the index of a waypoint of a stage's target in the file; None if the target is no trajectory."""
    return None if stage.trajectory is None else index
