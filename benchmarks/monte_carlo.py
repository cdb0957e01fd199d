"""Runs the transport task many times with an uncertainty, by controller: prints the table of docs/monte_carlo.md.

    python benchmarks/monte_carlo.py [CONTROLLER=RUNS ...] [--jobs N] [-o DIR]
    python benchmarks/monte_carlo.py psmpc=200 smpc=200 htmpc=50 hard=50        the default, some 13 minutes

The results of each controller go to a file in DIR, by default runs/. Stopped, it goes on where it was.
"""

import argparse
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from pages import markdown

from psmpc_cli.studies.monte_carlo import MonteCarloRuns, monte_carlo_study
from psmpc_cli.studies.runner import Progress, run_study

RUNS = {"psmpc": 200, "smpc": 200, "htmpc": 50, "hard": 50}
"""How many runs of each controller."""

UNCERTAINTY = (
    "uncertainty={mass: 0.1, inertia: 0.1, payload: {mass: 5, inertia: 0.67}, noise: {position: 1e-3, angle: 1e-3}}"
)

HEADINGS = (
    "controller",
    "succeeded",
    "rate, 95 % interval",
    "ends [s]",
    "final error [tolerances]",
    "velocity margin [%]",
    "object held [m]",
    "effort [m^2/s^3, rad^2/s^3]",
    "failed solves a run",
    "a run takes [s]",
)


def measure(controller: str, count: int, directory: Path, jobs: int) -> MonteCarloRuns:
    """Make the runs of a controller that its file lacks, and return all of them."""
    changes = ("controller.nodes=25", f"controller.kind={controller}", UNCERTAINTY)
    study, path = monte_carlo_study("transport", count, changes), directory / f"monte-carlo-{controller}.h5"

    def told(progress: Progress) -> None:
        sys.stderr.write(f"{controller}: {progress.ended} of {progress.runs} runs, {progress.failed} failed\n")

    return MonteCarloRuns(run_study(study, path, jobs, resume=path.exists(), watch=told))


def row(controller: str, runs: MonteCarloRuns) -> tuple[str, ...]:
    """Return what became of the runs of a controller."""
    made, succeeded = int(runs.made.sum()), int(runs.succeeded.sum())
    low, high = runs.interval
    return (
        f"`{controller}`",
        f"{succeeded} of {made}",
        f"{100 * succeeded / made:.1f} %, {100 * low:.1f} to {100 * high:.1f} %",
        spread(runs.end_time, 1),
        spread(runs["final_error"], 2),
        spread(100 * runs["relative_velocity_margin"], 0),
        spread(runs["monitor_margin"][:, 0], 3),
        spread(runs["control_effort"], 0),
        f"{np.maximum(runs['solves_failed'], 0).mean():.2f}",
        spread(runs["cell_time"], 1),
    )


def spread(values: np.ndarray, digits: int) -> str:
    """Return the 5, 50 and 95 % quantiles of what is known."""
    known = values[np.isfinite(values)]
    if not len(known):
        return "-"
    return " / ".join(f"{value:.{digits}f}" for value in np.quantile(known, (0.05, 0.5, 0.95)))


def table(rows: Mapping[str, MonteCarloRuns]) -> Iterator[str]:
    """Give the lines of the table, and of why runs failed."""
    yield from markdown(HEADINGS, (row(controller, runs) for controller, runs in rows.items()))
    yield ""
    yield "Spreads are 5 / 50 / 95 % quantiles; those of the end are over completed runs."
    for controller, runs in rows.items():
        for reason, seeds in failures(runs).items():
            named = ", ".join(map(str, seeds[:5])) + (", ..." if len(seeds) > 5 else "")
            yield f"- `{controller}`, {len(seeds)} failed: {reason} (seed {named})"


def failures(runs: MonteCarloRuns) -> Mapping[str, list[int]]:
    """Return the seeds of the runs that failed, by the reason."""
    found: dict[str, list[int]] = {}
    for number in np.flatnonzero(runs.failed):
        found.setdefault(runs.why(int(number)), []).append(int(runs["seed"][number]))
    return found


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("counts", nargs="*", metavar="CONTROLLER=RUNS")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("-o", dest="directory", type=Path, default=Path("runs"))
    given = parser.parse_args()
    counts = {name: int(count) for name, _, count in (each.partition("=") for each in given.counts)} or RUNS
    measured = {name: measure(name, count, given.directory, given.jobs) for name, count in counts.items()}
    print("\n".join(table(measured)))


if __name__ == "__main__":
    main()
