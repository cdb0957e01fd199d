"""Thrusters in pulses against their means: when the mission ends, and what it takes.

python benchmarks/thrusters.py table    the table of docs/mobility_results.md, a minute or two
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from pages import command_line, markdown

from psmpc_cli.logs.run import Run
from psmpc_cli.simulation.run import simulate
from psmpc_cli.specs.load import Task, load_task

SHORTEST_PULSES = (0.02, 0.05, 0.1)
"""Shortest pulses of the thrusters [s]; the last is that of the robot."""


def with_shortest_pulse(task: Task, shortest: float) -> Task:
    """Return a task whose robot's thrusters have another shortest pulse [s]."""
    thrusters = tuple(each.model_copy(update={"shortest_pulse": shortest}) for each in task.robot.thrusters)
    return replace(task, robot=task.robot.model_copy(update={"thrusters": thrusters}))


def table() -> Iterator[str]:
    """Yield a row for thrusts that are constant over each period, and one for each shortest pulse."""
    runs = {"none: mean thrusts throughout": simulate(load_task("thrust_and_reach", {"plant.thrusters": "continuous"}))}
    for shortest in SHORTEST_PULSES:
        task = with_shortest_pulse(load_task("thrust_and_reach"), shortest)
        runs[f"{1e3 * shortest:.0f} ms"] = simulate(task)
    yield from markdown([{"shortest pulse": name} | row(run) for name, run in runs.items()])


def row(run: Run) -> dict[str, str]:
    """Return the cells of a run."""
    summary = run.summary()
    fired = summary.thrusters
    if fired is None:
        raise RuntimeError("no thrusters fired")
    deviation = np.abs(run["deviation/Qdot"])
    return {
        "mission ends [s]": f"{summary.duration:.1f}" if summary.succeeded else "failed",
        "impulse [N s]": f"{fired.impulse:.0f}",
        "firings": f"{fired.firings}",
        "propellant [g]": f"{1e3 * fired.propellant:.0f}",
        "not yet given, largest [N s]": f"{fired.owed[0]:.2f}",
        "base off its plan, largest [mm/s]": f"{1e3 * deviation[:, :2].max():.1f}",
        "joints off their plan, largest [rad/s]": f"{deviation[:, 3:].max():.3f}",
    }


if __name__ == "__main__":
    command_line(table)
