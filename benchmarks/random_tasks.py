"""Holds `solver: sqp` with one iteration a sample against fatrop, iterated to convergence, in closed loop.

    python benchmarks/random_tasks.py                     writes benchmarks/random_tasks.yaml
    python benchmarks/random_tasks.py random --nodes 25 --count 5
    python benchmarks/random_tasks.py transport

`make random-tasks` does the first. Random tasks are drawn by seed (drawn_tasks.py), at N_s = 25 and 50; the transport
task runs under psmpc, smpc and hard at N_s = 100. Every pair of runs must have the same result, switch at the same
instants, end at the same time, need no more fall-backs and be as smooth. The exit code is 1 if one does not.
"""

import argparse
import os
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import yaml
from drawn_tasks import draw_task

from psmpc_cli.logs.run import Run
from psmpc_cli.logs.summary import Summary
from psmpc_cli.specs.load import Task, load_task, parse_task
from psmpc_cli.studies.compare import run_tasks

RESULTS = Path(__file__).with_suffix(".yaml")
SOLVERS = {"fatrop": ["solver.kind=fatrop"], "sqp": ["solver.kind=sqp"]}
QUICK = ["log.plans=false", "log.shares=false"]
CONTROLLERS = ("psmpc", "smpc", "hard")

SAMPLE, END, HAIR = 0.1, 0.2, 1e-6
"""By how much switching instants and the end of a run may differ [s]."""

ALTERNATION, JUMP, ROUGHER = 3, 0.3, 1.1
"""Smoothness: samples in a row at which a control may change its sign, by how much an optimized instant may move from
one sample to the next [s], and how many times as much as under fatrop the control may vary. Where a run under fatrop
does not keep the first two, it is itself the bound.
"""

HEADER = """\
# One iteration of sqp a sample against fatrop iterated to convergence. Written by `make random-tasks`.
# switches, end: of either run [s]; apart: the largest difference of the instants; variation: of the control, sqp's over
# fatrop's; alternation, jump: see random_tasks.py; not_met: what does not hold.
"""


@dataclass(frozen=True)
class Measured:
    """What a run came to.

    Attributes:
        result: How it ended, and whether every monitor held.
        switches: Instants that end the stages [s].
        end: When the run ended [s].
        starts: Actual starts of the stages [s].
        fallbacks: Samples without a usable solve.
        alternation: Most samples in a row at which a control changes its sign.
        jump: Most that an optimized instant moves from one sample to the next within the same window [s].
        variation: Total variation of the control, averaged over each sample, over all coordinates [m/s^2, rad/s^2].
        median: Median solve time [ms].
    """

    result: str
    switches: list[float]
    end: float
    starts: list[float]
    fallbacks: int
    alternation: int
    jump: float
    variation: float
    median: float


def measured(log: Run) -> Measured:
    """Return what a run came to."""
    summary = log.summary()
    return Measured(
        result=_result(summary),
        switches=[round(stage.switch_time, 3) for stage in summary.stages],
        end=round(summary.duration, 3),
        starts=[round(stage.actual_start, 3) for stage in summary.stages],
        fallbacks=summary.failed_solves,
        alternation=max(longest_alternation(u) for u in log["control/u"].T),
        jump=round(largest_jump(log), 3),
        variation=round(variation(log), 3),
        median=round(1e3 * float(summary.solves.median), 2),
    )


def _result(summary: Summary) -> str:
    if not summary.completed:
        return f"not completed: {summary.reason}"
    return "completed" if summary.succeeded else "completed, a monitor did not hold"


def longest_alternation(u: np.ndarray) -> int:
    """Return the longest run of samples whose control (K,) changes its sign, both values above 1 % of the peak."""
    large = np.abs(u) > 0.01 * np.abs(u).max()
    longest = run = 0
    for changed in (u[1:] * u[:-1] < 0) & large[1:] & large[:-1]:
        run = run + 1 if changed else 0
        longest = max(longest, run)
    return longest


def largest_jump(log: Run) -> float:
    """Return the most that the next optimized instant moves between samples whose windows hold the same stages [s]."""
    first, count = log["window/first"], log["window/count"]
    same = (np.diff(first) == 0) & (np.diff(count) == 0) & (count[1:] > 1)
    ahead = log["window/instants"][np.arange(len(first)), first]
    return float(np.abs(np.diff(ahead)[same]).max(initial=0.0))


def variation(log: Run) -> float:
    """Return the total variation of the control, averaged over each sample, over all coordinates.

    The control of a sample's first tick, which the summary of a run takes, may lie in a vanishing interval before a
    switch. Whether it does depends on a millisecond, and it is as tall as the interval is short.
    """
    mean = np.diff(log["state/Qdot"], axis=0) / np.diff(log.time)[:, None]
    return float(np.abs(np.diff(mean, axis=0)).sum())


def not_met(sqp: Measured, fatrop: Measured) -> list[str]:
    """Return which of the requirements a pair of runs does not meet."""
    requirements = {
        "result": sqp.result == fatrop.result,
        "instants": apart(sqp.switches, fatrop.switches) <= SAMPLE + HAIR,
        "end": abs(sqp.end - fatrop.end) <= END + HAIR,
        "fall-backs": sqp.fallbacks <= fatrop.fallbacks,
        "alternation": sqp.alternation <= max(ALTERNATION, fatrop.alternation),
        "jump": sqp.jump <= max(JUMP, fatrop.jump) + HAIR,
        "variation": sqp.variation <= ROUGHER * fatrop.variation,
    }
    return [name for name, holds in requirements.items() if not holds]


def apart(one: list[float], other: list[float]) -> float:
    """Return the largest difference [s]; infinite where only one of two is known."""
    differences = np.abs(np.subtract(one, other))
    known = ~(np.isnan(one) & np.isnan(other))
    return float(np.nan_to_num(differences[known], nan=np.inf).max(initial=0.0))


def random_tasks(nodes: int, seeds: Iterable[int]) -> dict[str, Task]:
    """Return the drawn tasks by name."""
    return {f"random {seed}": _changed(draw_task(seed), [f"controller.nodes={nodes}"]) for seed in seeds}


def transport_tasks() -> dict[str, Task]:
    """Return the transport task under the controllers whose windows sqp solves."""
    return {kind: load_task("transport", [f"controller.kind={kind}"]) for kind in CONTROLLERS}


def _changed(task: Task, changes: list[str]) -> Task:
    return parse_task(task.task_yaml, task.robot_yaml, task.spec.name, changes)


def compared(tasks: Mapping[str, Task], extra: list[str], keep: Path | None, jobs: int) -> dict[str, object]:
    """Run every task with both solvers, print a line for each, and return what was found by name."""
    variants = {
        f"{name}, {solver}": _changed(task, [*changes, *QUICK, *(extra if solver == "sqp" else [])])
        for name, task in tasks.items()
        for solver, changes in SOLVERS.items()
    }
    runs, rows = run_tasks(variants, jobs), {}
    if keep is not None:
        for name, run in runs.items():
            run.save(keep / f"{name}.h5", force=True)
    print(
        f"{'':<12} {'apart':>6} {'end':>13} {'fall-backs':>10} {'altern.':>8} {'jump':>12} {'variation':>9} {'ms':>12}"
    )
    for name in tasks:
        fatrop, sqp = (measured(runs[f"{name}, {solver}"]) for solver in SOLVERS)
        failed = not_met(sqp, fatrop)
        rows[name] = row(sqp, fatrop, failed)
        print(line(name, sqp, fatrop, failed), flush=True)
    return rows


def row(sqp: Measured, fatrop: Measured, failed: list[str]) -> dict[str, object]:
    """Return what is written of a pair of runs."""
    pair = {solver: asdict(found) for solver, found in (("fatrop", fatrop), ("sqp", sqp))}
    either = {key: {solver: found[key] for solver, found in pair.items()} for key in pair["sqp"] if key != "median"}
    return {
        "not_met": failed,
        "apart": round(apart(sqp.switches, fatrop.switches), 3),
        "variation_ratio": round(sqp.variation / fatrop.variation, 3),
        **either,
    }


def line(name: str, sqp: Measured, fatrop: Measured, failed: list[str]) -> str:
    """Return a pair of runs as a line of the table, sqp first."""
    return (
        f"{name:<12} {apart(sqp.switches, fatrop.switches):6.2f} {sqp.end:6.1f} {fatrop.end:6.1f} "
        f"{sqp.fallbacks:5d}{fatrop.fallbacks:5d} {sqp.alternation:4d}{fatrop.alternation:4d} "
        f"{sqp.jump:6.2f}{fatrop.jump:6.2f} {sqp.variation / fatrop.variation:9.3f} "
        f"{sqp.median:6.2f}{fatrop.median:6.1f}  "
        f"{', '.join(failed) or 'holds'}"
    )


def main() -> int:
    """Run what is asked for, write it unless only a part was, and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="?", choices=("random", "transport", "all"), default="all")
    parser.add_argument("--nodes", type=int, nargs="+", default=[25, 50], help="N_s of the random tasks")
    parser.add_argument("--count", type=int, default=20, help="how many random tasks")
    parser.add_argument("--first", type=int, default=0, help="seed of the first one")
    parser.add_argument("--jobs", type=int, default=2, help="processes at once")
    parser.add_argument("--set", dest="extra", action="append", default=[], help="key=value of the runs with sqp")
    parser.add_argument("--keep", type=Path, help="where to keep the logs")
    given = parser.parse_args()
    os.nice(10)
    seeds, found = range(given.first, given.first + given.count), {}
    tasks = {f"random, N_s = {nodes}": random_tasks(nodes, seeds) for nodes in given.nodes if given.what != "transport"}
    tasks |= {"transport, N_s = 100": transport_tasks()} if given.what != "random" else {}
    for name, drawn in tasks.items():
        print(f"{name}:")
        found[name] = compared(drawn, given.extra, given.keep and given.keep / name, given.jobs)
    if all(getattr(given, name) == parser.get_default(name) for name in ("what", "nodes", "count", "first", "extra")):
        text = yaml.safe_dump(found, sort_keys=False, default_flow_style=None, width=120)
        RESULTS.write_text(HEADER + text, encoding="utf-8")
    return 1 if any(row["not_met"] for rows in found.values() for row in rows.values()) else 0


if __name__ == "__main__":
    raise SystemExit(main())
