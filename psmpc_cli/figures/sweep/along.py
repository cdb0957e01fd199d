"""What figures against the ratio of the priorities have in common."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, NullLocator

from psmpc_cli.figures.sweep.plane import FAILED
from psmpc_cli.simulation.sweep_cells import AlongRatio, SweepCells

FEW = 60
"""Ratios up to this many are marked by points."""

MARKER = 2.2
"""Size of the points [pt]."""


def plot_along(axes: Axes, values: AlongRatio, **look: Any) -> None:
    """Plot a quantity over the ratio, and how far the cells of one ratio lie apart, where they do."""
    marker = "o" if len(values.ratio) <= FEW else ""
    axes.plot(values.ratio, values.middle, marker=marker, markersize=MARKER, **look)
    if np.any(values.highest > values.lowest):
        axes.fill_between(values.ratio, values.lowest, values.highest, color=look["color"], alpha=0.2, linewidth=0)


def set_ratio(axes: Axes, cells: SweepCells) -> None:
    """Make the axis one of ratios, over all that the sweep has, run or not."""
    low, high = float(cells.ratio.min()), float(cells.ratio.max())
    room = (high / low) ** 0.02 if high > low else 2.0
    axes.set_xscale("log")
    axes.set_xlim(low / room, high * room)
    axes.xaxis.set_major_locator(LogLocator(numticks=8))
    axes.xaxis.set_minor_locator(NullLocator())


def label_ratio(axes: Axes) -> None:
    """Name the axis of ratios."""
    axes.set_xlabel("Ratio of the priorities, ω₂/ω₁ (1)")


def mark_failed(axes: Axes, cells: SweepCells) -> None:
    """Mark the ratios of cells that failed along the lower edge."""
    ratio = np.unique(cells.ratio[cells.failed])
    if len(ratio):
        height = np.full(len(ratio), 0.045)
        axes.plot(ratio, height, transform=axes.get_xaxis_transform(), label="failed", **FAILED)
