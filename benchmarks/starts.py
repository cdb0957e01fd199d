"""Prints the actual starts of the transport task under both measures of a start: a table of docs/formulation.md.

python benchmarks/starts.py [NODES]          some half a minute
"""

import sys

import numpy as np
from pages import markdown

import psmpc_cli as psmpc

COLUMNS = {
    "Capture, PSMPC": ("psmpc", "capture"),
    "Capture, SMPC": ("smpc", "capture"),
    "Transport, PSMPC": ("psmpc", "transport"),
    "Release, PSMPC": ("psmpc", "release"),
}
MEASURES = {"control": [0.1], "closeness": [0.1, 0.5, 0.9]}
"""Thresholds of the actual start by what is compared with them."""


def starts(run: psmpc.Run, stage: str) -> list[str]:
    """Return the actual start of a stage for each threshold [s], and where there is none before its switch time, so."""
    i = list(run.stage_names).index(stage)
    found, switch = run["stages/actual_start_by_epsilon"][i], run.stages["switch_time"][i - 1]
    return [f"{start:.1f}" if start < switch else f"{switch:.2f}, its switch" for start in np.atleast_1d(found)]


def run(controller: str, nodes: str, measure: str) -> psmpc.Run:
    """Run the transport task with a measure of the actual start and its thresholds."""
    changes = [f"controller.kind={controller}", f"controller.nodes={nodes}", f"onset.kind={measure}"]
    return psmpc.simulate(psmpc.load_task("transport", [*changes, f"onset.series={MEASURES[measure]}"]))


def main(nodes: str) -> None:
    """Print the table."""
    rows = []
    for measure in MEASURES:
        runs = {controller: run(controller, nodes, measure) for controller in ("psmpc", "smpc")}
        columns = [starts(runs[controller], stage) for controller, stage in COLUMNS.values()]
        thresholds = runs["psmpc"]["stages/epsilon"]
        rows += [(f"{measure}, {epsilon:g}", *cells) for epsilon, *cells in zip(thresholds, *columns, strict=True)]
    print("\n".join(markdown(("actual start [s]", *COLUMNS), rows)))


if __name__ == "__main__":
    main([*sys.argv, "100"][1])
