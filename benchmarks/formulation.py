"""Tables of docs/formulation.md that take minutes: starts, control effort by mesh, and the departures from the paper.

python benchmarks/formulation.py starts [NODES]      both measures of an actual start; some half a minute
python benchmarks/formulation.py effort              control effort of two tasks on several meshes; some minutes
python benchmarks/formulation.py ablations [NODES]   and docs/figures/ablation_*.png; about half an hour
"""

import sys
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from pages import ROOT, command_line, markdown

import psmpc_cli as psmpc
from psmpc_cli.paper.ablations import CHANGES, DISCRETIZATIONS, run_ablations
from psmpc_cli.paper.figures import save_ablation

STARTS = {
    "Capture, PSMPC": ("psmpc", "capture"),
    "Capture, SMPC": ("smpc", "capture"),
    "Transport, PSMPC": ("psmpc", "transport"),
    "Release, PSMPC": ("psmpc", "release"),
}
"""Controller and stage of each column."""

THRESHOLDS = {"control": [0.1], "closeness": [0.1, 0.5, 0.9]}
"""Thresholds of the actual start by what is compared with them."""

MESHES: Mapping[str, Sequence[str]] = {
    "transport": ("12", "25", "50", "100", "400", "auto"),
    "transport_grasp": ("25", "50", "100", "auto"),
}
"""Values of `controller.nodes` on which the control effort of each task is measured."""

NEAR_SWITCH = 0.5
"""How far from a switch control effort counts to it [s]."""


def starts(nodes: str = "100") -> Iterator[str]:
    """Yield the table of the actual starts of the transport task under both measures of a start."""
    rows = []
    for measure, thresholds in THRESHOLDS.items():
        changes = {"controller.nodes": int(nodes), "onset.kind": measure, "onset.series": thresholds}
        runs = psmpc.compare(psmpc.load_task("transport", changes), ("psmpc", "smpc"))
        for number, epsilon in enumerate(runs["psmpc"].stages["epsilon"]):
            cells = {name: _start(runs[kind], stage, number) for name, (kind, stage) in STARTS.items()}
            rows.append({"actual start [s]": f"{measure}, {epsilon:g}", **cells})
    return markdown(rows)


def _start(run: psmpc.Run, stage: str, number: int) -> str:
    """Write the actual start of a stage with a threshold [s], or that there is none before its switch."""
    index = run.stage_names.index(stage)
    start, switch = run.stages["actual_start_by_epsilon"][index, number], run.stages["switch_time"][index - 1]
    return f"{start:.1f}" if start < switch else f"{switch:.2f}, its switch"


def effort() -> Iterator[str]:
    """Yield the table of both measures of control effort by mesh, and of where in time the first one arises."""
    return markdown(_effort(task, nodes) for task, meshes in MESHES.items() for nodes in meshes)


def _effort(task: str, nodes: str) -> dict[str, str]:
    """Run a task with PSMPC on a mesh and return its row of the table of efforts."""
    changes = ["controller.kind=psmpc", f"controller.nodes={nodes}", "log.shares=false", "log.plans=false"]
    run = psmpc.simulate(psmpc.load_task(task, changes))
    summary = run.summary()
    effort_by_sample = run["effort/control"]
    times = run.time[: len(effort_by_sample)]
    places = {"start": 0.0, **{f"end of {stage.name}": stage.switch_time for stage in summary.stages[:-1]}}
    near = {name: float(effort_by_sample[np.abs(times - at) <= NEAR_SWITCH].sum()) for name, at in places.items()}
    return {
        "task": f"`{task}`",
        "N_s": nodes,
        "`squared_acceleration`": f"{summary.squared_acceleration:.2f}",
        "`control_effort`": f"{summary.control_effort:.2f}",
        **{f"{name}, within {NEAR_SWITCH:g} s": f"{value:.2f}" for name, value in near.items()},
        "at all other times": f"{summary.control_effort - sum(near.values()):.2f}",
    }


def ablations(*nodes: str) -> Iterator[str]:
    """Draw the figures and yield the tables of each departure taken back, by default on the task's own mesh."""
    task = psmpc.load_task("transport", [f"controller.nodes={count}" for count in nodes])
    for ablation in run_ablations(task, watch=lambda name: print(name, file=sys.stderr, flush=True)):
        save_ablation(ablation, ROOT / "docs" / "figures")
        yield f"\nWithout our {ablation.name.replace('_', ' ')}:\n"
        yield from _by_variant(ablation.numbers)


def _by_variant(numbers: Mapping[str, float]) -> Iterator[str]:
    """Yield a table with a row for each quantity and a column for each variant, which the names of numbers contain."""
    columns = [each for each in (*CHANGES, *DISCRETIZATIONS) if any(f", {each}" in name for name in numbers)]
    rows: dict[str, dict[str, str]] = {}
    for name, value in numbers.items():
        of = next((each for each in sorted(columns, key=len, reverse=True) if f", {each}" in name), None)
        quantity = name.replace(f", {of}", "")
        row = rows.setdefault(quantity, {"": quantity, **dict.fromkeys(columns, "-")})
        row |= dict.fromkeys([of] if of else columns, f"{value:.4g}")
    return markdown(rows.values())


if __name__ == "__main__":
    command_line(starts, effort, ablations)
