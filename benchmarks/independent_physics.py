"""Compares the plant rk4 with MuJoCo on the transport task: prints a table of docs/reliability.md.

    python benchmarks/independent_physics.py [NODES]

NODES is the intervals a stage, 100 by default.
"""

import sys

import mujoco
import numpy as np
from pages import markdown

from psmpc_cli.logs.run import Run
from psmpc_cli.logs.summary import Summary
from psmpc_cli.plant.mujoco_plant import MujocoPlant
from psmpc_cli.robot.model import RobotModel, angle_rows
from psmpc_cli.simulation.run import simulate
from psmpc_cli.specs.load import load_task

WINDOW = 5.0
"""Length of an open-loop replay [s]."""

REPLAYS = {
    "Runge-Kutta, a step a tick": (mujoco.mjtIntegrator.mjINT_RK4, 1),
    "Runge-Kutta, four steps a tick": (mujoco.mjtIntegrator.mjINT_RK4, 4),
    "semi-implicit Euler, MuJoCo's default": (mujoco.mjtIntegrator.mjINT_EULER, 1),
}


def run(plant: str, nodes: int) -> Run:
    """Run the transport task on a plant, with every tick."""
    log = {"ticks": True, "plans": False, "shares": False}
    return simulate(load_task("transport", {"plant.kind": plant, "controller.nodes": nodes, "log": log}))


def deviation(log: Run, model: RobotModel, integrator: mujoco.mjtIntegrator, substeps: int, window: float) -> float:
    """Return by how much a coordinate or rate leaves the log's when its forces are replayed, anew every window [s]."""
    ticks, X = log.ticks, np.hstack([log.ticks["Q"], log.ticks["v"]])
    tick = float(ticks["time"][1] - ticks["time"][0])
    plant, length = MujocoPlant(model, tick, substeps), min(round(window / tick), len(X))
    plant.engine.opt.integrator = integrator
    starts = range(0, len(X) - 1, length)
    replayed = {start: plant.replay(X[start], ticks["F"][start : start + length]) for start in starts}
    return max(float(np.abs(new[: len(X) - start] - X[start:][: len(new)]).max()) for start, new in replayed.items())


def pose_differences(first: Run, second: Run, model: RobotModel) -> tuple[float, float]:
    """Return the largest differences of final positions [m] and angles [rad], of base and end-effectors."""
    difference = np.abs(first.final["xi"] - second.final["xi"])
    angles = list(angle_rows(model)[1])
    return float(np.delete(difference, angles).max()), float(difference[angles].max())


def instants(summary: Summary) -> np.ndarray:
    """Return the instants that end the stages, and their actual starts [s]."""
    return np.array([[stage.switch_time, stage.actual_start] for stage in summary.stages])


def rows(rk4: Run, engine: Run, model: RobotModel) -> dict[str, str]:
    """Return the table, by what was compared."""
    summaries = rk4.summary(), engine.summary()
    position, angle = pose_differences(rk4, engine, model)
    ends, starts = np.abs(instants(summaries[0]) - instants(summaries[1])).max(axis=0)
    drifts = [f"{s.momentum_error:.1e} N s, {s.energy_error:.1e} J" for s in summaries]
    return {
        **{
            f"open loop, {WINDOW:g} s: {name}": f"{deviation(rk4, model, *how, WINDOW):.1e}"
            for name, how in REPLAYS.items()
        },
        "open loop, the whole run: Runge-Kutta, a step a tick": (
            f"{deviation(rk4, model, mujoco.mjtIntegrator.mjINT_RK4, 1, rk4.ticks['time'][-1]):.1e}"
        ),
        "closed loop: final pose": f"{position:.1e} m, {angle:.1e} rad",
        "closed loop: instants that end the stages": f"{ends:.1e} s",
        "closed loop: actual starts": f"{starts:.1e} s",
        "balance of momentum and energy, rk4": drifts[0],
        "balance of momentum and energy, MuJoCo": drifts[1],
    }


def main(nodes: int) -> None:
    """Print the table."""
    logs = [run(plant, nodes) for plant in ("rk4", "mujoco")]
    lines = rows(*logs, RobotModel(load_task("transport").robot))
    headings = (f"rk4 against MuJoCo {mujoco.__version__}, N_s = {nodes}", "largest difference")
    print("\n".join(markdown(headings, lines.items())))


if __name__ == "__main__":
    main(int(sys.argv[1]) if sys.argv[1:] else 100)
