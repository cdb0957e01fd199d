"""Runs random missions under every controller with one setting: prints their tables.

    python benchmarks/equal_missions.py [CONTROLLER=MISSIONS ...]

Mission k is drawn with seed k: what is to be caught, where, and where it goes; the stages, skills, weights, priorities,
tolerances and limits are those of the task `catch_drifting`, the same for every controller. Each run adds one line to
runs/equal-missions.jsonl; a run that has its line is not repeated.
"""

import logging
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from missions import Row, median, results, run_missing
from numpy.typing import ArrayLike
from pages import markdown
from scipy.stats import binomtest

import psmpc_cli as psmpc
from psmpc_cli.ocp.feasibility import load_feasible
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.robot.reach import reach_of
from psmpc_cli.specs.load import Task, load_robot

RESULTS = Path("runs/equal-missions.jsonl")

CONTROLLERS: Mapping[str, Mapping[str, Any]] = {
    "psmpc": {"controller.kind": "psmpc"},
    "smpc": {"controller.kind": "smpc"},
    "hard, free end": {"controller.kind": "hard", "controller.one_stage": "free_end"},
    "hard": {"controller.kind": "hard"},
    "htmpc": {"controller.kind": "htmpc"},
}
"""What each mission is run under, by the row of the tables; `hard` and `htmpc` as published."""

MISSIONS = ("psmpc=100", "smpc=100", "hard, free end=100", "hard=100", "htmpc=20")

AGAINST = "hard, free end"
"""What the others are compared with, mission by mission."""

SIDEWAYS = 1.5
"""How far to either side of the base the grippers go when they have let go [m]."""


def draw_mission(seed: int, controller: str) -> Task:
    """Return the mission of a seed; those that `psmpc check` rejects are drawn again."""
    rng = np.random.default_rng(seed)
    lean = {"controller.nodes": 25, "log.plans": False, "log.shares": False, "time_limit": 120, "by_controller": {}}
    model = RobotModel(load_robot("planar_dual_arm"))
    while True:
        drawn = _drawn(rng, model)
        if drawn is None:
            continue
        try:
            return load_feasible("catch_drifting", {**lean, **drawn, **CONTROLLERS[controller]})
        except psmpc.SpecError:
            continue


def _drawn(rng: np.random.Generator, model: RobotModel) -> dict[str, Any] | None:
    """Draw a mission's changes of the task; None where the arms cannot hold the object so."""
    taken = _pose(rng, (1.5, 3.5), 90)
    left = _pose(rng, (0.0, 2.0), 60)
    drift = rng.uniform(0.0, 0.02)
    heading = rng.uniform(-np.pi, np.pi)
    spin = rng.uniform(-2.0, 2.0)
    mass = np.exp(rng.uniform(np.log(5.0), np.log(60.0)))
    half_width = rng.uniform(0.60, 0.68)
    turn = rng.uniform(125.0, 145.0)
    stand_off = rng.uniform(0.90, 1.02)
    arms = np.radians(rng.uniform([-45, -60, -30], [45, 60, 30], (2, 3)))
    grip = np.array([half_width, stand_off, np.radians(turn)])
    holding = reach_of(model, "arm_1", np.zeros(3), grip).configuration
    mirrored = reach_of(model, "arm_2", np.zeros(3), grip * [-1, 1, -1]).configuration
    if holding is None or mirrored is None:
        return None
    return {
        "initial": {"base": [0, 0, 0], "arm_1": arms[0].tolist(), "arm_2": arms[1].tolist()},
        "object.pose": _at(taken),
        "object.motion": {"linear": [drift * np.cos(heading), drift * np.sin(heading)], "angular": f"{spin:.3f} deg"},
        "object.mass": float(mass),
        "object.inertia": float(2.67 / 20 * mass),
        "object.grasp.at": {
            "arm_1": [float(half_width), 0, f"{turn:.3f} deg"],
            "arm_2": [float(-half_width), 0, f"{-turn:.3f} deg"],
        },
        "object.destination.pose": _at(left, [0.0, stand_off]),
        "stages.approach.target.base": {"object": [0, float(-stand_off), "0 deg"]},
        "stages.capture.target.base": {"object": [0, float(-stand_off), "0 deg"]},
        "stages.transport.target": {"base": _at(left), "arm_1": list(holding), "arm_2": list(mirrored)},
        "stages.release.target": {
            "base": _at(left),
            "arm_1": _at(left, [SIDEWAYS, 0.0]),
            "arm_2": _at(left, [-SIDEWAYS, 0.0]),
        },
    }


def _pose(rng: np.random.Generator, distances: tuple[float, float], angle: float) -> np.ndarray:
    """Return a pose [x, y, angle] [m, deg] at a random distance and bearing from the origin.

    As everything that a mission calls it is not imported from this folder, where the processes that run it do not look.
    """
    distance = rng.uniform(*distances)
    bearing = rng.uniform(-np.pi, np.pi)
    return np.array([distance * np.cos(bearing), distance * np.sin(bearing), rng.uniform(-angle, angle)])


def _at(frame: np.ndarray, offset: ArrayLike = (0.0, 0.0)) -> list[Any]:
    """Return the pose at an offset in a frame [x, y, angle] [m, deg], as a task has it."""
    c = np.cos(np.radians(frame[2]))
    s = np.sin(np.radians(frame[2]))
    x, y = frame[:2] + np.array([[c, -s], [s, c]]) @ offset
    return [float(x), float(y), f"{frame[2]:.4f} deg"]


def measure(mission: tuple[str, int]) -> Row:
    """Run the mission of a seed under a controller and return its line of the results."""
    logging.disable(logging.CRITICAL)
    controller, seed = mission
    run = psmpc.simulate(draw_mission(seed, controller))
    summary = run.summary()
    ends = np.array([float(stage.switch_time) for stage in summary.stages])
    starts = np.array([float(stage.actual_start) for stage in summary.stages])
    return {
        "seed": seed,
        "controller": controller,
        "completed": bool(summary.completed),
        "succeeded": bool(summary.succeeded),
        "why": "; ".join(each.name for each in summary.monitors if not each.held) or summary.reason,
        "time": round(float(summary.duration), 3),
        "ends": ends.round(3).tolist(),
        "starts": starts.round(3).tolist(),
        "effort": round(float(summary.control_effort), 4),
        "base_force": round(float(np.nanmax(run["peak/base_force"])), 3),
        "grasp_margin": round(float(min(each.margin for each in summary.monitors)), 4),
        "failed_solves": int(summary.failed_solves),
    }


def successes(made: dict[str, dict[int, Row]]) -> Iterator[Row]:
    """Yield how often each controller succeeds, and what its missions take."""
    for name, rows in made.items():
        succeeded = [row for row in rows.values() if row["succeeded"]]
        rate = binomtest(len(succeeded), len(rows)).proportion_ci(method="wilson")
        yield {
            "controller": name,
            "succeeded": f"{len(succeeded)} of {len(rows)}",
            "success rate": f"{100 * rate.low:.0f} to {100 * rate.high:.0f} %",
            "end [s]": _spread([row["time"] for row in succeeded]),
            "effort": _spread([row["effort"] for row in succeeded]),
            "largest force of the base [N]": _spread([row["base_force"] for row in succeeded]),
            "Capture starts early by [s]": _spread([row["ends"][0] - row["starts"][1] for row in succeeded]),
            "failed solves a run": f"{np.mean([row['failed_solves'] for row in rows.values()]):.2f}",
        }


def differences(made: dict[str, dict[int, Row]]) -> Iterator[Row]:
    """Yield what each controller needs more or less than the one it is compared with, where both succeed."""
    other = made.get(AGAINST, {})
    for name, rows in made.items():
        if name == AGAINST:
            continue
        pairs = [
            (row, other[seed])
            for seed, row in rows.items()
            if seed in other and row["succeeded"] and other[seed]["succeeded"]
        ]
        yield {
            "controller": name,
            "both succeed": len(pairs),
            "end, difference [s]": _median(pairs, lambda row, base: row["time"] - base["time"]),
            "end, ratio": _median(pairs, lambda row, base: row["time"] / base["time"]),
            "effort, ratio": _median(pairs, lambda row, base: row["effort"] / base["effort"]),
            "largest force, ratio": _median(pairs, lambda row, base: row["base_force"] / base["base_force"]),
        }


def failures(made: dict[str, dict[int, Row]]) -> Iterator[str]:
    """Yield why missions failed, and their numbers."""
    for name, rows in made.items():
        reasons: dict[str, list[int]] = {}
        for seed, row in rows.items():
            if not row["succeeded"]:
                reasons.setdefault(row["why"], []).append(seed)
        for reason, seeds in reasons.items():
            shown = ", ".join(map(str, sorted(seeds)[:8])) + (", ..." if len(seeds) > 8 else "")
            yield f"- {name}: {len(seeds)} failed: {reason} (missions {shown})"


def _spread(values: Sequence[float]) -> str:
    """Return the 5, 50 and 95 % quantiles of a sample."""
    known = np.array(values, float)
    known = known[np.isfinite(known)]
    return " / ".join(f"{value:.1f}" for value in np.quantile(known, (0.05, 0.5, 0.95))) if len(known) else "-"


def _median(pairs: Sequence[tuple[Row, Row]], of: Callable[[Row, Row], float]) -> str:
    """Return the median of a quantity of pairs of runs, with its bootstrap 95 % interval."""
    return median([of(*pair) for pair in pairs]) if len(pairs) > 1 else "-"


def main(words: Sequence[str]) -> None:
    """Run what is missing and print the tables."""
    run_missing(measure, words or MISSIONS, RESULTS)
    found = results(RESULTS)
    made = {name: found[name] for name in CONTROLLERS if name in found}
    print("\n".join([*markdown(successes(made)), "", *markdown(differences(made)), "", *failures(made)]))


if __name__ == "__main__":
    main(sys.argv[1:])
