"""Where the target object is during a run; nothing in the log measures it."""

from dataclasses import dataclass

import numpy as np

from psmpc_cli.figures.run import Run
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.simulation.monitors import verdicts
from psmpc_cli.specs.task import MonitorSpec


@dataclass(frozen=True)
class Hold:
    """When the object is held, from `start` to `end` [s], infinite if never; whether it ends because it is lost."""

    start: float
    end: float
    lost: bool


def object_pose(run: Run, time: float) -> np.ndarray | None:
    """Return the object's pose (3,) [m, m, rad] at a time [s]; None where the task has no object.

    It rests at the pose the task gives until the stage that takes it ends. From then on it moves rigidly with the
    grippers: with their midpoint and the line from the first to the second, or with the one gripper. Once the stage
    that lets it go begins, or it is lost, it is drawn where it was left: how it drifts on is not simulated.
    """
    spec = run.task.object
    if spec is None:
        return None
    pose, hold = np.array(spec.pose, float), held_between(run)
    if time <= hold.start:
        return pose
    Q = (run.coordinates_at(at) for at in (hold.start, min(time, hold.end)))
    return carried(run.model, pose, *Q)


def carried(model: RobotModel, pose: np.ndarray, taken: np.ndarray, now: np.ndarray) -> np.ndarray:
    """Return where an object taken at `pose` (3,) with the robot at `taken` (n,) is with the robot at `now` (n,)."""
    before, after = grasp(model, taken), grasp(model, now)
    turned = after[2] - before[2]
    c, s = np.cos(turned), np.sin(turned)
    offset = pose[:2] - before[:2]
    moved = after[:2] + np.array([c * offset[0] - s * offset[1], s * offset[0] + c * offset[1]])
    return np.array([*moved, pose[2] + turned])


def held_between(run: Run) -> Hold:
    """Return when the object is held.

    It is lost where a monitor of the distance between two grippers finds them farther apart than allowed meanwhile.
    """
    spec = run.task.object
    if spec is None:
        return Hold(np.inf, np.inf, False)
    names, ends = run.log.stage_names, run.log.stages["switch_time"]
    start, end = (float(ends[index]) for index in (names.index(spec.taken_by), names.index(spec.let_go_by) - 1))
    start, end = (time if np.isfinite(time) else np.inf for time in (start, end))
    opened = min((_opened(run, monitor) for monitor in run.task.monitors), default=np.inf)
    return Hold(start, opened, True) if start < opened < end else Hold(start, end, False)


def grasp(model: RobotModel, Q: np.ndarray) -> np.ndarray:
    """Return the frame the object is held in (3,) [m, m, rad] at Q (n,)."""
    xi = np.asarray(model.g(Q)).ravel()
    poses = [xi[rows] for name, rows in model.pose_rows.items() if name != "base"]
    if len(poses) == 1:
        return np.asarray(poses[0])
    line = poses[1][:2] - poses[0][:2]
    return np.array([*np.mean([pose[:2] for pose in poses], axis=0), np.arctan2(line[1], line[0])])


def _opened(run: Run, monitor: MonitorSpec) -> float:
    """Return when a monitor first finds two grippers too far apart [s]; infinite if it does not."""
    if monitor.quantity != "distance" or len(monitor.of) != 2 or "base" in monitor.of:
        return np.inf
    upper = monitor.model_copy(update={"below_start_at_most": None, "at_least": None})
    (verdict,) = verdicts(run.task.model_copy(update={"monitors": (upper,)}), run.log)
    return verdict.broken_at if np.isfinite(verdict.broken_at) else np.inf
