"""The optimized switching instants of all controllers. Fig. 11 of the paper."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from psmpc_cli.figures.comparison.names import title_of
from psmpc_cli.figures.run import Run
from psmpc_cli.figures.style import EDGE, LINE, PAGE, TEXT, legend_columns, line_look, new_figure, readable

MARKERS = ("o", "s", "^", "D", "v", "P", "X")

ACROSS = 4
"""Stages side by side in the lower rows."""

OVERVIEW, DETAIL, MARGINS = 2.2, 1.5, 0.9
"""Heights of the upper panel, of a lower one, and of the labels around them [in]."""


def plot_instants(runs: Mapping[str, Run]) -> Figure:
    """Return every optimized instant [s] over time, and by stage how far it is off the end that came true [ms]."""
    first = next(iter(runs.values()))
    seen = [s for s in range(len(first.stages)) if any(_optimized(run, s).any() for run in runs.values())]
    across = min(ACROSS, len(seen)) or 1
    rows = -(-len(seen) // across)
    figure = new_figure(OVERVIEW + rows * (DETAIL + LINE) + MARGINS, PAGE)
    grid = figure.add_gridspec(1 + rows, across, height_ratios=[OVERVIEW] + [DETAIL] * rows)
    overview = figure.add_subplot(grid[0, :])
    _plot_overview(overview, runs)
    shared: Axes | None = None
    for i, stage in enumerate(seen):
        axes = figure.add_subplot(grid[1 + i // across, i % across], sharey=shared, sharex=shared)
        shared = shared or axes
        _plot_detail(axes, runs, stage)
        axes.set_title(f"end of {readable(first.log.stage_names[stage])}", fontsize=TEXT, pad=3)
        axes.set_xlabel("Time minus actual end (s)")
        if i % across == 0:
            axes.set_ylabel("Optimized minus\nactual end (ms)")
        else:
            axes.tick_params(labelleft=False)
    _legend(figure, runs)
    return figure


def _plot_overview(axes: Axes, runs: Mapping[str, Run]) -> None:
    """Plot the instants over time, up to the line of the present, where they happen."""
    end = max(run.end for run in runs.values())
    axes.plot([0.0, end], [0.0, end], color=EDGE, linewidth=0.7, zorder=1.5)
    for i, run in enumerate(runs.values()):
        for stage in range(len(run.stages)):
            which = _optimized(run, stage)
            axes.plot(run.log.time[which], run.log["window/instants"][which, stage], **_look(i))
        switches = run.log.stages["switch_time"]
        axes.plot(switches, switches, linestyle="none", zorder=3, **_marker(i))
    axes.set_xlim(0.0, end * 1.012)
    axes.set_ylim(0.0, end * 1.05)
    axes.set_xlabel("Time (s)")
    axes.set_ylabel("Optimized end\nof a stage (s)")


def _plot_detail(axes: Axes, runs: Mapping[str, Run], stage: int) -> None:
    """Plot how far a stage's instant is off its actual end, over the time until then."""
    axes.axhline(0.0, color=EDGE, linewidth=0.7, zorder=1.5)
    for i, run in enumerate(runs.values()):
        which, end = _optimized(run, stage), float(run.log.stages["switch_time"][stage])
        if which.any() and np.isfinite(end):
            axes.plot(run.log.time[which] - end, 1e3 * (run.log["window/instants"][which, stage] - end), **_look(i))


def _optimized(run: Run, stage: int) -> np.ndarray:
    """Return at which samples (K,) the end of a stage was optimized."""
    return np.asarray(np.isfinite(run.log["window/instants"][:, stage]))


def _look(index: int) -> dict[str, Any]:
    return {**line_look(index), "linewidth": 1.3}


def _marker(index: int) -> dict[str, Any]:
    return {"marker": MARKERS[index % len(MARKERS)], "markersize": 4.5, **_hollow(line_look(index)["color"])}


def _hollow(color: str) -> dict[str, Any]:
    return {"color": color, "markeredgecolor": color, "markerfacecolor": "none", "markeredgewidth": 0.9}


def _legend(figure: Figure, runs: Mapping[str, Run]) -> None:
    handles = [Line2D([], [], label=title_of(name), **(_look(i) | _marker(i))) for i, name in enumerate(runs)]
    handles += [
        Line2D([], [], color=EDGE, linewidth=0.7, label="present time (markers: actual ends)"),
    ]
    columns = legend_columns((str(handle.get_label()) for handle in handles), PAGE - 0.1)
    figure.legend(handles=handles, loc="outside lower center", ncols=columns)
