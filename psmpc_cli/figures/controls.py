"""Controls over time, with their limits where there are any."""

from matplotlib.figure import Figure

from psmpc_cli.figures.panels import Quantity, plot_coordinates
from psmpc_cli.figures.run import Run


def plot_controls(run: Run) -> Figure:
    """Return the applied accelerations [m/s^2, rad/s^2] at the samples over time, with the limits in force."""
    return plot_coordinates(
        run,
        run.log.time,
        run.log["control/u"],
        Quantity(("control", "control"), ("m/s²", "rad/s²"), peaked=True),
        limits="acceleration",
    )
