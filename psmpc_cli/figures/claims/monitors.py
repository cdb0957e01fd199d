"""What the monitors watch, and the bounds that decide on the mission."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from psmpc_cli.figures.panels import panel_legend
from psmpc_cli.figures.run import Run
from psmpc_cli.figures.style import EDGE, PALETTE, readable
from psmpc_cli.figures.timeline import open_timeline
from psmpc_cli.simulation.monitors import signal, verdicts
from psmpc_cli.specs.task import MonitorSpec

HEIGHT = 1.6
"""Height of one panel [in]."""

BROKEN, BOUND = PALETTE[1], (0, (5, 2))


def plot_monitors(run: Run) -> Figure:
    """Return the signal of every monitor over time, its bounds while they count, and where it broke.

    A task without a monitor has one empty panel.
    """
    timeline = open_timeline(run, max(1, len(run.task.monitors)), HEIGHT)
    for axes, monitor, verdict in zip(timeline.panels, run.task.monitors, verdicts(run.task, run.log), strict=False):
        time, values = run.log.time, signal(monitor, run.log)
        axes.plot(time, values, color=PALETTE[0])
        _plot_bounds(axes, run, monitor, values)
        if np.isfinite(verdict.broken_at):
            at = verdict.broken_at
            axes.plot(at, np.interp(at, time, values), "X", color=BROKEN, markersize=6.0, zorder=3)
        axes.set_ylabel(_label(monitor))
        panel_legend(axes, f"{readable(monitor.name)} during {readable(monitor.during)}")
    if not run.task.monitors:
        timeline.panels[0].set_yticks([])
        panel_legend(timeline.panels[0], "the task has no monitor")
        return timeline.finish()
    bound = Line2D([], [], color=EDGE, linewidth=0.9, linestyle=BOUND, label="bound")
    broken = Line2D([], [], color=BROKEN, linestyle="none", marker="X", markersize=6.0, label="broken")
    return timeline.finish([bound, broken])


def _plot_bounds(axes: Axes, run: Run, monitor: MonitorSpec, values: np.ndarray) -> None:
    """Draw the bounds over the samples of the monitor's stage."""
    during = run.log["window/first"] == run.log.stage_names.index(monitor.during)
    if not during.any():
        return
    time, start = run.log.time[during], float(values[during][0])
    above, below = monitor.above_start_at_most, monitor.below_start_at_most
    bounds = (
        None if above is None else start + above,
        None if below is None else start - below,
        monitor.at_most,
        monitor.at_least,
    )
    for bound in bounds:
        if bound is not None:
            axes.plot(time[[0, -1]], [bound, bound], color=EDGE, linewidth=0.9, linestyle=BOUND, zorder=1.5)


def _label(monitor: MonitorSpec) -> str:
    if monitor.quantity == "speed":
        return "Speed (m/s)"
    names = [readable(name) for name in monitor.of] + ["base"] * (len(monitor.of) == 1)
    return f"Distance of\n{' and '.join(names)} (m)"
