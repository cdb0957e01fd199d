"""Generalized velocities over time, with their limits."""

from matplotlib.figure import Figure

from psmpc_cli.figures.panels import Quantity, plot_coordinates
from psmpc_cli.figures.run import Run


def plot_velocities(run: Run) -> Figure:
    """Return generalized velocities [m/s, rad/s] over time, with the limits in force and what the controller saw."""
    quantity = Quantity(("velocity", "velocity"), ("m/s", "rad/s"))
    return plot_coordinates(run, run.time, run.Qdot, quantity, limits="velocity", seen=run.Qdot_seen)
