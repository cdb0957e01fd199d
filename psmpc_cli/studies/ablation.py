"""What an ablation is, and by what its runs are compared."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from psmpc_cli.logs.read import Log
from psmpc_cli.simulation.summary import Summary, summarize

Curve = tuple[np.ndarray, np.ndarray]
Curves = Mapping[str, Curve]

OURS = "ours"
"""The run of the task as it is."""

END = "T_f"
"""The curve that says how far ahead the horizon ends."""

JUMP = 0.3
"""An optimized instant that moves by more between two samples jumps [s]."""


@dataclass(frozen=True, eq=False)
class Ablation:
    """One departure from the paper, and what becomes of a task without it.

    Attributes:
        name: Of the departure, and of its figure.
        sentence: What was measured.
        panels: Curves (x, y) by panel and label; `psmpc_cli.figures.ablations` says what they are.
        numbers: What was measured, the numbers of the sentence among it.
    """

    name: str
    sentence: str
    panels: Mapping[str, Curves]
    numbers: Mapping[str, float]


def ahead(log: Log) -> Curve:
    """Return how far ahead the optimized instant of the current stage is [s] over time [s]; NaN where there is none."""
    instants, first = log["window/instants"], log["window/first"]
    return log.time, instants[np.arange(len(first)), first] - log.time


def instants(logs: Mapping[str, Log], names: Iterable[str]) -> dict[str, Curve]:
    """Return for runs how far ahead the optimized instant is, and in the same way the end of their common horizon."""
    runs = {name: ahead(logs[name]) for name in names}
    horizons = [float(np.asarray(logs[name].attributes["horizon"])) for name in runs]
    latest = max(float(time[-1]) for time, _ in runs.values())
    return {**runs, END: (np.array([0.0, latest]), np.full(2, max(horizons)))}


def variation(log: Log) -> Curve:
    """Return the total variation of the joints' control up to each sample [rad/s^2] over time [s]."""
    joints = np.array([not name.startswith("base.") for name in log.coordinates], bool)
    steps = np.abs(np.diff(log["control/u"][:, joints], axis=0)).sum(axis=1)
    return log.time, np.r_[0.0, np.cumsum(steps)]


def starts_and_ends(log: Log) -> Curve:
    """Return the actual starts and the ends of the stages [s]."""
    return log.stages["actual_start"], log.stages["switch_time"]


def measured(logs: Mapping[str, Log], names: Iterable[str]) -> dict[str, float]:
    """Return what runs are compared by, one number a quantity and run."""
    return {f"{quantity}, {name}": value for name in names for quantity, value in _measured(logs[name]).items()}


def _measured(log: Log) -> dict[str, float]:
    """Return when a run's stages start and it ends, how its instants behave, and how its control varies."""
    summary, (time, to_go) = summarize(log), ahead(log)
    horizon = float(np.asarray(log.attributes["horizon"]))
    known, same = np.isfinite(to_go), np.diff(log["window/first"]) == 0
    moves = np.abs(np.diff(to_go + time))[same & known[1:] & known[:-1]]
    return {
        "at T_f": float(np.mean(to_go[known] >= horizon - JUMP / 2)) if known.any() else 0.0,
        "jumps": float(np.sum(moves > JUMP)),
        "variation": float(variation(log)[1][-1]),
        "end": end_of(summary),
        **{f"start of {stage.name}": stage.actual_start for stage in summary.stages[1:]},
    }


def end_of(summary: Summary) -> float:
    """Return when the last stage met its end condition [s]; NaN if it never did."""
    return summary.duration if summary.completed else np.nan


def ending(time: float) -> str:
    """Say when a run ends [s], or that it never does."""
    return f"ends after {time:.1f} s" if np.isfinite(time) else "never ends"


def starting(times: Iterable[float]) -> str:
    """Say when stages start [s]."""
    return f"{joined(f'{time:.1f}' if np.isfinite(time) else 'never' for time in times)} s"


def joined(words: Iterable[str]) -> str:
    """Return words as a list in a sentence."""
    *others, last = words
    return f"{', '.join(others)} and {last}" if others else last
