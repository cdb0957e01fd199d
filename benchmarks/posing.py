"""Compares the advice of `psmpc check` to pose arms with what posing them gains: prints a table of both.

    python benchmarks/posing.py [MISSIONS [CONTROLLER ...]]     runs what is missing of the first missions, 60 under
                                                                psmpc by default, and prints their table

Missions are those of `missions.py` from seed 2000 on, with an object that rests. The rule was made with missions from
100 to 159 and from 1000 to 1109. In even ones Approach holds the arms stretched, as its task does; in odd ones
somewhere between where they start and where Capture needs them, drawn as well. Each is run so, and with the arms posed
for Capture. It adds one line to benchmarks/results/posing.jsonl; one that has its line is not repeated.
"""

import json
import logging
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from missions import draw_mission
from pages import markdown
from scipy.stats import binomtest

import psmpc_cli as psmpc
from psmpc_cli.ocp.feasibility.forecast import forecast_configurations, forecast_stages
from psmpc_cli.ocp.feasibility.posing import LEAST_GAIN, Posing, posings
from psmpc_cli.specs.load import Task

RESULTS = Path(__file__).parent / "results" / "posing.jsonl"

CONTROLLERS: Mapping[str, dict[str, Any]] = {
    "psmpc": {},
    "smpc": {"controller.kind": "smpc"},
    "hard, free end": {"controller.kind": "hard", "controller.one_stage": "free_end"},
}
"""What missions are run under; the first is the task's own controller."""

FIRST = 2000
"""Seed of the first mission: the rule was made with others."""

AT_REST = {"object.motion": {"linear": [0, 0], "angular": 0}}
"""Where the arms are needed is known before the run only of an object at rest."""

SETTING = {"controller.nodes": 12}


def measure(controller: str, seed: int) -> dict[str, Any]:
    """Run a mission with the arms held and posed; return its line of the results."""
    changes = {**SETTING, **AT_REST, **CONTROLLERS[controller]}
    stops = stops_of(draw_mission("plane", seed, changes))
    needed = stops[2][3:]
    share = np.random.default_rng([seed, 1]).uniform()
    held = needed + share * (stops[0][3:] - needed) if seed % 2 else np.zeros(6)
    runs = {}
    as_held = draw_mission("plane", seed, {**changes, **arms_of_approach(held)})
    found = advice(as_held)
    posed = stops_of(as_held)[2][3:] if found is None else found.Q[3:]
    for name, joints in {"held": held, "posed": posed}.items():
        task = draw_mission("plane", seed, {**changes, **arms_of_approach(joints)})
        said = advice(task)
        summary = psmpc.simulate(task).summary()
        runs[name] = {
            "succeeded": bool(summary.succeeded),
            "time": round(float(summary.duration), 3),
            "ends": [round(float(stage.switch_time), 3) for stage in summary.stages],
            "starts": [round(float(stage.actual_start), 3) for stage in summary.stages],
            "advice": {"time": round(said.time, 3), "saved": round(said.saved, 3)} if said else None,
        }
    return {"controller": controller, "seed": seed, **runs}


def stops_of(task: Task) -> list[np.ndarray]:
    """Return the robot's coordinates at the start and at every stage's target, (nq,) each."""
    return forecast_configurations(task, forecast_stages(task))


def arms_of_approach(joints: np.ndarray) -> dict[str, Any]:
    """Return the changes by which Approach wants the arms at some joint coordinates (6,) [rad]."""
    return {f"stages.approach.target.arm_{i + 1}": joints[3 * i : 3 * i + 3].tolist() for i in range(2)}


def advice(task: Task) -> Posing | None:
    """Return the advice about Approach, or None where there is none."""
    forecasts = forecast_stages(task)
    stages = [each.stage for each in forecasts]
    for found in posings(task, forecasts[0].model, stages, forecast_configurations(task, forecasts)):
        if found.stage == 0:
            return found
    return None


def results(controller: str, seeds: range) -> list[dict[str, Any]]:
    """Return the lines of missions under a controller, in the order of their seeds; run those that have none."""
    RESULTS.parent.mkdir(exist_ok=True)
    lines = RESULTS.read_text(encoding="utf-8").splitlines() if RESULTS.exists() else []
    made = {row["seed"]: row for row in map(json.loads, lines) if row["controller"] == controller}
    for seed in seeds:
        if seed not in made:
            made[seed] = measure(controller, seed)
            with RESULTS.open("a", encoding="utf-8") as file:
                file.write(json.dumps(made[seed]) + "\n")
    return [made[seed] for seed in seeds]


def table(seeds: range, controllers: Sequence[str]) -> Iterator[dict[str, Any]]:
    """Yield how often posing gains, and how often it is advised where it does and does not.

    What is gained is when the mission ends, or Capture alone.
    """
    for controller in controllers:
        rows = results(controller, seeds)
        both = [row for row in rows if row["held"]["succeeded"] and row["posed"]["succeeded"]]
        advised = np.array([row["held"]["advice"] is not None for row in both])
        saved = [row["held"]["advice"]["saved"] for row in both if row["held"]["advice"]]
        for name, end in {"mission": -1, "Capture": 1}.items():
            gains = np.array([row["held"]["ends"][end] - row["posed"]["ends"][end] for row in both])
            worth = gains > LEAST_GAIN
            yield {
                "controller": f"`{controller}`",
                "end of": name,
                "both succeed": f"{len(both)} of {len(rows)}",
                f"advised where it gains more than {LEAST_GAIN:g} s": share_of(advised[worth]),
                "advised where it does not": share_of(advised[~worth]),
                "said to save [s]": spread(saved),
                "gained where advised [s]": spread(gains[advised]),
                "advised once posed": sum(row["posed"]["advice"] is not None for row in rows),
            }


def share_of(outcomes: Any) -> str:
    """Return how many of some outcomes are true, with the Wilson interval of their share at 95 %."""
    count = int(np.sum(outcomes))
    if not len(outcomes):
        return "0 of 0"
    interval = binomtest(count, len(outcomes)).proportion_ci(method="wilson")
    return f"{count} of {len(outcomes)} ({100 * interval.low:.0f} to {100 * interval.high:.0f} %)"


def spread(values: Any) -> str:
    """Return the least, the median and the largest of some values."""
    return " / ".join(f"{value:.1f}" for value in np.quantile(values, (0, 0.5, 1))) if len(values) else "-"


if __name__ == "__main__":
    logging.disable(logging.CRITICAL)
    number, *chosen = sys.argv[1:] or ["60"]
    print("\n".join(markdown(list(table(range(FIRST, FIRST + int(number)), chosen or list(CONTROLLERS)[:1])))))
