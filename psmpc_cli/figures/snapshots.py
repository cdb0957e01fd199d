"""The robot drawn: at the key instants of a run or of several, and what a task asks for. Paper Figs. 4 and 5."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise, product
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from matplotlib.ticker import MaxNLocator, MultipleLocator
from matplotlib.transforms import Bbox
from scipy.spatial import ConvexHull

from psmpc_cli.figures import style
from psmpc_cli.figures.scene import (
    CAMERAS,
    FRONT,
    OBLIQUE,
    PLAN,
    SIDE,
    Camera,
    Scene,
    base_half_edges,
    box_corners,
    capsules,
    half_edges,
    in_inertial_frame,
    object_frames,
    obstacle_frame,
    pointing_targets,
    points_around_robot,
    points_with_shadows,
    scene_of,
)
from psmpc_cli.figures.solids import (
    ABOVE_ALL,
    ADVICE_ORDER,
    BASE_ORDER,
    BELOW_ALL,
    COVER_ORDER,
    DEPTH_ORDER,
    FLOOR_ORDER,
    JOINT_ORDER,
    LINK_ORDER,
    SHADOW_COLOR,
    SHADOW_ORDER,
    capsule_outline,
    draw_box,
    draw_shadow,
    draw_shape,
)
from psmpc_cli.figures.timeline import runs_as_list
from psmpc_cli.logs.run import Run
from psmpc_cli.ocp.feasibility.posing import Posing, posings
from psmpc_cli.ocp.feasibility.postures import configurations_at_stops
from psmpc_cli.ocp.problem import build_stages
from psmpc_cli.ocp.stage import Stage
from psmpc_cli.robot.configuration import pose_frames
from psmpc_cli.robot.geometry import Piece, pieces_of
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.geometry import ObstacleSpec
from psmpc_cli.specs.load import Task
from psmpc_cli.specs.robots.robot import RobotSpec, resolve_limits

PANELS_ACROSS = 4
"""Most panels side by side on a page."""

MOST_IN_COLUMN = 10
"""Most panels of a run with which its figure is as wide as one column of text."""

AXIS_ROOM = 0.45
"""Width of the axis left of the panels [in]."""

FINER_STEPS = (1.0, 0.5, 0.4, 0.2, 0.1, 0.05, 0.02, 0.01)
"""Steps of ticks to try on an axis that is so short that it would have one tick or none, in steps of the others."""


@dataclass(frozen=True)
class SceneLook:
    """How scenes of robots of a dimension are drawn.

    Attributes:
        views: From where a robot at rest is seen, panel by panel.
        floor: Whether there are squares below, with shadows.
        triads: Whether targets have the axes of their frames.
        target: How a target is marked besides.
        path_order: What is added to the drawing order of paths.
    """

    views: list[list[Any]]
    floor: bool = False
    triads: bool = False
    target: Mapping[str, Any] = field(default_factory=dict)
    path_order: float = 0.0


SCENE_LOOKS = {
    2: SceneLook(views=[[PLAN]]),
    3: SceneLook(
        views=[[OBLIQUE, OBLIQUE], [PLAN, "."], [FRONT, SIDE]],
        floor=True,
        triads=True,
        target={"marker": ".", "markersize": 3.0},
        path_order=BELOW_ALL,
    ),
}
"""By dimension."""

FAINT_OPACITY = 0.25
"""Opacity of the robot where a stage begins."""

NUMBER_OFFSETS = np.array([(8.0 * x, -7.5 * away) for away in (1, 1.5, 2, 3, 4, 6, 8) for x in (0, 1, -1, 2, -2)])
"""Where a joint's number may be: offsets from the joint (., 2), the nearest first [pt]."""

POINTS_PER_INCH = 72
"""Points, the unit of sizes of texts, in an inch."""

FLOOR_COLOR = "#E0E0E0"
"""Colour of the squares below a scene."""

TRIAD_COLORS = {"x": "#000000", "y": "#808080", "z": "#C0C0C0"}
"""Colours of the axes of a frame."""


def plot_snapshots(runs: Run | Mapping[str, Run]) -> Figure:
    """Plot the robot at the times of a run at which something happens, all panels to one scale [m].

    Of a single run these are its start and end, early starts of stages, switches, and the loss of the object. Of
    several runs they are the ends of the stages, and each run has one or more rows of panels of its own. A panel shows
    the targets of the stages that act then, the path of the base, and the paths of the end-effectors since the panel
    before.

    Args:
        runs: A run, or several by controller.
    """
    is_one_run = isinstance(runs, Run)
    # what stands before the vertical labels of each run's rows
    names = [""] if isinstance(runs, Run) else [f"{style.escape_dollars(style.title_of(name))}\n" for name in runs]
    scenes = [scene_of(run) for run in runs_as_list(runs)]
    instants = [scene.key_instants() if is_one_run else scene.switches() for scene in scenes]
    most_panels = max(1, *map(len, instants))
    in_one_column = is_one_run and most_panels <= MOST_IN_COLUMN
    width = style.COLUMN if in_one_column else style.PAGE
    columns = min(2 if in_one_column else PANELS_ACROSS, most_panels)
    panels_of_a_run = -(-most_panels // columns) * columns  # whole rows

    titles: list[str] = []
    for instants_of_run in instants:
        titles += [f"{time:.1f}\N{NO-BREAK SPACE}s: {event}" for time, event in instants_of_run]
        titles += [""] * (panels_of_a_run - len(instants_of_run))
    # for each run its start, from which the first paths are drawn, and the times of its panels
    times = [
        [float(scene.run.motion.time[0]), *dict(instants_of_run)]  # the keys are times
        for scene, instants_of_run in zip(scenes, instants, strict=True)
    ]
    camera = scenes[0].camera
    extent = np.vstack([scene.extent(times_of_run) for scene, times_of_run in zip(scenes, times, strict=True)])

    figure, grid = _titled_panels(camera, extent, titles, columns, width)
    blocks = grid.reshape(len(scenes), -1)
    for block, scene, times_of_run, name in zip(blocks, scenes, times, names, strict=True):
        for axes, since, time in zip(block, times_of_run, times_of_run[1:], strict=False):
            draw_scene(axes, scene, time, since, extent)
        for axes in block[::columns]:
            axes.set_ylabel(f"{name}{axes.get_ylabel()}")
    return style.finish(figure, describe_view(camera, extent, width))


def _titled_panels(
    camera: Camera, extent: np.ndarray, titles: Sequence[str], columns: int, width: float
) -> tuple[Figure, np.ndarray]:
    """Make a figure with a grid of empty panels of the same view and scale, one for each title.

    Titles are broken between words to fit a panel. Where a title is empty there is a gap in the grid. Only the panels
    at the left and at the lower edge have labels of their axes.

    Args:
        camera: From where the scene is seen.
        extent: Points that the view contains (., 3) [m].
        titles: Titles of the panels, row by row.
        columns: Number of columns.
        width: Width of the figure [in].

    Returns:
        The figure, and its panels row by row (rows * columns,).
    """
    titles = [*titles, *[""] * (-len(titles) % columns)]  # to whole rows
    figure = style.new_figure(width)
    characters = int((width - AXIS_ROOM) / columns / style.CHARACTER)
    grid = figure.subplots(len(titles) // columns, columns, sharex=True, sharey=True, squeeze=False).ravel()
    for number, (axes, title) in enumerate(zip(grid, titles, strict=True)):
        if not title:
            axes.set_axis_off()
            continue
        set_view(axes, camera, camera.view(extent))
        axes.set_title("\n".join(fill(line, characters) for line in title.split("\n")))
        if number % columns:
            axes.set_ylabel("")
        if any(titles[number + columns :: columns]):  # there is a panel below in this column
            axes.set_xlabel("")
        else:
            axes.tick_params(labelbottom=True)
    if camera == OBLIQUE:
        _draw_directions(grid[0], camera, extent)
    return figure, grid


def describe_view(camera: Camera, extent: np.ndarray | None = None, width: float = style.COLUMN) -> str:
    """Describe from where a spatial scene is seen, and what lies under points (., 3), in lines of a width [in]."""
    if camera != OBLIQUE:
        return ""
    text = f"Seen from azimuth {camera.azimuth:g}°, elevation {camera.elevation:g}°, in parallel projection; "
    text += "axes: lengths in the drawing from the origin"
    if extent is not None:
        text += f"; squares of 1 m at z = {extent[:, 2].min():.1f} m with the robot's shadow"
    return fill(text.replace("-", "\N{MINUS SIGN}"), int(width / style.CHARACTER))


def _draw_directions(axes: Axes, camera: Camera, extent: np.ndarray) -> None:
    """Draw arrows of the directions x, y and z in the corner of a view in which there is most room.

    Args:
        axes: The panel.
        camera: From where the scene is seen.
        extent: Points in the view (., 3) [m], which the arrows keep away from.
    """
    view = camera.view(extent)
    points_in_view = camera.project(extent)
    length = 0.08 * view.width
    # possible origins of the arrows: the corners of the view, moved inwards by an arrow with its letter
    corners_inside = view.get_points() + 1.7 * length * np.array([[1], [-1]])
    # the one whose nearest point is farthest away
    origin = max(
        Bbox(corners_inside).corners(),
        key=lambda corner: float(np.linalg.norm(points_in_view - corner, axis=1).min()),
    )
    for name, direction in zip("xyz", camera.project(length * np.eye(3)), strict=True):
        axes.annotate(
            "",
            tuple(origin + direction),
            tuple(origin),
            arrowprops={**style.ARROW, "facecolor": "black", "zorder": ABOVE_ALL},
        )
        x, y = origin + 1.5 * direction
        axes.text(x, y, name, ha="center", va="center")


def set_view(axes: Axes, camera: Camera, view: Bbox, width: float | None = None) -> None:
    """Set the limits of a panel, with equal scales, labels, and ticks.

    Args:
        axes: The panel.
        camera: From where it is seen.
        view: The part of the drawing that it shows [m].
        width: Width in which there are about six ticks, by default that of the view [m]. An axis has at least two.
    """
    step = float(np.ptp(MaxNLocator(6, steps=[1, 2, 5, 10]).tick_values(0, width or view.width)[:2]))
    axes.set(xlim=view.intervalx, ylim=view.intervaly, aspect="equal")
    for axis, label in zip((axes.xaxis, axes.yaxis), camera.labels, strict=True):
        axis.set_label_text(label)
        axis.set_major_locator(MultipleLocator(_step_with_two_ticks(*axis.get_view_interval(), step)))


def _step_with_two_ticks(low: float, high: float, step: float) -> float:
    """Return the first of a step and finer ones that puts two ticks or more between the limits of an axis.

    Args:
        low: Lower limit of the axis.
        high: Upper limit.
        step: Distance of ticks if it does; also returned if none of the finer ones does.
    """
    for part in FINER_STEPS:
        finer = step * part
        count = np.floor(high / finer) - np.ceil(low / finer) + 1
        if count >= 2:
            return finer
    return step


def draw_scene(axes: Axes, scene: Scene, time: float, since: float, extent: np.ndarray) -> None:
    """Draw a run at a time: object, obstacles, robot, the paths so far, and the targets of the stages that act.

    Args:
        axes: The panel.
        scene: The run with what stands around the robot.
        time: The time [s].
        since: From when on the paths of the end-effectors are drawn [s]; that of the base is drawn from the start.
        extent: All points that the view contains (., 3) [m]. The floor of a spatial scene is at the lowest of them.
    """
    run = scene.run
    camera = scene.camera
    model = scene.run.problem.model
    scene_look = SCENE_LOOKS[model.dimension]
    Q = run.motion.coordinates_at(time)
    draw_robot(axes, camera, model, Q)
    if (frame := scene.object_frame(time)) is not None:
        name = "object, lost" if scene.lost and time >= scene.released_at else "object"
        draw_box(axes, camera, frame, scene.object_half_edges, style.look(name))
    if scene_look.floor:
        _draw_floor(axes, camera, model, Q, extent)
    _draw_obstacles(axes, camera, scene.obstacles, time, extent)
    for stage in scene.acting_stages(time):
        for i, target in enumerate(scene.target_frames(stage, time)):
            if not np.isfinite(target[:3, 3]).all():
                continue
            color = _arm_color(i - 1) if i else "black"  # the first target is the base's
            axes.plot(
                *camera.project(target[:3, 3]),
                color=color,
                **style.look("target", zorder=ABOVE_ALL, **scene_look.target),
            )
            if scene_look.triads:
                _draw_triad(axes, camera, target, 0.25 * model.shape.reach, "target")
    trail, *_ = camera.project(scene.paths(float(run.motion.time[0]), time))
    axes.plot(*trail.T, **style.look("path of the base", zorder=scene_look.path_order + 1.2))
    for i, path in enumerate(camera.project(scene.paths(since, time))[1:]):
        order = scene_look.path_order + 1.3
        axes.plot(
            *path.T, color=_arm_color(i), linewidth=0.6, zorder=order, label=style.shared_label("path of an arm's end")
        )


def _draw_obstacles(
    axes: Axes, camera: Camera, obstacles: Sequence[ObstacleSpec], time: float | None, extent: np.ndarray
) -> None:
    """Draw the obstacles of a task, and the paths along which moving ones have come.

    In space, boxes and capsules have shadows on the floor, and walls (half-spaces) are transparent.

    Args:
        axes: The panel.
        camera: From where the scene is seen.
        obstacles: The obstacles.
        time: When [s]; None before a run, where they are as at its start.
        extent: Points (., 3) in the view [m].
    """
    # walls last: the legend shows what is drawn first, which should be an obstacle with edges if there is one
    for obstacle in sorted(obstacles, key=lambda each: each.shape.half_space is not None):
        shape = obstacle.shape.shape
        moves = any(obstacle.velocity)
        frame = obstacle_frame(obstacle, time or 0.0)
        name = "obstacle at the start" if moves and time is None else "obstacle"
        draw_shape(axes, camera, shape, frame, extent, style.look("obstacle", label=style.shared_label(name)))
        if camera == OBLIQUE:
            draw_shadow(axes, camera, shape, frame, float(extent[:, 2].min()))
        if moves and time and shape.kind != "half_space":
            path = camera.project(np.array([obstacle_frame(obstacle, 0.0)[:3, 3], frame[:3, 3]]))
            axes.plot(*path.T, **style.look("path of an obstacle", zorder=1.2))


def draw_robot(
    axes: Axes, camera: Camera, model: RobotModel, Q: np.ndarray, base: str = "base", alpha: float = 1.0
) -> None:
    """Draw a robot as lines: the box of its base, the middle lines of its links, its grippers and joints.

    Args:
        axes: The panel.
        camera: From where it is seen; parts nearer to it cover others.
        model: The robot.
        Q: Its position (nq,).
        base: What the legend calls the base.
        alpha: Opacity of all, from 0 to 1; arms of a robot that is not opaque have no entry in the legend.
    """
    shape = model.shape
    frames = model.body_frames(Q)
    arms = list(model.spec.arms)
    base_look = style.look("base", label=style.shared_label(base), alpha=alpha)
    draw_box(axes, camera, frames[0] @ shape.box_frame, base_half_edges(model), base_look, BASE_ORDER)
    grippers = {tool.body: [shape.grippers[name]] for name, tool in model.spec.tools.items()}
    for number, (body, frame) in enumerate(zip(model.spec.bodies, frames, strict=True)):
        arm = body.name.rpartition(".")[0]  # links have names such as arm_1.2; empty for the base
        arm_look: dict[str, Any] = {"color": _arm_color(arms.index(arm)) if arm else style.EDGE, "alpha": alpha}
        name = style.shared_label(style.readable(arm)) if arm and alpha == 1.0 else style.NO_LABEL
        # pairs of a line's width [pt] and its points (., 3) [m]
        lines = [(1.5, in_inertial_frame(frame, ends)) for ends in shape.capsules[number]]
        lines += [(1.0, in_inertial_frame(frame, points)) for points in grippers.get(number, ())]
        for line_width, points in lines:
            thick_line = {"linewidth": line_width, "solid_capstyle": "round", "label": name, **arm_look}
            axes.plot(*camera.project(points).T, zorder=LINK_ORDER + DEPTH_ORDER * camera.depth(points), **thick_line)
        if arm:
            # the joint is drawn over all lines of its link: its depth is that of the nearest
            order = JOINT_ORDER + DEPTH_ORDER * max(
                camera.depth(points) for points in (frame[:3, 3], *(line[1] for line in lines))
            )
            joint = {"marker": "s" if model.spec.joints[number - 1].prismatic else "o", "markersize": 2.2, **arm_look}
            axes.plot(
                *camera.project(frame[:3, 3]), markeredgewidth=0.7, markerfacecolor="white", zorder=order, **joint
            )


def _draw_triad(axes: Axes, camera: Camera, frame: np.ndarray, length: float, of: str) -> None:
    """Draw the axes of a frame as lines over all bodies, but for those that point straight to the viewer.

    Args:
        axes: The panel.
        camera: From where the frame is seen.
        frame: The frame (4, 4) [m]; its rotation is NaN where it has no attitude, and then nothing is drawn.
        length: Length of the lines [m].
        of: What the frame is of, for the legend.
    """
    for (name, color), axis in zip(TRIAD_COLORS.items(), frame[:3, :3].T, strict=True):
        ends = camera.project(np.array([frame[:3, 3], frame[:3, 3] + length * axis]))
        if np.ptp(ends, axis=0).max() > 1e-9:  # false for NaN too
            label = style.shared_label(f"{name} axis of a {of}")
            axes.plot(*ends.T, color=color, linewidth=0.8, zorder=ABOVE_ALL + 3.4, label=label)


def _draw_floor(axes: Axes, camera: Camera, model: RobotModel, Q: np.ndarray, extent: np.ndarray) -> None:
    """Draw squares of 1 m below a scene in space, and the robot's shadow on them, to show depth.

    The shadow is that of light from straight above: a projection along z onto the floor.

    Args:
        axes: The panel.
        camera: From where the scene is seen.
        model: The robot.
        Q: Its position (nq,).
        extent: Points (., 3) in the view [m]; the floor is at the lowest.
    """
    low = np.floor(extent.min(axis=0))
    high = np.ceil(extent.max(axis=0))
    floor = extent[:, 2].min()
    for axis in (0, 1):  # lines at x = whole numbers along y, then the others
        for line_position in np.arange(low[axis], high[axis] + 0.5):
            ends = np.insert([[low[1 - axis]], [high[1 - axis]]], axis, line_position, axis=1)
            axes.plot(
                *camera.project(np.column_stack([ends, [floor] * 2])).T,
                color=FLOOR_COLOR,
                linewidth=0.5,
                zorder=FLOOR_ORDER,
            )
    # points are projected onto z = 0, and their images are then moved to the height of the floor
    onto_floor = np.diag([1.0, 1.0, 0.0])
    floor_shift = camera.project([0, 0, 1]) * floor
    shape = model.shape
    frames = model.body_frames(Q)
    hull = box_corners(frames[0] @ shape.box_frame, shape.box) @ onto_floor
    shadow = ConvexHull(hull[:, :2]).vertices
    axes.add_patch(Polygon(camera.project(hull[shadow]) + floor_shift, facecolor=SHADOW_COLOR, zorder=SHADOW_ORDER))
    for frame, segments in zip(frames, shape.capsules, strict=True):
        for ends in in_inertial_frame(frame, segments):
            axes.plot(
                *(camera.project(ends @ onto_floor) + floor_shift).T,
                color=SHADOW_COLOR,
                linewidth=2.0,
                zorder=SHADOW_ORDER,
            )


def _arm_color(index: int) -> str:
    """Return the colour of the arm of this number, counted from 0."""
    return style.PALETTE[index % len(style.PALETTE)]


def plot_robot(spec: RobotSpec) -> Figure:
    """Plot a robot with its frames, joint numbers and joint axes, as a drawing for whoever writes a task for it.

    Joints are at 0, or at the nearest position within their limits. A spatial robot is seen from four sides. The
    capsules that stand for its bodies where parts keep clear are drawn if the robot's file has a geometry.
    """
    model = RobotModel(spec)
    limits = resolve_limits(spec)
    joints_at_rest = np.clip(0.0, limits.position_low, limits.position_high)[model.parts["base"].stop :]
    # the base is at the origin, in the neutral attitude
    Q = np.r_[model.neutral[: model.nq - len(joints_at_rest)], joints_at_rest]
    frame_size = 0.2 * model.shape.reach
    frames = pose_frames(model.poses(Q))
    points = np.vstack(
        [
            points_around_robot(model, Q),
            *(in_inertial_frame(frame, frame_size * np.eye(3)[: model.dimension]) for frame in frames),
        ]
    )
    pieces = pieces_of(spec) if spec.geometry else ()
    for ends, radius in capsules(model, pieces, Q):
        points = np.vstack([points, *(ends + radius * side for side in np.vstack([np.eye(3), -np.eye(3)]))])
    # lowest and highest coordinates (2, 3), with a margin
    box = np.array([points.min(axis=0), points.max(axis=0)]) + 0.04 * np.ptp(points) * np.array([[-1], [1]])
    figure = style.new_figure()
    panel_widths = np.ptp(box, axis=0)[: model.dimension - 1]
    panels: dict[Any, Axes] = figure.subplot_mosaic(SCENE_LOOKS[model.dimension].views, width_ratios=panel_widths)
    for camera, axes in panels.items():
        # views along an axis show the whole box, so that they are in line with each other
        view = camera.view(points) if camera == OBLIQUE else Bbox(camera.project(box))
        set_view(axes, camera, view, width=panel_widths.sum())
        draw_robot(axes, camera, model, Q)
        _draw_capsules(axes, camera, model, pieces, Q)
        for frame in frames:
            _draw_triad(axes, camera, frame, frame_size, "frame")
    camera, axes = next(iter(panels.items()))  # joints have numbers in the first view alone
    _number_joints(axes, camera, model, Q)
    mass = sum(body.mass for body in spec.bodies)
    figure.suptitle(f"{style.escape_dollars(spec.name.replace('_', ' '))}: {mass:.4g} kg, {model.n} coordinates")
    return style.finish(figure, describe_view(camera))


def _number_joints(axes: Axes, camera: Camera, model: RobotModel, Q: np.ndarray) -> None:
    """Write numbers beside the joints of each arm, one text for joints in one place, and draw the joints' axes.

    A text covers neither the robot nor another text, if one of the `NUMBER_OFFSETS` from its joint allows that. Robot
    and texts are represented by sample points, on none of which a text may lie.

    Args:
        axes: The panel.
        camera: From where the robot is seen.
        model: The robot.
        Q: Its position (nq,).
    """
    width = float(np.ptp(axes.get_xlim()))  # of the view [m]
    same_place_distance = 0.06 * width
    metres_per_point = width / (POINTS_PER_INCH * style.AXIS_WIDTH)  # about, since the panel has its final width later
    frames = model.body_frames(Q)
    covered_points = camera.project(_points_inside(model, Q))
    for index, arm in enumerate(model.spec.arms):
        # places of joints in the view (2,) [m], with the numbers of the joints there
        places: list[tuple[np.ndarray, list[str]]] = []
        for body, joint, frame in zip(model.spec.bodies[1:], model.spec.joints, frames[1:], strict=True):
            arm_of_joint, _, number = body.name.rpartition(".")
            if arm_of_joint != arm:
                continue
            joint_in_view = camera.project(frame[:3, 3])
            # joints that follow each other in one place share a text
            if not places or np.linalg.norm(joint_in_view - places[-1][0]) > same_place_distance:
                places.append((joint_in_view, []))
            places[-1][1].append(number)
            ends = in_inertial_frame(frame, 1.5 * model.shape.radius * np.multiply.outer([-1, 1], joint.axis))
            axes.plot(*camera.project(ends).T, color="black", linewidth=0.6, zorder=ABOVE_ALL + 3.3)
        offsets = NUMBER_OFFSETS if index % 2 else -NUMBER_OFFSETS  # texts of two arms begin on opposite sides
        look: dict[str, Any] = {"ha": "center", "va": "center", "color": _arm_color(index), "zorder": ABOVE_ALL + 3.6}
        for place, numbers in places:
            text = ", ".join(numbers)
            offset, points_of_text = _free_offset(text, (covered_points - place) / metres_per_point, offsets)
            axes.annotate(text, tuple(place), tuple(offset), textcoords="offset points", **look)
            covered_points = np.vstack([covered_points, place + metres_per_point * points_of_text])
    # draws nothing: an entry of the common legend, which `finish` writes
    joint_look: dict[str, Any] = {"linewidth": 0.6, "markersize": 2.2, "markerfacecolor": "white"}
    axes.plot([], [], "ko-", label=style.shared_label("joint, its axis"), **joint_look)


def _free_offset(text: str, covered_points: np.ndarray, offsets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find where beside a joint a text covers nothing: the first of some offsets at which no covered point is under it.

    Args:
        text: The text, which is centred at the offset.
        covered_points: Points that the text should not cover, from the joint (., 2) [pt].
        offsets: The offsets from the joint to try (., 2) [pt].

    Returns:
        The offset (2,) [pt], the first one if none is free; and nine points that stand for the text there, from the
        joint (9, 2) [pt].
    """
    # half the width and height of the text, with a little air
    half_size = np.array([POINTS_PER_INCH / 2 * style.text_width(text) + 1, 0.6 * style.TEXT])
    free_offsets = (offset for offset in offsets if not (np.abs(covered_points - offset) < half_size).all(axis=1).any())
    offset = next(free_offsets, offsets[0])
    # the points reach a little farther than the text, so that texts in a row stay apart
    corner = half_size + np.array([0.3 * style.TEXT, 0.0])
    return offset, offset + corner * np.array(list(product((-1, 0, 1), repeat=2)))


def _points_inside(model: RobotModel, Q: np.ndarray) -> np.ndarray:
    """Sample points all over the base's box and along links and grippers, so that texts can keep off the robot.

    The box is sampled by points on all lines between the corners of boxes that shrink from its full size to its centre.

    Args:
        model: The robot.
        Q: Its position (nq,).

    Returns:
        Points (., 3) [m].
    """
    shape = model.shape
    frames = model.body_frames(Q)
    fractions = np.linspace(0.0, 1.0, 25)
    shrunk_boxes = [box_corners(frames[0] @ shape.box_frame, part * base_half_edges(model)) for part in fractions]
    points_in_box = [
        first + fraction * (second - first)
        for box in shrunk_boxes
        for first in box
        for second in box
        for fraction in fractions[::4]
    ]
    links = [
        in_inertial_frame(frame, ends[0] + fractions[:, None] * (ends[1] - ends[0]))
        for frame, segments in zip(frames, shape.capsules, strict=True)
        for ends in segments
    ]
    grippers = [
        in_inertial_frame(frames[tool.body], first + fractions[:, None] * (second - first))
        for arm, tool in model.spec.tools.items()
        for first, second in pairwise(shape.grippers[arm])
    ]
    return np.vstack([np.array(points_in_box), *links, *grippers])


def plot_scenario(task: Task) -> Figure:
    """Plot what a task asks for before anything has run: a panel for each stage with the robot at its target.

    The robot is faint where the stage begins. A base for which the stage has no target is drawn where it was. Object
    and obstacles are there too, obstacles where they are at the start. If parts of the task's robot keep clear of
    others, the robot at its target has the capsules that stand for its bodies. Thin arms show the posture that
    `psmpc check` advises to hold in this stage for the next one.
    """
    model = RobotModel(task.robot)
    stages = build_stages(task.spec, task.robot, model)
    stops = configurations_at_stops(task, model, stages)  # at the start, then at the end of each stage (nq,)
    target_object = task.spec.object
    camera = CAMERAS[model.dimension]
    half = half_edges(target_object.shape if target_object else (0.0, 0.0))
    objects = object_frames(task, model, stops)
    points = [pointing_targets(model, stage) for stage in stages]
    advised = {posing.stage: posing for posing in posings(task, model, stages, stops)}
    extent = points_with_shadows(
        [points_around_robot(model, Q) for Q in [*stops, *(posing.Q for posing in advised.values())]],
        [*(box_corners(frame, half) for frame in objects), *points],
        task.spec.obstacles,
    )
    pieces = pieces_of(task.robot) if task.spec.keeps_clear else ()
    titles = [f"{i}. {style.readable(stage.name)}, priority {stage.priority:g}" for i, stage in enumerate(stages, 1)]
    figure, grid = _titled_panels(camera, extent, titles, min(2, len(stages)), style.COLUMN)
    for i, axes in enumerate(grid[: len(stages)]):
        if SCENE_LOOKS[model.dimension].floor:
            _draw_floor(axes, camera, model, stops[i + 1], extent)
        for frame in objects[i : i + 1]:  # none in a task without an object
            draw_box(axes, camera, frame, half, style.look("object"))
        _draw_obstacles(axes, camera, task.spec.obstacles, None, extent)
        draw_robot(axes, camera, model, stops[i], "where the stage begins", FAINT_OPACITY)
        _draw_capsules(axes, camera, model, pieces, stops[i + 1])
        draw_robot(axes, camera, model, stops[i + 1], _base_of_scenario(model, stages[i]))
        if i in advised:
            _draw_advised_arms(axes, camera, model, advised[i])
        for arm, point in enumerate(camera.project(points[i])):
            axes.plot(
                *point,
                color=_arm_color(arm),
                **style.look("target", label=style.shared_label("point to look at"), zorder=ABOVE_ALL),
            )
    return style.finish(figure, describe_view(camera, extent))


def _draw_advised_arms(axes: Axes, camera: Camera, model: RobotModel, posing: Posing) -> None:
    """Draw the links of the arms that a stage could pose for the next one, thin, where the next one needs them."""
    for body, frame, segments in zip(model.spec.bodies, model.body_frames(posing.Q), model.shape.capsules, strict=True):
        if body.name.rpartition(".")[0] in posing.arms:
            for points in in_inertial_frame(frame, segments):
                order = ADVICE_ORDER + DEPTH_ORDER * camera.depth(points)
                axes.plot(*camera.project(points).T, **style.look("advised posture of the arms", zorder=order))


def _draw_capsules(axes: Axes, camera: Camera, model: RobotModel, pieces: Sequence[Piece], Q: np.ndarray) -> None:
    """Draw the outlines of the capsules of a robot at Q (nq,)."""
    for ends, radius in capsules(model, pieces, Q):
        order = COVER_ORDER + DEPTH_ORDER * camera.depth(ends)
        axes.plot(*capsule_outline(camera, ends, radius).T, **style.look("capsules of the bodies", zorder=order))


def _base_of_scenario(model: RobotModel, stage: Stage) -> str:
    """Return what the legend calls the base of the robot at a stage's target."""
    if stage.relevant_rows[model.space.base].any():
        return "base at the target"
    return "base as if it stayed" if model.spec.moved_by.moves else "fixed base"
