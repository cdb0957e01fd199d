"""Thrusters in pulses against their means, with a load and with plumes: when the mission ends, and what it takes.

python benchmarks/thrusters.py table     pulses, for docs/mobility_results.md, a minute or two
python benchmarks/thrusters.py load      pulses while two hands hold a load, for the same page, a minute
python benchmarks/thrusters.py plumes    plumes, for the same page, a minute or two
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import product

import numpy as np
from pages import command_line, markdown

from psmpc_cli.logs.run import Run
from psmpc_cli.simulation.run import simulate
from psmpc_cli.specs.load import Task, load_task
from psmpc_cli.specs.robots.actuators import PlanarThruster, Plume

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


def load() -> Iterator[str]:
    """Yield a row for each stiffness of the grasps on a load of 20 kg, with mean thrusts and with pulses."""
    thrusters = with_shortest_pulse(load_task("thrust_and_reach"), SHORTEST_PULSES[0]).robot.thrusters
    rows = []
    for (stiffness, step), fire in product(((1e4, 1e-3), (1e5, 2e-4)), ("continuous", "pulsed")):
        grasp = {"object.grasp.stiffness": [stiffness, stiffness / 10], "plant.step": step}
        task = load_task("transport_grasp", {**grasp, "limits.base.force": None})
        task = replace(
            task,
            robot=task.robot.model_copy(update={"thrusters": thrusters}),
            spec=task.spec.model_copy(update={"plant": task.spec.plant.model_copy(update={"thrusters": fire})}),
        )
        run = simulate(task)
        summary = run.summary()
        off = np.abs(run["deviation/Qdot"][:, 3:]).max(axis=1)
        holds = run["grasp/closed"].all(axis=1)
        rows.append(
            {
                "grasps [N/m]": f"{stiffness:,.0f}",
                "thrusts": {"continuous": "means", "pulsed": "pulses"}[fire],
                "mission ends [s]": f"{summary.duration:.1f}" if summary.succeeded else "failed",
                "joints off their plan, hands empty [mrad/s]": f"{1e3 * np.quantile(off[~holds], 0.95):.2f}",
                "hands loaded [mrad/s]": f"{1e3 * np.quantile(off[holds], 0.95):.2f}",
                "solves failed": f"{summary.failed_solves} of {summary.solves.count}",
            }
        )
    yield from markdown(rows)


PLUME = Plume(angle=np.radians(20), length=1.5)

CANTED = tuple(
    PlanarThruster(position=(0.25, y), direction=(-0.5, turn), force=10, shortest_pulse=0.1, specific_impulse=60)
    for y, turn in ((0.24, -0.866), (-0.24, 0.866))
)
"""Thrusters that brake too, and whose plumes leave at 60 deg to the way ahead, one to each side."""


def before_a_panel(avoided: bool, canted: bool) -> Task:
    """Return the task of flying to a place one metre from a panel, and stopping there."""
    folded = {"arm_1": ["60 deg", "-110 deg", "-40 deg"], "arm_2": ["-60 deg", "110 deg", "40 deg"]}
    stage = {
        "name": "fly",
        "skill": "move",
        "target": {"base": [1.2, 0, 0], **folded},
        "ends_when": {"coordinates": "base", "tolerance": 0.02},
    }
    panel = {"name": "panel", "shape": {"box": [0.2, 0.6]}, "pose": [2.2, 0, 0]}
    task = load_task("thrust_and_reach", {"stages": [stage], "obstacles": [panel]})
    thrusters = (*task.robot.thrusters, *(CANTED if canted else ()))
    thrusters = tuple(each.model_copy(update={"plume": PLUME}) for each in thrusters)
    return replace(
        task,
        robot=task.robot.model_copy(update={"thrusters": thrusters}),
        spec=task.spec.model_copy(update={"plumes": "avoided" if avoided else "ignored"}),
    )


def plumes() -> Iterator[str]:
    """Yield a row for each set of thrusters, with plumes that are ignored and avoided."""
    rows = []
    for canted, avoided in product((True, False), (False, True)):
        run = simulate(before_a_panel(avoided, canted))
        summary = run.summary()
        fired = summary.thrusters
        if fired is None:
            raise RuntimeError("no thrusters fired")
        ahead = float(run["thrusters/impulse"][:, 2:4].sum())
        rows.append(
            {
                "thrusters": "eight, and two canted ones" if canted else "eight",
                "plumes": "avoided" if avoided else "ignored",
                "mission ends [s]": f"{summary.duration:.1f}" if summary.succeeded else "failed",
                "impulse [N s]": f"{fired.impulse:.0f}",
                "of the two towards the panel [N s]": f"{ahead:.0f}",
                "shut for [s]": f"{max(fired.shut.values(), default=0.0):.1f}" if fired.shut is not None else "",
                "that no thrusts can give [N s]": f"{fired.refused[0]:.1f}",
                "solves failed": f"{summary.failed_solves} of {summary.solves.count}",
            }
        )
    yield from markdown(rows)


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
    command_line(table, load, plumes)
