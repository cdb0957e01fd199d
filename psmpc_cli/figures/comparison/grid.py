"""The frame of figures over time with a column a controller: its name, a strip of its stages, shaded panels."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from psmpc_cli.figures.comparison.names import title_of
from psmpc_cli.figures.run import Run
from psmpc_cli.figures.style import COLUMN, LINE, PAGE, TEXT, legend_columns, new_figure
from psmpc_cli.figures.timeline import MARGINS, ROOM, STRIP, draw_strip, shade, stage_handles

LEFT = 0.6
"""Width of what stands left of the panels [in]."""

ABOVE = 0.15
"""Height of a row's legend, and of the titles [in]."""

TITLE = 8.0
"""Size of the controllers' names [pt]."""


@dataclass(frozen=True, eq=False)
class Grid:
    """A figure, its panels (rows, controllers), and what its common legend says of the stages."""

    figure: Figure
    panels: np.ndarray
    handles: tuple[Artist, ...]

    def finish(self, handles: Sequence[Artist] = ()) -> Figure:
        """Write the common legend, with more entries, each once, below the panels and return the figure."""
        entries = {str(handle.get_label()): handle for handle in (*handles, *self.handles)}
        if entries:
            columns = legend_columns(entries, self.figure.get_figwidth() - 0.1)
            self.figure.set_figheight(self.figure.get_figheight() + -(-len(entries) // columns) * LINE)
            self.figure.legend(handles=list(entries.values()), loc="outside lower center", ncols=columns)
        return self.figure


def open_grid(runs: Mapping[str, Run], rows: int, height: float) -> Grid:
    """Return a figure of rows of empty panels, each `height` [in] tall, along one time axis for all runs."""
    width = COLUMN if len(runs) == 1 else PAGE
    figure = new_figure(STRIP + ABOVE + MARGINS + rows * (height + ABOVE), width)
    ratios = [STRIP] + [height] * rows
    axes = figure.subplots(rows + 1, len(runs), sharex=True, sharey="row", squeeze=False, height_ratios=ratios)
    _set_time(axes[0, 0], runs.values())
    handles: list[Artist] = []
    keys: list[Artist] = []
    for column, (name, run) in zip(axes.T, runs.items(), strict=True):
        keys += draw_strip(column[0], run, (width - LEFT) / len(runs))
        handles += stage_handles(run.spans)
        column[0].set_title(title_of(name), fontsize=TITLE, pad=3)
        for panel in column[1:]:
            shade(panel, run.spans)
        column[-1].set_xlabel("Time (s)")
    figure.align_ylabels(axes[1:, 0])
    return Grid(figure, axes[1:], (*handles, *keys))


def row_legend(axes: Axes) -> None:
    """Write the legend of a row above its first panel; it may reach over the next, where nothing stands."""
    axes.set_title(" ", loc="left", pad=2, fontsize=TEXT)
    handles, _ = axes.get_legend_handles_labels()
    legend = axes.legend(loc="lower left", bbox_to_anchor=(0.0, 0.98), ncols=len(handles))
    legend.set_in_layout(False)


def _set_time(axes: Axes, runs: Iterable[Run]) -> None:
    """Set the common time axis: from the first start to the last end."""
    every = list(runs)
    start, end = min(float(run.time[0]) for run in every), max(run.end for run in every)
    room = ROOM * (end - start) or 0.55 * every[0].task.controller.sample_time
    axes.set_xlim(start - room, end + room)
    axes.xaxis.set_major_locator(MaxNLocator(nbins=4, steps=[1, 2, 5, 10]))
