"""Runs random missions of the transport kind under every controller: prints the tables of docs/missions.md.

    python benchmarks/missions.py [CONTROLLER=MISSIONS ...]

Mission k is drawn with seed k; stages, skills, weights, priorities and monitors are those of the transport task. Each
run adds one line to benchmarks/missions.jsonl; a run that has its line is not repeated.
"""

import json
import logging
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pages import markdown
from scipy.stats import binomtest, bootstrap

import psmpc_cli as psmpc
from psmpc_cli.ocp.feasibility import load_feasible
from psmpc_cli.specs.load import Task
from psmpc_cli.studies.runner import compute

RESULTS = Path(__file__).with_suffix(".jsonl")
MISSIONS = ("psmpc=200", "smpc=200", "htmpc=200", "hard=200")
STAND_OFF, GRIP, SIDEWAYS = np.array([0.0, -0.978]), np.array([0.6415, 0.0]), np.array([1.5, 0.0])
"""Where the base stands, and the first arm grips and lets go, in the object's frame [m]; the second arm is opposite."""

OBJECT, DESTINATION = ((1.5, 4.0), 90.0), ((0.0, 2.0), 60.0)
"""Ranges of the poses that are drawn: distance from the origin [m] and angle [deg]."""

Row = dict[str, Any]


def draw_mission(seed: int, controller: str) -> Task:
    """Return the mission of a seed; poses that `psmpc check` rejects are drawn again."""
    random = np.random.default_rng(seed)
    lean = {"controller.nodes": 25, "log.plans": False, "log.shares": False, "time_limit": 120}
    while True:
        taken, left = draw_pose(random, *OBJECT), draw_pose(random, *DESTINATION)
        try:
            return load_feasible("transport", {**targets(taken, left), "controller.kind": controller, **lean})
        except psmpc.SpecError:
            continue


def draw_pose(random: np.random.Generator, distances: tuple[float, float], angle: float) -> np.ndarray:
    """Return a pose [x, y, angle] [m, deg] at a random distance and bearing from the origin."""
    distance, bearing = random.uniform(*distances), random.uniform(-np.pi, np.pi)
    return np.array([distance * np.cos(bearing), distance * np.sin(bearing), random.uniform(-angle, angle)])


def targets(taken: np.ndarray, left: np.ndarray) -> dict[str, Any]:
    """Return what places object and stages: the poses [x, y, angle] (3,) [m, deg] of the object and of its release."""

    def at(frame: np.ndarray, offset: ArrayLike = (0, 0), turn: float = 0.0) -> list[Any]:
        c, s = np.cos(np.radians(frame[2])), np.sin(np.radians(frame[2]))
        x, y = frame[:2] + np.array([[c, -s], [s, c]]) @ offset
        return [round(float(x), 4), round(float(y), 4), f"{frame[2] + turn:.2f} deg"]

    base, destination = at(taken, STAND_OFF), at(left)
    return {
        "object.pose": at(taken),
        "stages.approach.target.base": base,
        "stages.capture.target": {"base": base, "arm_1": at(taken, GRIP, 135), "arm_2": at(taken, -GRIP, -135)},
        "stages.transport.target.base": destination,
        "stages.release.target": {"base": destination, "arm_1": at(left, SIDEWAYS), "arm_2": at(left, -SIDEWAYS)},
    }


def measure(mission: tuple[str, int]) -> Row:
    """Run the mission of a seed under a controller and return its line of the results."""
    logging.disable(logging.CRITICAL)
    controller, seed = mission
    summary = psmpc.simulate(draw_mission(seed, controller)).summary()
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
        "effort": round(summary.squared_acceleration, 4),
        "control_effort": round(summary.control_effort, 4),
        "failed_solves": summary.failed_solves,
    }


def results(path: Path = RESULTS) -> dict[str, dict[int, Row]]:
    """Return the lines of a file of results by controller and seed."""
    found: dict[str, dict[int, Row]] = {}
    for row in map(json.loads, path.read_text(encoding="utf-8").splitlines() if path.exists() else []):
        found.setdefault(row["controller"], {})[row["seed"]] = row
    return found


def successes(made: dict[str, dict[int, Row]]) -> Iterator[Row]:
    """Yield how often each controller succeeds, and what it costs against hard switching."""
    for name, rows in made.items():
        succeeded = sum(row["succeeded"] for row in rows.values())
        rate = binomtest(succeeded, len(rows)).proportion_ci(method="wilson")
        hard = made.get("hard", {})
        pairs = [(row, hard[seed]) for seed, row in rows.items() if seed in hard and row["completed"]]
        yield {
            "controller": f"`{name}`",
            "succeeded": f"{succeeded} of {len(rows)}",
            "success rate": f"{100 * rate.low:.1f} to {100 * rate.high:.1f} %",
            "time less that of `hard` [s]": median([row["time"] - other["time"] for row, other in pairs]),
            "integral of &#124;u&#124;^2 over that of `hard`": relative(pairs, "effort"),
            "control effort over that of `hard`": relative(pairs, "control_effort"),
        }


def relative(pairs: Sequence[tuple[Row, Row]], name: str) -> str:
    """Return the median of a quantity over that of the other run, and of how many missions where not all have it."""
    known = [row[name] / other[name] for row, other in pairs if name in row and name in other]
    if not known:
        return "-"
    return median(known) + ("" if len(known) == len(pairs) else f", {len(known)} missions")


def starts(made: dict[str, dict[int, Row]]) -> Iterator[Row]:
    """Yield how early each stage starts, and when objects are lost."""
    for name, rows in made.items():
        ends, starts = (np.array([row[key] for row in rows.values()]) for key in ("switch_time", "actual_start"))
        capture, transport, release = map(median, (ends[:, :3] - starts[:, 1:]).T)
        lost = [(row["broken_at"], row["actual_start"][3]) for row in rows.values() if row["broken_at"] is not None]
        yield {
            "controller": f"`{name}`",
            "Capture starts early by [s]": capture,
            "Transport by [s]": transport,
            "Release by [s]": release,
            "lost after Release began": f"{sum(at >= start for at, start in lost)} of {len(lost)}",
        }


def median(values: ArrayLike) -> str:
    """Return the median of a sample, with its bootstrap 95 % interval."""
    sample = np.asarray(values)
    found = bootstrap((sample,), np.median, method="percentile", rng=np.random.default_rng(0)).confidence_interval
    return f"{np.median(sample):.2f} ({found.low:.2f} to {found.high:.2f})"


def run_missing(measure: Callable[[tuple[str, int]], Row], words: Sequence[str], path: Path) -> None:
    """Run the missions that a file of results lacks; words say how many of each controller, CONTROLLER=MISSIONS."""
    counts = {name: int(count) for name, count in (word.split("=") for word in words)}
    made = results(path)
    wanted = [(name, seed) for seed in range(max(counts.values())) for name in counts if seed < counts[name]]
    missing = [(name, seed) for name, seed in wanted if seed not in made.get(name, {})]
    path.parent.mkdir(exist_ok=True)
    with path.open("a", encoding="utf-8") as file:
        for _, row in compute(measure, dict(enumerate(missing)), 2):
            file.write(json.dumps(row) + "\n")
            file.flush()


def main(words: Sequence[str]) -> None:
    """Run what is missing and print the tables."""
    run_missing(measure, words or MISSIONS, RESULTS)
    print("\n".join([*markdown(successes(results())), "", *markdown(starts(results()))]))


if __name__ == "__main__":
    main(sys.argv[1:])
