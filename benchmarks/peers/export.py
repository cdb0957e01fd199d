"""Writes windows of a transport run, and what psmpc itself makes of them, for programs that know nothing of psmpc.

    python benchmarks/peers/export.py DIRECTORY          writes windows.json and psmpc.json there

The run is a closed loop at N_s = 25. Each window is solved from two starts: cold from rest, its stages of equal length,
and warm from the optimum of the sample before at the same N_s, moved on by a sample. Times are those of a core, in the
peers as well, so that what else the machine does hardly counts.
"""

import argparse
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
from psmpc_cli.control.multipliers import Before, shift_multipliers
from psmpc_cli.control.window_solver import WindowSolver
from psmpc_cli.ocp.layout import Layout

from psmpc_cli.control import Command
from psmpc_cli.control.controller import SwitchingController
from psmpc_cli.ocp.plan import resting_plan, shift
from psmpc_cli.ocp.window import Window, bounds, end_tolerance, pack_guess, parameter_vector, shortest_durations
from psmpc_cli.simulation.loop import closed_loop
from psmpc_cli.simulation.setup import Experiment, build_experiment
from psmpc_cli.solvers import Guess, Solution
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
class Recorded:
    """Two decisions of a run, a sample apart."""

    before: Command
    at: Command


class Recorder(SwitchingController):
    """A controller that keeps what it decided."""

    def __init__(self, controller: SwitchingController) -> None:
        super().__init__(controller.spec, controller.stages, controller.windows)
        self.decided: list[Command] = []

    def decide(self, now: float, x: np.ndarray) -> Command:
        """Decide and keep the decision."""
        self.decided.append(super().decide(now, x))
        return self.decided[-1]


def recorded(experiment: Experiment) -> dict[str, Recorded]:
    """Run until the last window of `AT` and return the decisions of each with those before."""
    recorder, last = Recorder(experiment.controller), max(AT.values())
    for record in closed_loop(replace(experiment, controller=recorder)):
        if record.command.time >= last - 1e-9:
            break
    step, decided = experiment.task.controller.sample_time, recorder.decided
    return {name: Recorded(*decided[round(time / step) - 1 : round(time / step) + 1]) for name, time in AT.items()}


@dataclass(frozen=True, eq=False)
class Start:
    """Where a solve of a window starts."""

    guess: Guess
    instants: np.ndarray


def starts(windows: WindowSolver, pair: Recorded) -> dict[str, Start]:
    """Return the cold and the warm start of a window on the mesh of `windows`."""
    window = meshed(pair.at, windows)
    nlp, _ = windows.compiled(windows.shape(window))
    count = len(window.stages)
    equal = window.start + window.horizon * np.arange(1, count) / count
    rest = resting_plan(window.start, window.horizon, nlp.layout.K, window.x0)
    before = windows.solve(meshed(pair.before, windows), pair.before.prediction, pair.before.sequence.instants)
    assert before.solution.outcome.usable, "the run's windows have solutions"
    nlp_before, _ = windows.compiled(windows.shape(before.window))
    moved = shift(before.plan, window.start, window.horizon, window.x0)
    z = pack_guess(nlp, window, moved, moved.instants, windows.costs)
    warm = shift_multipliers(nlp, z, window, Before(nlp_before, before.window, before.solution))
    assert warm.warm, "both windows hold the same stages"
    cold = Guess(pack_guess(nlp, window, rest, equal, windows.costs))
    return {"cold": Start(cold, equal), "warm": Start(warm, moved.instants)}


def meshed(decision: Command, windows: WindowSolver) -> Window:
    """Return a decision's window with the N_s of `windows`."""
    window = decision.solution.window
    return replace(window, nodes=(windows.task.controller.uniform_nodes,) * len(window.stages))


def window_numbers(window: Window, pair: Recorded, by_nodes: dict[int, WindowSolver]) -> dict[str, Any]:
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
        "starts": {str(nodes): _start_numbers(windows, pair) for nodes, windows in by_nodes.items()},
    }


def _start_numbers(windows: WindowSolver, pair: Recorded) -> dict[str, Any]:
    layout = windows.compiled(windows.shape(meshed(pair.at, windows)))[0].layout
    return {name: _plain(start.guess.z, layout) for name, start in starts(windows, pair).items()}


def _plain(z: np.ndarray, layout: Layout) -> dict[str, Any]:
    """Return states, controls and free durations of a decision vector."""
    u = np.vstack([z[layout.input_index(s)] for s in range(len(layout.nodes))])
    return {
        "X": z[layout.state_index].tolist(),
        "u": u.tolist(),
        "durations": z[layout.duration_index[0]].tolist(),
    }


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


def own_results(by_nodes: dict[int, WindowSolver], pairs: dict[str, Recorded]) -> Iterator[dict[str, Any]]:
    """Give what each solver of psmpc makes of each window at each N_s."""
    for nodes, windows in by_nodes.items():
        for name, pair in pairs.items():
            begins = starts(windows, pair)
            for kind in SOLVERS:
                print(f"psmpc {kind}, {name}, N_s = {nodes}", flush=True)
                yield _own_result(windows, meshed(pair.at, windows), begins, kind) | {"window": name, "nodes": nodes}


def _own_result(windows: WindowSolver, window: Window, begins: dict[str, Start], kind: str) -> dict[str, Any]:
    task = windows.task.model_copy(update={"solver": SolverSpec(kind=kind)})
    began = process_time()
    solver_of = WindowSolver(task, windows.model, windows.costs)
    nlp, solver = solver_of.compiled(solver_of.shape(window))

    def solve(start: Start) -> Solution:
        return solver.solve(start.guess, parameter_vector(nlp, window, start.instants), bounds(nlp, window))

    first = {name: solve(start) for name, start in begins.items()}
    spent = process_time() - began
    times = {name: float(np.median([_timed(solve, start) for _ in range(REPEATS)])) for name, start in begins.items()}
    build = max(spent - sum(times.values()), 0.0)  # solvers are built by their first solve
    durations = {name: solution.z[nlp.layout.duration_index[0]] for name, solution in first.items()}
    return {
        "program": f"psmpc, {kind}",
        "build": build,
        **{
            name: {
                "status": solution.outcome.name.lower(),
                "objective": solution.objective,
                "instants": np.cumsum(durations[name]).tolist(),
                "iterations": solution.iterations,
                "time": times[name],
            }
            for name, solution in first.items()
        },
    }


def _timed(solve: Callable[[Start], Solution], start: Start) -> float:
    """Return how much time of a core a solve takes [s]."""
    began = process_time()
    solve(start)
    return process_time() - began


def main(directory: Path) -> None:
    """Run, solve and write."""
    directory.mkdir(parents=True, exist_ok=True)
    experiment = build_experiment(load_task("transport", QUICK))
    pairs = recorded(experiment)
    by_nodes = {}
    for nodes in NODES:
        controller = experiment.task.controller.model_copy(update={"nodes": nodes})
        task = experiment.task.model_copy(update={"controller": controller, "solver": SolverSpec(kind="fatrop")})
        by_nodes[nodes] = WindowSolver(task, experiment.model, experiment.costs)
    windows = {name: window_numbers(pair.at.solved.window, pair, by_nodes) for name, pair in pairs.items()}
    numbers = {"arms": robot_numbers(experiment.loaded.robot), "repeats": REPEATS, "windows": windows}
    (directory / "windows.json").write_text(json.dumps(numbers), encoding="utf-8")
    own = list(own_results(by_nodes, pairs))
    (directory / "psmpc.json").write_text(json.dumps(own), encoding="utf-8")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("directory", type=Path)
    main(parser.parse_args().directory)
