"""Base pose and joint angles over time, a column a controller. Figs. 8 to 10 of the paper side by side."""

from collections.abc import Mapping

from matplotlib.figure import Figure

from psmpc_cli.figures.comparison.grid import open_grid, row_legend
from psmpc_cli.figures.panels import HEIGHT, Quantity, axis_label, coordinate_panels, plot_lines
from psmpc_cli.figures.run import Run


def plot_states(runs: Mapping[str, Run]) -> Figure:
    """Return base pose [m, rad] and joint angles [rad] over time, all controllers on the same axes."""
    panels = coordinate_panels(next(iter(runs.values())).model)
    quantity = Quantity(("position", "angle"), ("m", "rad"))
    grid = open_grid(runs, len(panels), HEIGHT)
    for row, panel in zip(grid.panels, panels, strict=True):
        for axes, run in zip(row, runs.values(), strict=True):
            plot_lines(axes, run.time, run.Q[:, panel.rows], panel.labels)
        row[0].set_ylabel(axis_label(panel, quantity))
        row_legend(row[0])
    return grid.finish()
