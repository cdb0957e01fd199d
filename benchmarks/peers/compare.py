"""Solves the same windows with psmpc, rockit and do-mpc and prints one table.

    python benchmarks/peers/compare.py          with .venv-rockit and .venv-do-mpc beside it

`make docs-tables ONLY=peers` makes the environments and does this. The windows are those of a closed loop at N_s = 25.
Each is solved from two starts: cold from rest, its stages of equal length, and warm from the optimum of the sample
before at the same N_s, moved on by a sample. Times are those of a core, in the peers as well, so that what else the
machine does hardly counts. The exit code is 1 where objectives differ by more than 1e-3 relative or instants by more
than 20 ms from those of fatrop.
"""

import pickle
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from itertools import islice, product
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from typing import Any

import numpy as np
import window as peers
from window import Solve, measured

from psmpc_cli.ocp.plan import Plan, resting_plan, shift
from psmpc_cli.ocp.problem import Problem
from psmpc_cli.ocp.window import Window, on_mesh, shortest_durations
from psmpc_cli.simulation.run import build_experiment, closed_loop
from psmpc_cli.solvers import Solution, Solver, build_solver
from psmpc_cli.specs.load import load_task
from psmpc_cli.specs.task import SolverSpec

HERE = Path(__file__).parent
PEERS = {"rockit": ".venv-rockit", "do_mpc": ".venv-do-mpc"}
REFERENCE = "psmpc, fatrop"
OBJECTIVE, INSTANT = 1e-3, 0.02
HEADINGS = (
    "| window | N_s | program | build [s] | cold [ms] | warm [ms] | warm over sqp | J apart | instants apart [ms] |"
)

Result = Mapping[str, Any]

Start = tuple[Plan, Solution | None]
"""Where a solve of a window starts: a plan on its mesh, and the solution of the sample before, if any."""

AT = {"one stage": 3.0, "two stages": 8.0}
"""When each window is solved [s]: Approach alone, and Approach with Capture."""

NODES = (25, 50, 100)
SOLVERS = ("sqp", "fatrop", "ipopt")
REPEATS = 5


def recorded() -> tuple[Problem, dict[str, tuple[Solution, Solution]]]:
    """Run until the last window of `AT` and return the solve of each after the one of the sample before."""
    experiment = build_experiment(load_task("transport", {"controller.nodes": 25, "plant.kind": "ideal"}))
    at = {name: round(time / experiment.problem.spec.controller.sample_time) for name, time in AT.items()}
    solves = [sample.command.solution for sample in islice(closed_loop(experiment), max(at.values()) + 1)]
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
    return {"cold": (on_mesh(rest, window), None), "warm": (on_mesh(moved, window), before)}


def plain(problem: Problem, window: Window, begins: dict[int, dict[str, Start]]) -> peers.Window:
    """Return every number of a window, and its starts by N_s."""
    shortest, last = shortest_durations(window), len(window.stages) - 1
    stages = [
        peers.Stage(
            space=stage.space,
            omega=window.omega[s] / window.omega.max(),
            offset=window.offset[s],
            scale=window.scale[s],
            weights=stage.weights,
            control_weights=stage.control_weights,
            target=stage.target,
            end_rows=list(stage.end_rows) if s < last else [],
            tolerance=stage.end_tolerance,
            shortest=shortest[s],
            low=np.r_[stage.limits.position_low, stage.limits.velocity_low],
            high=np.r_[stage.limits.position_high, stage.limits.velocity_high],
        )
        for s, stage in enumerate(window.stages)
    ]
    plans = {
        nodes: {
            name: peers.Start(plan.X, plan.u, np.diff(plan.instants, prepend=window.start))
            for name, (plan, _) in each.items()
        }
        for nodes, each in begins.items()
    }
    arms = [
        (tuple(arm.mount.position), arm.mount.angle, [link.a + link.b for link in arm.links], arm.tool.angle)
        for arm in problem.task.robot.arms.values()
    ]
    return peers.Window(arms, window.x0, window.horizon, window.pending_cost, stages, plans, REPEATS)


def own_solve(problem: Problem, window: Window, kind: str) -> Solve:
    """Return what solves a window from a start with a solver of psmpc."""
    solver = build_solver(problem, SolverSpec(kind=kind))

    def solve(start: Start) -> dict[str, Any]:
        began = process_time()
        solution = solver.solve(window, *start)
        return {
            "time": process_time() - began,
            "status": solution.outcome.name.lower(),
            "objective": solution.objective,
            "instants": (solution.plan.instants - window.start).tolist(),
            "iterations": solution.iterations,
        }

    return solve


def results(directory: Path) -> Iterator[Result]:
    """Yield what every program makes of every window; the peers read them from a file."""
    problem, pairs = recorded()
    fatrop = build_solver(problem, SolverSpec(kind="fatrop"))
    begins = {name: {nodes: starts(fatrop, pair, nodes) for nodes in NODES} for name, pair in pairs.items()}
    windows = {name: plain(problem, pair[1].window, begins[name]) for name, pair in pairs.items()}
    (directory / "windows").write_bytes(pickle.dumps(windows))
    for nodes, (name, pair), kind in product(NODES, pairs.items(), SOLVERS):
        print(f"psmpc {kind}, {name}, N_s = {nodes}", file=sys.stderr)
        build = partial(own_solve, problem, meshed(pair[1].window, nodes), kind)
        found = measured(build, begins[name][nodes], REPEATS)
        yield {"program": f"psmpc, {kind}", **found, "window": name, "nodes": nodes}
    for name, environment in PEERS.items():
        subprocess.run([HERE / environment / "bin" / "python", HERE / f"{name}_peer.py", directory], check=True)
        yield from pickle.loads((directory / name).read_bytes())


def apart(row: Result, reference: Result, start: str) -> tuple[float, float]:
    """Return the relative difference of the objectives and the largest of the instants [s]."""
    found, expected = row[start], reference[start]
    instants = [abs(a - b) for a, b in zip(found["instants"], expected["instants"], strict=True)]
    return abs(found["objective"] / expected["objective"] - 1), max(instants, default=0.0)


def table(rows: list[Result]) -> tuple[list[str], bool]:
    """Return the table of the results by window and N_s, and whether all programs agree."""
    lines, agree = [HEADINGS, "|---" * HEADINGS.count(" | ") + "|---|"], True
    for window, nodes in dict.fromkeys((row["window"], row["nodes"]) for row in rows):
        here = {row["program"]: row for row in rows if (row["window"], row["nodes"]) == (window, nodes)}
        for program, row in here.items():
            pairs = [apart(row, here[REFERENCE], start) for start in ("cold", "warm")]
            objective, instant = (max(values) for values in zip(*pairs, strict=True))
            agree &= objective <= OBJECTIVE and instant <= INSTANT
            cold, warm = (f"{1e3 * row[start]['time']:.1f} ({row[start]['iterations']})" for start in ("cold", "warm"))
            ratio = row["warm"]["time"] / here["psmpc, sqp"]["warm"]["time"]
            lines.append(
                f"| {window} | {nodes} | {program} | {row['build']:.2f} | {cold} | {warm} | {ratio:.0f} "
                f"| {objective:.0e} | {1e3 * instant:.2f} |"
            )
    return lines, agree


if __name__ == "__main__":
    with TemporaryDirectory() as temporary:
        lines, agree = table(list(results(Path(temporary))))
    print("\n".join(lines))
    raise SystemExit(0 if agree else 1)
