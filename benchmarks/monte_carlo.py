"""Runs the transport task many times with an uncertainty: prints the table of docs/monte_carlo.md, and that on delays.

    python benchmarks/monte_carlo.py [CONTROLLER=RUNS ...]      by controller; by default `RUNS`, some 13 minutes
    python benchmarks/monte_carlo.py delays                     late controls, known and not; docs/uncertainty.md

The results of each row go to a file in runs/. Stopped, it goes on where it was.
"""

import sys
from collections.abc import Iterator, Mapping, Sequence
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

DELAYS = (
    (0, 0, 0.03),
    (1, 0, 0.03),
    (1, 0, 1.0),
    (1, 1, 0.03),
    (2, 1, 0.03),
    (2, 2, 0.03),
    (5, 5, 0.03),
    (10, 10, 0.03),
)
"""Samples of delay, how many of them the controller knows of, and W_r."""

LATE_RUNS = 20
EFFORT = "effort [m^2/s^3, rad^2/s^3]"
LATE_HEADINGS = ("succeeded", "ends [s]", "final error [tolerances]", EFFORT, "failed solves a run", "why runs fail")
HEADINGS = (
    "controller",
    "succeeded",
    "rate, 95 % interval",
    "ends [s]",
    "final error [tolerances]",
    "velocity margin [%]",
    "object held [m]",
    EFFORT,
    "failed solves a run",
)


def measure(name: str, count: int, directory: Path, changes: Sequence[str]) -> MonteCarloRuns:
    """Make the runs of a row that its file lacks, and return all of them."""
    study = monte_carlo_study("transport", count, ("controller.nodes=25", UNCERTAINTY, *changes))
    path = directory / f"{name}.h5"

    def told(progress: Progress) -> None:
        sys.stderr.write(f"{name}: {progress.ended} of {progress.runs} runs, {progress.failed} failed\n")

    return MonteCarloRuns(run_study(study, path, 2, resume=path.exists(), watch=told))


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


def late(directory: Path) -> Iterator[str]:
    """Give the lines of the table on delays."""
    rows = []
    for delay, known, weight in DELAYS:
        weights = (f"skills.{skill}.weights.control={weight}" for skill in ("move", "reach"))
        changes = (f"uncertainty.delay={delay}", f"controller.known_delay={known}", *weights)
        runs = measure(f"delay-{delay}-{known}-{weight:g}", LATE_RUNS, directory, changes)
        cells = (
            f"{int(runs.succeeded.sum())} of {int(runs.made.sum())}",
            spread(runs.end_time, 1),
            spread(runs["final_error"], 2),
            spread(runs["control_effort"], 0),
            f"{np.maximum(runs['solves_failed'], 0).mean():.1f}",
            "; ".join(f"{len(seeds)}: {reason}" for reason, seeds in failures(runs).items()),
        )
        rows.append((delay, known, f"{weight:g}", *cells))
    return markdown(("delay [samples]", "known", "W_r", *LATE_HEADINGS), rows)


def main(directory: Path, words: Sequence[str]) -> Iterator[str]:
    """Measure; give the lines of the table."""
    directory.mkdir(exist_ok=True)
    if words == ["delays"]:
        return late(directory)
    counts = {name: int(count) for name, _, count in (each.partition("=") for each in words)} or RUNS
    return table(
        {
            name: measure(f"monte-carlo-{name}", count, directory, [f"controller.kind={name}"])
            for name, count in counts.items()
        }
    )


if __name__ == "__main__":
    print("\n".join(main(Path("runs"), sys.argv[1:])))
