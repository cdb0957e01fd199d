"""Coordinates over time: states, velocities, controls, forces, and errors against the tolerances of the stages."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from psmpc_cli.figures import style
from psmpc_cli.figures.timeline import label_row, runs_of, timeline
from psmpc_cli.logs.run import Run, Span
from psmpc_cli.ocp.problem import Problem, in_own_chart
from psmpc_cli.ocp.stage import Stage
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.parts import POSITION_AXES, axes_of

HEIGHT = 0.82
"""Height of a panel of coordinates [in]."""

FARTHEST = 4.0
PEAK = 5.0
"""Limits farther away than so many times the largest value are not drawn; peaks so many times as large as 19 in 20
values hide the rest."""

SMALLEST = 1e-5
"""Smaller errors are not shown [m, rad]."""


def plot_states(runs: Run | Mapping[str, Run]) -> Figure:
    """Plot base pose [m, rad] and joint angles [rad], of a run or of several side by side. Paper Figs. 8 to 10.

    Of one run it also shows what the controller saw of them. In space the attitude is a rotation vector, beside the
    angle to the attitude the current stage aims at [deg].
    """
    curves = [(run.motion.time, _in_vectors(run, run.motion.Q)) for run in runs_of(runs)]
    seen = _in_vectors(runs, runs.motion.Q_seen) if isinstance(runs, Run) else None
    return _plot_quantity(runs, ("position", "m"), ("angle", "rad"), curves, seen)


def plot_velocities(run: Run) -> Figure:
    """Plot generalized velocities [m/s, rad/s] with the limits in force and what the controller saw."""
    curves = [(run.motion.time, run.motion.v)]
    seen = run.motion.v_seen
    return _plot_quantity(run, ("velocity", "m/s"), ("velocity", "rad/s"), curves, seen, limits="velocity")


def plot_controls(run: Run) -> Figure:
    """Plot the applied accelerations [m/s^2, rad/s^2], constant over each sample, with the limits in force."""
    held = [(np.r_[run.time, run.motion.end], np.vstack([run.u, run.u[-1:]]))]
    linear = ("control", "m/s²")
    angular = ("control", "rad/s²")
    return _plot_quantity(run, linear, angular, held, None, "acceleration", "steps-post", peaked=True)


def plot_forces(run: Run) -> Figure:
    """Plot base force [N], base torque and joint torques [N m] at every tick if logged, else at every sample."""
    curves = (run.ticks["time"], run.ticks["F"]) if len(run.ticks.get("time", ())) else (run.time, run["force/F"])
    return _plot_quantity(run, ("force", "N"), ("torque", "N m"), [curves], peaked=True)


def _in_vectors(run: Run, Q: np.ndarray) -> np.ndarray:
    """Return coordinates (K, nq) of a run with the attitude in space as a rotation vector continuous over time."""
    return run.problem.model.space.unrolled(Q)


def attitude_error(run: Run) -> np.ndarray:
    """Return the angle (N,) [rad] from the base's attitude to the one that the current stage aims at, in space."""
    found = np.full(len(run.motion.time), np.nan)
    for span in run.spans:
        stage = run.followed[span.index]
        now = (run.motion.time >= span.start) & (run.motion.time <= span.end)
        if now.any():
            errors = _errors(run.problem, stage, run.motion.Q[now], run.motion.time[now] - span.start)
            found[now] = np.linalg.norm(errors[:, 3:6], axis=1)
            found[np.flatnonzero(now)[: span.index > 0]] = np.nan  # a break where the target changes
    return found


def plot_overlay(runs: Mapping[str, Run]) -> Figure:
    """Plot every coordinate [m, rad] of several runs on the same axes, with the ends of their stages."""
    model = next(iter(runs.values())).problem.model
    rows = [
        (f"{part} {'attitude ' * (unit == 'deg')}{label}\n({unit})", row, factor)
        for part, _, unit, factor, at, labels in _panels(model, ("position", "m"), ("angle", "rad"))
        for row, label in zip(range(at.start, at.stop), labels, strict=True)
    ]
    figure = style.new_figure(style.PAGE)
    across = 3
    down = -(-len(rows) // across)
    grid = figure.subplots(down, across, sharex=True, squeeze=False, height_ratios=[1.3] * down)
    for axes, (label, row, factor) in zip(grid.flat, rows, strict=False):
        for number, (name, run) in enumerate(runs.items()):
            motion = run.motion
            look = style.line_look(number)
            values = factor * _in_vectors(run, motion.Q)[:, row]
            axes.plot(motion.time, values, linewidth=1.2, label=f"_{style.title_of(name)}", **look)
            switches = run.stages["switch_time"][np.isfinite(run.stages["switch_time"])]
            at = np.interp(switches, motion.time, values)
            axes.plot(switches, at, "o", markersize=3, color=look["color"])
        axes.set_ylabel(label)
    for axes in grid.flat[len(rows) :]:
        axes.set_visible(False)
    for axes in grid[-1]:
        axes.set_xlabel("Time (s)")
    grid[0, 0].plot([], [], "o", markersize=3, color=style.EDGE, label="_ends of stages")
    return style.finish(figure)


def _plot_quantity(
    runs: Run | Mapping[str, Run],
    linear: tuple[str, str],
    angular: tuple[str, str],
    curves: Sequence[tuple[np.ndarray, np.ndarray]],
    seen: np.ndarray | None = None,
    limits: Literal["velocity", "acceleration"] | None = None,
    drawstyle: Literal["default", "steps-post"] = "default",
    peaked: bool = False,
) -> Figure:
    """Plot a quantity with a value for each generalized coordinate over time.

    There is a row of panels for base position, base angles and each arm, and a column for each run. A quantity has a
    name and a unit for `linear` and for `angular` coordinates, `curves` of times (K,) [s] and values (K, n) of each
    run, what the controller has `seen` of it (K, n), drawn where it differs, and the `limits` of the stages that bound
    it. One that is `peaked` may have short peaks that hide the rest; the axis is then logarithmic far out.
    """
    panels = list(_panels(runs_of(runs)[0].problem.model, linear, angular))
    figure, grid = timeline(runs, len(panels), HEIGHT)
    for places, (part, word, unit, factor, rows, labels) in zip(grid, panels, strict=True):
        note = ""
        for axes, run, (time, every) in zip(places, runs_of(runs), curves, strict=True):
            values = factor * every[:, rows]
            for i, label in enumerate(labels):
                axes.plot(time, values[:, i], label=label, drawstyle=drawstyle, **style.line_look(i))
            axes.margins(y=0.08)
            if limits is not None:
                _plot_limits(axes, run, limits, rows, values, factor)
            if seen is not None and not np.array_equal(seen, every, equal_nan=True):
                axes.plot(time, factor * seen[:, rows], **style.look("seen by the controller"))
            if word == "attitude":
                axes.plot(time, factor * attitude_error(run), label="to the target", color="black", linewidth=0.8)
            if peaked:
                note = _compress(axes, values) or note
        short = len(f"{part} {word}") * style.CHARACTER < HEIGHT
        label_row(places, f"{part} {word}\n({unit})" if short else f"{part}\n{word} ({unit})", note)
    return style.finish(figure)


def _panels(
    model: RobotModel, linear: tuple[str, str], angular: tuple[str, str]
) -> Iterator[tuple[str, str, str, float, slice, Sequence[str]]]:
    """Give the panels of v: part, name, unit, factor to this unit, rows, labels of the rows; attitudes are in degrees.

    `linear` and `angular` are the quantity's name and SI unit for linear and for angular coordinates.
    """
    base = model.parts["base"]
    d = model.dimension
    yield "Base", *linear, 1.0, slice(base.start, base.start + d), "xyz"[:d]
    turns = slice(base.start + d, base.stop)
    word, unit = angular
    if d == 2:
        yield "Base", word, unit, 1.0, turns, ("θ",)
    else:
        factor = 180 / np.pi if "rad" in unit else 1.0
        yield "Base", word.replace("angle", "attitude"), unit.replace("rad", "deg"), factor, turns, "xyz"
    for name, rows in list(model.parts.items())[1:]:
        joints = rows.stop - rows.start
        labels = [f"joint {i + 1}" if joints <= 4 else str(i + 1) for i in range(joints)]
        yield style.readable(name).capitalize(), word, unit, 1.0, rows, labels


def _compress(axes: Axes, values: np.ndarray) -> str:
    """Make the axis logarithmic beyond a tenth of the peak's power of ten if peaks hide the rest; return a note."""
    size = np.abs(values[np.isfinite(values)])
    peak = float(np.max(size, initial=0.0))
    if peak <= PEAK * float(np.quantile(size, 0.95)) or peak == 0.0:
        return ""
    threshold = 10.0 ** (np.floor(np.log10(peak)) - 1)
    axes.set_yscale("symlog", linthresh=threshold)
    axes.set_yticks(threshold * np.array([-10.0, -1.0, 0.0, 1.0, 10.0]), minor=False)
    axes.set_yticks([], minor=True)
    axes.yaxis.set_major_formatter("{x:g}")
    return f"log beyond ±{threshold:g}"


def _plot_limits(axes: Axes, run: Run, kind: str, rows: slice, values: np.ndarray, factor: float) -> None:
    """Draw the limits of the current stage that are not far off the values."""
    time = np.array([edge for span in run.spans for edge in (span.start, span.end)])
    limits = [run.problem.stages[span.index].limits for span in run.spans for _ in "ab"]
    sides = [
        factor * np.array([getattr(limit, f"{kind}_{side}")[rows] for limit in limits]) for side in ("low", "high")
    ]
    farthest = FARTHEST * float(np.nanmax(np.abs(values), initial=0.0)) or np.inf
    near = np.unique(np.hstack([np.where(np.abs(side) < farthest, side, np.nan) for side in sides]), axis=1)
    axes.plot(time, near[:, np.isfinite(near).any(axis=0)], label="_limit", **style.LEVEL)


def plot_errors(run: Run) -> Figure:
    """Plot how far base and arms are from the current stage's target, in the coordinates the stage controls.

    A curve is the largest error of a group of coordinates: base position [m], base angle [rad], and of each arm its
    joints [rad], or the position [m] and angle [rad] of its end-effector, by what the stage controls. Of a group on
    which the end condition stands only the coordinates in it count, and a line shows their tolerance. Where the target
    is a trajectory, the error is against its present value. Logarithmic.
    """
    figure, grid = timeline(run, 2, 1.35)
    panels = list(grid[:, 0])
    for axes in panels:
        for frame, name in enumerate(run.problem.model.pose_rows):
            axes.plot([], [], label=style.readable(name), **_frame_look(frame))
    curves = list(error_curves(run))
    for span, frame, angular, time, size, tolerance in curves:
        look = _frame_look(frame)
        panels[angular].plot(time, np.where(size > 0, size, np.nan), label="_", **look)
        same = {curve[-1] for curve in curves if curve[0] == span and curve[2] == angular and np.isfinite(curve[-1])}
        line = style.LEVEL if len(same) == 1 else {**style.LEVEL, "color": look["color"]}
        if np.isfinite(tolerance):
            panels[angular].hlines(tolerance, span.start, span.end, **line)
    for row, (axes, what) in enumerate(zip(panels, ("coordinate", "joint or angle"), strict=True)):
        axes.set_yscale("log")
        axes.set_ylim(bottom=max(axes.get_ylim()[0], SMALLEST))
        axes.yaxis.set_minor_formatter(NullFormatter())
        label_row(grid[row], ("Position error\n(m)", "Angle error\n(rad)")[row], f"largest {what}")
    if np.isfinite([tolerance for *_, tolerance in curves]).any():
        panels[0].plot([], [], label="_tolerance", **style.LEVEL)
    return style.finish(figure)


def error_curves(run: Run) -> Iterator[tuple[Span, int, bool, np.ndarray, np.ndarray, float]]:
    """Yield the errors against the current stage's target, stage by stage, as `plot_errors` draws them.

    Of each the stage's span, the number of the frame (the base, then the arms), whether they are angles, times (K,)
    [s], the largest error at those (K,) [m] or [rad], and the tightest tolerance of the end condition, or NaN.
    """
    motion = run.motion
    parts = run.problem.model.spec.parts
    for span in run.spans:
        inside = (motion.time > span.start) & (motion.time < span.end)
        time = np.r_[span.start, motion.time[inside], span.end]
        stage = run.followed[span.index]
        first = 0
        Q = np.array([motion.coordinates_at(t) for t in time])
        errors = np.abs(_errors(run.problem, stage, Q, time - span.start))
        tolerances = dict(zip(stage.end_rows, stage.tolerance, strict=True))
        for frame, axes in enumerate(axes_of(parts, stage.space).values()):
            for angular in (False, True):
                rows = [row for row, axis in enumerate(axes, start=first) if (axis not in POSITION_AXES) == angular]
                ending = [row for row in rows if row in tolerances]
                if rows:
                    tightest = min((tolerances[row] for row in ending), default=np.nan)
                    yield span, frame, angular, time, errors[:, ending or rows].max(axis=1), tightest
            first += len(axes)


def _errors(problem: Problem, stage: Stage, Q: np.ndarray, since: np.ndarray) -> np.ndarray:
    """Return a stage's errors (K, rows) at coordinates (K, nq), at times since its start (K,) [s].

    In space the chart is anew at every attitude, and of a target's two quaternions the nearer one counts.
    """
    found = []
    at_rest = np.zeros(problem.model.n)
    for q, time in zip(Q, since, strict=True):
        placed, x = in_own_chart(problem.model, stage, q, at_rest, time)
        found.append(problem.costs.errors(placed, x[None], np.array([time]))[0])
    return np.array(found)


def _frame_look(index: int) -> dict[str, Any]:
    """Return colour and line style of a frame: black for the base, then the arms as in the snapshots."""
    return {"color": style.PALETTE[-1], "linestyle": "-"} if index == 0 else style.line_look(index - 1)
