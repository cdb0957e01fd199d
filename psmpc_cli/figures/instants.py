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

DASHED = (0, (5, 2))

MOST_NAMES = 6
"""Stages that the legend names; of more it gives the numbers."""


def plot_instants(run: Run) -> Figure:
    """Return each stage's optimized instant [s] over time, and how far it is off the instant that came true.

    An instant happens when it meets the line of the present; the horizon ends T_h above that line. The second panel is
    there only if an optimized instant came true.
    """
    instants, switches = run.log["window/instants"], run.log.stages["switch_time"]
    optimized = [stage for stage, column in enumerate(instants.T) if np.any(np.isfinite(column))]
    came_true = [stage for stage in optimized if np.isfinite(switches[stage])]
    timeline = open_timeline(run, 2 if came_true else 1, 1.5)
    above = timeline.panels[0]
    _draw_present(above, run)
    for stage in optimized:
        name = readable(run.log.stage_names[stage]) if len(optimized) <= MOST_NAMES else str(stage + 1)
        _plot(above, run.log.time, instants[:, stage], stage, name)
    above.plot(switches, switches, "o", color="black", markerfacecolor="white", markersize=3.5, zorder=3)
    above.set_ylabel("Optimized end\nof the stage (s)")
    panel_legend(above, "" if optimized else "no instant was optimized")
    for below in timeline.panels[1:]:
        for stage in came_true:
            _plot(
                below, run.log.time, instants[:, stage] - switches[stage], stage, readable(run.log.stage_names[stage])
            )
        below.axhline(0.0, color=EDGE, linewidth=0.7, zorder=1.5)
        below.set_ylabel("Optimized minus\nactual end (s)")
    return timeline.finish(
        [
            Line2D([], [], color=EDGE, linewidth=0.7, label="present time"),
            Line2D([], [], color="black", linestyle="none", marker="o", markerfacecolor="white", label="actual end"),
            Line2D([], [], color=EDGE, linewidth=0.7, linestyle=DASHED, label="end of the horizon"),
        ]
    )


def _draw_present(axes: Axes, run: Run) -> None:
    """Draw the line of the present and the end of the horizon, and see to it that both fit."""
    ends, horizon = np.array([run.time[0], run.end]), run.task.controller.horizon
    axes.plot(ends, ends, color=EDGE, linewidth=0.7, zorder=1.5)
    axes.plot(ends, ends + horizon, color=EDGE, linewidth=0.7, linestyle=DASHED, zorder=1.5)
    axes.set_ylim(ends[0], ends[1] + horizon)


def _plot(axes: Axes, time: np.ndarray, values: np.ndarray, stage: int, name: str) -> None:
    """Plot a stage's values (K,) over time (K,) [s] where there are any, the first with a marker."""
    seen = np.isfinite(values)
    look: dict[str, Any] = {"color": PALETTE[stage % len(PALETTE)], "marker": MARKERS[stage % len(MARKERS)]}
    axes.plot(time[seen], values[seen], label=name, markevery=[0], linewidth=1.3, **look)
