"""What figures over the plane of the two priorities have in common: axes of logarithms, one scale of colours."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, MaxNLocator

from psmpc_cli.figures.style import COLUMN, TEXT, legend_columns, readable
from psmpc_cli.simulation.sweep_cells import SweepCells

COLORS = "viridis"

SEEN = "$t_s - T_h$"

FAILED: Mapping[str, Any] = {"color": "black", "marker": "x", "markersize": 3.5, "linestyle": "none"}
"""Look of a cell that failed."""

ROOM = 0.4
"""Width left and right of a legend that no entry may use [in]."""


@dataclass(frozen=True)
class StartScale:
    """The scale of actual starts, from the earliest t_s - T_h to the latest t_s [s]."""

    low: float
    high: float

    @property
    def norm(self) -> Normalize:
        """The map from times [s] to 0 to 1."""
        return Normalize(self.low, self.high)

    @property
    def colors(self) -> ScalarMappable:
        """The map from times [s] to colours."""
        return ScalarMappable(self.norm, COLORS)


def start_scale(cells: SweepCells) -> StartScale:
    """Return the scale for a sweep; any where no cell has ended."""
    instant, floor = cells.instant[cells.ended], cells.floor[cells.ended]
    return StartScale(float(floor.min()), float(instant.max())) if len(instant) else StartScale(0.0, 1.0)


def starts_of(cells: SweepCells) -> np.ndarray:
    """Return the actual start for the one threshold that is shown, NaN where no cell has ended (cells,) [s]."""
    return np.where(cells.ended, cells.of("actual_start")[:, cells.chosen], np.nan)


def start_label(cells: SweepCells, between: str = ", ") -> str:
    """Return what the shown actual start is called on an axis."""
    return f"Actual start of {readable(cells.names[1])}{between}ε = {cells.epsilons[cells.chosen]:g} (s)"


def label_plane(axes: Axes, cells: SweepCells) -> None:
    """Name the axes of logarithms: omega_1 to the right, omega_2 up."""
    first, second = (readable(name) for name in cells.names)
    axes.set_xlabel(f"Priority of {first}, ω₁ (1)")
    axes.set_ylabel(f"Priority of {second}, ω₂ (1)")
    for axis in (axes.xaxis, axes.yaxis):
        count_decades(axis)


def count_decades(axis: Axis, most: int = 7) -> None:
    """Let an axis of logarithms have ticks at whole powers of ten."""
    axis.set_major_locator(MaxNLocator(nbins=most, integer=True))
    axis.set_major_formatter(FuncFormatter(lambda exponent, _: f"$10^{{{exponent:.0f}}}$"))


def add_colour_bar(figure: Figure, axes: Axes, cells: SweepCells, scale: StartScale) -> None:
    """Add the bar of colours, if anything has one; its ends are t_s - T_h and t_s."""
    if not cells.ended.any():
        return
    bar = figure.colorbar(scale.colors, ax=axes, pad=0.02, aspect=22)
    bar.set_label(start_label(cells))
    bar.ax.set_title("$t_s$", fontsize=TEXT, pad=3)
    bar.ax.set_xlabel(SEEN, fontsize=TEXT, labelpad=4, loc="left")


def failed_mark() -> Line2D:
    """Return what a legend says of cells that failed."""
    return Line2D([], [], label="failed", **FAILED)


def legend_above(figure: Figure, handles: list[Artist]) -> None:
    """Write a legend above everything."""
    if handles:
        columns = legend_columns((str(handle.get_label()) for handle in handles), COLUMN - ROOM)
        figure.legend(handles=handles, loc="outside upper center", ncols=columns)
