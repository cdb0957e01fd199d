"""The robot, its object, targets and paths, drawn to scale in the plane."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.patches import Polygon
from matplotlib.ticker import MaxNLocator, MultipleLocator

from psmpc_cli.figures import style
from psmpc_cli.logs.run import Run
from psmpc_cli.logs.summary import verdicts
from psmpc_cli.ocp.skills import SKILLS
from psmpc_cli.robot.model import RobotModel, arm_points
from psmpc_cli.specs.task import MonitorSpec

FINGER = 0.09
"""Length of a gripper's finger, in lengths of the longest arm."""

TRAIL = (0, (2, 1.5))

TARGET: dict[str, Any] = {"linestyle": "none", "marker": "+", "markersize": 5.5, "markeredgewidth": 0.9}
"""Look of a target."""


@dataclass(frozen=True)
class View:
    """What a panel shows: x and y from low to high [m]."""

    x: tuple[float, float]
    y: tuple[float, float]

    @property
    def aspect(self) -> float:
        """Height over width."""
        return (self.y[1] - self.y[0]) / (self.x[1] - self.x[0])

    def show(self, axes: Axes) -> None:
        """Set a panel's limits and ticks, with equal scales."""
        step = float(np.ptp(MaxNLocator(6, steps=[1, 2, 5, 10]).tick_values(*self.x)[:2]))
        axes.set_xlim(self.x)
        axes.set_ylim(self.y)
        axes.set_aspect("equal")
        axes.xaxis.set_major_locator(MultipleLocator(step))
        axes.yaxis.set_major_locator(MultipleLocator(step))


def view_around(points: np.ndarray) -> View:
    """Return the smallest view, with a margin, that shows these points (., 2) [m]."""
    low, high = points.min(axis=0), points.max(axis=0)
    size = (high - low) + 0.08 * float(np.max(high - low))
    size = np.maximum(size, [size[1] / 1.6, size[0] * 0.45])
    (left, bottom), (right, top) = (low + high - size) / 2, (low + high + size) / 2
    return View((left, right), (bottom, top))


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
        if spec is None:
            return None
        pose = np.array(spec.pose, float)
        if time <= self.taken:
            return pose
        before, now = map(self.run.motion.coordinates_at, (self.taken, min(time, self.left)))
        return carried(self.run.problem.model, pose, before, now)

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

    def tip_paths(self, since: float, time: float) -> dict[str, np.ndarray]:
        """Return the path of each end-effector (., 2) [m] between two times [s]."""
        run = self.run
        times = np.r_[since, run.motion.time[(run.motion.time > since) & (run.motion.time < time)], time]
        xi = run.motion.poses_at(times)
        return {name: xi[:, rows][:, :2] for name, rows in run.problem.model.pose_rows.items() if name != "base"}

    def points(self, time: float) -> np.ndarray:
        """Return points (., 2) [m] whose hull holds robot and object at a time [s]."""
        pose, spec = self.object_pose(time), self.run.task.spec.object
        found = [outline(self.run.problem.model, self.run.motion.coordinates_at(time))]
        return np.vstack([*found, *([] if pose is None or spec is None else [rectangle(pose, spec.shape)])])

    def view(self, times: Iterable[float]) -> View:
        """Return the smallest view, with a margin, that shows all that is drawn up to and at these times [s]."""
        every, poses = list(times), self.run.problem.model.pose_rows.values()
        past = self.run.motion.time <= max(every)
        tracks = [self.run.motion.xi[past][:, rows][:, :2] for rows in poses]
        aims = [self.targets(stage, time) for time in every for stage in self.acting(time)]
        return view_around(np.vstack([*(self.points(time) for time in every), *tracks, *aims]))

    def draw(
        self, axes: Axes, time: float, since: float, stages: Iterable[int] | None = None, width: float = 1.0
    ) -> None:
        """Draw object, paths, targets and robot.

        Args:
            axes: A panel.
            time: The time [s].
            since: From when on the paths of the end-effectors are drawn [s].
            stages: Whose targets are drawn; those that act by default.
            width: Scales the lines.
        """
        run, pose, Q = self.run, self.object_pose(time), self.run.motion.coordinates_at(time)
        if pose is not None and run.task.spec.object is not None:
            look = object_look(self.lost and time >= self.left, width)
            axes.add_patch(Polygon(rectangle(pose, run.task.spec.object.shape), zorder=1, **look))
        trail = np.vstack([run.motion.Q[run.motion.time <= time, :2], Q[:2]])
        axes.plot(*trail.T, color=style.EDGE, linewidth=0.7 * width, linestyle=TRAIL, zorder=1.2)
        for i, path in enumerate(self.tip_paths(since, time).values()):
            axes.plot(*path.T, color=style.PALETTE[i % len(style.PALETTE)], linewidth=0.6 * width, zorder=1.3)
        draw_robot(axes, run.problem.model, Q, width)
        for stage in self.acting(time) if stages is None else stages:
            for i, point in enumerate(self.targets(stage, time)):
                color = style.PALETTE[(i - 1) % len(style.PALETTE)] if i else "black"
                axes.plot(*point, color=color, zorder=3.5, **TARGET)


def scene_of(run: Run) -> Scene:
    """Return a run as a scene."""
    spec = run.task.spec.object
    if spec is None:
        return Scene(run, np.inf, np.inf, False)
    names, ends = run.stage_names, run.stages["switch_time"]
    taken, left = (float(ends[index]) for index in (names.index(spec.taken_by), names.index(spec.let_go_by) - 1))
    taken, left = (time if np.isfinite(time) else np.inf for time in (taken, left))
    opened = min((_opened(run, monitor) for monitor in run.task.spec.monitors), default=np.inf)
    return Scene(run, taken, opened, True) if taken < opened < left else Scene(run, taken, left, False)


def _opened(run: Run, monitor: MonitorSpec) -> float:
    """Return when a monitor first finds two grippers too far apart [s]; infinite if it does not."""
    if monitor.quantity != "distance" or len(monitor.of) != 2 or "base" in monitor.of:
        return np.inf
    upper = monitor.model_copy(update={"below_start_at_most": None, "at_least": None})
    (verdict,) = verdicts((upper,), run.arrays)
    return verdict.broken_at if np.isfinite(verdict.broken_at) else np.inf


def scene_handles(scenes: Iterable[Scene]) -> list[Artist]:
    """Return what a legend says of drawings of these scenes."""
    every = list(scenes)
    model, spec = every[0].run.problem.model, every[0].run.task.spec.object
    handles: list[Artist] = [style.patch_entry("base", facecolor=style.BODY, edgecolor="black", linewidth=0.7)]
    handles += arm_handles(model)
    if spec is not None:
        handles.append(style.patch_entry("object", **object_look(lost=False)))
    if any(scene.lost for scene in every):
        handles.append(style.patch_entry("object, lost", **object_look(lost=True)))
    return [
        *handles,
        style.entry("target", color="black", **TARGET),
        style.entry("path of the base", color=style.EDGE, linewidth=0.7, linestyle=TRAIL),
        style.entry("path of an arm's end", color=style.PALETTE[0], linewidth=0.6),
    ]


def arm_handles(model: RobotModel) -> list[Artist]:
    """Return what a legend says of the arms."""
    return [
        style.entry(style.readable(name), color=style.PALETTE[i % len(style.PALETTE)], linewidth=1.5)
        for i, name in enumerate(model.spec.arms)
    ]


def draw_robot(axes: Axes, model: RobotModel, Q: np.ndarray, width: float = 1.0, alpha: float = 1.0) -> None:
    """Draw base, arms and grippers at Q (n,); `width` scales the lines, `alpha` their opacity."""
    look: dict[str, Any] = {"facecolor": style.BODY, "edgecolor": "black", "linewidth": 0.7 * width, "alpha": alpha}
    axes.add_patch(Polygon(base_outline(model, Q), zorder=2, **look))
    for i, points in enumerate(arm_points(model, Q).values()):
        color = style.PALETTE[i % len(style.PALETTE)]
        axes.plot(*points.T, color=color, linewidth=1.5 * width, solid_joinstyle="round", alpha=alpha, zorder=3)
        joints: dict[str, Any] = {"linestyle": "none", "marker": "o", "markerfacecolor": "white"}
        joints |= {"markersize": 2.2 * width, "markeredgewidth": 0.7 * width, "markeredgecolor": color}
        axes.plot(*points[:-1].T, alpha=alpha, zorder=3.1, **joints)
        axes.plot(*_fingers(points, reach(model)).T, color=color, linewidth=1.0 * width, alpha=alpha, zorder=3)


def object_look(lost: bool, width: float = 1.0) -> dict[str, Any]:
    """Return colours and lines of the object."""
    if lost:
        return {"facecolor": "none", "edgecolor": style.EDGE, "linewidth": 0.8 * width, "linestyle": (0, (3, 1.5))}
    return {"facecolor": style.OBJECT, "edgecolor": style.EDGE, "linewidth": 0.6 * width}


def carried(model: RobotModel, pose: np.ndarray, taken: np.ndarray, now: np.ndarray) -> np.ndarray:
    """Return where an object taken at `pose` (3,) with the robot at `taken` (n,) is with the robot at `now` (n,)."""
    before, after = grasp(model, taken), grasp(model, now)
    turned = after[2] - before[2]
    c, s = np.cos(turned), np.sin(turned)
    moved = after[:2] + np.array([[c, -s], [s, c]]) @ (pose[:2] - before[:2])
    return np.array([*moved, pose[2] + turned])


def grasp(model: RobotModel, Q: np.ndarray) -> np.ndarray:
    """Return the frame the object is held in (3,) [m, m, rad] at Q (n,)."""
    xi = np.asarray(model.g(Q)).ravel()
    poses = [xi[rows] for name, rows in model.pose_rows.items() if name != "base"]
    if len(poses) == 1:
        return np.asarray(poses[0])
    line = poses[1][:2] - poses[0][:2]
    return np.array([*np.mean([pose[:2] for pose in poses], axis=0), np.arctan2(line[1], line[0])])


def outline(model: RobotModel, Q: np.ndarray) -> np.ndarray:
    """Return points (., 2) [m] whose hull holds the robot at Q (n,)."""
    arms = arm_points(model, Q).values()
    return np.vstack([base_outline(model, Q), *(_fingers(points, reach(model)) for points in arms), *arms])


def base_outline(model: RobotModel, Q: np.ndarray) -> np.ndarray:
    """Return the corners (4, 2) [m] of the base: a box through the arms' mounts, for a spec gives no shape."""
    half = base_half(model)
    return rectangle(Q[:3], (2 * half[0], 2 * half[1]))


def base_half(model: RobotModel) -> np.ndarray:
    """Return half the length and half the width of the base's box (2,) [m]."""
    mounts = np.abs([arm.mount.position for arm in model.spec.arms.values()])
    half = np.maximum(mounts.max(axis=0), 0.1 * reach(model))
    return np.asarray(np.maximum(half, 0.6 * half.max()))


def reach(model: RobotModel) -> float:
    """Return the length of the longest arm [m]."""
    return max(sum(link.a + link.b for link in arm.links) for arm in model.spec.arms.values())


def rectangle(pose: np.ndarray, shape: tuple[float, float]) -> np.ndarray:
    """Return the corners (4, 2) [m] of a rectangle, length by width, at a pose (3,)."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * np.array(shape) / 2
    return np.asarray(pose[:2] + corners @ np.array([[c, s], [-s, c]]))


def _fingers(points: np.ndarray, length: float) -> np.ndarray:
    """Return a gripper's outline (4, 2) [m] at the end of an arm's polyline: two fingers along the last link."""
    link = points[-1] - points[-2]
    along = link / max(float(np.linalg.norm(link)), 1e-12) * FINGER * length
    across = np.array([-along[1], along[0]]) * 0.7
    tip = points[-1]
    return np.array([tip + across + along, tip + across, tip - across, tip - across + along])
