"""Every figure of a sweep by its name, which is also its file's stem, for each way to sample the priorities."""

from collections.abc import Callable, Mapping

from matplotlib.figure import Figure

from psmpc_cli.figures.sweep.draws import plot_draws
from psmpc_cli.figures.sweep.heat_map import plot_heat_map
from psmpc_cli.figures.sweep.sensitivity import plot_sensitivity
from psmpc_cli.figures.sweep.starts import plot_starts
from psmpc_cli.figures.sweep.surface import plot_surface
from psmpc_cli.simulation.sweep_cells import GRID, RANDOM, RATIOS, SweepCells

Drawings = Mapping[str, Callable[[SweepCells], Figure]]

_AGAINST_RATIO: Drawings = {"starts": plot_starts, "sensitivity": plot_sensitivity}

FIGURES: Mapping[str, Drawings] = {
    GRID: {"surface": plot_surface, "heat_map": plot_heat_map, **_AGAINST_RATIO},
    RATIOS: _AGAINST_RATIO,
    RANDOM: {"draws": plot_draws, **_AGAINST_RATIO},
}
