"""Thrusters in pulses against their means, with a load and with plumes: when the mission ends, and what it takes.

python benchmarks/thrusters.py table     pulses, for docs/mobility_results.md, a minute or two
python benchmarks/thrusters.py load      pulses while two hands hold a load, for the same page, a minute
python benchmarks/thrusters.py plumes    plumes, for the same page, a minute or two
python benchmarks/thrusters.py missions 50   random missions, for the same page: flies what is missing, 2 s a flight
"""

import json
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from pages import command_line, markdown

from psmpc_cli.errors import SpecError
from psmpc_cli.logs.run import Run
from psmpc_cli.ocp.feasibility.checks import ensure_feasible
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.simulation.run import simulate
from psmpc_cli.specs.load import Task, load_task
from psmpc_cli.specs.robots.actuators import PlanarThruster, Plume

SHORTEST_PULSES = (0.02, 0.05, 0.1)
"""Shortest pulses of the thrusters [s]; the last is that of the robot."""


RESULTS = Path(__file__).with_suffix(".jsonl")
"""Flights of random missions, one a line."""

FLOWN_WITH: Mapping[str, tuple[str, float | None]] = {
    "continuous": ("mean thrusts throughout", None),
    "20 ms": ("pulses of 20 ms at least", 0.02),
    "50 ms": ("pulses of 50 ms at least", 0.05),
    "100 ms": ("pulses of 100 ms at least, the robot's own", 0.1),
}
"""Names in the results, names in the table, and shortest pulses of the thrusters [s], None for none."""


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
                "impossible [N s]": f"{fired.refused[0]:.1f}",
                "solves failed": f"{summary.failed_solves} of {summary.solves.count}",
            }
        )
    yield from markdown(rows)


def mission(seed: int) -> Task:
    """Draw a mission of the two stages of `thrust_and_reach`; draws that `psmpc check` refuses are repeated.

    The base flies up to 2 m in any direction, and turns by up to 90 deg. The arms fly in a random posture. The hands
    then reach the poses to which joints lead that move by up to 1 rad each.
    """
    rng = np.random.default_rng(seed)
    builtin = load_task("thrust_and_reach")
    model = RobotModel(builtin.robot)
    low, high = np.transpose(builtin.robot.limits["arms"].position * len(builtin.robot.arms))
    while True:
        distance = rng.uniform(0.3, 2.0)
        bearing = rng.uniform(-np.pi, np.pi)
        turn = rng.uniform(-np.pi / 2, np.pi / 2)
        base = np.array([distance * np.cos(bearing), distance * np.sin(bearing), turn])
        folded = rng.uniform(low, high)
        reached = folded + rng.uniform(-1.0, 1.0, len(folded))
        if ((reached < low) | (reached > high)).any():
            continue
        _, hand_1, hand_2 = model.poses(np.concatenate([base, reached]))
        arms = {"arm_1": folded[:3].tolist(), "arm_2": folded[3:].tolist()}
        hands = {"arm_1": hand_1.tolist(), "arm_2": hand_2.tolist()}
        changes = {
            "initial": {"base": [0, 0, 0], **arms},
            "stages.fly.target": {"base": base.tolist(), **arms},
            "stages.reach.target": {"base": base.tolist(), **hands},
            "log": {"shares": False, "plans": False},
        }
        try:
            return ensure_feasible(load_task("thrust_and_reach", changes))
        except SpecError:
            continue


def flight(seed: int, thrusters: str) -> dict[str, Any]:
    """Fly a mission with thrusters as `FLOWN_WITH` says, and return what became of it."""
    task = mission(seed)
    _, shortest = FLOWN_WITH[thrusters]
    if shortest is None:
        plant = task.spec.plant.model_copy(update={"thrusters": "continuous"})
        task = replace(task, spec=task.spec.model_copy(update={"plant": plant}))
    else:
        task = with_shortest_pulse(task, shortest)
    run = simulate(task)
    summary = run.summary()
    fired = summary.thrusters
    if fired is None:
        raise RuntimeError("no thrusters fired")
    reached = run.problem.model.poses(run["final/Q"])
    target = task.spec.stages[-1].target
    errors = np.array([pose - target[part] for pose, part in zip(reached, ("base", "arm_1", "arm_2"), strict=True)])
    distances = 1e3 * np.linalg.norm(errors[:, :2], axis=1)
    angles = 1e3 * np.abs((errors[:, 2] + np.pi) % (2 * np.pi) - np.pi)
    in_window = run["window/count"] > 1
    return {
        "seed": seed,
        "thrusters": thrusters,
        "succeeded": bool(summary.succeeded),
        "why": summary.reason,
        "time": round(summary.duration, 1),
        "arrived": round(float(run.stages["switch_time"][0]), 2),
        "reach_entered": round(float(run.time[in_window.argmax()]), 1) if in_window.any() else None,
        "impulse": round(fired.impulse, 1),
        "propellant": round(1e3 * fired.propellant, 1),
        "firings": fired.firings,
        "distances": distances.round(2).tolist(),
        "angles": angles.round(2).tolist(),
        "failed_solves": summary.failed_solves,
        "late": summary.missed,
        "samples": len(run.time),
    }


def flights() -> dict[str, dict[int, dict[str, Any]]]:
    """Return the flights so far, by thrusters and seed."""
    made: dict[str, dict[int, dict[str, Any]]] = {thrusters: {} for thrusters in FLOWN_WITH}
    lines = RESULTS.read_text().splitlines() if RESULTS.exists() else []
    for result in map(json.loads, lines):
        made[result["thrusters"]][result["seed"]] = result
    return made


def missions(count: str) -> Iterator[str]:
    """Fly so many random missions as far as results lack them, and yield a row for each way to fire.

    Differences and ratios are to the flight of the same mission with mean thrusts.
    """
    made = flights()
    for seed, thrusters in product(range(int(count)), FLOWN_WITH):
        if seed not in made[thrusters]:
            made[thrusters][seed] = flight(seed, thrusters)
            with RESULTS.open("a") as file:
                file.write(json.dumps(made[thrusters][seed]) + "\n")
    rows = []
    for thrusters, (name, shortest) in FLOWN_WITH.items():
        flown = [made[thrusters][seed] for seed in range(int(count))]
        reference = [made["continuous"][seed] for seed in range(int(count))]
        delivered = [each for each in flown if each["succeeded"]]
        pairs = [(a, b) for a, b in zip(flown, reference, strict=True) if a["succeeded"] and b["succeeded"]]
        later = np.array([pulsed["time"] - mean["time"] for pulsed, mean in pairs]).round(1)
        ratio = np.array([pulsed["propellant"] / mean["propellant"] for pulsed, mean in pairs])
        compared = shortest is not None
        rows.append(
            {
                "thrusters": name,
                "succeeded": f"{len(delivered)} of {len(flown)}",
                "end later by [s]": spread_of(later, "+.1f") if compared else "",
                "within 1 s": f"{np.sum(np.abs(later) <= 1.0)} of {len(later)}" if compared else "",
                "propellant, ratio": spread_of(ratio, ".2f") if compared else "",
                "base off its place at the end [mm]": spread_of([each["distances"][0] for each in delivered], ".1f"),
                "hands [mm]": spread_of([max(each["distances"][1:]) for each in delivered], ".1f"),
                "solves failed": f"{sum(each['failed_solves'] for each in flown)} of "
                f"{sum(each['samples'] for each in flown):,}",
            }
        )
    yield from markdown(rows)


def spread_of(values: Any, form: str) -> str:
    """Write the median of some values (N,), with what 5 % and 95 % of them are below."""
    low, middle, high = np.quantile(values, [0.05, 0.5, 0.95])
    return f"{middle:{form}} ({low:{form}} to {high:{form}})"


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
    command_line(table, load, plumes, missions)
