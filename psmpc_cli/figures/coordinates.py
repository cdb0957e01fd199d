"""Coordinates over time: states, velocities, controls, forces, and errors against the tolerances of the stages."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from psmpc_cli.figures import style
from psmpc_cli.figures.timeline import open_timeline
from psmpc_cli.logs.run import Run, Span
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.coordinates import AXES, error_axes

HEIGHT = 0.92
"""Height of a panel of coordinates [in]."""

FARTHEST = 4.0
"""Limits farther away than so many times the largest value are not drawn: nothing else could be read."""

PEAK = 5.0
"""Peaks so many times as large as 19 in 20 values hide the rest."""

APART = 1.5
"""Distance of two lines that can be told apart in print [pt]: more than the width of one."""

SMALLEST = 1e-5
"""Smaller errors are not shown [m, rad]."""

SEEN: Mapping[str, Any] = {"color": "#7A7A7A", "linewidth": 0.55}
"""Look of what the controller saw."""

Curves = tuple[np.ndarray, np.ndarray]
"""Times (K,) [s] and values (K, n) in the order of Q."""


@dataclass(frozen=True)
class PlottedQuantity:
    """A quantity with a value for each generalized coordinate.

    Attributes:
        words, units: For linear, then for angular coordinates.
        curves: What is drawn of a run.
        seen: What the controller saw of it (K, n), drawn where it can be told apart.
        limits: Which limits of the stages bound it.
        steps: It is constant between the times.
        peaked: It may have short peaks that hide the rest; the axis is then logarithmic far out.
    """

    words: tuple[str, str]
    units: tuple[str, str]
    curves: Callable[[Run], Curves]
    seen: Callable[[Run], np.ndarray] | None = None
    limits: Literal["velocity", "acceleration"] | None = None
    steps: bool = False
    peaked: bool = False


@dataclass(frozen=True)
class Panel:
    """Rows of a vector of generalized coordinates that share a panel."""

    name: str
    rows: slice
    labels: tuple[str, ...]
    angular: bool


def plot_states(runs: Run | Mapping[str, Run]) -> Figure:
    """Plot base pose [m, rad] and joint angles [rad], of a run or of several side by side. Paper Figs. 8 to 10.

    Of one run it also shows what the controller saw of them.
    """
    quantity = PlottedQuantity(
        ("position", "angle"),
        ("m", "rad"),
        lambda run: (run.motion.time, run.motion.Q),
        seen=(lambda run: run.motion.Q_seen) if isinstance(runs, Run) else None,
    )
    return plot_quantity(runs, quantity)


def plot_velocities(run: Run) -> Figure:
    """Plot generalized velocities [m/s, rad/s] with the limits in force and what the controller saw."""
    quantity = PlottedQuantity(
        ("velocity", "velocity"),
        ("m/s", "rad/s"),
        lambda run: (run.motion.time, run.motion.v),
        seen=lambda run: run.motion.v_seen,
        limits="velocity",
    )
    return plot_quantity(run, quantity)


def plot_controls(run: Run) -> Figure:
    """Plot the applied accelerations [m/s^2, rad/s^2], constant over each sample, with the limits in force."""
    quantity = PlottedQuantity(
        ("control", "control"), ("m/s²", "rad/s²"), _controls, limits="acceleration", steps=True, peaked=True
    )
    return plot_quantity(run, quantity)


def plot_forces(run: Run) -> Figure:
    """Plot base force [N], base torque and joint torques [N m] at every tick if logged, else at every sample."""
    return plot_quantity(run, PlottedQuantity(("force", "torque"), ("N", "N m"), _forces, peaked=True))


def _controls(run: Run) -> Curves:
    """Return the controls with the last one repeated at the end of the run."""
    u, last = run["control/u"], run.time[-1]
    if run.motion.end <= last:
        return run.time, u
    return np.r_[run.time, run.motion.end], np.vstack([u, u[-1:]])


def _forces(run: Run) -> Curves:
    ticks = run.ticks
    return (ticks["time"], ticks["F"]) if len(ticks.get("time", ())) else (run.time, run["force/F"])


def plot_quantity(runs: Run | Mapping[str, Run], quantity: PlottedQuantity) -> Figure:
    """Plot a quantity over time, a row of panels for base position, base angles and each arm, a column for each run."""
    columns = [runs] if isinstance(runs, Run) else list(runs.values())
    panels = coordinate_panels(columns[0].problem.model)
    timeline = open_timeline(runs, len(panels), HEIGHT)
    bounded = blurred = False
    for row, panel in enumerate(panels):
        notes: list[str] = []
        for axes, run in zip(timeline.panels[row], columns, strict=True):
            time, values = quantity.curves(run)
            values = values[:, panel.rows]
            _plot_lines(axes, time, values, panel.labels, quantity.steps)
            if quantity.limits is not None:
                within, notes = _plot_limits(axes, run, quantity.limits, panel.rows, values)
                bounded |= within
            if quantity.seen is not None:
                blurred |= _plot_seen(axes, time, values, quantity.seen(run)[:, panel.rows])
            if quantity.peaked:
                notes += _compress(axes, values)
        timeline.label(row, _axis_label(panel, quantity), ", ".join(notes))
    limit = [style.entry("limit", color=style.EDGE, linewidth=0.7)] if bounded else []
    return timeline.finish([*limit, *([style.entry("seen by the controller", **SEEN)] if blurred else [])])


def coordinate_panels(model: RobotModel) -> tuple[Panel, ...]:
    """Return the panels of Q: base position, base angles, then each arm."""
    base, d = model.parts["base"], model.dimension
    angles = ("θ",) if base.stop - base.start - d == 1 else ("yaw", "pitch", "roll")
    panels = [
        Panel("base", slice(base.start, base.start + d), ("x", "y", "z")[:d], False),
        Panel("base", slice(base.start + d, base.stop), angles, True),
    ]
    for name, rows in model.parts.items():
        joints, word = rows.stop - rows.start, "joint " if rows.stop - rows.start <= 4 else ""
        if name != "base":
            panels.append(Panel(style.readable(name), rows, tuple(f"{word}{i + 1}" for i in range(joints)), True))
    return tuple(panels)


def _axis_label(panel: Panel, quantity: PlottedQuantity) -> str:
    """Return name, quantity and unit on two lines, broken so that they fit the panel's height."""
    name, word, unit = panel.name.capitalize(), quantity.words[panel.angular], f"({quantity.units[panel.angular]})"
    return f"{name} {word}\n{unit}" if style.text_width(f"{name} {word}") < HEIGHT else f"{name}\n{word} {unit}"


def _plot_lines(axes: Axes, time: np.ndarray, values: np.ndarray, labels: Sequence[str], steps: bool) -> None:
    """Plot values (K, len(labels)) over time (K,) [s], a line a column."""
    drawstyle = "steps-post" if steps else "default"
    for i, label in enumerate(labels):
        axes.plot(
            time,
            values[:, i],
            label=label,
            marker=style.point_if_alone(time),
            drawstyle=drawstyle,
            **style.line_look(i),
        )
    axes.margins(y=0.08)


def _plot_seen(axes: Axes, time: np.ndarray, values: np.ndarray, seen: np.ndarray) -> bool:
    """Draw what was seen (K, i) beneath those values (K, i) it can be told apart from; return whether there are any."""
    low, high = axes.get_ylim()
    apart = np.nanmax(np.abs(seen - values), axis=0, initial=0.0) * 72 * HEIGHT / (high - low) > APART
    for column in np.flatnonzero(apart):
        axes.plot(time, seen[:, column], label="_seen", zorder=1.4, **SEEN)
    return bool(apart.any())


def _compress(axes: Axes, values: np.ndarray) -> list[str]:
    """Make the axis logarithmic beyond a tenth of the peak's power of ten, and say so, if peaks hide the rest."""
    size = np.abs(values[np.isfinite(values)])
    peak = float(np.max(size, initial=0.0))
    if peak <= PEAK * float(np.quantile(size, 0.95)) or peak == 0.0:
        return []
    threshold = 10.0 ** (np.floor(np.log10(peak)) - 1)
    axes.set_yscale("symlog", linthresh=threshold)
    axes.set_yticks(threshold * np.array([-10.0, -1.0, 0.0, 1.0, 10.0]), minor=False)
    axes.set_yticks([], minor=True)
    axes.yaxis.set_major_formatter(FuncFormatter(lambda y, _: f"{y:g}".replace("-", "\N{MINUS SIGN}")))
    return [f"log beyond ±{threshold:g}"]


def _plot_limits(axes: Axes, run: Run, kind: str, rows: slice, values: np.ndarray) -> tuple[bool, list[str]]:
    """Draw the limits of the current stage; return whether any is seen, and a note where some are far off the axis."""
    time = np.array([edge for span in run.spans for edge in (span.start, span.end)])
    limits = [run.problem.stages[span.index].limits for span in run.spans for _ in "ab"]
    low, high = (np.array([getattr(limit, f"{kind}_{side}")[rows] for limit in limits]) for side in ("low", "high"))
    largest, seen, beyond = float(np.nanmax(np.abs(values), initial=0.0)), False, False
    bounds, width = np.hstack([low, high]), low.shape[1]
    shared = all(len(np.unique(side, axis=1).T) == 1 for side in (low, high))
    for i in (0, width) if shared else range(2 * width):
        bound = np.where(np.isfinite(bounds[:, i]), bounds[:, i], np.nan)
        if np.all(np.isnan(bound)):
            continue
        if np.nanmin(np.abs(bound)) > FARTHEST * largest > 0:
            beyond = True
            continue
        color = style.EDGE if shared else style.line_look(i % width)["color"]
        axes.plot(time, bound, color=color, linewidth=0.7, label="_limit", zorder=1.5)
        seen = True
    return seen, ["limits beyond the axis"] if beyond else []


@dataclass(frozen=True)
class ErrorGroup:
    """Coordinates of one frame or arm whose errors share a curve.

    Attributes:
        frame: Number of the frame: the base, then the arms.
        angular: Whether they are angles.
        rows: Their rows in the stage's own coordinates, Q or xi.
        tolerance: The tightest tolerance of the end condition on any of them, or None.
    """

    frame: int
    angular: bool
    rows: list[int]
    tolerance: float | None


def plot_errors(run: Run) -> Figure:
    """Plot how far base and arms are from the current stage's target, in the coordinates the stage controls.

    A curve is the largest error of a group of coordinates: base position [m], base angle [rad], and of each arm its
    joints [rad], or the position [m] and angle [rad] of its end-effector, by what the stage controls. Of a group on
    which the end condition stands only the coordinates in it count, and a line shows their tolerance. Where the target
    is a trajectory, the error is against its present value. Logarithmic.
    """
    timeline = open_timeline(run, 2, 1.35)
    names = [style.readable(name) for name in run.problem.model.pose_rows]
    bounded = False
    for row, angular in enumerate((False, True)):
        axes: Axes = timeline.panels[row, 0]
        for i, name in enumerate(names):
            axes.plot([], [], label=name, **_frame_look(i))
        for span in run.spans:
            groups = [group for group in error_groups(run, span) if group.angular == angular]
            tolerances = {group.tolerance for group in groups} - {None}
            bounded |= bool(tolerances)
            for group in groups:
                look = _frame_look(group.frame)
                _plot_group(axes, run, span, group, look)
                if group.tolerance is not None:
                    color = style.EDGE if len(tolerances) == 1 else look["color"]
                    axes.hlines(group.tolerance, span.start, span.end, color=color, linewidth=0.7, zorder=1.5)
        axes.set_yscale("log")
        axes.set_ylim(bottom=max(axes.get_ylim()[0], SMALLEST))
        note = "largest joint or angle" if angular else "largest coordinate"
        timeline.label(row, "Angle error\n(rad)" if angular else "Position error\n(m)", note)
    return timeline.finish([style.entry("tolerance", color=style.EDGE, linewidth=0.7)] if bounded else [])


def error_groups(run: Run, span: Span) -> Iterator[ErrorGroup]:
    """Give the groups of coordinates a stage controls."""
    stage, first = run.problem.stages[span.index], 0
    tolerances = dict(zip(stage.end_rows, stage.tolerance, strict=True))
    for frame, axes in enumerate(error_axes(run.problem.model.spec.parts, stage.space).values()):
        rows = dict(enumerate(axes, start=first))
        first += len(axes)
        for angular in (False, True):
            every = [row for row, axis in rows.items() if (axis not in AXES[:2]) == angular]
            ending = [row for row in every if row in tolerances]
            tolerance = min(float(tolerances[row]) for row in ending) if ending else None
            if every:
                yield ErrorGroup(frame, angular, ending or every, tolerance)


def stage_errors(run: Run, span: Span, time: np.ndarray) -> np.ndarray:
    """Return the errors at times (K,) [s] in the coordinates a stage controls (K, rows) [m, rad]."""
    stage = run.problem.stages[span.index]
    Q = np.column_stack([np.interp(time, run.motion.time, column) for column in run.motion.Q.T])
    return run.problem.costs.errors(stage, np.hstack([Q, np.zeros_like(Q)]), time - span.start)


def _plot_group(axes: Axes, run: Run, span: Span, group: ErrorGroup, look: Mapping[str, Any]) -> None:
    """Plot the largest error of a group over a stage."""
    inside = run.motion.time[(run.motion.time > span.start) & (run.motion.time < span.end)]
    time = np.r_[span.start, inside, span.end]
    size = np.abs(stage_errors(run, span, time)[:, group.rows]).max(axis=1)
    axes.plot(time, np.where(size > 0, size, np.nan), label="_", marker=style.point_if_alone(time), **look)


def _frame_look(index: int) -> dict[str, Any]:
    """Return colour and line style of a frame: black for the base, then the arms as in the snapshots."""
    return {"color": style.PALETTE[-1], "linestyle": "-"} if index == 0 else style.line_look(index - 1)
