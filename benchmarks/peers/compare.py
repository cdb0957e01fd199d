"""Solves the same windows with psmpc, acados, rockit and do-mpc and prints one table.

    python benchmarks/peers/compare.py          with the environments of the peers beside it, `.venv-acados` and so on

`make docs-tables ONLY=peers` makes the environments and does this. The windows are those of closed loops at N_s = 25.
Each is solved from two starts: cold from rest, its stages of equal length, and warm from the optimum of the sample
before at the same N_s, moved on by a sample. Times are those of a core, in the peers as well, so that what else the
machine does hardly counts. A peer that is not installed, fails or needs more than five minutes for all windows is named
below the table, in which is what it has solved until then. The exit code is 1 where one fails, or where objectives
differ by more than 1e-3 relative or instants by more than 20 ms from those of fatrop.
"""

import pickle
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice, product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import window as peers
from window import Solve, measured

from psmpc_cli.ocp.constraints.boxes import node_limits, shift_limits
from psmpc_cli.ocp.plan import Grid, Plan, resting_plan, shift
from psmpc_cli.ocp.problem import Problem
from psmpc_cli.ocp.window import Window, on_mesh, shortest_durations
from psmpc_cli.robot.rotations import exp
from psmpc_cli.simulation.run import build_experiment, closed_loop
from psmpc_cli.solvers import Solution, Solver, build_solver
from psmpc_cli.solvers.bounded import processor_time
from psmpc_cli.specs.controller import SolverSpec
from psmpc_cli.specs.load import load_task
from psmpc_cli.specs.robots.robot import Attachment, RobotSpec

HERE = Path(__file__).parent
PEERS = {"acados": ".venv-acados", "rockit": ".venv-rockit", "do_mpc": ".venv-do-mpc"}
REFERENCE = "psmpc, fatrop"
OBJECTIVE, INSTANT = 1e-3, 0.02
HEADINGS = (
    "| window | N_s | program | build [s] | cold [ms] | warm [ms] | warm over sqp | J apart | switch times apart [ms] |"
)

Result = Mapping[str, Any]

Start = tuple[Plan, Solution | None]
"""Where a solve of a window starts: a plan on its mesh, and the solution of the sample before, if any."""


@dataclass(frozen=True)
class Case:
    """A window: of which task, when it is solved [s], and at which N_s."""

    task: str
    time: float
    nodes: tuple[int, ...]


CASES = {
    "planar, one stage": Case("transport", 3.0, (25, 50, 100)),
    "planar, two stages": Case("transport", 8.0, (25, 50, 100)),
    "servicer, one stage": Case("servicing", 3.0, (25, 50)),
    "servicer, two stages": Case("servicing", 5.0, (25, 50)),
}
"""Approach alone, and Approach with Capture, of a robot with 9 and of one with 20 degrees of freedom."""

LIMIT = 300
"""For how long a peer may run [s]: with those of psmpc all windows take less than 20 minutes."""

SOLVERS = ("sqp", "fatrop", "ipopt")
REPEATS = 5


@dataclass(frozen=True)
class Meshed:
    """A window at some N_s, and its cold and its warm start."""

    window: Window
    starts: dict[str, Start]


@dataclass(frozen=True)
class Recorded:
    """A window of a run on every mesh, by N_s, with the problem of its task."""

    problem: Problem
    meshes: dict[int, Meshed]


def recorded() -> dict[str, Recorded]:
    """Run the tasks until the last of their windows and return all windows."""
    found = {}
    for task in dict.fromkeys(case.task for case in CASES.values()):
        experiment = build_experiment(load_task(task, {"controller.nodes": 25}))
        fatrop = build_solver(experiment.problem, SolverSpec(kind="fatrop"))
        sample_time = experiment.problem.spec.controller.sample_time
        at = {name: round(case.time / sample_time) for name, case in CASES.items() if case.task == task}
        solves = [sample.command.solution for sample in islice(closed_loop(experiment), max(at.values()) + 1)]
        for name, k in at.items():
            meshes = {nodes: meshed(fatrop, solves[k - 1], solves[k], nodes) for nodes in CASES[name].nodes}
            found[name] = Recorded(experiment.problem, meshes)
    return found


def stated(window: Window, nodes: int) -> Window:
    """Return a window with so many intervals a stage and without limits of forces, which no peer states."""
    stages = tuple(replace(stage, constraints={}) for stage in window.stages)
    return replace(window, stages=stages, nodes=(nodes,) * len(stages))


def meshed(solver: Solver, before: Solution, solution: Solution, nodes: int) -> Meshed:
    """Return the window of a solution on a mesh, and its starts; `before` is the solution of the sample before."""
    window, count = stated(solution.window, nodes), len(solution.window.stages)
    equal = window.start + window.horizon * np.arange(1, count) / count
    rest = resting_plan(window.start, window.horizon, window.K, window.x0, window.chart)
    cold = on_mesh(replace(rest, switch_times=equal), window)
    found = solver.solve(stated(before.window, nodes), before.guess)
    assert found.outcome.usable, "the run's windows have solutions"
    moved = shift(found.plan.in_chart(window.chart), window.start, window.horizon, window.x0)
    warm = on_mesh(moved, window)
    return Meshed(window.about(warm), {"cold": (cold, None), "warm": (warm, found)})


def plain(case: Recorded) -> peers.Window:
    """Return every number of a window on all of its meshes."""
    window = next(iter(case.meshes.values())).window
    shortest, last = shortest_durations(window), len(window.stages) - 1
    assert not window.offset.any(), "costs are normalized by their largest value alone"
    stages = [
        peers.Stage(
            space=stage.space,
            omega=window.omega[s] / window.omega.max(),
            scale=window.scale[s],
            weights=stage.weights,
            control_weights=stage.control_weights,
            target=stage.target[: len(stage.target) - case.problem.model.space.n_sample_numbers],
            end_rows=list(stage.end.rows) if s < last else [],
            tolerance=stage.end.half_widths if s < last else np.zeros(0),
            shortest=shortest[s],
            low=stage.limits.acceleration_low,
            high=stage.limits.acceleration_high,
        )
        for s, stage in enumerate(window.stages)
    ]
    return peers.Window(
        robot=robot(case.problem.task.robot, window.chart.anchor),
        x0=window.x0,
        horizon=window.horizon,
        pending_cost=window.pending_cost,
        stages=stages,
        meshes={nodes: plain_mesh(each) for nodes, each in case.meshes.items()},
        repeats=REPEATS,
    )


def plain_mesh(case: Meshed) -> peers.Mesh:
    """Return the numbers of a mesh."""
    window = case.window
    low, high = node_limits(Grid(len(window.x0) // 2, window.nodes), window.stages)
    shift_limits(window, case.starts["warm"][0], low, high)
    starts = {
        name: peers.Start(plan.X, plan.u, np.diff(plan.switch_times, prepend=window.start), before is not None)
        for name, (plan, before) in case.starts.items()
    }
    return peers.Mesh(low, high, starts)


def robot(spec: RobotSpec, anchor: np.ndarray) -> peers.Robot:
    """Return the numbers of a robot; anchor: attitude about which a spatial one has its coordinates."""
    if spec.dimension == 2:
        return peers.PlanarRobot(
            [
                (tuple(arm.mount.position), arm.mount.angle, [link.a + link.b for link in arm.links], arm.tool.angle)
                for arm in spec.arms.values()
            ]
        )
    joints = [(frame(joint.at), np.array(joint.axis)) for joint in spec.joints]
    return peers.SpatialRobot(anchor, joints, [frame(tool) for tool in spec.tools.values()])


def frame(at: Attachment) -> peers.Frame:
    """Return the numbers of a frame."""
    return peers.Frame(at.body, np.array(at.position), np.array(exp(at.rotation), float))


def own_solve(problem: Problem, window: Window, kind: str) -> Solve:
    """Return what solves a window from a start with a solver of psmpc."""
    solver = build_solver(problem, SolverSpec(kind=kind))

    def solve(start: Start) -> dict[str, Any]:
        began = processor_time()
        solution = solver.solve(window, *start)
        return {
            "time": processor_time() - began,
            "status": solution.outcome.name.lower(),
            "objective": solution.objective,
            "instants": (solution.plan.switch_times - window.start).tolist(),
            "iterations": solution.iterations,
        }

    return solve


def own_results(cases: Mapping[str, Recorded]) -> Iterator[Result]:
    """Yield what every solver of psmpc makes of every window."""
    for name, case in cases.items():
        for (nodes, each), kind in product(case.meshes.items(), SOLVERS):
            print(f"psmpc {kind}, {name}, N_s = {nodes}", file=sys.stderr)
            found = measured(partial(own_solve, case.problem, each.window, kind), each.starts, REPEATS)
            yield {"program": f"psmpc, {kind}", **found, "window": name, "nodes": nodes}


def peer_results(directory: Path) -> Iterator[tuple[list[Result], str]]:
    """Yield what each peer makes of the windows in a directory, and what is to be said of it if that is not all."""
    for name, environment in PEERS.items():
        python = HERE / environment / "bin" / "python"
        if not python.exists():
            yield [], f"{name} is not installed here."
            continue
        note = ""
        try:
            subprocess.run([python, HERE / f"{name}_peer.py", directory], stdout=sys.stderr, timeout=LIMIT, check=True)
        except subprocess.TimeoutExpired:
            note = f"{name} was stopped after {LIMIT / 60:.0f} minutes."
        except subprocess.CalledProcessError:
            note = f"{name} failed."
        written = directory / name
        results = pickle.loads(written.read_bytes()) if written.exists() else []
        yield results, note


def apart(found: Result, expected: Result) -> tuple[float, float]:
    """Return the relative difference of the objectives and the largest of the instants [s]."""
    switch_times = [abs(a - b) for a, b in zip(found["instants"], expected["instants"], strict=True)]
    return abs(found["objective"] / expected["objective"] - 1), max(switch_times, default=0.0)


def table(rows: Iterable[Result]) -> tuple[list[str], bool]:
    """Return the table of the results by window and N_s, and whether all programs agree."""
    rows = list(rows)
    lines, agree = [HEADINGS, "|---" * HEADINGS.count(" | ") + "|---|"], True
    for window, nodes in dict.fromkeys((row["window"], row["nodes"]) for row in rows):
        here = {row["program"]: row for row in rows if (row["window"], row["nodes"]) == (window, nodes)}
        for program, row in here.items():
            starts = ("cold", "warm")
            solved = [start for start in starts if row[start]["objective"] is not None]
            pairs = [apart(row[start], here[REFERENCE][start]) for start in solved]
            objective, instant = np.max(pairs, axis=0) if pairs else (np.nan, np.nan)
            agree &= objective <= OBJECTIVE and instant <= INSTANT
            cold, warm = (
                f"{1e3 * row[start]['time']:.1f} ({row[start]['iterations']})" if start in solved else "fails"
                for start in starts
            )
            ratio = row["warm"]["time"] / here["psmpc, sqp"]["warm"]["time"]
            lines.append(
                f"| {window} | {nodes} | {program} | {row['build']:.2f} | {cold} | {warm} | {ratio:.2g} "
                f"| {objective:.0e} | {1e3 * instant:.2f} |"
            )
    return lines, agree


def main() -> int:
    """Solve all windows with all programs, print the table; return 1 where a peer fails or programs disagree."""
    cases = recorded()
    with TemporaryDirectory() as temporary:
        directory = Path(temporary)
        (directory / "windows").write_bytes(pickle.dumps({name: plain(case) for name, case in cases.items()}))
        rows = list(own_results(cases))
        notes = []
        for results, note in peer_results(directory):
            rows += results
            notes += [note] if note else []
    lines, agree = table(rows)
    print("\n".join(lines))
    if notes:
        print(f"\n{' '.join(notes)}")
    return 0 if agree and not any(note.endswith("failed.") for note in notes) else 1


if __name__ == "__main__":
    raise SystemExit(main())
