"""What a task asks for, before anything has run: start, targets and object, stage by stage. Fig. 4 of the paper."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon

from psmpc_cli.figures.files import prepare, save
from psmpc_cli.figures.object_motion import carried
from psmpc_cli.figures.robot_drawing import draw_robot, object_look, outline, rectangle, show, view_around
from psmpc_cli.figures.style import BODY, COLUMN, LINE, PALETTE, TEXT, in_style, new_figure, readable
from psmpc_cli.ocp.stages import Stage, build_stages
from psmpc_cli.robot.model import RobotModel, build_model
from psmpc_cli.robot.reach import reach_of
from psmpc_cli.specs.coordinates import stack
from psmpc_cli.specs.load import Task

FAINT = 0.25
"""Opacity of where a stage begins."""

AROUND, BELOW = 0.45, 0.75
"""Width of the axis left of the panels, height of axis and legend below them [in]."""


def draw_scenario(task: Task, path: Path, force: bool = False) -> Path:
    """Draw a task's scenario into a file, in the format of its ending, and return it.

    Raises:
        InputError: The file exists or cannot be written.
    """
    prepare(path.parent, [path], force)
    with in_style():
        save(plot_scenario(task), [path])
    return path


def plot_scenario(task: Task) -> Figure:
    """Return one panel for each stage: the robot at its target, faint where the stage begins, and the object."""
    model = build_model(task.robot)
    stages = build_stages(task.spec, task.robot, model)
    stops = configurations(task, model, stages)
    objects = object_poses(task, model, stops)
    points = [outline(model, Q) for Q in stops]
    if task.spec.object is not None:
        points += [rectangle(pose, task.spec.object.shape) for pose in objects]
    view = view_around(np.vstack(points))
    columns = min(2, len(stages))
    rows, across = -(-len(stages) // columns), (COLUMN - AROUND) / columns
    figure = new_figure(rows * (across * view.aspect + 2 * LINE) + BELOW)
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    for i, (axes, stage) in enumerate(zip(grid, stages, strict=False)):
        if task.spec.object is not None:
            look = object_look(lost=False)
            axes.add_patch(Polygon(rectangle(objects[i], task.spec.object.shape), zorder=1, **look))
        draw_robot(axes, model, stops[i], alpha=FAINT)
        draw_robot(axes, model, stops[i + 1])
        show(axes, view)
        axes.set_title(
            f"{i + 1}. {readable(stage.name)}, priority {stage.priority:g}", loc="left", pad=2, fontsize=TEXT
        )
        if i % columns == 0:
            axes.set_ylabel("y (m)")
        if i >= len(stages) - columns:
            axes.set_xlabel("x (m)")
            axes.tick_params(labelbottom=True)
    for axes in grid[len(stages) :]:
        axes.set_axis_off()
    figure.legend(handles=_handles(task), loc="outside lower center", ncols=2)
    return figure


def configurations(task: Task, model: RobotModel, stages: tuple[Stage, ...]) -> list[np.ndarray]:
    """Return the robot's coordinates at the start and at every stage's target, (n,) each.

    Where a target is in task space the arms are those of inverse kinematics; an arm that cannot reach stays as it was.
    """
    stops = [stack(task.spec.initial, task.robot, "joint")]
    for stage in stages:
        if stage.space == "joint":
            stops.append(stage.target)
            continue
        Q, base = stops[-1].copy(), stage.target[model.pose_rows["base"]]
        Q[model.parts["base"]] = base
        for arm in task.robot.arms:
            found = reach_of(task.robot, arm, tuple(base), tuple(stage.target[model.pose_rows[arm]])).configuration
            if found is not None:
                Q[model.parts[arm]] = found
        stops.append(Q)
    return stops


def object_poses(task: Task, model: RobotModel, stops: list[np.ndarray]) -> list[np.ndarray]:
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


def _handles(task: Task) -> list[Patch | Line2D]:
    arms = [
        Line2D([], [], color=PALETTE[i % len(PALETTE)], linewidth=1.5, label=readable(name))
        for i, name in enumerate(task.robot.arms)
    ]
    thing = [] if task.spec.object is None else [Patch(label="object", **object_look(lost=False))]
    at_target = Patch(facecolor=BODY, edgecolor="black", linewidth=0.7, label="base at the target")
    begins = Patch(facecolor=BODY, edgecolor="black", linewidth=0.7, alpha=FAINT, label="where the stage begins")
    return [at_target, begins, *arms, *thing]
