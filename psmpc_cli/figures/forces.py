"""Generalized forces of the low-level controller over time."""

from matplotlib.figure import Figure

from psmpc_cli.figures.panels import Quantity, plot_coordinates
from psmpc_cli.figures.run import Run


def plot_forces(run: Run) -> Figure:
    """Return base force [N], base torque and joint torques [N m] at every tick if logged, else at every sample."""
    ticks = run.log.ticks
    time, F = (ticks["time"], ticks["F"]) if len(ticks.get("time", ())) else (run.log.time, run.log["force/F"])
    return plot_coordinates(run, time, F, Quantity(("force", "torque"), ("N", "N m"), peaked=True))
