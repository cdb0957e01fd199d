"""Completion, control effort and final error against the ratio of the priorities, and the recommended ratio."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullLocator, StrMethodFormatter

from psmpc_cli.figures.panels import panel_legend
from psmpc_cli.figures.style import EDGE, PALETTE, STAGE, line_look, new_figure, readable
from psmpc_cli.figures.sweep.along import label_ratio, mark_failed, plot_along, set_ratio
from psmpc_cli.simulation.recommendation import ALLOWED, WITHIN, Recommendation, recommend
from psmpc_cli.simulation.sweep_cells import AlongRatio, SweepCells, along_ratio

HEIGHT, AROUND = 1.05, 0.6
"""Heights of a panel and of what stands around all of them [in]."""

WIDE = 5.0
"""Efforts of which the largest is so many times the smallest have an axis of logarithms."""

WIDEST = 300.0
"""Up to this, the axis has numbers between the powers of ten as well."""

LINE = 1.0
"""Length of the lines in the legend [em]."""


def plot_sensitivity(cells: SweepCells) -> Figure:
    """Return completion [s], control effort [m^2/s^3, rad^2/s^3] and final error [tolerances] over omega_2 / omega_1.

    Shaded are the completions within 5 % of the earliest one; the lines through all panels are ratios.
    """
    completion, effort, error = (
        along_ratio(cells, cells.of(name)) for name in ("completion_time", "control_effort", "final_error")
    )
    panels = [
        (completion, f"Completion\nof {readable(cells.names[1])} (s)"),
        (effort, "Control effort\n(m²/s³, rad²/s³)"),
    ]
    if np.isfinite(error.middle).any():
        panels.append((error, "Final error\n(tolerances)"))
    figure = new_figure(len(panels) * HEIGHT + AROUND)
    rows = figure.subplots(len(panels), 1, sharex=True)
    set_ratio(rows[0], cells)
    for axes, (values, label) in zip(rows, panels, strict=True):
        plot_along(axes, values, **line_look(0))
        axes.set_ylabel(label)
        axes.margins(y=0.12)
        _mark_ratios(axes, cells, recommend(cells))
    if len(completion.ratio):
        _shade_near_earliest(rows[0], completion)
        _scale_effort(rows[1], effort)
    else:
        rows[0].set_yticks([])
        rows[1].set_yticks([])
    if len(rows) == 3:
        _plot_allowed(rows[2], error)
    mark_failed(rows[0], cells)
    panel_legend(rows[0], line=LINE)
    label_ratio(rows[-1])
    figure.align_ylabels()
    return figure


def _mark_ratios(axes: Axes, cells: SweepCells, best: Recommendation | None) -> None:
    """Mark the task's own ratio, as far as the sweep comes by it, and the recommended one."""
    if cells.ratio.min() <= cells.own_ratio <= cells.ratio.max():
        label = f"task's {cells.own_ratio:.4g}"
        axes.axvline(cells.own_ratio, color=EDGE, linewidth=0.9, linestyle=(0, (1, 1)), label=label, zorder=1.7)
    if best is not None:
        label = f"recommended {best.ratio:.4g}"
        axes.axvline(best.ratio, color=PALETTE[1], linewidth=1.1, label=label, zorder=1.8)


def _shade_near_earliest(axes: Axes, completion: AlongRatio) -> None:
    earliest = float(completion.lowest.min())
    label = f"earliest + {WITHIN:.0%}"
    axes.axhspan(earliest, (1 + WITHIN) * earliest, facecolor=STAGE, edgecolor="none", label=label, zorder=0.5)


def _scale_effort(axes: Axes, effort: AlongRatio) -> None:
    """Make the axis of efforts logarithmic, with plain numbers, where they differ much."""
    low, high = float(effort.lowest.min()), float(effort.highest.max())
    if not high > WIDE * low > 0:
        return
    axes.set_yscale("log")
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < WIDEST * low else (1.0,)))
    axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.yaxis.set_minor_locator(NullLocator())


def _plot_allowed(axes: Axes, error: AlongRatio) -> None:
    """Draw what the end condition allows."""
    axes.axhline(ALLOWED, color=EDGE, linewidth=0.7, zorder=1.5)
    axes.set_ylim(0.0, 1.15 * max(ALLOWED, float(np.nanmax(error.highest, initial=0.0))))
    axes.yaxis.set_major_locator(MaxNLocator(nbins=5, prune="lower"))
