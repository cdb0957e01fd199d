"""The robot drawn: at the key instants of a run or of several, and what a task asks for. Paper Figs. 4 and 5."""

from collections.abc import Mapping, Sequence
from itertools import product
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from matplotlib.ticker import MaxNLocator, MultipleLocator, NullLocator
from matplotlib.transforms import Bbox
from scipy.spatial import ConvexHull

from psmpc_cli.figures import style
from psmpc_cli.figures.scene import (
    FRONT,
    NO_BREAK,
    OBLIQUE,
    PLAN,
    SIDE,
    Camera,
    Scene,
    base_half,
    camera_of,
    configurations,
    corners,
    half_edges,
    looked_at,
    object_frames,
    outline,
    placed,
    scene_of,
    with_shadows,
)
from psmpc_cli.figures.timeline import runs_of
from psmpc_cli.logs.run import Run
from psmpc_cli.ocp.problem import build_stages
from psmpc_cli.robot.model import RobotModel, pose_frames
from psmpc_cli.specs.load import Task
from psmpc_cli.specs.robot import RobotSpec, resolve_limits

AXIS, AROUND = 0.3, 0.45
"""Height of the axis below the panels; width of the axis left of them [in]."""

ACROSS = 4
"""Frames, or stages, side by side on a page."""

NEARER = 100.0
"""Order of a body by how near to the viewer it is [1/m]."""

ARROW: Mapping[str, Any] = {
    "arrowstyle": "-|>,head_width=0.12,head_length=0.25",
    "linewidth": 0.6,
    "shrinkA": 0,
    "shrinkB": 0,
}
"""Look of a direction."""

VIEWS = {PLAN: "", FRONT: "", SIDE: "", OBLIQUE: "seen from azimuth −60°, elevation 25°, in parallel projection"}
"""From where robots are shown, and how panels say so."""

JOINT: Mapping[str, Any] = {
    "color": "black",
    "linewidth": 0.6,
    "marker": "o",
    "markersize": 2.2,
    "markerfacecolor": "w",
}
"""Look of a joint with its axis."""

FAINT = 0.25
"""Opacity of the robot where a stage begins."""

TRAIL: Mapping[str, Any] = {"color": style.EDGE, "linewidth": 0.7, "linestyle": (0, (2, 1.5))}
"""Look of the path of the base."""

TARGET: Mapping[str, Any] = {"linestyle": "none", "marker": "+", "markersize": 5.5, "markeredgewidth": 0.9}
"""Look of a target."""

TRIAD = ("#000000", "#808080", "#C0C0C0")
"""Colours of the x, y and z axis of a frame."""

UNDER, FLOOR, SHADOW = -1e4, "#E0E0E0", "#EFEFEF"
"""Order of what lies under all bodies of a spatial scene; colours of the squares below it and of the shadow on them."""

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
    camera = scenes[0].camera
    extent = np.vstack([scene.extent(drawn) for scene, drawn in zip(scenes, times, strict=True)])
    figure, grid = _panels(camera, extent, titles, across, width)
    for block, scene, drawn, name in zip(grid.reshape(len(scenes), -1), scenes, times, names, strict=True):
        for axes, since, time in zip(block, drawn, drawn[1:], strict=False):
            draw_scene(axes, scene, time, since, extent)
        for axes in block[::across]:
            axes.set_ylabel(f"{name}{axes.get_ylabel()}")
    style.add_legend(figure, _handles(scenes), title=describe(camera, extent, width))
    return figure


def _panels(
    camera: Camera, extent: np.ndarray, titles: Sequence[str], columns: int, width: float
) -> tuple[Figure, np.ndarray]:
    """Return a figure and its panels, all to one scale, one below each title; those without a title are empty.

    They show points (., 3) [m]. Titles are broken between words to the width of a panel.
    """
    view, labels = camera.view(extent), camera.labels
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
        show(axes, camera, view)
        axes.set_title(broken[i], loc="left", pad=2, fontsize=style.TEXT)
        if i % columns == 0 and labels:
            axes.set_ylabel(labels[1])
        if not any(titles[i + columns :: columns]) and labels:
            axes.set_xlabel(labels[0])
            axes.tick_params(labelbottom=True)
    if not labels:
        _draw_directions(grid[0], camera, extent)
    return figure, grid


def describe(camera: Camera, extent: np.ndarray, width: float = style.COLUMN) -> str:
    """Describe from where a spatial scene is seen, and what lies under it, in lines of a width [in]."""
    if camera.labels:
        return ""
    seen = f"Seen from azimuth {camera.azimuth:g}°, elevation {camera.elevation:g}°, in parallel projection; squares"
    text = f"{seen} of 1 m at z = {extent[:, 2].min():.1f} m with the robot's shadow"
    return fill(text.replace("-", "\N{MINUS SIGN}"), int(width / style.CHARACTER))


def _draw_directions(axes: Axes, camera: Camera, extent: np.ndarray) -> None:
    """Draw the directions of x, y and z in the corner of a view that is farthest from all points (., 3) in it."""
    view, seen = camera.view(extent), camera.see(extent)
    length = 0.08 * view.width
    inner = view.get_points() + 1.7 * length * np.array([[1], [-1]])
    corner = max(Bbox(inner).corners(), key=lambda corner: float(np.linalg.norm(seen - corner, axis=1).min()))
    for name, direction in zip("xyz", camera.see(length * np.eye(3)), strict=True):
        axes.annotate("", tuple(corner + direction), tuple(corner), arrowprops={**ARROW, "zorder": -UNDER})
        x, y = corner + 1.5 * direction
        axes.text(x, y, name, fontsize=style.TEXT, ha="center", va="center")


def show(axes: Axes, camera: Camera, view: Bbox, ticks: int = 6) -> None:
    """Set a panel's limits and ticks, with equal scales; without ticks where an axis has no name."""
    step = float(np.ptp(MaxNLocator(ticks, steps=[1, 2, 5, 10]).tick_values(*view.intervalx)[:2]))
    axes.set_xlim(view.intervalx)
    axes.set_ylim(view.intervaly)
    axes.set_aspect("equal")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MultipleLocator(step) if camera.labels else NullLocator())


def draw_scene(axes: Axes, scene: Scene, time: float, since: float, extent: np.ndarray, width: float = 1.0) -> None:
    """Draw object, paths, robot and the targets of the stages that act.

    Args:
        axes: A panel.
        scene: What is drawn.
        time: The time [s].
        since: From when on the paths of the end-effectors are drawn [s].
        extent: Points (., 3) in the view [m]; below them are the squares of a spatial scene.
        width: Scales the lines.
    """
    run, camera, model = scene.run, scene.camera, scene.run.problem.model
    spatial, Q = model.dimension == 3, run.motion.coordinates_at(time)
    if (frame := scene.object_frame(time)) is not None and run.task.spec.object is not None:
        look = LOST if scene.lost and time >= scene.left else OBJECT
        _draw_box(axes, camera, frame, half_edges(run.task.spec.object.shape), look, width, 1.0)
    if spatial:
        _draw_floor(axes, camera, model, Q, extent)
    under = UNDER if spatial else 0.0
    trail, *_ = camera.see(scene.paths(float(run.motion.time[0]), time))
    axes.plot(*trail.T, zorder=under + 1.2, **{**TRAIL, "linewidth": TRAIL["linewidth"] * width})
    for i, path in enumerate(camera.see(scene.paths(since, time))[1:]):
        axes.plot(*path.T, color=_arm_color(i), linewidth=0.6 * width, zorder=under + 1.3)
    draw_robot(axes, camera, model, Q, width)
    for stage in scene.acting(time):
        for i, target in enumerate(scene.target_frames(stage, time)):
            if spatial:
                _draw_triad(axes, camera, target, 0.25 * model.shape.reach, width)
            look = {**TARGET, "marker": ".", "markersize": 3.0} if spatial else TARGET
            color = _arm_color(i - 1) if i else "black"
            axes.plot(*camera.see(target[:3, 3]), color=color, zorder=3.5 - under, **look)


def draw_robot(
    axes: Axes, camera: Camera, model: RobotModel, Q: np.ndarray, width: float = 1.0, alpha: float = 1.0
) -> None:
    """Draw base, arms and grippers at Q (nq,); `width` scales the lines."""
    shape, frames, arms = model.shape, model.body_frames(Q), list(model.spec.arms)
    _draw_box(axes, camera, frames[0] @ shape.box_frame, base_half(model), {**BASE, "alpha": alpha}, width, 2.0)
    grippers = {tool.body: [shape.grippers[name]] for name, tool in model.spec.tools.items()}
    for number, (body, frame) in enumerate(zip(model.spec.bodies, frames, strict=True)):
        arm = body.name.rpartition(".")[0]
        line: dict[str, Any] = {"color": _arm_color(arms.index(arm)) if arm else style.EDGE, "alpha": alpha}
        lines = [(1.5, placed(frame, ends)) for ends in shape.capsules[number]]
        lines += [(1.0, placed(frame, points)) for points in grippers.get(number, ())]
        for thick, points in lines:
            order = 3.0 + NEARER * camera.depth(points)
            axes.plot(*camera.see(points).T, linewidth=thick * width, solid_capstyle="round", zorder=order, **line)
        if arm:
            joint = {"marker": "s" if body.joint and body.joint.prismatic else "o", "markersize": 2.2 * width, **line}
            order = 3.1 + NEARER * max(camera.depth(points) for points in (frame[:3, 3], *(line[1] for line in lines)))
            edge = 0.7 * width
            axes.plot(*camera.see(frame[:3, 3]), markeredgewidth=edge, markerfacecolor="white", zorder=order, **joint)


def _draw_box(
    axes: Axes,
    camera: Camera,
    frame: np.ndarray,
    half: np.ndarray,
    look: Mapping[str, Any],
    width: float = 1.0,
    zorder: float = 1.0,
) -> None:
    """Draw the faces towards the viewer of a box with half edges (3,) in a frame (4, 4), those aside darker."""
    for axis, sign in product(range(3), (-1, 1)):
        towards = float(sign * frame[:3, axis] @ camera.axes[2])
        if towards > 1e-6 and np.delete(half, axis).min() > 0:
            signs = np.insert([[1, 1], [-1, 1], [-1, -1], [1, -1]], axis, sign, axis=1)
            points = placed(frame, signs * half)
            order = zorder + NEARER * camera.depth(points)
            given = {**look, "linewidth": look["linewidth"] * width, "zorder": order}
            if look["facecolor"] != "none":
                given["facecolor"] = np.array(to_rgb(look["facecolor"])) * (0.7 + 0.3 * towards)
            axes.add_patch(Polygon(camera.see(points), **given))


def _draw_triad(axes: Axes, camera: Camera, frame: np.ndarray, length: float, width: float) -> None:
    """Draw the axes of a frame (4, 4); none where it has no attitude."""
    for color, axis in zip(TRIAD, frame[:3, :3].T, strict=True):
        ends = camera.see(np.array([frame[:3, 3], frame[:3, 3] + length * axis]))
        axes.plot(*ends.T, color=color, linewidth=0.8 * width, zorder=3.4 - UNDER)


def _draw_floor(axes: Axes, camera: Camera, model: RobotModel, Q: np.ndarray, extent: np.ndarray) -> None:
    """Draw squares of 1 m below a scene, and on them the shadow of the robot from straight above."""
    low, high, floor = np.floor(extent.min(axis=0)), np.ceil(extent.max(axis=0)), extent[:, 2].min()
    for axis in (0, 1):
        for at in np.arange(low[axis], high[axis] + 0.5):
            ends = np.insert([[low[1 - axis]], [high[1 - axis]]], axis, at, axis=1)
            axes.plot(*camera.see(np.column_stack([ends, [floor] * 2])).T, color=FLOOR, linewidth=0.5, zorder=2 * UNDER)
    below = camera.see([0, 0, 1]) * floor
    flat, shape, frames = np.diag([1.0, 1.0, 0.0]), model.shape, model.body_frames(Q)
    hull = corners(frames[0] @ shape.box_frame, shape.box) @ flat
    shadow = ConvexHull(hull[:, :2]).vertices
    axes.add_patch(Polygon(camera.see(hull[shadow]) + below, facecolor=SHADOW, zorder=1.5 * UNDER))
    for frame, capsules in zip(frames, shape.capsules, strict=True):
        for ends in placed(frame, capsules):
            axes.plot(*(camera.see(ends @ flat) + below).T, color=SHADOW, linewidth=2.0, zorder=1.5 * UNDER)


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
    if run.problem.model.dimension == 3:
        axis = zip("xyz", TRIAD, strict=True)
        handles += [style.entry(f"{name} axis of a target", color=color, linewidth=0.8) for name, color in axis]
    else:
        handles.append(style.entry("target", color="black", **TARGET))
    return [
        *handles,
        style.entry("path of the base", **TRAIL),
        style.entry("path of an arm's end", color=style.PALETTE[0], linewidth=0.6),
    ]


def plot_robot(spec: RobotSpec) -> Figure:
    """Plot a robot at rest at joint coordinates 0, or the nearest within its limits [m].

    Joints have their numbers and axes, base and end-effectors their frames. A spatial robot is seen from four sides.
    """
    model, limits = RobotModel(spec), resolve_limits(spec)
    rest = np.clip(0.0, limits.position_low, limits.position_high)[model.parts["base"].stop :]
    Q, size = np.r_[np.zeros(model.nq - len(rest)), rest], 0.2 * model.shape.reach
    Q[3:4] = 1.0 if model.dimension == 3 else Q[3:4]
    frames = pose_frames(model.poses(Q))
    points = np.vstack([outline(model, Q), *(placed(frame, size * np.eye(3)[: model.dimension]) for frame in frames)])
    low, high = points.min(axis=0) - 0.04 * np.ptp(points), points.max(axis=0) + 0.04 * np.ptp(points)
    box = corners(pose_frames([*(low + high) / 2, 1, 0, 0, 0]), (high - low) / 2)
    scale = (style.COLUMN - 0.9) / float((high - low)[: model.dimension - 1].sum())
    figure, panels = _robot_panels(box, OBLIQUE.view(points), scale, model.dimension)
    for camera, axes in panels.items():
        seen = camera.see(box)
        view = Bbox([seen.min(axis=0), seen.max(axis=0)]) if camera.labels else camera.view(points)
        show(axes, camera, view, ticks=max(1, int(view.width * scale / 0.45)))
        axes.set_title(VIEWS[camera], loc="left", pad=2, fontsize=style.TEXT)
        axes.set(**dict(zip(("xlabel", "ylabel"), camera.labels or ("", ""), strict=True)))
        draw_robot(axes, camera, model, Q)
        for frame in frames:
            _draw_triad(axes, camera, frame, size, 1.0)
    _number_joints(axes, camera, model, Q)
    mass = sum(body.mass for body in spec.bodies)
    figure.suptitle(f"{spec.name.replace('_', ' ')}: {mass:.4g} kg, {model.n} coordinates", fontsize=style.TEXT)
    axis = zip("xyz"[: model.dimension], TRIAD, strict=False)
    handles = [style.patch_entry("base", **BASE), *_arm_handles(model)]
    handles += [style.entry(f"{name} axis of a frame", color=color, linewidth=0.8) for name, color in axis]
    style.add_legend(figure, [*handles, style.entry("joint, its axis", **JOINT)])
    return figure


def _robot_panels(box: np.ndarray, aside: Bbox, scale: float, dimension: int) -> tuple[Figure, dict[Camera, Axes]]:
    """Return a figure and its panels by camera, for a box with corners (8, 3) [m], to a scale [in/m]."""
    x, y, z = np.ptp(box, axis=0).tolist()
    if dimension == 2:
        figure = style.new_figure(scale * y + 0.9)
        return figure, {PLAN: figure.add_subplot()}
    heights = [(style.COLUMN - 0.1) * aside.height / aside.width, scale * y + 0.5, scale * z + 0.5]
    figure = style.new_figure(sum(heights) + 0.3)
    layout: list[Any] = [["oblique", "oblique"], ["plan", "."], ["front", "side"]]
    found = figure.subplot_mosaic(layout, width_ratios=[x, y], height_ratios=heights)
    return figure, {PLAN: found["plan"], FRONT: found["front"], SIDE: found["side"], OBLIQUE: found["oblique"]}


def _number_joints(axes: Axes, camera: Camera, model: RobotModel, Q: np.ndarray) -> None:
    """Write numbers beside the joints of each arm, one text for those in one place, and draw their axes."""
    near, frames = 0.06 * float(np.ptp(axes.get_xlim())), model.body_frames(Q)
    for index, arm in enumerate(model.spec.arms):
        places: list[tuple[np.ndarray, list[str]]] = []
        for body, frame in zip(model.spec.bodies, frames, strict=True):
            of, _, number = body.name.rpartition(".")
            if of != arm or body.joint is None:
                continue
            at = camera.see(frame[:3, 3])
            if not places or np.linalg.norm(at - places[-1][0]) > near:
                places.append((at, []))
            places[-1][1].append(number)
            ends = placed(frame, 1.5 * model.shape.radius * np.multiply.outer([-1, 1], body.joint.axis))
            axes.plot(*camera.see(ends).T, color=JOINT["color"], linewidth=JOINT["linewidth"], zorder=3.3 - UNDER)
        for (x, y), names in places:
            look: dict[str, Any] = {"fontsize": style.TEXT, "ha": "center", "color": _arm_color(index)}
            offset = (0, 4 if index % 2 == 0 else -10)
            axes.annotate(", ".join(names), (x, y), offset, textcoords="offset points", zorder=3.6 - UNDER, **look)


def plot_scenario(task: Task) -> Figure:
    """Plot a task before anything has run: a panel for each stage with the robot at its target, and the object.

    The robot is faint where the stage begins.
    """
    model = RobotModel(task.robot)
    stages = build_stages(task.spec, task.robot, model)
    stops, thing, camera = configurations(task, model, stages), task.spec.object, camera_of(model)
    half, objects = half_edges(thing.shape if thing else (0.0, 0.0)), object_frames(task, model, stops)
    points = [looked_at(model, stage) for stage in stages]
    extent = with_shadows([outline(model, Q) for Q in stops], [*(corners(frame, half) for frame in objects), *points])
    titles = [f"{i}. {style.readable(stage.name)}, priority {stage.priority:g}" for i, stage in enumerate(stages, 1)]
    figure, grid = _panels(camera, extent, titles, min(2, len(stages)), style.COLUMN)
    for i, axes in enumerate(grid[: len(stages)]):
        if model.dimension == 3:
            _draw_floor(axes, camera, model, stops[i + 1], extent)
        for frame in objects[i : i + 1]:
            _draw_box(axes, camera, frame, half, OBJECT)
        draw_robot(axes, camera, model, stops[i], alpha=FAINT)
        draw_robot(axes, camera, model, stops[i + 1])
        for arm, point in enumerate(camera.see(points[i])):
            axes.plot(*point, color=_arm_color(arm), zorder=-UNDER, **TARGET)
    handles: list[Artist] = [style.patch_entry("base at the target", **BASE)]
    handles += [style.patch_entry("where the stage begins", alpha=FAINT, **BASE), *_arm_handles(model)]
    handles += [style.patch_entry("object", **OBJECT)] * bool(objects)
    handles += [style.entry("point to look at", color="black", **TARGET)] * any(map(len, points))
    style.add_legend(figure, handles, title=describe(camera, extent))
    return figure
