"""The robot, its object and the trail of its base, drawn to scale in the plane."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Polygon
from matplotlib.ticker import MultipleLocator

from psmpc_cli.figures.object_motion import held_between, object_pose
from psmpc_cli.figures.run import Run
from psmpc_cli.figures.style import BODY, EDGE, OBJECT, PALETTE
from psmpc_cli.robot.model import RobotModel, arm_points

FINGER = 0.09
"""Length of a gripper's finger, in lengths of the longest arm."""

TRAIL = (0, (2, 1.5))

MOST_TICKS = 6
"""Most ticks along the x axis."""

FLATTEST, TALLEST = 0.45, 1.6
"""Height over width of a view at least and at most; beyond, it shows more space."""


@dataclass(frozen=True)
class View:
    """What a panel shows: x and y from low to high [m]."""

    x: tuple[float, float]
    y: tuple[float, float]

    @property
    def step(self) -> float:
        """Distance of ticks [m], the same on both axes: 1, 2 or 5 times a power of ten."""
        width = self.x[1] - self.x[0]
        power = 10.0 ** np.floor(np.log10(width / MOST_TICKS))
        return float(power * next(step for step in (1, 2, 5, 10) if width <= MOST_TICKS * step * power))

    @property
    def aspect(self) -> float:
        """Height over width."""
        return (self.y[1] - self.y[0]) / (self.x[1] - self.x[0])


def view_of(run: Run, times: np.ndarray) -> View:
    """Return the smallest view, with a margin, that shows everything at all of these times [s]."""
    points = [_everything(run, float(time)) for time in times]
    return view_around(np.vstack([*points, run.Q[:, :2]]))


def view_around(inside: np.ndarray) -> View:
    """Return the smallest view, with a margin, that shows these points (., 2) [m]."""
    low, high = inside.min(axis=0), inside.max(axis=0)
    size = (high - low) + 0.08 * float(np.max(high - low))
    size = np.maximum(size, [size[1] / TALLEST, size[0] * FLATTEST])
    (left, bottom), (right, top) = (low + high - size) / 2, (low + high + size) / 2
    return View((left, right), (bottom, top))


def draw_scene(axes: Axes, run: Run, time: float, width: float = 1.0) -> None:
    """Draw object, trail, base, arms and grippers at a time [s]; `width` scales the lines."""
    Q, pose = run.coordinates_at(time), object_pose(run, time)
    if pose is not None and run.task.object is not None:
        corners = rectangle(pose, run.task.object.shape)
        hold = held_between(run)
        axes.add_patch(Polygon(corners, zorder=1, **object_look(hold.lost and time >= hold.end, width)))
    past = run.time <= time
    trail = np.vstack([run.Q[past, :2], Q[:2]])
    axes.plot(*trail.T, color=EDGE, linewidth=0.7 * width, linestyle=TRAIL, zorder=1.2)
    draw_robot(axes, run.model, Q, width)


def draw_robot(axes: Axes, model: RobotModel, Q: np.ndarray, width: float = 1.0, alpha: float = 1.0) -> None:
    """Draw base, arms and grippers at Q (n,); `width` scales the lines, `alpha` their opacity."""
    look: dict[str, Any] = {"facecolor": BODY, "edgecolor": "black", "linewidth": 0.7 * width, "alpha": alpha}
    axes.add_patch(Polygon(base_outline(model, Q), zorder=2, **look))
    for i, points in enumerate(arm_points(model, Q).values()):
        color = PALETTE[i % len(PALETTE)]
        axes.plot(*points.T, color=color, linewidth=1.5 * width, solid_joinstyle="round", alpha=alpha, zorder=3)
        joints: dict[str, Any] = {
            "linestyle": "none",
            "marker": "o",
            "markerfacecolor": "white",
            "markeredgecolor": color,
            "alpha": alpha,
        }
        axes.plot(*points[:-1].T, markersize=2.2 * width, markeredgewidth=0.7 * width, zorder=3.1, **joints)
        axes.plot(*_fingers(points, reach(model)).T, color=color, linewidth=1.0 * width, alpha=alpha, zorder=3)


def object_look(lost: bool, width: float = 1.0) -> dict[str, Any]:
    """Return how the object is drawn."""
    return {
        "facecolor": "none" if lost else OBJECT,
        "edgecolor": EDGE,
        "linewidth": (0.8 if lost else 0.6) * width,
        "linestyle": (0, (3, 1.5)) if lost else "-",
    }


def show(axes: Axes, view: View) -> None:
    """Set a panel's view, with equal scales."""
    axes.set_xlim(view.x)
    axes.set_ylim(view.y)
    axes.set_aspect("equal")
    axes.xaxis.set_major_locator(MultipleLocator(view.step))
    axes.yaxis.set_major_locator(MultipleLocator(view.step))


def base_outline(model: RobotModel, Q: np.ndarray) -> np.ndarray:
    """Return the corners (4, 2) [m] of the base: a box through the arms' mounts, for a spec gives no shape."""
    mounts = np.abs([arm.mount.position for arm in model.spec.arms.values()])
    half = np.maximum(mounts.max(axis=0), 0.1 * reach(model))
    half = np.maximum(half, 0.6 * half.max())
    return rectangle(Q[:3], (2 * half[0], 2 * half[1]))


def reach(model: RobotModel) -> float:
    """Return the length of the longest arm [m]."""
    return max(sum(link.a + link.b for link in arm.links) for arm in model.spec.arms.values())


def _everything(run: Run, time: float) -> np.ndarray:
    """Return points (., 2) [m] whose hull holds the robot and the object at a time [s]."""
    Q, pose = run.coordinates_at(time), object_pose(run, time)
    shape = None if run.task.object is None else run.task.object.shape
    return np.vstack([outline(run.model, Q), *([] if pose is None or shape is None else [rectangle(pose, shape)])])


def outline(model: RobotModel, Q: np.ndarray) -> np.ndarray:
    """Return points (., 2) [m] whose hull holds the robot at Q (n,)."""
    arms = arm_points(model, Q).values()
    return np.vstack([base_outline(model, Q), *(_fingers(points, reach(model)) for points in arms), *arms])


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
