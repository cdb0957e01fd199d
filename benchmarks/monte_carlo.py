"""Runs the transport task many times with an uncertainty: tables of docs/success_results.md.

    python benchmarks/monte_carlo.py controllers [CONTROLLER=RUNS ...]      by controller, some 13 minutes
    python benchmarks/monte_carlo.py noise                                  by the level of the noise, some 25 minutes
    python benchmarks/monte_carlo.py delays [RUNS]                          late commands: delay found, given, ignored
    python benchmarks/monte_carlo.py limited                                tasks with limits of forces, some 25 minutes

The results of each row go to a file in runs/. Stopped, it goes on where it was.
"""

import sys
from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from pathlib import Path

import numpy as np
from pages import command_line, markdown

from psmpc_cli.studies.monte_carlo import MonteCarloRuns, monte_carlo_study
from psmpc_cli.studies.runner import run_study

RUNS = ("psmpc=200", "smpc=200", "htmpc=50", "hard=50")
"""How many runs of each controller."""

UNCERTAINTY = (
    "uncertainty={mass: 0.1, inertia: 0.1, payload: {mass: 5, inertia: 0.67}, noise: {position: 1e-3, angle: 1e-3}}"
)

NO_PAYLOAD = "uncertainty={mass: 0.1, inertia: 0.1, noise: {position: 1e-3, angle: 1e-3}}"
"""The same where the task has an object of its own, or none."""

LIMITED = {
    "transport_grasp": (100, ("controller.nodes=25",)),
    "catch_drifting": (100, ("controller.nodes=25",)),
    "inspect": (10, ()),
    "tracking": (10, ()),
    "float_and_reach": (10, ()),
    "fly_and_point": (10, ()),
    "float_and_look": (10, ()),
    "catch_tumbling": (10, ()),
    "servicing": (10, ()),
}
"""Runs and changes of each task with limits of forces."""

DELAYS = (
    (0.0, "auto", 0.03),
    (0.1, 0.0, 0.03),
    (0.1, 0.0, 1.0),
    (0.1, 0.0, 4.0),
    (0.1, "auto", 0.03),
    (0.1, 0.1, 0.03),
    (0.1, "auto", 4.0),
    (0.2, "auto", 0.03),
    (0.3, "auto", 0.03),
    (0.5, 0.5, 0.03),
)
"""Delays [s], those that the controller counts with, and W_r."""

EFFORT = "effort [m^2/s^3, rad^2/s^3]"


def measure(
    name: str,
    count: int,
    *changes: str,
    task: str = "transport",
    common: Sequence[str] = ("controller.nodes=25", UNCERTAINTY),
) -> MonteCarloRuns:
    """Make the runs of a row that its file lacks, and return all of them."""
    study = monte_carlo_study(task, count, (*common, *changes))
    path = Path("runs") / f"{name}.h5"
    sys.stderr.write(f"{path}: {count} runs\n")
    return MonteCarloRuns(run_study(study, path, 2, resume=path.exists()))


def columns(runs: MonteCarloRuns) -> dict[str, str]:
    """Return what became of runs by the column of a table."""
    made, succeeded = int(runs.made.sum()), int(runs.succeeded.sum())
    low, high = runs.interval
    return {
        "succeeded": f"{succeeded} of {made}",
        "rate, 95 % interval": f"{100 * succeeded / made:.1f} %, {100 * low:.1f} to {100 * high:.1f} %",
        "ends [s]": spread(runs.end_time, 1),
        "final error [tolerances]": spread(runs["final_error"], 2),
        "velocity margin [%]": spread(100 * runs["relative_velocity_margin"], 0),
        **({"object held [m]": spread(runs["monitor_margin"][:, 0], 3)} if runs.monitors else {}),
        EFFORT: spread(runs["control_effort"], 0),
        "failed solves a run": f"{np.maximum(runs['solves_failed'], 0).mean():.2f}",
    }


def spread(values: np.ndarray, digits: int) -> str:
    """Return the 5, 50 and 95 % quantiles of what is known."""
    known = values[np.isfinite(values)]
    return " / ".join(f"{value:.{digits}f}" for value in np.quantile(known, (0.05, 0.5, 0.95))) if len(known) else "-"


def failures(runs: MonteCarloRuns) -> Mapping[str, list[int]]:
    """Return the seeds of the runs that failed, by the reason."""
    found: dict[str, list[int]] = {}
    for number in map(int, np.flatnonzero(runs.failed)):
        found.setdefault(runs.why(number), []).append(int(runs["seed"][number]))
    return found


def controllers(*counts: str) -> Iterator[str]:
    """Yield the table of the controllers, and why their runs failed."""
    given = (each.split("=") for each in counts or RUNS)
    runs = {name: measure(f"monte-carlo-{name}", int(count), f"controller.kind={name}") for name, count in given}
    yield from markdown({"controller": f"`{name}`", **columns(each)} for name, each in runs.items())
    yield ""
    yield "Spreads are 5 / 50 / 95 % quantiles; those of the end are over completed runs."
    for name, each in runs.items():
        for reason, seeds in failures(each).items():
            named = ", ".join(map(str, seeds[:5])) + (", ..." if len(seeds) > 5 else "")
            yield f"- `{name}`, {len(seeds)} failed: {reason} (seed {named})"


def noise() -> Iterator[str]:
    """Yield the table of PSMPC and hard switching under more and more noise, and why runs failed."""
    rows, why = dict[str, list[dict[str, object]]](), list[str]()
    for (name, keys), level in product(EQUAL_OR_OWN.items(), LEVELS):
        count = 200 if level in (0, 1) else 50
        of_noise = f"uncertainty.noise={{position: {level}e-3, angle: {level}e-3}}"
        runs = measure(f"noise-{name.replace(', ', '-').replace(' ', '-')}-{level:g}", count, *keys, of_noise)
        found = columns(runs)
        largest = np.nanmax(runs["end_error_noise"], axis=1, initial=0.0)
        arrived = int((runs["succeeded"] * (largest <= 1.0)).sum())
        given = {"controller": name, "noise [mm, mrad]": f"{level:g}", "succeeded": found["succeeded"]}
        given |= {"true errors in bounds": arrived, "largest": f"{largest.max():.2f}"}
        row = {**given, **{key: found[key] for key in ("ends [s]", "failed solves a run")}}
        rows.setdefault("equal" if name == EQUAL else "as shipped", []).append(row)
        why += [f"- {name}, {level:g} mm: {len(seeds)} failed: {reason}" for reason, seeds in failures(runs).items()]
    yield from markdown(rows["as shipped"])
    yield from ("", "With equal settings:", "")
    yield from markdown(rows["equal"])
    yield ""
    yield from why


LEVELS = (0, 0.3, 1, 3, 10)
"""Standard deviations of the noise [mm, mrad]."""

EQUAL = "hard, settings of psmpc"

EQUAL_OR_OWN = {
    "psmpc": ("controller.kind=psmpc",),
    "hard, own settings": ("controller.kind=hard",),
    EQUAL: (
        "controller.kind=hard",
        "skills.move.weights.control=4",
        "skills.reach.weights.control=4",
        "stages.approach.ends_when.tolerance=2e-3",
        "stages.capture.ends_when.tolerance=1.1e-3",
        "stages.transport.ends_when.tolerance=2e-3",
        "stages.release.ends_when.tolerance=0.012",
    ),
}
"""Controllers, and with which settings they run."""


def delays(count: str = "20") -> Iterator[str]:
    """Yield the table of late controls."""
    shown = ("succeeded", "ends [s]", "final error [tolerances]", EFFORT, "failed solves a run")

    def row(delay: float, counted: str | float, weight: float) -> dict[str, object]:
        weights = (f"skills.{skill}.weights.control={weight}" for skill in ("move", "reach"))
        changes = (f"uncertainty.delay={delay:g} s", f"controller.delay={counted}", *weights)
        runs = measure(f"delay-{delay:g}-{counted}-{weight:g}", int(count), *changes)
        found, why = columns(runs), (f"{len(seeds)}: {reason}" for reason, seeds in failures(runs).items())
        given = {"delay [s]": f"{delay:g}", "counted with [s]": counted, "W_r": f"{weight:g}"}
        return {**given, **{name: found[name] for name in shown}, "why runs fail": "; ".join(why)}

    return markdown(row(*each) for each in DELAYS)


def limited() -> Iterator[str]:
    """Yield the table of the built-in tasks with limits of forces, and why runs failed."""
    reasons = list[str]()

    def row(task: str, count: int, changes: Sequence[str]) -> dict[str, object]:
        runs = measure(f"limited-{task}", count, *changes, task=task, common=("log.shares=false", NO_PAYLOAD))
        found = columns(runs)
        for reason, seeds in failures(runs).items():
            reasons.append(f"- {task}: {len(seeds)} failed: {reason}")
        used = np.nanquantile(runs["force_utilization"], (0.5, 1.0))
        return {
            "task": task,
            **{name: found[name] for name in ("succeeded", "rate, 95 % interval", "ends [s]", "failed solves a run")},
            "largest force commanded [% of its limit]": f"{100 * used[0]:.1f}, at most {100 * used[1]:.1f}",
            "forces cut [% of the time]": f"{100 * np.nanmean(runs['force_saturated']):.2f}",
        }

    yield from markdown(row(task, *each) for task, each in LIMITED.items())
    yield ""
    yield from reasons


if __name__ == "__main__":
    command_line(controllers, noise, delays, limited)
