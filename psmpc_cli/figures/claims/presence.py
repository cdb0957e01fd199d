"""How waiting stages come to act on the control: what the actual starts are read from. Section IV-B of the paper."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from psmpc_cli.figures.claims.marks import published_mark
from psmpc_cli.figures.panels import panel_legend, point_if_alone
from psmpc_cli.figures.run import Run
from psmpc_cli.figures.style import EDGE, line_look, readable
from psmpc_cli.figures.timeline import open_timeline

HEIGHT, SMALLEST = 2.4, 1e-5
"""Height of the panel [in]; less presence is not shown [m/s^2, rad/s^2]."""


def plot_presence(run: Run, published: Mapping[str, float]) -> Figure:
    """Return what each waiting stage adds to the control, its threshold, and where it starts.

    Args:
        run: The run.
        published: Published actual starts by stage [s].
    """
    timeline = open_timeline(run, 1, HEIGHT)
    (axes,) = timeline.panels
    presence, waited = run.log["window/presence"], []
    for stage, name in enumerate(run.log.stage_names):
        if np.isfinite(presence[:, stage]).any():
            waited.append(stage)
            _plot_stage(axes, run, stage, readable(name))
    axes.axhline(run.task.onset.epsilon, color=EDGE, linewidth=0.7, zorder=1.5)
    for time in published.values():
        axes.plot(time, run.task.onset.epsilon, **published_mark())
    axes.set_yscale("log")
    axes.set_ylim(bottom=SMALLEST)
    axes.set_ylabel("Control added by a waiting stage\n(m/s², rad/s²)")
    panel_legend(axes, "" if waited else "no stage waits: one at a time")
    threshold = Line2D([], [], color=EDGE, linewidth=0.7, label="threshold")
    marks = [Line2D([], [], label="published start", **published_mark())] if published else []
    return timeline.finish([threshold, *marks])


def _plot_stage(axes: Axes, run: Run, stage: int, name: str) -> None:
    """Plot the presence of a stage where it waited."""
    values = run.log["window/presence"][:, stage]
    seen = np.isfinite(values)
    shown = np.maximum(values[seen], SMALLEST)
    axes.plot(run.log.time[seen], shown, label=name, marker=point_if_alone(run.log.time[seen]), **line_look(stage))
