"""Runs random missions of the transport kind under every controller: prints the tables of docs/missions.md.

    python benchmarks/missions.py [CONTROLLER=MISSIONS ...]

Mission k is drawn with seed k; stages, skills, weights, priorities and monitors are those of the transport task. Each
run adds one line to benchmarks/missions.jsonl; a run that has its line is not repeated.
"""

import json
import logging
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import ArrayLike
from pages import markdown
from scipy.stats import binomtest, bootstrap

from psmpc_cli.errors import SpecError
from psmpc_cli.ocp.feasibility import ensure_feasible
from psmpc_cli.simulation.run import simulate
from psmpc_cli.specs.load import Task, load_task

RESULTS = Path(__file__).with_suffix(".jsonl")
MISSIONS = dict.fromkeys(("psmpc", "smpc", "htmpc", "hard"), 200)
STAND_OFF, GRIP = np.array([0.0, -0.978]), np.array([0.6415, 0.0])
"""Where the base stands and the first arm grips, in the object's frame [m]; the second arm grips opposite."""

OBJECT, DESTINATION = ((1.5, 4.0), 90.0), ((0.0, 2.0), 60.0)
"""Ranges of the poses that are drawn: distance from the origin [m] and angle [deg]."""

SUCCESS = ("controller", "succeeded", "success rate", "time less that of `hard` [s]", "effort over that of `hard`")
STARTS = ("controller", "Capture starts early by [s]", "Transport by [s]", "Release by [s]", "lost after Release began")

Row = dict[str, Any]


def draw_mission(seed: int, controller: str) -> Task:
    """Return the mission of a seed; poses that `psmpc check` rejects are drawn again."""
    random = np.random.default_rng(seed)
    while True:
        taken, left = pose(random, *OBJECT), pose(random, *DESTINATION)
        mission = {
            **targets(taken, left),
            "controller.kind": controller,
            "controller.nodes": 25,
            "log.plans": False,
            "log.shares": False,
            "time_limit": 120,
        }
        try:
            task = load_task("transport", mission)
            ensure_feasible(task)
        except SpecError:
            continue
        return task


def pose(random: np.random.Generator, distances: tuple[float, float], angle: float) -> np.ndarray:
    """Return a pose [x, y, angle] [m, deg] at a random distance and bearing from the origin."""
    distance, bearing = random.uniform(*distances), random.uniform(-np.pi, np.pi)
    return np.array([distance * np.cos(bearing), distance * np.sin(bearing), random.uniform(-angle, angle)])


def targets(taken: np.ndarray, left: np.ndarray) -> dict[str, Any]:
    """Return what places object and stages: the poses [x, y, angle] (3,) [m, deg] of the object and of its release."""

    def at(frame: np.ndarray, offset: np.ndarray, turn: float = 0.0) -> list[Any]:
        c, s = np.cos(np.radians(frame[2])), np.sin(np.radians(frame[2]))
        x, y = frame[:2] + np.array([[c, -s], [s, c]]) @ offset
        return [round(float(x), 4), round(float(y), 4), f"{frame[2] + turn:.2f} deg"]

    sideways = np.array([1.5, 0.0])
    base, destination = at(taken, STAND_OFF), at(left, np.zeros(2))
    return {
        "object.pose": at(taken, np.zeros(2)),
        "stages.approach.target.base": base,
        "stages.capture.target": {"base": base, "arm_1": at(taken, GRIP, 135), "arm_2": at(taken, -GRIP, -135)},
        "stages.transport.target.base": destination,
        "stages.release.target": {"base": destination, "arm_1": at(left, sideways), "arm_2": at(left, -sideways)},
    }


def results() -> dict[tuple[str, int], Row]:
    """Return the lines of the results by controller and seed."""
    lines = RESULTS.read_text(encoding="utf-8").splitlines() if RESULTS.exists() else []
    return {(row["controller"], row["seed"]): row for row in map(json.loads, lines)}


def measure(seed: int, controller: str) -> Row:
    """Run the mission of a seed under a controller and return its line of the results."""
    logging.disable(logging.CRITICAL)
    summary = simulate(draw_mission(seed, controller)).summary()
    held = summary.monitors[0]
    return {
        "seed": seed,
        "controller": controller,
        "completed": summary.completed,
        "succeeded": summary.succeeded,
        "time": round(summary.duration, 3),
        "switch_time": [round(float(stage.switch_time), 3) for stage in summary.stages],
        "actual_start": [round(float(stage.actual_start), 3) for stage in summary.stages],
        "margin": round(held.margin, 4),
        "broken_at": None if held.held else round(held.broken_at, 2),
        "effort": round(summary.control_effort, 4),
        "failed_solves": summary.failed_solves,
    }


def tables(made: dict[tuple[str, int], Row]) -> Iterator[str]:
    """Give the lines of the tables: success, what it costs against hard switching, when stages start."""
    names = dict.fromkeys(name for name, _ in made)
    by = {name: {seed: row for (of, seed), row in made.items() if of == name} for name in names}
    rows_of_success = []
    for name, rows in by.items():
        succeeded = sum(row["succeeded"] for row in rows.values())
        rate = binomtest(succeeded, len(rows)).proportion_ci(method="wilson")
        pairs = [(row, by["hard"][seed]) for seed, row in rows.items() if seed in by["hard"] and row["completed"]]
        paired = (
            median([r["time"] - h["time"] for r, h in pairs]),
            median([r["effort"] / h["effort"] for r, h in pairs]),
        )
        interval = f"{100 * rate.low:.1f} to {100 * rate.high:.1f} %"
        rows_of_success.append((f"`{name}`", f"{succeeded} of {len(rows)}", interval, *paired))
    yield from markdown(SUCCESS, rows_of_success)
    yield ""
    rows_of_starts = []
    for name, rows in by.items():
        ends, starts = (np.array([row[key] for row in rows.values()]) for key in ("switch_time", "actual_start"))
        lost = [(row["broken_at"], row["actual_start"][3]) for row in rows.values() if row["broken_at"] is not None]
        early = (median(column) for column in (ends[:, :3] - starts[:, 1:]).T)
        after = f"{sum(at >= start for at, start in lost)} of {len(lost)}"
        rows_of_starts.append((f"`{name}`", *early, after))
    yield from markdown(STARTS, rows_of_starts)


def median(values: ArrayLike) -> str:
    """Return the median of a sample, with its bootstrap 95 % interval."""
    sample = np.asarray(values)
    found = bootstrap((sample,), np.median, method="percentile", rng=np.random.default_rng(0)).confidence_interval
    return f"{np.median(sample):.2f} ({found.low:.2f} to {found.high:.2f})"


def main() -> None:
    """Run what is missing and print the tables."""
    given = (each.partition("=") for each in sys.argv[1:])
    counts = {name: int(count) for name, _, count in given} or MISSIONS
    made = results()
    wanted = [(name, seed) for seed in range(max(counts.values())) for name in counts if seed < counts[name]]
    calls = (delayed(measure)(seed, name) for name, seed in wanted if (name, seed) not in made)
    with RESULTS.open("a", encoding="utf-8") as file:
        for row in Parallel(n_jobs=2, return_as="generator_unordered")(calls):
            file.write(json.dumps(row) + "\n")
            file.flush()
    print("\n".join(tables(results())))


if __name__ == "__main__":
    main()
