"""How long each solve took against the sample time."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, MaxNLocator, NullLocator, StrMethodFormatter

from psmpc_cli.figures.panels import panel_legend
from psmpc_cli.figures.run import Run
from psmpc_cli.figures.style import EDGE, PALETTE
from psmpc_cli.figures.timeline import open_timeline

MARKERS = ("o", "^", "s", "D")


def plot_solve_time(run: Run) -> Figure:
    """Return the wall time [ms] and the iterations of each solve over time, by how many stages were in the window."""
    timeline = open_timeline(run, 2, 1.25)
    above, below = timeline.panels
    wall, count = run.log["solver/wall_time"] * 1e3, run.log["window/count"]
    solved = np.isfinite(wall) & (wall > 0)
    counts = np.unique(count[solved])
    for i, stages in enumerate(counts):
        which = solved & (count == stages)
        look: dict[str, Any] = {
            "color": PALETTE[i % len(PALETTE)],
            "marker": MARKERS[i % len(MARKERS)],
            "linestyle": "none",
            "markersize": 1.8,
        }
        label = f"{stages} stage{'s' if stages > 1 else ''}{' in the window' if stages == counts[-1] else ''}"
        above.plot(run.log.time[which], wall[which], label=label, **look)
        below.plot(run.log.time[which], run.log["solver/iterations"][which], label=label, **look)
    limit = run.task.controller.sample_time * 1e3
    above.axhline(limit, color=EDGE, linewidth=0.7)
    above.set_yscale("log")
    above.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    above.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    above.yaxis.set_minor_locator(NullLocator())
    above.margins(y=0.1)
    above.set_ylabel("Solve time\n(ms)")
    below.set_ylabel("Iterations\nof the solve")
    below.margins(y=0.1)
    below.set_ylim(bottom=0)
    below.yaxis.set_major_locator(MaxNLocator(integer=True, nbins=5, steps=[1, 2, 5, 10]))
    panel_legend(above, line=0.8)
    handles = [Line2D([], [], color=EDGE, linewidth=0.7, label=f"sample time, {limit:g} ms")]
    failed = run.log["events/solve_failed"].astype(bool)
    if np.any(failed):
        for axes, values in ((above, np.where(solved, wall, limit)), (below, run.log["solver/iterations"])):
            axes.plot(run.log.time[failed], values[failed], "x", color="black", markersize=4)
        handles.append(Line2D([], [], color="black", marker="x", markersize=4, linestyle="none", label="failed solve"))
    return timeline.finish(handles)
