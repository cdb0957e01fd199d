"""The robot at the key instants of a run or of several, and what a task asks for. Paper Figs. 4 and 5."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from string import ascii_lowercase
from textwrap import fill

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from psmpc_cli.figures import style
from psmpc_cli.figures.robot_drawing import (
    Scene,
    View,
    arm_handles,
    base_outline,
    carried,
    draw_robot,
    object_look,
    outline,
    rectangle,
    scene_handles,
    scene_of,
    view_around,
)
from psmpc_cli.logs.run import Run, Span
from psmpc_cli.ocp.problem import Stage, build_stages
from psmpc_cli.ocp.skills import SKILLS, Posture
from psmpc_cli.robot.model import RobotModel, arm_points, build_model
from psmpc_cli.robot.reach import reach_of
from psmpc_cli.specs.coordinates import stack
from psmpc_cli.specs.load import Task

AXIS, AROUND = 0.3, 0.45
"""Height of the axis below the panels; width of the axis left of them [in]."""

ACROSS = 4
"""Frames, or stages, side by side on a page."""

NO_BREAK = "\N{NO-BREAK SPACE}"
"""Between a number and its unit."""

GHOST = "#9A9A9A"
"""Colour of the robot at an early start."""

FAINT = 0.25
"""Opacity of the robot where a stage begins."""


@dataclass(frozen=True)
class KeyInstant:
    """A time [s] that is shown, and what happens then."""

    time: float
    event: str


def plot_snapshots(run: Run) -> Figure:
    """Plot the robot at each key instant, all panels to the same scale [m].

    A panel shows the targets of the stages that act, the path of the base, and the paths of the end-effectors since the
    panel before.
    """
    scene = scene_of(run)
    frames = key_frames(scene)
    view = scene.view(key.time for key in frames)
    width, columns = (style.COLUMN, min(2, len(frames))) if len(frames) <= 10 else (style.PAGE, ACROSS)
    events = [f"({letters(i)}) {key.event}" for i, key in enumerate(frames)]
    figure, grid = _panels(view, events, columns, width)
    before = frames[0].time
    for axes, key in zip(grid, frames, strict=False):
        scene.draw(axes, key.time, since=before)
        before = key.time
    handles, vacant = scene_handles([scene]), grid[len(frames) :]
    if len(vacant):
        vacant[0].legend(handles=handles, loc="center")
    else:
        style.add_legend(figure, handles)
    return figure


def _panels(view: View, titles: Sequence[str], columns: int, width: float) -> tuple[Figure, np.ndarray]:
    """Return a figure and its panels, all to one scale, one below each title; those that are left over are empty.

    Titles are broken between words to the width of a panel.
    """
    across, rows = (width - AROUND) / columns, -(-len(titles) // columns)
    characters = int(across / style.CHARACTER)
    broken = ["\n".join(fill(line, characters) for line in title.split("\n")) for title in titles]
    lines = 1 + max(title.count("\n") for title in broken)
    figure = style.new_figure(rows * (across * view.aspect + lines * style.LINE + 0.08) + AXIS, width)
    grid: np.ndarray = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    for i, (axes, title) in enumerate(zip(grid, broken, strict=False)):
        view.show(axes)
        axes.set_title(title, loc="left", pad=2, fontsize=style.TEXT)
        if i % columns == 0:
            axes.set_ylabel("y (m)")
        if i >= len(titles) - columns:
            axes.set_xlabel("x (m)")
            axes.tick_params(labelbottom=True)
    for axes in grid[len(titles) :]:
        axes.set_axis_off()
    return figure, grid


def key_instants(scene: Scene) -> list[KeyInstant]:
    """Return start, early starts, switches, loss of the object and end of a run, in the order of time."""
    run = scene.run
    found = [KeyInstant(float(run.motion.time[0]), "start")]
    for span in run.spans:
        if span.early is not None:
            found.append(KeyInstant(span.early, f"{style.readable(span.name)} starts"))
        if np.isfinite(run.stages["switch_time"][span.index]):
            found.append(KeyInstant(span.end, f"{style.readable(span.name)} ends"))
    if scene.lost:
        found.append(KeyInstant(scene.left, "object lost"))
    if not any(abs(key.time - run.motion.end) < 1e-6 for key in found):
        found.append(KeyInstant(run.motion.end, "end of the run"))
    return sorted(found, key=lambda key: key.time)


def key_frames(scene: Scene) -> list[KeyInstant]:
    """Return the key instants that are shown; those between which nothing moves visibly are one, with all events."""
    frames: list[KeyInstant] = []
    size = float(np.ptp(scene.view(key.time for key in key_instants(scene)).x))
    told = ""
    for key in key_instants(scene):
        time = f"{key.time:.1f}{NO_BREAK}s"
        moved = np.inf if not frames else np.abs(scene.points(key.time) - scene.points(frames[-1].time)).max()
        if moved < 0.03 * size:
            joined = f"{frames[-1].event}, " + (key.event if time == told else f"{time}: {key.event}")
            frames[-1] = replace(frames[-1], event=joined)
        else:
            frames.append(KeyInstant(key.time, f"{time}: {key.event}"))
        told = time
    return frames


def letters(index: int) -> str:
    """Return a, b, ..., z, aa, ab, ..."""
    return ascii_lowercase[index] if index < 26 else letters(index // 26 - 1) + ascii_lowercase[index % 26]


def plot_compared_snapshots(runs: Mapping[str, Run]) -> Figure:
    """Plot the robot at the end of every stage [m] and, in grey, at the early start of the stage after it.

    A row, or several, for each controller; all panels are to the same scale. The targets are those of the stage that
    ends, the paths of the end-effectors those during the stage.
    """
    scenes = {name: scene_of(run) for name, run in runs.items()}
    names = next(iter(runs.values())).stage_names
    across = min(ACROSS, len(names))
    vacant = -len(names) % across
    titles = _stage_titles(runs.values(), vacant)
    figure, grid = _panels(_common_view(scenes.values()), titles, across, style.PAGE)
    for (name, scene), block in zip(scenes.items(), grid.reshape(len(runs), -1), strict=True):
        for stage, axes in enumerate(block):
            if stage < len(names):
                _draw_end(axes, scene, stage)
            else:
                axes.set_axis_off()
        for axes in block[::across]:
            axes.set_ylabel(f"{style.title_of(name)}\ny (m)")
    handles = scene_handles(scenes.values())
    if any(span.early is not None for run in runs.values() for span in run.spans):
        handles.append(style.entry("robot at the early start of the next stage", color=GHOST, linewidth=0.9))
    style.add_legend(figure, handles)
    return figure


def _stage_titles(runs: Iterable[Run], vacant: int) -> list[str]:
    """Return every panel's title, when a stage ends and when the next one starts; after each run so many empty ones."""
    titles: list[str] = []
    for number, run in enumerate(runs):
        for stage, name in enumerate(run.stage_names):
            end, start = float(run.stages["switch_time"][stage]), _next_span(run, stage)
            ended = f"ends at {end:.1f}{NO_BREAK}s" if np.isfinite(end) else "did not end"
            lines = [f"({letters(len(titles) - number * vacant)}) {style.readable(name)} {ended}"]
            if np.isfinite(end) and start is not None:
                begun = "starts then" if start.early is None else f"starts at {start.early:.1f}{NO_BREAK}s"
                lines.append(f"{style.readable(start.name)} {begun}")
            titles.append("\n".join(lines))
        titles += [""] * vacant
    return titles


def _next_span(run: Run, stage: int) -> Span | None:
    return next((span for span in run.spans if span.index == stage + 1), None)


def _draw_end(axes: Axes, scene: Scene, stage: int) -> None:
    """Draw the robot at the end of a stage, if it ended, and at the early start of the next."""
    run = scene.run
    end, following = float(run.stages["switch_time"][stage]), _next_span(run, stage)
    if not np.isfinite(end):
        return
    if following is not None and following.early is not None:
        Q, model = run.motion.coordinates_at(following.early), run.problem.model
        axes.add_patch(Polygon(base_outline(model, Q), fill=False, edgecolor=GHOST, linewidth=0.6, zorder=1.1))
        for points in arm_points(model, Q).values():
            axes.plot(*points.T, color=GHOST, linewidth=0.9, solid_joinstyle="round", zorder=1.1)
    since = next((span.start for span in run.spans if span.index == stage), end)  # none if it ended within a sample
    scene.draw(axes, end, since=since, stages=[stage])


def _common_view(scenes: Iterable[Scene]) -> View:
    """Return the smallest view that shows everything that is drawn of all scenes."""
    views = []
    for scene in scenes:
        ends = scene.run.stages["switch_time"]
        early = [span.early for span in scene.run.spans if span.early is not None]
        views.append(scene.view(np.concatenate([scene.run.motion.time[:1], ends[np.isfinite(ends)], early]).tolist()))
    return View(
        (min(view.x[0] for view in views), max(view.x[1] for view in views)),
        (min(view.y[0] for view in views), max(view.y[1] for view in views)),
    )


def plot_scenario(task: Task) -> Figure:
    """Plot a task before anything has run: a panel for each stage with the robot at its target, and the object.

    The robot is faint where the stage begins.
    """
    model = build_model(task.robot)
    stages = build_stages(task.spec, task.robot, model)
    stops = configurations(task, model, stages)
    objects = object_poses(task, model, stops)
    points = [outline(model, Q) for Q in stops]
    if task.spec.object is not None:
        points += [rectangle(pose, task.spec.object.shape) for pose in objects]
    view = view_around(np.vstack(points))
    titles = [f"{i}. {style.readable(stage.name)}, priority {stage.priority:g}" for i, stage in enumerate(stages, 1)]
    figure, grid = _panels(view, titles, min(2, len(stages)), style.COLUMN)
    for i, axes in enumerate(grid[: len(stages)]):
        if task.spec.object is not None:
            look = object_look(lost=False)
            axes.add_patch(Polygon(rectangle(objects[i], task.spec.object.shape), zorder=1, **look))
        draw_robot(axes, model, stops[i], alpha=FAINT)
        draw_robot(axes, model, stops[i + 1])
    look = {"facecolor": style.BODY, "edgecolor": "black", "linewidth": 0.7}
    handles: list[Artist] = [style.patch_entry("base at the target", **look)]
    handles += [style.patch_entry("where the stage begins", alpha=FAINT, **look), *arm_handles(model)]
    if task.spec.object is not None:
        handles.append(style.patch_entry("object", **object_look(lost=False)))
    style.add_legend(figure, handles)
    return figure


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
    taken, let_go = names.index(spec.taken_by) + 1, names.index(spec.let_go_by)
    poses = []
    for panel in range(len(names)):
        now = min(panel + 1, let_go)
        pose = np.array(spec.pose, float)
        poses.append(pose if now <= taken else carried(model, pose, stops[taken], stops[now]))
    return poses
