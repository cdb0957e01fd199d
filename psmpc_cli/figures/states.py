"""Base pose and joint angles over time. Figs. 8 to 10 of the paper."""

from matplotlib.figure import Figure

from psmpc_cli.figures.panels import Quantity, plot_coordinates
from psmpc_cli.figures.run import Run


def plot_states(run: Run) -> Figure:
    """Return base pose [m, rad] and joint angles [rad] over time, and what the controller saw of them."""
    return plot_coordinates(run, run.time, run.Q, Quantity(("position", "angle"), ("m", "rad")), seen=run.Q_seen)
