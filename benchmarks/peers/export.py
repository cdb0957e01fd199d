"""Writes windows of a transport run, and what psmpc itself makes of them, for programs that know nothing of psmpc.

    python benchmarks/peers/export.py DIRECTORY          writes windows.json and psmpc.json there

The run is a closed loop at N_s = 25. Each window is solved from two starts: cold from rest, its stages of equal length,
and warm from the optimum of the sample before at the same N_s, moved on by a sample. Times are those of a core, in the
peers as well, so that what else the machine does hardly counts.
"""

import argparse
import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from psmpc_cli.ocp.plan import Plan, resting_plan, shift
from psmpc_cli.ocp.problem import Problem
from psmpc_cli.ocp.window import Window, end_tolerance, on_mesh, shortest_durations
from psmpc_cli.simulation.run import build_experiment, closed_loop
from psmpc_cli.solvers import Solution, Solver, build_solver
from psmpc_cli.specs.load import load_task
from psmpc_cli.specs.robot import RobotSpec
from psmpc_cli.specs.task import SolverSpec

AT = {"one stage": 3.0, "two stages": 8.0}
"""When each window is solved [s]: Approach alone, and Approach with Capture."""

NODES = (25, 50, 100)
SOLVERS = ("sqp", "fatrop", "ipopt")
REPEATS = 5
QUICK = ("controller.nodes=25", "solver.kind=sqp", "plant.kind=ideal")


@dataclass(frozen=True, eq=False)
class Start:
    """Where a solve of a window starts: a plan on its mesh, and the solution of the sample before, if any."""

    guess: Plan
    previous: Solution | None = None


def recorded() -> tuple[Problem, dict[str, tuple[Solution, Solution]]]:
    """Run until the last window of `AT` and return the solve of each after the one of the sample before."""
    experiment = build_experiment(load_task("transport", QUICK))
    solves: list[Solution] = []
    for sample in closed_loop(experiment):
        solves.append(sample.command.solution)
        if sample.command.time >= max(AT.values()) - 1e-9:
            break
    step = experiment.problem.spec.controller.sample_time
    at = {name: round(time / step) for name, time in AT.items()}
    return experiment.problem, {name: (solves[k - 1], solves[k]) for name, k in at.items()}


def meshed(window: Window, nodes: int) -> Window:
    """Return a window with so many intervals a stage."""
    return replace(window, nodes=(nodes,) * len(window.stages))


def starts(solver: Solver, pair: tuple[Solution, Solution], nodes: int) -> dict[str, Start]:
    """Return the cold and the warm start of a window on a mesh."""
    window, count = meshed(pair[1].window, nodes), len(pair[1].window.stages)
    equal = window.start + window.horizon * np.arange(1, count) / count
    rest = replace(resting_plan(window.start, window.horizon, window.K, window.x0), instants=equal)
    before = solver.solve(meshed(pair[0].window, nodes), pair[0].guess)
    assert before.outcome.usable, "the run's windows have solutions"
    moved = shift(before.plan, window.start, window.horizon, window.x0)
    return {"cold": Start(on_mesh(rest, window)), "warm": Start(on_mesh(moved, window), before)}


def window_numbers(window: Window, by_nodes: dict[int, dict[str, Start]]) -> dict[str, Any]:
    """Return every number of a window, and its starts by N_s."""
    largest, shortest = float(window.omega.max()), shortest_durations(window)
    stages = [
        {
            "space": stage.space,
            "omega": float(window.omega[s]) / largest,
            "offset": float(window.offset[s]),
            "scale": float(window.scale[s]),
            "weights": stage.weights.tolist(),
            "control_weights": stage.control_weights.tolist(),
            "target": stage.target.tolist(),
            "end_rows": list(stage.end_rows) if s < len(window.stages) - 1 else [],
            "tolerance": end_tolerance(stage).tolist() if s < len(window.stages) - 1 else [],
            "shortest": float(shortest[s]),
            "low": np.r_[stage.limits.position_low, stage.limits.velocity_low].tolist(),
            "high": np.r_[stage.limits.position_high, stage.limits.velocity_high].tolist(),
        }
        for s, stage in enumerate(window.stages)
    ]
    return {
        "x0": window.x0.tolist(),
        "horizon": window.horizon,
        "pending_cost": window.pending_cost,
        "stages": stages,
        "starts": {
            str(nodes): {name: _plain(start.guess, window) for name, start in starts.items()}
            for nodes, starts in by_nodes.items()
        },
    }


def _plain(plan: Plan, window: Window) -> dict[str, Any]:
    """Return states, controls and free durations of a plan."""
    durations = np.diff(plan.instants, prepend=window.start)
    return {"X": plan.X.tolist(), "u": plan.u.tolist(), "durations": durations.tolist()}


def robot_numbers(robot: RobotSpec) -> list[dict[str, Any]]:
    """Return the geometry of the arms."""
    return [
        {
            "mount": list(arm.mount.position),
            "mount_angle": arm.mount.angle,
            "lengths": [link.a + link.b for link in arm.links],
            "tool_angle": arm.tool.angle,
        }
        for arm in robot.arms.values()
    ]


def own_results(
    problem: Problem, pairs: dict[str, tuple[Solution, Solution]], begins: dict[str, dict[int, dict[str, Start]]]
) -> Iterator[dict[str, Any]]:
    """Give what each solver of psmpc makes of each window at each N_s."""
    for nodes in NODES:
        for name, pair in pairs.items():
            for kind in SOLVERS:
                print(f"psmpc {kind}, {name}, N_s = {nodes}", flush=True)
                found = _own_result(problem, meshed(pair[1].window, nodes), begins[name][nodes], kind)
                yield found | {"window": name, "nodes": nodes}


def _own_result(problem: Problem, window: Window, begins: dict[str, Start], kind: str) -> dict[str, Any]:
    began = process_time()
    solver = build_solver(problem, SolverSpec(kind=kind))
    found: dict[str, Solution] = {}
    for name, start in begins.items():
        found[name] = solver.solve(window, start.guess, start.previous)
    spent = process_time() - began
    times = {
        name: float(np.median([_timed(solver, window, start) for _ in range(REPEATS)]))
        for name, start in begins.items()
    }
    build = max(spent - sum(times.values()), 0.0)  # solvers are built by their first solve
    return {
        "program": f"psmpc, {kind}",
        "build": build,
        **{
            name: {
                "status": solution.outcome.name.lower(),
                "objective": solution.objective,
                "instants": (solution.plan.instants - window.start).tolist(),
                "iterations": solution.iterations,
                "time": times[name],
            }
            for name, solution in found.items()
        },
    }


def _timed(solver: Solver, window: Window, start: Start) -> float:
    """Return how much time of a core a solve takes [s]."""
    began = process_time()
    solver.solve(window, start.guess, start.previous)
    return process_time() - began


def main(directory: Path) -> None:
    """Run, solve and write."""
    directory.mkdir(parents=True, exist_ok=True)
    problem, pairs = recorded()
    fatrop = build_solver(problem, SolverSpec(kind="fatrop"))
    begins = {name: {nodes: starts(fatrop, pair, nodes) for nodes in NODES} for name, pair in pairs.items()}
    windows = {name: window_numbers(pair[1].window, begins[name]) for name, pair in pairs.items()}
    numbers = {"arms": robot_numbers(problem.task.robot), "repeats": REPEATS, "windows": windows}
    (directory / "windows.json").write_text(json.dumps(numbers), encoding="utf-8")
    own = list(own_results(problem, pairs, begins))
    (directory / "psmpc.json").write_text(json.dumps(own), encoding="utf-8")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("directory", type=Path)
    main(parser.parse_args().directory)
