"""Where robot, object and targets of a run or a task are, and what happens when; nothing here draws."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.transforms import Bbox

from psmpc_cli.figures.style import readable
from psmpc_cli.logs.run import Run
from psmpc_cli.logs.summary import judge_monitor
from psmpc_cli.ocp.problem import Stage
from psmpc_cli.ocp.skills import SKILLS, Posture
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.robot.reach import reach_of
from psmpc_cli.specs.coordinates import stack
from psmpc_cli.specs.load import Task
from psmpc_cli.specs.task import MonitorSpec

MOVED = 0.1
"""Motions by less than this cannot be seen, in lengths of the longest arm."""

NO_BREAK = "\N{NO-BREAK SPACE}"
"""Between a number and its unit."""


def view_around(points: np.ndarray) -> Bbox:
    """Return the smallest part of the plane, with a margin, that shows these points (., 2) [m]."""
    low, high = points.min(axis=0), points.max(axis=0)
    size = (high - low) + 0.08 * float(np.max(high - low))
    size = np.maximum(size, [size[1] / 1.6, size[0] * 0.45])
    return Bbox([(low + high - size) / 2, (low + high + size) / 2])


@dataclass(frozen=True, eq=False)
class Scene:
    """A run as a moving picture: where robot, object and targets are at any time.

    Nothing in the log measures the object. It rests at the pose the task gives until the stage that takes it ends. From
    then on it moves rigidly with the grippers: with their midpoint and the line from the first to the second, or with
    the one gripper. Once the stage that lets it go begins, or it is lost, it is drawn where it was left.

    Attributes:
        run: The run.
        taken, left: When the object is taken, and when it is let go or lost [s]; infinite if never.
        lost: Whether it is lost: a monitor of the distance of two grippers finds them too far apart while they hold it.
    """

    run: Run
    taken: float
    left: float
    lost: bool

    def object_pose(self, time: float) -> np.ndarray | None:
        """Return the object's pose (3,) [m, m, rad] at a time [s]; None where the task has no object."""
        spec = self.run.task.spec.object
        if spec is None or time <= self.taken:
            return None if spec is None else np.array(spec.pose, float)
        before, now = map(self.run.motion.coordinates_at, (self.taken, min(time, self.left)))
        return carried(self.run.problem.model, np.array(spec.pose, float), before, now)

    def object_corners(self, time: float) -> np.ndarray:
        """Return the corners of the object at a time [s], (4, 2) [m]; (0, 2) where the task has no object."""
        spec, pose = self.run.task.spec.object, self.object_pose(time)
        return np.zeros((0, 2)) if spec is None or pose is None else rectangle(pose, spec.shape)

    def acting(self, time: float) -> list[int]:
        """Return the stages that act from a time [s] on: the current one and those that start early."""
        spans = self.run.spans
        begun = [span for span in spans if (span.start if span.early is None else span.early) <= time]
        return [span.index for span in begun if time < span.end] or [begun[-1].index]

    def targets(self, stage: int, time: float) -> np.ndarray:
        """Return the positions (1 + arms, 2) [m] of base and end-effectors a stage aims at, at a time [s]."""
        model, target = self.run.problem.model, self.run.problem.stages[stage]
        start = next((span.start for span in self.run.spans if span.index == stage), time)
        aim = target.reference(np.array([max(time - start, 0.0)]))[0]
        return SKILLS[target.space].aims(model, aim)

    def paths(self, since: float, time: float) -> list[np.ndarray]:
        """Return the paths of base and end-effectors (., 2) [m] between two times [s]."""
        motion = self.run.motion
        xi = motion.poses_at(np.r_[since, motion.time[(motion.time > since) & (motion.time < time)], time])
        return [xi[:, rows][:, :2] for rows in self.run.problem.model.pose_rows.values()]

    def points(self, time: float) -> np.ndarray:
        """Return points (., 2) [m] whose hull holds robot and object at a time [s]."""
        robot = outline(self.run.problem.model, self.run.motion.coordinates_at(time))
        return np.vstack([robot, self.object_corners(time)])

    def extent(self, times: Iterable[float]) -> np.ndarray:
        """Return points (., 2) [m] whose hull holds all that is drawn up to and at these times [s]."""
        every = list(times)
        tracks = self.paths(float(self.run.motion.time[0]), max(every))
        aims = [self.targets(stage, time) for time in every for stage in self.acting(time)]
        return np.vstack([*map(self.points, every), *tracks, *aims])

    def events(self, time: float) -> list[str]:
        """Return what is on at a time [s]: the current stage, those that already act, whether the object is lost."""
        spans = self.run.spans
        current = [span for span in spans if span.start <= time]
        early = [span for span in spans if span.early is not None and span.early <= time < span.start]
        events = [readable(current[-1].name), *(f"{readable(span.name)} already acts" for span in early)]
        return events + ["object lost"] * (self.lost and time >= self.left)

    def switches(self) -> list[tuple[float, str]]:
        """Return when stages ended [s], and what to call that."""
        ended = [span for span in self.run.spans if np.isfinite(self.run.stages["switch_time"][span.index])]
        return [(span.end, f"{readable(span.name)} ends") for span in ended]

    def key_instants(self) -> list[tuple[float, str]]:
        """Return start, early starts, switches, loss of the object and end of the run [s] with their names, by time.

        Those between which nothing moves visibly are one.
        """
        start, end = float(self.run.motion.time[0]), self.run.motion.end
        early = [(span.early, f"{readable(span.name)} starts") for span in self.run.spans if span.early is not None]
        found = [(start, "start"), *early, *self.switches(), *[(self.left, "object lost")] * self.lost]
        found += [(end, "end of the run")] * all(abs(time - end) > 1e-6 for time, _ in found)
        kept: list[tuple[float, str]] = []
        for time, event in sorted(found, key=lambda instant: instant[0]):
            before = kept[-1][0] if kept else -np.inf
            far = MOVED * self.run.problem.model.shape.reach
            if kept and np.abs(self.points(time) - self.points(before)).max() < far:
                kept[-1] = before, f"{kept[-1][1]}, {event}"
            else:
                kept.append((time, event))
        return kept


def scene_of(run: Run) -> Scene:
    """Return a run as a scene."""
    spec = run.task.spec.object
    if spec is None:
        return Scene(run, np.inf, np.inf, False)
    names, ends = run.stage_names, np.nan_to_num(run.stages["switch_time"], nan=np.inf)
    taken, left = float(ends[names.index(spec.taken_by)]), float(ends[names.index(spec.let_go_by) - 1])
    opened = min((_opened(run, monitor) for monitor in run.task.spec.monitors), default=np.inf)
    return Scene(run, taken, opened, True) if taken < opened < left else Scene(run, taken, left, False)


def _opened(run: Run, monitor: MonitorSpec) -> float:
    """Return when a monitor first finds two grippers too far apart [s]; infinite if it does not."""
    if monitor.quantity != "distance" or len(monitor.of) != 2 or "base" in monitor.of:
        return np.inf
    upper = monitor.model_copy(update={"below_start_at_most": None, "at_least": None})
    verdict = judge_monitor(upper, run.arrays)
    return verdict.broken_at if np.isfinite(verdict.broken_at) else np.inf


def carried(model: RobotModel, pose: np.ndarray, taken: np.ndarray, now: np.ndarray) -> np.ndarray:
    """Return where an object taken at `pose` (3,) with the robot at `taken` (n,) is with the robot at `now` (n,)."""
    before, after = grasp(model, taken), grasp(model, now)
    turned = after[2] - before[2]
    c, s = np.cos(turned), np.sin(turned)
    moved = after[:2] + np.array([[c, -s], [s, c]]) @ (pose[:2] - before[:2])
    return np.array([*moved, pose[2] + turned])


def grasp(model: RobotModel, Q: np.ndarray) -> np.ndarray:
    """Return the frame the object is held in (3,) [m, m, rad] at Q (n,)."""
    first, *others = model.poses(Q)[1:]
    if not others:
        return np.asarray(first)
    line = others[0][:2] - first[:2]
    return np.array([*np.mean([first[:2], *(pose[:2] for pose in others)], axis=0), np.arctan2(line[1], line[0])])


def bodies(model: RobotModel, Q: np.ndarray) -> tuple[np.ndarray, list[tuple[np.ndarray, np.ndarray]]]:
    """Return the corners of the base (4, 2), and of each arm its joints (., 2) and its gripper (4, 2) [m]."""
    shape, frames, arms = model.shape, model.body_frames(Q)[:, :2], []
    for name, gripper in shape.grippers.items():
        numbers = [number for number, body in enumerate(model.spec.bodies) if body.name.rpartition(".")[0] == name]
        tip, last = model.spec.tools[name].position, frames[numbers[-1]]
        joints = [frames[number, :, 3] for number in numbers]
        arms.append((np.array([*joints, last @ (*tip, 1.0)]), gripper @ last[:, :3].T + last[:, 3]))
    return rectangle(Q[:3], (2 * shape.box[0], 2 * shape.box[1])), arms


def outline(model: RobotModel, Q: np.ndarray) -> np.ndarray:
    """Return points (., 2) [m] whose hull holds the robot at Q (n,)."""
    base, arms = bodies(model, Q)
    return np.vstack([base, *(part for arm in arms for part in arm)])


def rectangle(pose: np.ndarray, shape: tuple[float, ...]) -> np.ndarray:
    """Return the corners (4, 2) [m] of a rectangle, length by width, at a pose (3,)."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * np.array(shape[:2]) / 2
    return np.asarray(pose[:2] + corners @ np.array([[c, s], [-s, c]]))


def configurations(task: Task, model: RobotModel, stages: Sequence[Stage]) -> list[np.ndarray]:
    """Return the robot's coordinates at the start and at every stage's target, (n,) each.

    Where a target is in task space the arms are those of inverse kinematics; an arm that cannot reach stays as it was.
    """
    stops = [stack(task.spec.initial, task.robot, "joint")]
    for stage in stages:
        before = Posture(stops[-1], np.asarray(model.g(stops[-1])).ravel())
        Q, base = SKILLS[stage.space].after(model, before, stage.target).Q.copy(), stage.target[model.pose_rows["base"]]
        for arm in task.robot.arms if stage.space == "task" else ():
            found = reach_of(task.robot, arm, tuple(base), tuple(stage.target[model.pose_rows[arm]])).configuration
            if found is not None:
                Q[model.parts[arm]] = found
        stops.append(Q)
    return stops


def object_poses(task: Task, model: RobotModel, stops: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Return the object's pose (3,) in each stage's panel: at rest, carried to the stage's target, or left there."""
    spec = task.spec.object
    if spec is None:
        return []
    names = [stage.name for stage in task.spec.stages]
    taken, let_go, pose = names.index(spec.taken_by) + 1, names.index(spec.let_go_by), np.array(spec.pose, float)
    ends = (min(panel, let_go) for panel in range(1, len(names) + 1))
    return [pose if end <= taken else carried(model, pose, stops[taken], stops[end]) for end in ends]
