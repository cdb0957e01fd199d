"""Each stage's share in objective and control over time, a column a controller. What Fig. 1 of the paper sketches."""

from collections.abc import Mapping

from matplotlib.figure import Figure

from psmpc_cli.figures.comparison.grid import open_grid, row_legend
from psmpc_cli.figures.run import Run
from psmpc_cli.figures.shares import HEIGHT, blanks, cost_shares, plot_stack


def plot_shares(runs: Mapping[str, Run]) -> Figure:
    """Return each stage's share [%] in the window's weighted cost and in the applied control, by controller."""
    grid = open_grid(runs, 2, HEIGHT)
    found = []
    for (above, below), run in zip(grid.panels.T, runs.values(), strict=True):
        cost, control = cost_shares(run), run.log["window/share"]
        plot_stack(above, run, cost)
        plot_stack(below, run, control)
        found += [cost, control]
    grid.panels[0, 0].set_ylabel("Share in the\nweighted cost (%)")
    grid.panels[1, 0].set_ylabel("Share in the\napplied control (%)")
    row_legend(grid.panels[0, 0])
    return grid.finish(blanks(*found))
