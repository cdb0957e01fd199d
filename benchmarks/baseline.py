"""Measures the transport task under every controller, and when Capture starts under different ratios of the priorities.

    python benchmarks/baseline.py          `make baseline`: writes benchmarks/baseline.yaml and weights.yaml

Later work compares itself with these tables. A change that moves one says why, in docs/decisions.md.
"""

from pathlib import Path

import numpy as np
import yaml

import psmpc_cli as psmpc
from psmpc_cli.logs.results import Results
from psmpc_cli.logs.summary import Summary
from psmpc_cli.studies.runner import run_study
from psmpc_cli.studies.sweep import DEFAULT_TASK, load_sweep_task, parse_sampling, weight_study

SINGLE_WEIGHT = ("controller.zeta=1e-3", "onset=control", *(f"skills.{s}.weights.control=1" for s in ("move", "reach")))

RUNS = {
    "psmpc": [],
    "psmpc, converged (fatrop)": ["solver.kind=fatrop"],
    "psmpc, nodes: auto": ["controller.nodes=auto"],
    "psmpc, ideal plant": ["plant.kind=ideal"],
    "smpc": ["controller.kind=smpc"],
    "smpc, converged (fatrop)": ["controller.kind=smpc", "solver.kind=fatrop"],
    "hard": ["controller.kind=hard"],
    "htmpc": ["controller.kind=htmpc"],
    "psmpc, W_r = 1, tolerance 3e-3": [
        *SINGLE_WEIGHT,
        *(f"stages.{stage}.ends_when.tolerance=3e-3" for stage in ("approach", "capture", "transport")),
        "stages.release.ends_when.tolerance=0.05",
    ],
}
HEADER = (
    "# Transport task, N_s = 100. Written by `make baseline`; times [s], distances [m], efforts as in docs/log.md.\n"
)

RATIOS, RANGE = "13", (1e-3, 1e3)
SETTINGS = {
    "as shipped, N_s = 100": [],
    "W_r = 1, tolerance 3e-3, N_s = 25, ideal plant": [
        "controller.nodes=25",
        *SINGLE_WEIGHT,
        "plant.kind=ideal",
        *(f"stages.{stage}.ends_when.tolerance=3e-3" for stage in ("approach", "capture")),
    ],
}
WEIGHTS_HEADER = (
    "# Actual start of Capture [s] by omega_2/omega_1, one column a threshold epsilon: of closeness [1] as shipped,\n"
    "# of the control [rad/s^2] in the setting of the prototype.\n"
    "# Written by `make baseline`.\n"
)


def row(summary: Summary) -> dict[str, object]:
    """Return a summary's numbers at full precision: a rerun on one machine repeats every digit."""
    stages = summary.stages
    return {
        "completed": summary.completed,
        "mission": "succeeded" if summary.succeeded else "failed",
        "switch_time": {stage.name: float(stage.switch_time) for stage in stages},
        "actual_start": {stage.name: float(stage.actual_start) for stage in stages},
        "gripper_distance": {s.name: float(d) for s, d in zip(stages, summary.distances, strict=True)},
        "control_effort": float(summary.control_effort),
        "base_force": float(summary.base_force),
        "base_torque": float(summary.base_torque),
        "fallbacks": summary.failed_solves,
        "postponed": summary.postponed,
    }


def table(results: Results) -> dict[str, object]:
    """Return a sweep's starts and ends by ratio."""
    rows = {
        float(f"{ratio:.3g}"): [float(start) for start in starts]
        for ratio, starts in zip(results["ratio"], results["actual_start"], strict=True)
    }
    return {
        "epsilon": [float(epsilon) for epsilon in results["epsilon"]],
        "approach_ends": float(np.median(results["switch_time"][:, 0])),
        "actual_start": rows,
        "capture_ends": [float(end) for end in results["completion_time"]],
        "failed_solves": int(results["solves_failed"].sum()),
    }


def sweep(changes: list[str]) -> Results:
    """Run the sweep over ratios with keys of the task changed."""
    task = load_sweep_task(DEFAULT_TASK, tuple(changes), ())
    return run_study(weight_study(task, (0, 1), parse_sampling(RATIOS, RANGE)))


def save(name: str, header: str, tables: dict[str, dict[str, object]]) -> None:
    """Write tables into a file beside this one."""
    text = header + yaml.safe_dump(tables, sort_keys=False, default_flow_style=None, width=120)
    Path(__file__).with_name(name).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    tasks = {name: psmpc.load_task("transport", changes) for name, changes in RUNS.items()}
    save("baseline.yaml", HEADER, {name: row(psmpc.simulate(task).summary()) for name, task in tasks.items()})
    save("weights.yaml", WEIGHTS_HEADER, {name: table(sweep(changes)) for name, changes in SETTINGS.items()})
