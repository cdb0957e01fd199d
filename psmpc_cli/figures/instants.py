"""The optimized switching instants, sample by sample. Fig. 11 of the paper."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from psmpc_cli.figures.panels import panel_legend
from psmpc_cli.figures.run import Run
from psmpc_cli.figures.style import EDGE, PALETTE, readable
from psmpc_cli.figures.timeline import open_timeline

MARKERS = ("o", "s", "^", "D", "v", "P", "X")

MOST_NAMES = 6
"""Stages that the legend names; of more it gives the numbers."""


def plot_instants(run: Run) -> Figure:
    """Return each stage's optimized instant [s] over time, and how far it is off the instant that came true.

    An instant happens when it meets the line of the present; the horizon ends T_h above that line.
    """
    timeline = open_timeline(run, 2, 1.5)
    above, below = timeline.panels
    horizon = run.task.controller.horizon
    ends = np.array([run.time[0], run.end])
    above.plot(ends, ends, color=EDGE, linewidth=0.7, zorder=1.5)
    above.plot(ends, ends + horizon, color=EDGE, linewidth=0.7, linestyle=(0, (5, 2)), zorder=1.5)
    seen = [stage for stage, column in enumerate(run.log["window/instants"].T) if np.any(np.isfinite(column))]
    for stage in seen:
        name = readable(run.log.stage_names[stage]) if len(seen) <= MOST_NAMES else str(stage + 1)
        _plot_stage(above, below, run, stage, name)
    switches = run.log.stages["switch_time"]
    above.plot(switches, switches, "o", color="black", markerfacecolor="white", markersize=3.5, zorder=3)
    above.set_ylim(ends[0], ends[1] + horizon)
    above.set_ylabel("Optimized end\nof the stage (s)")
    below.set_ylabel("Optimized minus\nactual end (s)")
    below.axhline(0.0, color=EDGE, linewidth=0.7, zorder=1.5)
    panel_legend(above, "" if seen else "no instant optimized: one stage at a time")
    return timeline.finish(
        [
            Line2D([], [], color=EDGE, linewidth=0.7, label="present time"),
            Line2D([], [], color="black", linestyle="none", marker="o", markerfacecolor="white", label="actual end"),
            Line2D([], [], color=EDGE, linewidth=0.7, linestyle=(0, (5, 2)), label="end of the horizon"),
        ]
    )


def _plot_stage(above: Axes, below: Axes, run: Run, stage: int, name: str) -> None:
    instants, switch = run.log["window/instants"][:, stage], float(run.log.stages["switch_time"][stage])
    seen = np.isfinite(instants)
    look: dict[str, Any] = {
        "color": PALETTE[stage % len(PALETTE)],
        "marker": MARKERS[stage % len(MARKERS)],
        "linewidth": 1.3,
    }
    above.plot(run.log.time[seen], instants[seen], label=name, markevery=[0], **look)
    if np.isfinite(switch):
        below.plot(run.log.time[seen], instants[seen] - switch, markevery=[0], **look)
