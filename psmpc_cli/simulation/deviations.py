"""The largest deviations of a run, as it measured them itself: off its plans, beyond limits, off end conditions."""

from dataclasses import dataclass

import numpy as np

from psmpc_cli.logs.read import Log


@dataclass(frozen=True)
class Largest:
    """The largest value of a quantity.

    Attributes:
        value: Itself [m, rad, m/s, rad/s], or [1] for an end condition.
        where: The coordinate, its velocity, or the stage.
        time: Of the sample after which it was measured [s].
    """

    value: float
    where: str
    time: float


@dataclass(frozen=True)
class Deviations:
    """The largest deviations of a run.

    Attributes:
        off_plan: Of the state at a sample from what the plan before it foresaw, first of a position, then of a
            velocity; none in a log that does not tell.
        beyond_limits: Violations of a position and of a velocity limit at a tick, where there are any.
        end_condition: Error over tolerance at a planned hand-over; None without one.
    """

    off_plan: tuple[Largest, ...]
    beyond_limits: tuple[Largest, ...]
    end_condition: Largest | None


def largest_deviations(log: Log) -> Deviations:
    """Return the largest deviations of a run, from its log."""
    velocities = tuple(f"{name} velocity" for name in log.coordinates)
    off_plan = [
        _largest(log, f"deviation/{name}", names) for name, names in (("Q", log.coordinates), ("Qdot", velocities))
    ]
    beyond = [
        _largest(log, f"margin/{kind}", names, below=True)
        for kind, names in (("position", log.coordinates), ("velocity", velocities))
    ]
    return Deviations(
        off_plan=tuple(largest for largest in off_plan if largest is not None),
        beyond_limits=tuple(largest for largest in beyond if largest is not None and largest.value > 0),
        end_condition=_largest(log, "deviation/end", log.stage_names),
    )


def _largest(log: Log, path: str, names: tuple[str, ...], below: bool = False) -> Largest | None:
    """Return the largest magnitude of a dataset, or how far it goes below 0; None if it tells nothing."""
    values = log.columns.get(path, np.zeros((0, 0)))
    found = np.where(np.isnan(values), -np.inf, -values if below else np.abs(values))
    if not found.size or not np.isfinite(found).any():
        return None
    row, column = np.unravel_index(int(np.argmax(found)), found.shape)
    return Largest(float(found[row, column]), names[int(column)], float(log.time[row]))
