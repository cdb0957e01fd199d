"""Holds `solver: sqp` with one iteration a sample against fatrop, iterated to convergence, in closed loop.

    python benchmarks/random_tasks.py             `make random-tasks`: writes benchmarks/random_tasks.yaml

Tasks of the planar dual arm are drawn by seed, at N_s = 25 and 50. Every pair of runs must have the same result, switch
at the same instants, end at the same time, need no more fall-backs and be as smooth. The exit code is 1 if one does
not.
"""

import os
import sys
from pathlib import Path
from typing import Any

import numpy as np
import yaml

sys.path.append(str(Path(__file__).parents[1] / "tests" / "acceptance"))
from steadiness import largest_jump, longest_alternation

from psmpc_cli.errors import SpecError
from psmpc_cli.logs.run import Run
from psmpc_cli.ocp.feasibility.checks import ensure_feasible
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.document import write
from psmpc_cli.specs.library import find, read_text
from psmpc_cli.specs.load import Task, load_robot, parse_task
from psmpc_cli.studies.compare import run_tasks
from psmpc_cli.studies.runner import with_changes

RESULTS = Path(__file__).with_suffix(".yaml")
COUNT = 20
ROBOT = "planar_dual_arm"
STAGES, PRIORITIES, TOLERANCES, SPEEDS = (2, 4), (1e-2, 1e2), (1e-3, 1e-2), (0.5, 1.5)
WAY = np.array([0.7, 0.7, 0.6] + [0.8] * 6)
"""The farthest that the target of a stage is from the one before it [m, rad]."""

REACH = np.array([3.0, 3.0, 2.5] + [1.4, 2.5, 2.5] * 2)
"""How far from 0 targets may lie, inside the robot's limits [m, rad]."""

WEIGHTS = {
    "joint": {"base": [100, 100, 10], "arms": [100, 100, 10], "control": 0.03},
    "task": {"base": [100, 100, 100], "arms": [10, 10, 1], "control": 0.03},
}
"""Those of the transport task, with a smaller weight of the control."""

ENDS = (["base"], ["arms"], ["all"])

SAMPLE, END, HAIR = 0.1, 0.2, 1e-6
"""By how much switch times and the end of a run may differ [s]."""

ALTERNATION, JUMP, ROUGHER = 3, 0.3, 1.1
"""Smoothness: samples in a row at which a control may change its sign, by how much an optimized instant may move from
one sample to the next [s], and how many times as much as under fatrop the control may vary. Where a run under fatrop
does not keep the first two, it is itself the bound.
"""

HEADER = """\
# One iteration of sqp a sample against fatrop iterated to convergence. Written by `make random-tasks`.
# switches, end: of either run [s]; apart: the largest difference of the instants; variation: of the control, sqp's over
# fatrop's; alternation, jump: see random_tasks.py; not_met: what does not hold.
"""

Row = dict[str, Any]


def draw_task(seed: int) -> Task:
    """Draw 2 to 4 stages in joint or task space, each some seconds after the one before; repeat while infeasible."""
    random, text = np.random.default_rng(seed), read_text(find("robot", ROBOT))
    while True:
        task, robot = _drawn(random), yaml.safe_load(text)
        speed = float(random.uniform(*SPEEDS))
        for limits in robot["limits"].values():
            limits["velocity"] = [float(f"{speed * limit:.3g}") for limit in limits["velocity"]]
        try:
            parsed = parse_task(write(task), write(robot), f"random_{seed}")
            ensure_feasible(parsed)
        except SpecError:
            continue
        return parsed


def _drawn(random: np.random.Generator) -> Row:
    """Return a task as its YAML would have it; targets in task space are poses of configurations within the limits."""
    count, model = int(random.integers(*STAGES, endpoint=True)), RobotModel(load_robot(ROBOT))

    def log_uniform(low: float, high: float) -> float:
        return float(f"{np.exp(random.uniform(np.log(low), np.log(high))):.3g}")

    def by_part(rows: np.ndarray) -> dict[str, list[float]]:
        return dict(zip(("base", "arm_1", "arm_2"), np.round(rows, 4).reshape(3, 3).tolist(), strict=True))

    Q = np.concatenate([np.zeros(3), random.uniform(-1.2, 1.2, 6)])
    initial, stages = by_part(Q), []
    for index in range(count):
        Q = np.clip(Q + random.uniform(-WAY, WAY), -REACH, REACH)
        space, priority = str(random.choice(["joint", "task"])), log_uniform(*PRIORITIES)
        coordinates = ["all"] if index == count - 1 else ENDS[int(random.integers(len(ENDS)))]
        ends = {"coordinates": coordinates, "tolerance": log_uniform(*TOLERANCES)}
        target = by_part(Q if space == "joint" else np.asarray(model.g(Q)).ravel())
        stage = {"name": f"stage_{index + 1}", "skill": space, "priority": priority, "target": target}
        stages.append({**stage, "ends_when": ends})
    skills = {space: {"space": space, "weights": weights} for space, weights in WEIGHTS.items()}
    return {"robot": ROBOT, "initial": initial, "skills": skills, "stages": stages}


def measured(log: Run) -> Row:
    """Return what a run came to: result, times [s], samples without a solve, and how smooth it was."""
    summary = log.summary()
    completed = "completed" if summary.succeeded else "completed, a monitor did not hold"
    return {
        "result": completed if summary.completed else f"not completed: {summary.reason}",
        "switches": [round(stage.switch_time, 3) for stage in summary.stages],
        "end": round(summary.duration, 3),
        "starts": [round(stage.actual_start, 3) for stage in summary.stages],
        "fallbacks": summary.failed_solves,
        "alternation": max(longest_alternation(u) for u in log["control/u"].T),
        "jump": round(largest_jump(log), 3),
        "variation": round(variation(log), 3),
    }


def variation(log: Run) -> float:
    """Return the total variation of the control, averaged over each sample, over all coordinates.

    The control of a sample's first tick, which the summary of a run takes, may lie in a vanishing interval before a
    switch. Whether it does depends on a millisecond, and it is as tall as the interval is short.
    """
    mean = np.diff(log["state/Qdot"], axis=0) / np.diff(log.time)[:, None]
    return float(np.abs(np.diff(mean, axis=0)).sum())


def compared(fatrop: Row, sqp: Row) -> Row:
    """Return what is written of a pair of runs, first what does not hold."""
    ends = np.array([fatrop["switches"], sqp["switches"]])
    apart = np.abs(np.diff(ends[:, ~np.isnan(ends).all(axis=0)], axis=0))
    farthest = float(np.nan_to_num(apart, nan=np.inf).max(initial=0.0))
    requirements = {
        "result": sqp["result"] == fatrop["result"],
        "instants": farthest <= SAMPLE + HAIR,
        "end": abs(sqp["end"] - fatrop["end"]) <= END + HAIR,
        "fall-backs": sqp["fallbacks"] <= fatrop["fallbacks"],
        "alternation": sqp["alternation"] <= max(ALTERNATION, fatrop["alternation"]),
        "jump": sqp["jump"] <= max(JUMP, fatrop["jump"]) + HAIR,
        "variation": sqp["variation"] <= ROUGHER * fatrop["variation"],
    }
    return {
        "not_met": [name for name, holds in requirements.items() if not holds],
        "apart": round(farthest, 3),
        "variation_ratio": round(sqp["variation"] / fatrop["variation"], 3),
        **{key: {"fatrop": fatrop[key], "sqp": sqp[key]} for key in sqp},
    }


def main() -> int:
    """Run everything, write it, and return the exit code."""
    os.nice(10)
    found: dict[str, dict[str, Row]] = {}
    for nodes in (25, 50):
        runs = {}
        for solver in ("fatrop", "sqp"):
            changes = (f"controller.nodes={nodes}", f"solver.kind={solver}", "log.plans=false", "log.shares=false")
            runs[solver] = run_tasks({f"random {k}": with_changes(draw_task(k), changes) for k in range(COUNT)}, jobs=2)
        pairs = {name: (measured(run), measured(runs["sqp"][name])) for name, run in runs["fatrop"].items()}
        found[f"random, N_s = {nodes}"] = {name: compared(*pair) for name, pair in pairs.items()}
    text = yaml.safe_dump(found, sort_keys=False, default_flow_style=None, width=120)
    RESULTS.write_text(HEADER + text, encoding="utf-8")
    return 1 if any(row["not_met"] for rows in found.values() for row in rows.values()) else 0


if __name__ == "__main__":
    raise SystemExit(main())
