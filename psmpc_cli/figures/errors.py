"""How far base and end-effectors are from where the current stage wants them."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from psmpc_cli.figures.panels import panel_legend, point_if_alone
from psmpc_cli.figures.run import Run, Span
from psmpc_cli.figures.style import EDGE, PALETTE, line_look, readable
from psmpc_cli.figures.timeline import open_timeline

HEIGHT, SMALLEST = 1.35, 1e-5
"""Height of one panel [in]; smaller errors are not shown [m, rad]."""


def plot_errors(run: Run) -> Figure:
    """Return position errors [m] and angle errors [rad] of base and end-effectors against the current stage's target.

    Where the target is a trajectory, it is where that has got to; the target poses of a joint-space stage are those of
    its target coordinates. Logarithmic; a line a stage shows the
    widest tolerance its end condition allows any coordinate of that panel.
    """
    timeline = open_timeline(run, 2, HEIGHT)
    tolerance = False
    for axes, angular in zip(timeline.panels, (False, True), strict=True):
        for span in run.spans:
            _plot_span(axes, run, span, angular)
            tolerance |= _plot_tolerance(axes, run, span, angular)
        axes.set_yscale("log")
        axes.set_ylim(bottom=max(axes.get_ylim()[0], SMALLEST))
        axes.set_ylabel("Angle error\n(rad)" if angular else "Position error\n(m)")
    panel_legend(timeline.panels[0])
    line = Line2D([], [], color=EDGE, linewidth=0.7, label="tolerance per coordinate")
    return timeline.finish([line] if tolerance else [])


def pose_errors(run: Run, span: Span, time: np.ndarray) -> np.ndarray:
    """Return xi - xi_d (K, m) [m, rad] at times (K,) [s] against what a stage follows."""
    stage = run.stages[span.index]
    desired = stage.reference(time - span.start)
    return np.asarray(run.poses_at(time) - (desired if stage.space == "task" else np.asarray(run.model.g(desired.T)).T))


def _plot_span(axes: Axes, run: Run, span: Span, angular: bool) -> None:
    inside = run.time[(run.time > span.start) & (run.time < span.end)]
    time, d = np.r_[span.start, inside, span.end], run.model.dimension
    error = pose_errors(run, span, time)
    for i, (name, rows) in enumerate(run.model.pose_rows.items()):
        size = np.linalg.norm(error[:, rows][:, d:] if angular else error[:, rows][:, :d], axis=1)
        label = readable(name) if span.index == 0 else "_"
        axes.plot(time, np.where(size > 0, size, np.nan), label=label, marker=point_if_alone(time), **frame_look(i))


def _plot_tolerance(axes: Axes, run: Run, span: Span, angular: bool) -> bool:
    """Draw the widest tolerance on an angle, or on a position, in force during a stage; return whether there is one."""
    stage = run.stages[span.index]
    if stage.space == "joint":
        base = run.model.parts["base"]
        angle_from = {base.start: base.start + run.model.dimension}
        wanted = [row for row in stage.end_rows if row < base.stop and (row >= angle_from[base.start]) == angular]
    else:
        wanted = [row for row in stage.end_rows if _is_angle(run, row) == angular]
    sizes = [float(stage.tolerance[stage.end_rows.index(row)]) for row in wanted]
    if sizes:
        axes.hlines(max(sizes), span.start, span.end, color=EDGE, linewidth=0.7, zorder=1.5)
    return bool(sizes)


def _is_angle(run: Run, row: int) -> bool:
    """Return whether a row of xi is an angle."""
    rows = next(rows for rows in run.model.pose_rows.values() if rows.start <= row < rows.stop)
    return bool(row - rows.start >= run.model.dimension)


def frame_look(index: int) -> dict[str, Any]:
    """Return colour and line style of a frame: black for the base, then the arms as in the snapshots."""
    return {"color": PALETTE[-1], "linestyle": "-"} if index == 0 else line_look(index - 1)
