"""Measures the transport task under every controller, and when Capture starts under different ratios of the priorities.

    python benchmarks/baseline.py          `make baseline`: writes benchmarks/baseline.yaml and weights.yaml

Later work compares itself with these tables. A change that moves one says why, in docs/decisions.md.
"""

import sys
from pathlib import Path

import numpy as np
import yaml

import psmpc_cli as psmpc
from psmpc_cli.studies.runner import run_study
from psmpc_cli.studies.sampling import parse_sampling
from psmpc_cli.studies.sweep import DEFAULT_TASK, load_sweep_task, weight_study

sys.path.append(str(Path(__file__).parents[1] / "tests" / "acceptance"))
from steadiness import largest_jump

SINGLE_WEIGHT = (
    "controller.zeta=1e-3",
    "onset={kind: control}",
    *(f"skills.{s}.weights.control=1" for s in ("move", "reach")),
)

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


def row(run: psmpc.Run) -> dict[str, object]:
    """Return a run's numbers at full precision: a rerun on one machine repeats every digit."""
    summary = run.summary()
    stages, efforts = summary.stages, ("squared_acceleration", "base_force", "base_torque")
    return {
        "completed": summary.completed,
        "mission": "succeeded" if summary.succeeded else "failed",
        **{key: {stage.name: getattr(stage, key) for stage in stages} for key in ("switch_time", "actual_start")},
        "gripper_distance": {s.name: d for s, d in zip(stages, summary.distances, strict=True)},
        **{key: getattr(summary, key) for key in efforts},
        "fallbacks": summary.failed_solves,
        "postponed": summary.postponed,
        "largest_jump": largest_jump(run),
    }


def sweep(changes: list[str]) -> dict[str, object]:
    """Run the sweep over ratios with keys of the task changed; return its starts and ends by ratio."""
    task = load_sweep_task(DEFAULT_TASK, changes)
    results = run_study(weight_study(task, (0, 1), parse_sampling(RATIOS, RANGE)))
    ratios = [float(f"{ratio:.3g}") for ratio in results["ratio"]]
    return {
        "epsilon": results["epsilon"].tolist(),
        "approach_ends": float(np.median(results["switch_time"][:, 0])),
        "actual_start": dict(zip(ratios, results["actual_start"].tolist(), strict=True)),
        "capture_ends": results["completion_time"].tolist(),
        "failed_solves": int(results["solves_failed"].sum()),
    }


def save(name: str, header: str, tables: dict[str, dict[str, object]]) -> None:
    """Write tables into a file beside this one."""
    text = header + yaml.safe_dump(tables, sort_keys=False, default_flow_style=None, width=120)
    Path(__file__).with_name(name).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    tasks = {name: psmpc.load_task("transport", changes) for name, changes in RUNS.items()}
    runs = {name: {"set": RUNS[name], **row(psmpc.simulate(task))} for name, task in tasks.items()}
    save("baseline.yaml", HEADER, runs)
    save("weights.yaml", WEIGHTS_HEADER, {name: sweep(changes) for name, changes in SETTINGS.items()})
