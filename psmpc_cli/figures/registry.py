"""Every figure by its name, which is also its file's stem."""

from collections.abc import Callable, Mapping

from matplotlib.figure import Figure

from psmpc_cli.figures.controls import plot_controls
from psmpc_cli.figures.errors import plot_errors
from psmpc_cli.figures.forces import plot_forces
from psmpc_cli.figures.instants import plot_instants
from psmpc_cli.figures.run import Run
from psmpc_cli.figures.shares import plot_shares
from psmpc_cli.figures.snapshots import plot_snapshots
from psmpc_cli.figures.solve_time import plot_solve_time
from psmpc_cli.figures.states import plot_states
from psmpc_cli.figures.velocities import plot_velocities

FIGURES: Mapping[str, Callable[[Run], Figure]] = {
    "states": plot_states,
    "velocities": plot_velocities,
    "controls": plot_controls,
    "forces": plot_forces,
    "errors": plot_errors,
    "instants": plot_instants,
    "shares": plot_shares,
    "snapshots": plot_snapshots,
    "solve_time": plot_solve_time,
}
