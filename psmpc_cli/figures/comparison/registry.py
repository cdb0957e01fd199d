"""Every figure of a comparison by its name, which is also its file's stem."""

from collections.abc import Callable, Mapping

from matplotlib.figure import Figure

from psmpc_cli.figures.comparison.instants import plot_instants
from psmpc_cli.figures.comparison.shares import plot_shares
from psmpc_cli.figures.comparison.snapshots import plot_snapshots
from psmpc_cli.figures.comparison.states import plot_states
from psmpc_cli.figures.run import Run

FIGURES: Mapping[str, Callable[[Mapping[str, Run]], Figure]] = {
    "states": plot_states,
    "instants": plot_instants,
    "shares": plot_shares,
    "snapshots": plot_snapshots,
}
