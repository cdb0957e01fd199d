"""Each stage's share in objective and control over time, a column a controller. What Fig. 1 of the paper sketches."""

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from psmpc_cli.figures.comparison.grid import open_grid, row_legend
from psmpc_cli.figures.run import Run
from psmpc_cli.figures.shares import CONTROL, COST, HEIGHT, blanks, logged_shares, plot_stack


def plot_shares(runs: Mapping[str, Run]) -> Figure:
    """Return each stage's share [%] in the window's weighted cost and in the applied control, by controller.

    The row of the control is there only if those shares were logged.
    """
    found = {name: logged_shares(run) for name, run in runs.items()}
    wholes = [whole for whole in (COST, CONTROL) if any(whole in shares for shares in found.values())]
    grid = open_grid(runs, len(wholes), HEIGHT)
    for row, whole in zip(grid.panels, wholes, strict=True):
        for axes, (name, shares) in zip(row, found.items(), strict=True):
            plot_stack(axes, runs[name], shares.get(whole, np.full_like(shares[COST], np.nan)))
        row[0].set_ylabel(f"Share in the\n{whole} (%)")
    row_legend(grid.panels[0, 0])
    return grid.finish(blanks(*(values for shares in found.values() for values in shares.values())))
