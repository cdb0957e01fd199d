"""Measures the transport task under every controller and writes the table that later work compares itself with.

    python benchmarks/baseline.py          writes benchmarks/baseline.yaml

`make baseline` does the same. A change that moves this table says why, in docs/decisions.md.
"""

import tempfile
from pathlib import Path

import yaml

from psmpc_cli.logs.run import read_run
from psmpc_cli.logs.summary import Summary
from psmpc_cli.simulation.run import simulate
from psmpc_cli.specs.load import load_task

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
        "controller.zeta=1e-3",
        "onset=control",
        "skills.move.weights.control=1",
        "skills.reach.weights.control=1",
        *(f"stages.{stage}.ends_when.tolerance=3e-3" for stage in ("approach", "capture", "transport")),
        "stages.release.ends_when.tolerance=0.05",
    ],
}
HEADER = (
    "# Transport task, N_s = 100. Written by `make baseline`; times [s], distances [m], efforts as in docs/log.md.\n"
)


def measure(changes: list[str], directory: Path) -> Summary:
    """Run the transport task with keys changed and return its summary."""
    path = directory / "run.h5"
    simulate(load_task("transport", changes), path, force=True)
    return read_run(path).summary()


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


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as directory:
        table = {name: row(measure(changes, Path(directory))) for name, changes in RUNS.items()}
    text = HEADER + yaml.safe_dump(table, sort_keys=False, default_flow_style=None, width=120)
    Path(__file__).with_suffix(".yaml").write_text(text, encoding="utf-8")
