"""Measures when Capture starts under different ratios of the priorities: the table later work is held against.

    python benchmarks/weights.py          writes benchmarks/weights.yaml

`make baseline` does the same. A change that moves this table says why, in docs/decisions.md.
"""

import tempfile
from pathlib import Path

import numpy as np
import yaml

from psmpc_cli.logs.results import Results
from psmpc_cli.studies.runner import run_study
from psmpc_cli.studies.sweep import DEFAULT_TASK, load_sweep_task, parse_sampling, weight_study

RATIOS, RANGE = "13", (1e-3, 1e3)
SETTINGS = {
    "as shipped, N_s = 100": [],
    "W_r = 1, tolerance 3e-3, N_s = 25, ideal plant": [
        "controller.nodes=25",
        "controller.zeta=1e-3",
        "plant.kind=ideal",
        "onset=control",
        "skills.move.weights.control=1",
        "skills.reach.weights.control=1",
        *(f"stages.{stage}.ends_when.tolerance=3e-3" for stage in ("approach", "capture")),
    ],
}
HEADER = (
    "# Actual start of Capture [s] by omega_2/omega_1, one column a threshold epsilon: of closeness [1] as shipped,\n"
    "# of the control [rad/s^2] in the setting of the prototype.\n"
    "# Written by `make baseline`.\n"
)


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


def measure(changes: list[str], path: Path) -> Results:
    """Run the sweep over ratios with keys of the task changed."""
    task = load_sweep_task(DEFAULT_TASK, tuple(changes), ())
    return run_study(weight_study(task, (0, 1), parse_sampling(RATIOS, RANGE)), path, force=True)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as directory:
        tables = {name: table(measure(changes, Path(directory) / "sweep.h5")) for name, changes in SETTINGS.items()}
    text = HEADER + yaml.safe_dump(tables, sort_keys=False, default_flow_style=None, width=120)
    Path(__file__).with_suffix(".yaml").write_text(text, encoding="utf-8")
