"""A capture with the thrusters off, beside the same with thrusters on, other controllers, and what is not declared.

python benchmarks/capture_floating.py table    the table of docs/mobility_results.md, some minutes
"""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from pages import command_line, markdown

from psmpc_cli.logs.run import Run
from psmpc_cli.simulation.run import simulate
from psmpc_cli.specs.load import load_task

FREE_FLYING = {"skills.drift.mobility": "free-flying", "skills.grasp.mobility": "free-flying"}
WITH_BASE = {"skills.drift.weights.base": [100, 100, 10], "skills.grasp.weights.base": [100, 100, 100]}
NOISE = {"position": 1e-3, "angle": 1e-3, "velocity": 1e-3, "angular_velocity": 1e-3}

CASES: Mapping[str, Mapping[str, Any]] = {
    "thrusters off from `coast` to `capture`": {},
    "the same, `smpc`": {"controller.kind": "smpc"},
    "the same, `hard` with a free end": {"controller.kind": "hard", "controller.one_stage": "free_end"},
    "thrusters on throughout": {
        **FREE_FLYING,
        **WITH_BASE,
        "stages.capture.target.base": {"object": [0, -0.978, 0]},
    },
    "noise of 1 mm, 1 mrad, 1 mm/s, 1 mrad/s": {"uncertainty": {"noise": NOISE}},
    "commands 0.2 s late": {"uncertainty": {"delay": "0.2 s"}},
    "the load to be found out, up to 30 % off": {
        "object.grasp.known": "estimated",
        "uncertainty": {"object": {"mass": 0.3}},
        "seed": 2,
    },
    "the object drifts by up to 2 mm/s and 0.1 deg/s": {
        "uncertainty": {"object": {"linear": 0.002, "angular": "0.1 deg"}}
    },
}
"""What differs from the built-in task."""


def table() -> Iterator[str]:
    """Yield a row for each case."""
    rows = [{"": name} | row(simulate(load_task("capture_floating", changes))) for name, changes in CASES.items()]
    yield from markdown(rows)


def row(run: Run) -> dict[str, str]:
    """Return the cells of a run."""
    summary = run.summary()
    taken = float(run.stages["switch_time"][2])
    before = run.time < (taken if np.isfinite(taken) else np.inf)
    return {
        "delivered": "yes" if summary.succeeded else "no",
        "taken at [s]": f"{taken:.1f}" if np.isfinite(taken) else "never",
        "ends [s]": f"{summary.duration:.1f}" if summary.succeeded else "-",
        "thrust until then [N s]": f"{run['effort/base_force'][before].sum():.1f}",
        "failed solves": f"{summary.failed_solves} of {len(run.time)}",
    }


if __name__ == "__main__":
    command_line(table)
