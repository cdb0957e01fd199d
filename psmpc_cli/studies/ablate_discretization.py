"""Euler's discretization, eq. (20), against the exact one over N_s: the prediction in one window, and the run."""

from collections.abc import Mapping

import numpy as np

from psmpc_cli.logs.read import Log
from psmpc_cli.simulation.summary import summarize
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
    panels: dict[str, dict[str, Curve]] = {"error": {}, "missed": {}, "end": {}}
    numbers: dict[str, float] = {}
    for kind in KINDS:
        errors, missed = np.array([on_mesh(one, count, kind) for count in counts]).T
        ends = np.array([end_of(summarize(logs[run_on_mesh(kind, count, nodes)])) for count in counts])
        for panel, values in (("error", errors), ("missed", missed), ("end", ends)):
            panels[panel][kind] = np.array(counts, float), values
            numbers |= {f"{panel}, {kind}, {c} nodes": float(v) for c, v in zip(counts, values, strict=True)}
    return Ablation("discretization", _sentence(numbers, counts, one.window.start), panels, numbers)


def _sentence(numbers: Mapping[str, float], counts: list[int], start: float) -> str:
    """Say what Euler's discretization costs with the fewest nodes and with all."""
    few, many = counts[0], counts[-1]

    def of(quantity: str, kind: str) -> str:
        return f"{numbers[f'{quantity}, {kind}, {few} nodes']:.2g} ({numbers[f'{quantity}, {kind}, {many} nodes']:.2g})"

    def end(kind: str, count: int) -> str:
        return ending(numbers[f"end, {kind}, {count} nodes"])

    return (
        f"With N_s = {few} ({many}) and in the window at {start:.1f} s Euler's prediction of a coordinate is off by "
        f"{of('error', 'euler')} m or rad and its control leads at t_s to {of('missed', 'euler')} tolerances from the "
        f"target, the exact one by {of('error', 'exact')} m or rad and to {of('missed', 'exact')} tolerances; the run "
        f"{end('euler', few)} ({end('euler', many)}) with Euler's discretization and {end('exact', few)} "
        f"({end('exact', many)}) with the exact one."
    )
