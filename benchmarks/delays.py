"""Runs the transport task with late controls, known and not: prints the table of docs/uncertainty.md on delays.

    python benchmarks/delays.py [--runs N] [--jobs N] [-o DIR]          20 runs a row, some 5 minutes on two cores

The results go to files in DIR, by default runs/. Stopped, it goes on where it was.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from monte_carlo import UNCERTAINTY, failures, spread
from pages import markdown

from psmpc_cli.studies.monte_carlo import MonteCarloRuns, monte_carlo_study
from psmpc_cli.studies.runner import run_study

ROWS = ((0, 0, 0.03), (1, 0, 0.03), (1, 0, 1.0), (1, 1, 0.03), (2, 1, 0.03), (2, 2, 0.03), (5, 5, 0.03), (10, 10, 0.03))
"""Samples of delay, how many of them the controller knows of, and W_r."""

HEADINGS = (
    "delay [samples]",
    "known",
    "W_r",
    "succeeded",
    "ends [s]",
    "final error [tolerances]",
    "effort [m^2/s^3, rad^2/s^3]",
    "failed solves a run",
    "why runs fail",
)


def measure(delay: int, known: int, weight: float, count: int, directory: Path, jobs: int) -> MonteCarloRuns:
    """Make the runs of a row that its file lacks, and return all of them."""
    weights = (f"skills.{skill}.weights.control={weight}" for skill in ("move", "reach"))
    late = (f"uncertainty.delay={delay}", f"controller.known_delay={known}")
    study = monte_carlo_study("transport", count, ("controller.nodes=25", UNCERTAINTY, *late, *weights))
    path = directory / f"delay-{delay}-{known}-{weight:g}.h5"
    return MonteCarloRuns(run_study(study, path, jobs, resume=path.exists()))


def row(delay: int, known: int, weight: float, runs: MonteCarloRuns) -> tuple[str, ...]:
    """Return what became of the runs of a row."""
    return (
        str(delay),
        str(known),
        f"{weight:g}",
        f"{int(runs.succeeded.sum())} of {int(runs.made.sum())}",
        spread(runs.end_time, 1),
        spread(runs["final_error"], 2),
        spread(runs["control_effort"], 0),
        f"{np.maximum(runs['solves_failed'], 0).mean():.1f}",
        "; ".join(f"{len(seeds)}: {reason}" for reason, seeds in failures(runs).items()),
    )


def table(count: int, directory: Path, jobs: int) -> Iterator[str]:
    """Give the lines of the table."""
    return markdown(HEADINGS, (row(*each, measure(*each, count, directory, jobs)) for each in ROWS))


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("-o", dest="directory", type=Path, default=Path("runs"))
    given = parser.parse_args()
    print("\n".join(table(given.runs, given.directory, given.jobs)))


if __name__ == "__main__":
    main()
