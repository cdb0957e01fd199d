"""Missions among obstacles that a free run would hit: with routes, without them, and by hard switching with them.

    python benchmarks/clearance.py missions plane 200     completes runs/clearance-plane.jsonl and prints the table
    python benchmarks/clearance.py missions space 20      the same for the dual-arm servicer
    python benchmarks/clearance.py windows 40             `sqp` against IPOPT on windows with active rows
    python benchmarks/clearance.py cost [REPEAT]          what clearance costs; two minutes

A mission is drawn by its number: a start, a place to fly to, a posture to take there, and one to four obstacles of
random shape about the way. It counts where start and targets are clear and the free run, without clearance, hits.
"""

import os

os.environ["OMP_NUM_THREADS"] = "1"  # before NumPy is loaded

import json
import sys
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

sys.path.append(str(Path(__file__).parents[1]))

from pages import command_line, markdown
from performance_table import floating

import psmpc_cli as psmpc
from psmpc_cli.ocp.constraints import soft_row_violations
from psmpc_cli.ocp.constraints.clearance import distance_rows, groups, poses_at, poses_at_sample
from psmpc_cli.ocp.feasibility.postures import configurations_at_stops
from psmpc_cli.ocp.problem import Problem, build_problem
from psmpc_cli.ocp.stage import SampleContext
from psmpc_cli.simulation.replay import logged_solve
from psmpc_cli.solvers import Outcome
from psmpc_cli.specs.load import Task, parse_task
from psmpc_cli.studies.runner import compute
from tests.ocp.constraints.windows_past_a_post import active_rows, near_post, passing, solved

MARGIN = 0.02
SPARE = 0.02
"""What routes and targets keep more than the margin [m]."""

VARIANTS: Mapping[str, Mapping[str, Any]] = {
    "routes": {},
    "without routes": {"routes": None},
    "hard switching with routes": {"controller.kind": "hard"},
}
"""What each mission is run with, by the row of the table."""

MOST_DRAWS = 60
"""Draws of a mission of a number before it is given up."""


def planar(rng: np.random.Generator) -> dict[str, Any]:
    """Draw a mission of the planar dual arm."""

    def arms() -> dict[str, list[float]]:
        bent = np.radians(rng.uniform([20, 20, -30], [100, 90, 30]))
        other = np.radians(rng.uniform([20, 20, -30], [100, 90, 30]))
        return {"arm_1": bent.tolist(), "arm_2": (-other).tolist()}

    way = rng.uniform(1.5, 3.0)
    direction = rng.uniform(-np.pi, np.pi)
    goal = [way * np.cos(direction), way * np.sin(direction), rng.uniform(-1.0, 1.0)]
    obstacles = []
    for number in range(rng.integers(1, 5)):
        along = rng.uniform(0.2, 0.9) * way
        across = rng.uniform(-0.9, 0.9)
        at = [
            along * np.cos(direction) - across * np.sin(direction),
            along * np.sin(direction) + across * np.cos(direction),
            rng.uniform(-np.pi, np.pi),
        ]
        size = rng.uniform(0.05, 0.2, 2)
        kind = rng.integers(3)
        shape = (
            {"sphere": size[0]}
            if kind == 0
            else {"capsule": [size[0], 2 * size[1]]}
            if kind == 1
            else {"box": [2 * size[0], 2 * size[1]]}
        )
        obstacles.append({"name": f"obstacle {number + 1}", "shape": _plain(shape), "pose": at})
    first, last = arms(), arms()
    ends = {"coordinates": ["all"], "tolerance": 5e-3}
    return {
        "robot": "planar_dual_arm",
        "initial": {"base": [0, 0, 0], **first},
        "controller": {"nodes": 25},
        "skills": {
            "move": {"space": "joint", "weights": {"base": [100, 100, 10], "arms": [10, 10, 1], "control": 0.1}}
        },
        "limits": {"base": {"force": [20, 20, 6]}, "arms": {"force": [56, 28, 12]}},
        "obstacles": obstacles,
        "stages": [
            {"name": "fly", "skill": "move", "target": {"base": goal, **first}, "ends_when": ends},
            {"name": "reach", "skill": "move", "priority": 10, "target": {"base": goal, **last}, "ends_when": ends},
        ],
        "time_limit": 90,
    }


def spatial(rng: np.random.Generator) -> dict[str, Any]:
    """Draw a mission of the dual-arm servicer."""

    def arms() -> dict[str, list[float]]:
        bent = rng.uniform(-0.5, 0.5, 7) + np.array([0, 0.6, 0, -1.2, 0, 0.6, 0])
        other = rng.uniform(-0.5, 0.5, 7) - np.array([0, 0.6, 0, -1.2, 0, 0.6, 0])
        return {"left": bent.tolist(), "right": other.tolist()}

    direction = rng.standard_normal(3)
    direction /= np.linalg.norm(direction)
    way = rng.uniform(1.5, 2.5)
    axis = rng.standard_normal(3)
    goal = {
        "position": (way * direction).tolist(),
        "attitude": {"axis": (axis / np.linalg.norm(axis)).tolist(), "angle": float(rng.uniform(-0.6, 0.6))},
    }
    obstacles = []
    for number in range(rng.integers(1, 4)):
        aside = np.cross(direction, rng.standard_normal(3))
        at = rng.uniform(0.3, 0.9) * way * direction + rng.uniform(0.0, 0.9) * aside / np.linalg.norm(aside)
        size = rng.uniform(0.08, 0.25, 3)
        kind = rng.integers(3)
        shape = (
            {"sphere": size[0]}
            if kind == 0
            else {"capsule": [size[0], 2 * size[1]]}
            if kind == 1
            else {"box": (2 * size).tolist()}
        )
        turn = rng.standard_normal(4)
        pose = {"position": at.tolist(), "attitude": {"quaternion": turn.tolist()}}
        obstacles.append({"name": f"obstacle {number + 1}", "shape": _plain(shape), "pose": pose})
    first, last = arms(), arms()
    ends = {"coordinates": ["all"], "tolerance": 1e-2}
    weights = {"base": [100, 100, 100, 30, 30, 30], "arms": [10] * 7, "control": 0.1}
    return {
        "robot": "dual_arm_servicer",
        "initial": {"base": {"position": [0, 0, 0]}, **first},
        "controller": {"nodes": 20},
        "skills": {"move": {"space": "joint", "weights": weights}},
        "obstacles": obstacles,
        "stages": [
            {"name": "fly", "skill": "move", "target": {"base": goal, **first}, "ends_when": ends},
            {"name": "reach", "skill": "move", "priority": 10, "target": {"base": goal, **last}, "ends_when": ends},
        ],
        "time_limit": 90,
    }


def _plain(shape: Mapping[str, Any]) -> dict[str, Any]:
    """Return a shape as YAML has it."""
    return {key: np.asarray(value).tolist() for key, value in shape.items()}


DRAWN = {"plane": planar, "space": spatial}

COMMON = {"clearance": {"margin": MARGIN}, "routes": {"spare": SPARE}, "log": {"shares": False, "plans": False}}


def nearest(problem: Problem, Q: np.ndarray) -> float:
    """Return the smallest distance of any pair at coordinates (K, nq) [m]."""
    model = problem.model
    found = []
    for Q_of_one in Q:
        chart = model.space.chart_at(Q_of_one)
        x = np.asarray(chart.to_chart(Q_of_one[None], np.zeros((1, model.n))))[0]
        sample = SampleContext(0.0, x, chart.anchor)
        for group in groups(problem.spec, model, 0).values():
            argument = poses_at_sample(group, model, sample)
            if argument is not None:
                taken = np.concatenate([chart.anchor, poses_at(group.pairs, model, argument, np.zeros(1))[0]])
                rows = model.cached((distance_rows, group.pairs), partial(distance_rows, model, group.pairs))
                found.append(rows.value(x, taken)[0].min())
    return float(np.min(found))


def drawn(where: str, number: int) -> dict[str, Any] | None:
    """Return the mission of a number; None where no draw of it counts."""
    for draw in range(MOST_DRAWS):
        data = {**DRAWN[where](np.random.default_rng([number, draw])), **COMMON, "seed": number}
        problem = build_problem(psmpc.load_task(data))
        stops = np.array(configurations_at_stops(problem.task, problem.model, problem.stages))
        if nearest(problem, stops) < MARGIN + SPARE:
            continue
        free = psmpc.simulate(psmpc.load_task({**data, "clearance": None, "routes": None}))
        if free.summary().succeeded and nearest(problem, free["state/Q"]) < 0:
            return data
    return None


def run(where: str, number: int, variants: tuple[str, ...]) -> list[dict[str, Any]]:
    """Run a mission with some variants, and return what became of it."""
    data = drawn(where, number)
    if data is None:
        return [{"number": number, "variant": variant, "drawn": False} for variant in variants]
    found = []
    for variant in variants:
        log = psmpc.simulate(psmpc.load_task(data, VARIANTS[variant]))
        summary = log.summary()
        distance = log["clearance/distance"]
        solves = summary.solves
        found.append(
            {
                "number": number,
                "variant": variant,
                "drawn": True,
                "succeeded": bool(summary.succeeded),
                "reason": summary.reason,
                "ends": float(log.time[-1]),
                "nearest": float(np.nanmin(distance)),
                "pair": str(log["clearance/pair"][int(np.nanargmin(np.nanmin(distance, axis=0)))]),
                "failed solves": int(log["events/solve_failed"].sum()),
                "median solve": float(solves.median),
            }
        )
    return found


def missions(where: str = "plane", count: str = "200", *variants: str) -> Iterator[str]:
    """Make the runs that the file lacks, and yield the table."""
    path = Path("runs") / f"clearance-{where}.jsonl"
    path.parent.mkdir(exist_ok=True)
    wanted = variants or tuple(VARIANTS)
    made = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    has = {(each["number"], each["variant"]) for each in made}
    left = {number: tuple(v for v in wanted if (number, v) not in has) for number in range(int(count))}
    items = {number: (number, of_number) for number, of_number in left.items() if of_number}
    with path.open("a") as file:
        for _, found in compute(lambda item: run(where, *item), items, jobs=2):
            if found is None:
                continue
            for each in found:
                file.write(json.dumps(each) + "\n")
            file.flush()
            made += found
    made = [each for each in made if each["number"] < int(count) and each["drawn"]]
    rows = []
    for variant in wanted:
        own = [each for each in made if each["variant"] == variant]
        succeeded = [each for each in own if each["succeeded"]]
        ends = np.array([each["ends"] for each in succeeded] or [np.nan])
        rows.append(
            (
                variant,
                f"{len(succeeded)} of {len(own)}",
                sum(each["nearest"] < 0 for each in own),
                f"{1e3 * min(each['nearest'] for each in own):.1f}" if own else "",
                f"{np.median(ends):.1f}",
                f"{np.mean([each['failed solves'] for each in own]):.2f}",
                f"{1e3 * np.median([each['median solve'] for each in own]):.1f}",
            )
        )
    headings = (
        "succeeded",
        "touched",
        "smallest distance [mm]",
        "ends [s]",
        "failed solves a run",
        "median solve [ms]",
    )
    yield from markdown(rows, "run", *headings)
    yield ""
    by_reason: dict[str, list[dict[str, Any]]] = {}
    for each in sorted(made, key=lambda each: each["number"]):
        if not each["succeeded"] and each["variant"] == wanted[0]:
            by_reason.setdefault(each["reason"], []).append(each)
    for reason, failed in by_reason.items():
        if len(failed) > MOST_LISTED:
            distances = [1e3 * each["nearest"] for each in failed]
            apart = f"nearest parts {min(distances):.1f} to {max(distances):.1f} mm apart"
            yield f"- {len(failed)} missions: {reason}; {apart}: {', '.join(str(each['number']) for each in failed)}"
        else:
            for each in failed:
                yield f"- {each['number']}: {reason}; nearest {each['pair']}, {1e3 * each['nearest']:.1f} mm"


MOST_LISTED = 5
"""Missions that failed for the same reason which have a line each."""

MOST_ITERATIONS = 1000
"""Iterations of IPOPT: in one of the windows it takes 288 from where `sqp` ends."""

SAME = 1e-5
"""Largest relative difference of two objectives that count as the same."""


def windows(count: str = "40") -> Iterator[str]:
    """Yield in how many windows with active rows `sqp` and IPOPT, started at its plan, end at one objective.

    Windows are drawn until in so many `sqp` keeps the rows; those whose plans violate rows are compared by themselves.
    """
    differences: dict[str, list[float]] = {"keep the margin": [], "lie inside it": []}
    kept, violating = differences.values()
    tried = 0
    while len(kept) < int(count):
        problem, window = near_post(tried)
        tried += 1
        sqp = solved(problem, window, "sqp")
        if sqp.outcome is not Outcome.OPTIMAL or not active_rows(problem, window, sqp.plan):
            continue
        ipopt = solved(problem, window, "ipopt", sqp.plan, MOST_ITERATIONS)
        solves = ipopt.outcome is Outcome.OPTIMAL
        violation, _ = soft_row_violations(problem.model, window, sqp.plan)
        found = violating if violation > SAME else kept
        found.append(ipopt.objective / sqp.objective - 1 if solves else np.nan)
    rows = []
    for name, each in differences.items():
        compared = np.array(each)
        same = np.abs(compared) <= SAME
        rows.append((name, len(each), same.sum(), (compared < -SAME).sum(), np.isnan(compared).sum()))
    yield from markdown(rows, f"plans of `sqp`, {tried} windows drawn", "windows", "J the same", "lower", "IPOPT fails")


FAR = [{"name": "post", "shape": {"sphere": 0.1}, "pose": [30, 0, 0]}]
"""An obstacle that nothing comes near."""


def beside_post(y: float) -> Task:
    """Return the task `passing` with a target of the base at [1, y], from which the arms reach past the post.

    At y = 0 they would touch it: the robot comes to rest against it, and the last stage does not end.
    """
    target = [1.0, y, 0.0]
    return passing({"stages.fly.target.base": target, "stages.reach.target.base": target})


def cost_rows() -> Iterator[tuple[str, Task, Mapping[str, Any], int]]:
    """Yield what is run with and without clearance: name, task, what asks for none, how many pairs count."""
    none: dict[str, Any] = {"clearance": None, "obstacles": []}
    yield "plane, N_s 25, beside a post", beside_post(-0.1), none, 30
    yield "the same, at rest against the post", beside_post(0.0), none, 30
    own = [["base", "arm_1"], ["base", "arm_2"], ["arm_1", "arm_2"], ["arm_1", "arm_1"], ["arm_2", "arm_2"]]
    far = {"obstacles": FAR, "clearance": {"except": own}}
    yield "plane, N_s 25, none near", passing(far), none, 0
    arms = floating()
    yield (
        "20 degrees of freedom, nodes auto",
        parse_task(arms.task_yaml, arms.robot_yaml, "arms", {"clearance": {}}),
        none,
        30,
    )


def pairs_in_windows(run: psmpc.Run) -> np.ndarray:
    """Return how many pairs the first stage of each sample's window has, (K,)."""
    stages = [logged_solve(run, sample).window.stages[0] for sample in range(len(run["solver/wall_time"]))]
    groups = [[each for name, each in stage.constraints.items() if name.startswith("clearance")] for stage in stages]
    return np.array([sum(len(group.low) for group in each if group.is_known) for each in groups])


def cost(repeat: str = "5") -> Iterator[str]:
    """Yield the table of what clearance costs: runs in turn, medians over the rounds of their median solves.

    Both are over the samples at which windows have many pairs, as far as both runs last.
    """
    rows = []
    for name, task, none, many in cost_rows():
        medians = np.zeros((int(repeat), 2))
        for round_ in range(int(repeat)):
            kept = psmpc.simulate(task)
            free = psmpc.simulate(parse_task(task.task_yaml, task.robot_yaml, name, none))
            times = [run["solver/wall_time"] for run in (free, kept)]
            common = min(map(len, times))
            pairs = pairs_in_windows(kept)[:common]
            counted = pairs >= many
            medians[round_] = [np.median(each[:common][counted]) for each in times]
        without, with_pairs = np.median(medians, axis=0)
        ratio = f"{with_pairs / without:.2f}"
        counts = f"{np.median(pairs[counted]):.0f}", f"{counted.sum()} of {common}"
        rows.append((name, *counts, f"{1e3 * without:.2f}", f"{1e3 * with_pairs:.2f}", ratio))
    headings = ("pairs in windows", "samples", "median solve without [ms]", "with [ms]", "ratio")
    yield from markdown(rows, "run", *headings)


if __name__ == "__main__":
    command_line(missions, windows, cost)
