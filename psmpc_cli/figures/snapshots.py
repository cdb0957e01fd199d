"""The robot in the plane: at the key instants of a run or of several, and what a task asks for. Paper Figs. 4 and 5."""

from collections.abc import Mapping, Sequence
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from matplotlib.ticker import MaxNLocator, MultipleLocator
from matplotlib.transforms import Bbox

from psmpc_cli.figures import style
from psmpc_cli.figures.scene import (
    NO_BREAK,
    Scene,
    bodies,
    configurations,
    object_poses,
    outline,
    rectangle,
    scene_of,
    view_around,
)
from psmpc_cli.figures.timeline import runs_of
from psmpc_cli.logs.run import Run
from psmpc_cli.ocp.problem import build_stages
from psmpc_cli.robot.model import RobotModel, build_model
from psmpc_cli.specs.load import Task

AXIS, AROUND = 0.3, 0.45
"""Height of the axis below the panels; width of the axis left of them [in]."""

ACROSS = 4
"""Frames, or stages, side by side on a page."""

FAINT = 0.25
"""Opacity of the robot where a stage begins."""

TRAIL: Mapping[str, Any] = {"color": style.EDGE, "linewidth": 0.7, "linestyle": (0, (2, 1.5))}
"""Look of the path of the base."""

TARGET: Mapping[str, Any] = {"linestyle": "none", "marker": "+", "markersize": 5.5, "markeredgewidth": 0.9}
"""Look of a target."""

BASE: Mapping[str, Any] = {"facecolor": style.BODY, "edgecolor": "black", "linewidth": 0.7}
"""Look of the base."""

OBJECT: Mapping[str, Any] = {"facecolor": style.OBJECT, "edgecolor": style.EDGE, "linewidth": 0.6}
"""Look of the object."""

LOST: Mapping[str, Any] = {"facecolor": "none", "edgecolor": style.EDGE, "linewidth": 0.8, "linestyle": (0, (3, 1.5))}
"""Look of the object that was lost."""


def plot_snapshots(runs: Run | Mapping[str, Run]) -> Figure:
    """Plot the robot at each key instant of a run, or of several where their stages end; all to the same scale [m].

    Several runs have a row, or several, for each controller. A panel shows the targets of the stages that act, the path
    of the base, and the paths of the end-effectors since the panel before.
    """
    names = [""] if isinstance(runs, Run) else [f"{style.title_of(name)}\n" for name in runs]
    scenes, one = [scene_of(run) for run in runs_of(runs)], isinstance(runs, Run)
    frames = [scene.key_instants() if one else scene.switches() for scene in scenes]
    most = max(1, *map(len, frames))
    width, across = (style.COLUMN, min(2, most)) if one and most <= 10 else (style.PAGE, min(ACROSS, most))
    room = -(-most // across) * across  # panels of a run
    titles: list[str] = []
    for shown in frames:
        titles += [*(f"{time:.1f}{NO_BREAK}s: {event}" for time, event in shown), *[""] * (room - len(shown))]
    times = [[float(scene.run.motion.time[0]), *dict(shown)] for scene, shown in zip(scenes, frames, strict=True)]
    view = view_around(np.vstack([scene.extent(drawn) for scene, drawn in zip(scenes, times, strict=True)]))
    figure, grid = _panels(view, titles, across, width)
    for block, scene, drawn, name in zip(grid.reshape(len(scenes), -1), scenes, times, names, strict=True):
        for axes, since, time in zip(block, drawn, drawn[1:], strict=False):
            draw_scene(axes, scene, time, since)
        for axes in block[::across]:
            axes.set_ylabel(f"{name}y (m)")
    style.add_legend(figure, _handles(scenes))
    return figure


def _panels(view: Bbox, titles: Sequence[str], columns: int, width: float) -> tuple[Figure, np.ndarray]:
    """Return a figure and its panels, all to one scale, one below each title; those without a title are empty.

    Titles are broken between words to the width of a panel.
    """
    titles = [*titles, *[""] * (-len(titles) % columns)]
    across, rows = (width - AROUND) / columns, len(titles) // columns
    characters = int(across / style.CHARACTER)
    broken = ["\n".join(fill(line, characters) for line in title.split("\n")) for title in titles]
    lines = 1 + max(title.count("\n") for title in broken)
    axis = AXIS * (1 + ("" in titles))  # also above vacant panels
    figure = style.new_figure(rows * (across * view.height / view.width + lines * style.LINE + 0.08) + axis, width)
    grid: np.ndarray = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    for i, axes in enumerate(grid):
        if not titles[i]:
            axes.set_axis_off()
            continue
        show(axes, view)
        axes.set_title(broken[i], loc="left", pad=2, fontsize=style.TEXT)
        if i % columns == 0:
            axes.set_ylabel("y (m)")
        if not any(titles[i + columns :: columns]):
            axes.set_xlabel("x (m)")
            axes.tick_params(labelbottom=True)
    return figure, grid


def show(axes: Axes, view: Bbox) -> None:
    """Set a panel's limits and ticks, with equal scales."""
    step = float(np.ptp(MaxNLocator(6, steps=[1, 2, 5, 10]).tick_values(*view.intervalx)[:2]))
    axes.set_xlim(view.intervalx)
    axes.set_ylim(view.intervaly)
    axes.set_aspect("equal")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MultipleLocator(step))


def draw_scene(axes: Axes, scene: Scene, time: float, since: float, width: float = 1.0) -> None:
    """Draw object, paths, robot and the targets of the stages that act.

    Args:
        axes: A panel.
        scene: What is drawn.
        time: The time [s].
        since: From when on the paths of the end-effectors are drawn [s].
        width: Scales the lines.
    """
    run = scene.run
    if run.task.spec.object is not None:
        _draw_area(axes, scene.object_corners(time), LOST if scene.lost and time >= scene.left else OBJECT, width)
    trail, *_ = scene.paths(float(run.motion.time[0]), time)
    axes.plot(*trail.T, zorder=1.2, **{**TRAIL, "linewidth": TRAIL["linewidth"] * width})
    for i, path in enumerate(scene.paths(since, time)[1:]):
        axes.plot(*path.T, color=_arm_color(i), linewidth=0.6 * width, zorder=1.3)
    draw_robot(axes, run.problem.model, run.motion.coordinates_at(time), width)
    for stage in scene.acting(time):
        for i, point in enumerate(scene.targets(stage, time)):
            axes.plot(*point, color=_arm_color(i - 1) if i else "black", zorder=3.5, **TARGET)


def draw_robot(axes: Axes, model: RobotModel, Q: np.ndarray, width: float = 1.0, alpha: float = 1.0) -> None:
    """Draw base, arms and grippers at Q (n,); `width` scales the lines."""
    base, arms = bodies(model, Q)
    _draw_area(axes, base, {**BASE, "alpha": alpha}, width, 2.0)
    for i, (points, gripper) in enumerate(arms):
        line: dict[str, Any] = {"color": _arm_color(i), "alpha": alpha, "zorder": 3.0}
        axes.plot(*points.T, linewidth=1.5 * width, solid_joinstyle="round", **line)
        axes.plot(*gripper.T, linewidth=1.0 * width, **line)
        edge = 0.7 * width
        axes.plot(*points[:-1].T, "o", markersize=2.2 * width, markeredgewidth=edge, markerfacecolor="white", **line)


def _draw_area(axes: Axes, corners: np.ndarray, look: Mapping[str, Any], width: float = 1.0, zorder: float = 1) -> None:
    axes.add_patch(Polygon(corners, zorder=zorder, **{**look, "linewidth": look["linewidth"] * width}))


def _arm_color(index: int) -> str:
    return style.PALETTE[index % len(style.PALETTE)]


def _arm_handles(model: RobotModel) -> list[Artist]:
    """Return what a legend says of the arms."""
    arms = enumerate(map(style.readable, model.spec.arms))
    return [style.entry(name, color=_arm_color(i), linewidth=1.5) for i, name in arms]


def _handles(scenes: Sequence[Scene]) -> list[Artist]:
    """Return what a legend says of drawings of these scenes."""
    run = scenes[0].run
    handles = [style.patch_entry("base", **BASE), *_arm_handles(run.problem.model)]
    if run.task.spec.object is not None:
        handles.append(style.patch_entry("object", **OBJECT))
    if any(scene.lost for scene in scenes):
        handles.append(style.patch_entry("object, lost", **LOST))
    return [
        *handles,
        style.entry("target", color="black", **TARGET),
        style.entry("path of the base", **TRAIL),
        style.entry("path of an arm's end", color=style.PALETTE[0], linewidth=0.6),
    ]


def plot_scenario(task: Task) -> Figure:
    """Plot a task before anything has run: a panel for each stage with the robot at its target, and the object.

    The robot is faint where the stage begins.
    """
    model = build_model(task.robot)
    stages = build_stages(task.spec, task.robot, model)
    stops, thing = configurations(task, model, stages), task.spec.object
    objects = [rectangle(pose, thing.shape) for pose in object_poses(task, model, stops)] if thing is not None else []
    view = view_around(np.vstack([*(outline(model, Q) for Q in stops), *objects]))
    titles = [f"{i}. {style.readable(stage.name)}, priority {stage.priority:g}" for i, stage in enumerate(stages, 1)]
    figure, grid = _panels(view, titles, min(2, len(stages)), style.COLUMN)
    for i, axes in enumerate(grid[: len(stages)]):
        for corners in objects[i : i + 1]:
            _draw_area(axes, corners, OBJECT)
        draw_robot(axes, model, stops[i], alpha=FAINT)
        draw_robot(axes, model, stops[i + 1])
    handles: list[Artist] = [style.patch_entry("base at the target", **BASE)]
    handles += [style.patch_entry("where the stage begins", alpha=FAINT, **BASE), *_arm_handles(model)]
    handles += [style.patch_entry("object", **OBJECT)] * bool(objects)
    style.add_legend(figure, handles)
    return figure
