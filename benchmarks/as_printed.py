"""Tables of docs/reproduce.md and docs/departures.md: the task as printed, each departure, and what a start is.

python benchmarks/as_printed.py claims               claims that hold by setting, as shipped and as printed; minutes
python benchmarks/as_printed.py departures [NODES ...]   each departure alone, as printed and as shipped; minutes
python benchmarks/as_printed.py starts [NODES]       claims that hold by each definition of a start; minutes
python benchmarks/as_printed.py figure6 [GRID] [NODES]   Fig. 6 by each definition of a start; minutes
"""

import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from pages import command_line, markdown

import psmpc_cli as psmpc
from psmpc_cli.paper.departures import DEPARTURES, PRINTED, SHIPPED, load_variant
from psmpc_cli.paper.reproduce import load_variants, load_weights_sweep, reproduce
from psmpc_cli.studies.compare import run_tasks
from psmpc_cli.studies.runner import run_study
from psmpc_cli.studies.sweep import SweepCells

BRIEF = ("log.plans=false", "log.shares=false")
"""Changes of a run of which nothing but its summary is read."""

DEFINITIONS: Mapping[str, str] = {
    "control, 0.1": "onset={kind: control, epsilon: 0.1}",
    "closeness, 0.5": "onset={kind: closeness, epsilon: 0.5}",
    "control, 1e-4, as printed": "onset={kind: control, epsilon: 1e-4}",
}
"""Definitions of a start by their names."""

COARSE = ("controller.nodes=25",)
CONVERGED = ("solver.kind=fatrop", "solver.deadline=null")
WITHOUT_PENDING = (*COARSE, "controller.pending_cost=0", "controller.normalization=range")

JUDGED: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "as shipped, HTMPC with settings of its own": (SHIPPED, ()),
    "one setting for all three controllers": (SHIPPED, ("by_controller={}",)),
    "a start is judged by the control": (SHIPPED, ("onset={kind: control}",)),
    "coarser mesh": (SHIPPED, COARSE),
    "coarser mesh, converged": (SHIPPED, (*COARSE, *CONVERGED)),
    "coarser mesh, no pending cost, the range in (12)": (SHIPPED, WITHOUT_PENDING),
    "the same, converged": (SHIPPED, (*WITHOUT_PENDING, *CONVERGED)),
    "as printed, coarser mesh": (PRINTED, COARSE),
    "as printed, coarser mesh, one iteration of `sqp` a sample": (PRINTED, (*COARSE, "solver.kind=sqp")),
}
"""The settings whose claims are counted, each with its task and the changes of it."""

SAMPLE = 0.1
"""Time between two samples of the tasks [s]: starts are known no better."""


def claims() -> Iterator[str]:
    """Yield the table of how many claims hold in each setting, with the options of `psmpc reproduce`."""
    return markdown(_counts())


def _counts() -> Iterator[dict[str, str]]:
    for setting, (task, changes) in JUDGED.items():
        with TemporaryDirectory() as folder:
            made = reproduce(Path(folder) / "made", changes, task=task)
        held, count = made.count()
        words = ["--as-printed"] * (task == PRINTED) + [f"--set {shlex.quote(change)}" for change in changes]
        yield {
            "setting": setting,
            "options": f"`{' '.join(words)}`" if words else "none",
            "claims that hold": f"{held} of {count}",
        }


def departures(*nodes: str) -> Iterator[str]:
    """Yield the table of the runs of PSMPC with each departure switched alone, for each number of intervals."""
    return markdown(_of_departures(nodes or ("25", "100")))


def _of_departures(meshes: Sequence[str]) -> Iterator[dict[str, str]]:
    for base, name in ((PRINTED, "as printed"), (SHIPPED, "as shipped")):
        for departure in (None, *DEPARTURES):
            if departure is None:
                run = name
            else:
                run = f"{name}, but {departure.name if base == PRINTED else departure.as_paper}"
            row = {"run": run}
            for nodes in meshes:
                variant = load_variant(base, departure, (f"controller.nodes={nodes}", *BRIEF))
                stages = psmpc.simulate(variant).summary().stages
                row[f"ends, N_s = {nodes} [s]"] = _times([stage.switch_time for stage in stages], 2)
                row[f"starts, N_s = {nodes} [s]"] = _times([stage.actual_start for stage in stages[1:]], 1)
            yield row


def _times(times: Sequence[float], digits: int) -> str:
    """Write times [s], and "never" for what did not happen."""
    return ", ".join(f"{time:.{digits}f}" if np.isfinite(time) else "never" for time in times)


def starts(nodes: str = "25") -> Iterator[str]:
    """Yield the table of the claims that hold by each definition of a start."""
    with TemporaryDirectory() as folder:
        made = reproduce(Path(folder) / "made", (f"controller.nodes={nodes}",), force=True)
        rows = []
        for name, definition in DEFINITIONS.items():
            runs = run_tasks(load_variants((f"controller.nodes={nodes}", definition)))
            judged = replace(made, runs=runs)
            held, count = judged.count()
            missed = [finding.claim.id for finding in judged.part(None) if not finding.holds]
            row = {"definition": name, "claims that hold": f"{held} of {count}"}
            for controller in ("psmpc", "smpc"):
                stages = runs[controller].summary().stages
                early = (
                    f"{stage.actual_start:.1f} ({stage.actual_start - before.switch_time:+.1f})"
                    for before, stage in pairwise(stages)
                )
                row[f"starts of Capture, Transport, Release, {controller.upper()} [s]"] = ", ".join(early)
            rows.append({**row, "does not hold": ", ".join(f"`{claim}`" for claim in missed)})
    return markdown(rows)


def figure6(grid: str = "25x25", nodes: str = "25") -> Iterator[str]:
    """Yield the table of the start of Capture over the ratio of the weights, by each definition of a start."""
    rows = []
    with TemporaryDirectory() as folder:
        for kind in ("closeness", "control"):
            chosen = {name: each for name, each in DEFINITIONS.items() if f"kind: {kind}" in each}
            epsilons = [float(each.partition("epsilon: ")[2].rstrip("}")) for each in chosen.values()]
            changes = (f"controller.nodes={nodes}",)
            study = load_weights_sweep(changes, grid, (f"onset={{kind: {kind}, series: {epsilons}}}",))
            cells = SweepCells(run_study(study, Path(folder) / f"{kind}.h5"))
            for name, epsilon in zip(chosen, epsilons, strict=True):
                rows.append({"definition": name, **_along_ratio(cells, epsilon)})
    return markdown(rows)


def _along_ratio(cells: SweepCells, epsilon: float) -> dict[str, str]:
    """Return what the table says of the starts of a sweep for one threshold."""
    at = int(np.argmin(np.abs(cells.epsilons / epsilon - 1)))
    runs = cells.ended_by_ratio
    start = cells.quantity("actual_start")[runs, at]
    ratio = cells.ratio[runs]
    away = np.flatnonzero(np.abs(start - start[-1]) > SAMPLE + 1e-9)
    settled = int(away[-1]) + 1 if len(away) else 0
    return {
        "ratios, ended": f"{len(runs)} of {len(cells.run_by_ratio)}",
        **{f"start at {wanted:g} [s]": _at(ratio, start, wanted) for wanted in (1e-6, 1e-2, 1.0, 1e2, 1e6)},
        "settled from ratio": f"{ratio[settled]:.2g}",
        "`t_s` there [s]": f"{cells.first_switch[runs][settled]:.2f}",
        "`t_s - T_h` there [s]": f"{cells.earliest_start[runs][settled]:.2f}",
    }


def _at(ratio: np.ndarray, start: np.ndarray, wanted: float) -> str:
    near = np.flatnonzero(np.abs(np.log10(ratio / wanted)) < 1e-6)
    return f"{start[near[0]]:.1f}" if len(near) else "-"


if __name__ == "__main__":
    command_line(claims, departures, starts, figure6)
