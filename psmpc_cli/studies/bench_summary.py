"""A bench in numbers: what each way took and how near it came, by mesh and by number of stages, and how times grow."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from psmpc_cli.studies.bench import Bench, Posed
from psmpc_cli.studies.bench_problems import relative
from psmpc_cli.studies.bench_solves import COLD, REFERENCE, Solved, Way
from psmpc_cli.studies.bench_statistics import Spread, exponent, spread


@dataclass(frozen=True, eq=False)
class Gaps:
    """How far a point is from an optimum; NaN where there is none, or the solve failed.

    Attributes:
        objective: By how much J is above, relative; below where constraints are violated, or in a better basin.
        over_time: The same of what the plan costs over time.
        instants: Largest difference of an instant [s]; 0 without instants.
    """

    objective: float
    over_time: float
    instants: float


@dataclass(frozen=True, eq=False)
class Row:
    """What one way came to on one mesh, over all windows or those with so many stages; failed solves only counted.

    Attributes:
        nodes: The mesh.
        stages: Number of stages in the windows; None for all.
        way: The way.
        windows, failed: How many windows there were, and in how many it failed.
        time: Of the timed solves that did not fail [s].
        busy: Mean processor time of a solve in each of those windows [s].
        iterations: Of those solves.
        objective_gap, instant_gap: Sizes of the gaps to the mesh's own optimum, [1] and [s].
        to_finest: Size of the gap to the finest mesh's optimum of what plans cost over time [1].
        violation: Of constraints [m, rad, m/s, rad/s, s].
        speedup: The median of the reference way over this one.
    """

    nodes: str
    stages: int | None
    way: Way
    windows: int
    failed: int
    time: Spread
    busy: Spread
    iterations: Spread
    objective_gap: Spread
    instant_gap: Spread
    to_finest: Spread
    violation: Spread
    speedup: float


@dataclass(frozen=True, eq=False)
class Growth:
    """How the processor time of one way grows with the nodes of each stage, in windows with so many stages.

    That of the processor, because meshes are measured one after the other and the machine may do more beside one of
    them than beside another.

    Attributes:
        way, stages: The way and the number of stages.
        nodes: N_s (meshes,).
        medians: Median processor times of a solve (meshes,) [s].
        exponent: p of time ~ N_s^p; NaN with one mesh.
        doubling: The time at 200 nodes over that at 100; NaN without both.
    """

    way: Way
    stages: int
    nodes: tuple[int, ...]
    medians: tuple[float, ...]
    exponent: float
    doubling: float


def gaps(solved: Solved, posed: Posed) -> Gaps:
    """Return how far a solve is from an optimum of its window."""
    if solved.failed or posed.optimum is None:
        return Gaps(np.nan, np.nan, np.nan)
    best = posed.optimum
    late = float(np.abs(solved.instants - best.instants).max(initial=0.0))
    return Gaps(relative(solved.objective, best.objective), relative(solved.over_time, best.over_time), late)


def finest(bench: Bench) -> str | None:
    """Return the mesh with the most nodes; None if all are automatic."""
    numbers = [nodes for nodes in bench.choices.nodes if nodes != "auto"]
    return max(numbers, key=int, default=None)


def summarize_bench(bench: Bench) -> list[Row]:
    """Return a row for every mesh, number of stages and way; first of each mesh those over all its windows."""
    counts = sorted({solved.stages for solved in bench.solved})
    ways = dict.fromkeys(solved.way for solved in bench.solved)
    groups = product(bench.choices.nodes, (None, *counts), ways)
    return [_row(bench, nodes, stages, way) for nodes, stages, way in groups]


def _row(bench: Bench, nodes: str, stages: int | None, way: Way) -> Row:
    every = _of(bench, nodes, stages, way)
    good = [solved for solved in every if not solved.failed]
    apart, best = [gaps(solved, bench.posed[solved.index, nodes]) for solved in good], finest(bench)
    to_best = [] if best is None else [gaps(solved, bench.posed[solved.index, best]) for solved in good]
    time, reference = _times(good), _times(_of(bench, nodes, stages, Way(REFERENCE, COLD)))
    return Row(
        nodes=nodes,
        stages=stages,
        way=way,
        windows=len(every),
        failed=len(every) - len(good),
        time=time,
        busy=spread([solved.busy / len(solved.times) for solved in good]),
        iterations=spread([solved.iterations for solved in good]),
        objective_gap=_sizes([gap.objective for gap in apart]),
        instant_gap=_sizes([gap.instants for gap in apart]),
        to_finest=_sizes([gap.over_time for gap in to_best]),
        violation=spread([solved.violation for solved in good]),
        speedup=reference.median / time.median,
    )


def _sizes(every: Sequence[float]) -> Spread:
    """Return how the sizes of gaps spread, those that are there."""
    return spread([abs(gap) for gap in every if np.isfinite(gap)])


def _of(bench: Bench, nodes: str, stages: int | None, way: Way) -> list[Solved]:
    every = (solved for solved in bench.solved if solved.nodes == nodes and solved.way == way)
    return [solved for solved in every if stages is None or solved.stages == stages]


def _times(every: Sequence[Solved]) -> Spread:
    return spread([time for solved in every if not solved.failed for time in solved.times])


def grow(rows: Sequence[Row]) -> Iterator[Growth]:
    """Give how the time of each way grows with N_s, from the rows of a bench."""
    for way, stages in dict.fromkeys((row.way, row.stages) for row in rows):
        if stages is None:
            continue
        found = {
            int(row.nodes): row.busy.median
            for row in rows
            if (row.way, row.stages) == (way, stages) and row.nodes != "auto" and row.busy.count
        }
        sizes = tuple(sorted(found))
        medians = tuple(found[nodes] for nodes in sizes)
        doubling = found[200] / found[100] if {100, 200} <= set(found) else np.nan
        yield Growth(way, stages, sizes, medians, exponent(sizes, medians), doubling)
