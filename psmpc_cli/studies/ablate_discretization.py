"""Euler's discretization, eq. (20), against the exact one over N_s: prediction, instant and run."""

from collections.abc import Mapping

import numpy as np

from psmpc_cli.experiment.summary import summarize
from psmpc_cli.logs.read import Log
from psmpc_cli.studies.ablation import OURS, Ablation, Curve, end_of, ending
from psmpc_cli.studies.one_window import OneWindow, on_mesh

KINDS = ("exact", "euler")

PARTS = (0.1, 0.2, 0.5, 1.0)
"""N_s of the runs, as parts of the task's."""


def meshes(nodes: int) -> list[int]:
    """Return the N_s of the runs for a task with so many nodes, rising."""
    return sorted({max(2, round(part * nodes)) for part in PARTS})


def run_on_mesh(kind: str, count: int, nodes: int) -> str:
    """Return the name of the run with a discretization and N_s; one of them is the task itself."""
    return OURS if (kind, count) == ("exact", nodes) else f"{kind}, {count} nodes"


def ablate_discretization(logs: Mapping[str, Log], one: OneWindow, nodes: int) -> Ablation:
    """Compare the runs with either discretization over N_s, and their predictions in one window."""
    counts = meshes(nodes)
    panels: dict[str, dict[str, Curve]] = {"error": {}, "instant": {}, "end": {}}
    numbers: dict[str, float] = {}
    for kind in KINDS:
        instants, errors = np.array([on_mesh(one, count, kind) for count in counts]).T
        ends = np.array([end_of(summarize(logs[run_on_mesh(kind, count, nodes)])) for count in counts])
        for panel, values in (("error", errors), ("instant", instants), ("end", ends)):
            panels[panel][kind] = np.array(counts, float), values
            numbers |= {f"{panel}, {kind}, {c} nodes": float(v) for c, v in zip(counts, values, strict=True)}
    return Ablation("discretization", _sentence(numbers, counts, one.window.start), panels, numbers)


def _sentence(numbers: Mapping[str, float], counts: list[int], start: float) -> str:
    """Say what Euler's discretization costs with the fewest nodes and with all."""
    few, many = counts[0], counts[-1]

    def error(kind: str, count: int) -> str:
        return f"{numbers[f'error, {kind}, {count} nodes']:.1e}"

    def end(kind: str, count: int) -> str:
        return ending(numbers[f"end, {kind}, {count} nodes"])

    return (
        f"Within the window at {start:.1f} s Euler's prediction of a coordinate is off by up to "
        f"{error('euler', few)} m or rad with N_s = {few} and {error('euler', many)} with {many}, the exact one by "
        f"{error('exact', few)} and {error('exact', many)}; with N_s = {few} the run {end('euler', few)} (exact: it "
        f"{end('exact', few)}), with {many} it {end('euler', many)} ({end('exact', many)})."
    )
