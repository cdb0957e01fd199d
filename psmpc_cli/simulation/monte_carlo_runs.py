"""The runs of a Monte Carlo study, complete or not: how often they succeed, how they spread, which are the worst."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from psmpc_cli.errors import LogError
from psmpc_cli.logs.results import Results, read_results
from psmpc_cli.logs.schema import MONTE_CARLO

WAITING, ENDED, CRASHED = range(3)
STATUS = ("waiting", "ended", "crashed")
"""Codes of a run's status and what they mean."""

NORMAL = 1.959963984540054
"""The 97.5 % quantile of the standard normal distribution."""

QUANTILES = (0.05, 0.5, 0.95)

DIMENSIONS = {
    "stage": ("stage",),
    "monitor": ("monitor",),
    "switch_time": ("run", "stage"),
    "actual_start": ("run", "stage"),
    "monitor_margin": ("run", "monitor"),
    "wall_time": (),
}
"""What the arrays of a study stand along that are not one value a run."""


def wilson_interval(successes: int, runs: int) -> tuple[float, float]:
    """Return the ends of Wilson's 95 % score interval of a success rate; 0 and 1 without runs. Wilson (1927)."""
    if not runs:
        return 0.0, 1.0
    rate, share = successes / runs, NORMAL**2 / runs
    middle, half = rate + share / 2, np.sqrt(share * (rate * (1 - rate) + share / 4))
    low, high = float(middle - half) / (1 + share), float(middle + half) / (1 + share)
    return low if successes else 0.0, high if successes < runs else 1.0  # where rounding would leave a rest


@dataclass(frozen=True)
class Quantiles:
    """How a quantity spreads over the runs that have it.

    Attributes:
        name: What it is, with its unit.
        runs: How many runs have it.
        at: Its 5, 50 and 95 % quantiles; NaN without runs.
    """

    name: str
    runs: int
    at: tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class MonteCarloRuns:
    """The runs of a study.

    Attributes:
        results: What its file holds.
    """

    results: Results

    def __getitem__(self, name: str) -> np.ndarray:
        return self.results[name]

    @property
    def made(self) -> np.ndarray:
        """Which runs were made, those that crashed among them (runs,)."""
        return np.asarray(self["status"] != WAITING)

    @property
    def succeeded(self) -> np.ndarray:
        """Which runs succeeded (runs,)."""
        return np.asarray(self["succeeded"] == 1)

    @property
    def completed(self) -> np.ndarray:
        """Which runs came to the end of their last stage (runs,)."""
        return np.asarray(self["completed"] == 1)

    @property
    def failed(self) -> np.ndarray:
        """Which runs were made and did not succeed (runs,)."""
        return np.asarray(self.made & ~self.succeeded)

    @property
    def stages(self) -> tuple[str, ...]:
        """Names of the stages."""
        return tuple(map(str, self["stage"]))

    @property
    def monitors(self) -> tuple[str, ...]:
        """Names of the monitors."""
        return tuple(map(str, self["monitor"])) if "monitor" in self.results.quantities else ()

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's 95 % interval of the success rate."""
        return wilson_interval(int(self.succeeded.sum()), int(self.made.sum()))

    @property
    def end_time(self) -> np.ndarray:
        """End of the mission (runs,) [s]; NaN where it was not completed."""
        return np.where(self.completed, self["end_time"], np.nan)

    def quantiles(self) -> Iterator[Quantiles]:
        """Give how every quantity spreads."""
        yield _quantiles("mission ends, completed runs [s]", self.end_time)
        for number, stage in enumerate(self.stages):
            if number:
                yield _quantiles(f"{stage} starts [s]", self["actual_start"][:, number])
            if number < len(self.stages) - 1:
                yield _quantiles(f"{stage} ends [s]", self["switch_time"][:, number])
        yield _quantiles("final error [tolerances]", self["final_error"])
        for kind in ("position", "velocity"):
            yield _quantiles(f"tightest {kind} margin [% of the limit]", 100 * self[f"relative_{kind}_margin"])
        for number, monitor in enumerate(self.monitors):
            yield _quantiles(f"margin of {monitor} [m, m/s]", self["monitor_margin"][:, number])
        yield _quantiles("control effort [m^2/s^3, rad^2/s^3]", self["control_effort"])

    def worst(self, count: int) -> np.ndarray:
        """Return the numbers of the worst runs: those that failed first, then the latest, then the largest error."""
        late, wrong = (np.nan_to_num(self[name], nan=np.inf) for name in ("end_time", "final_error"))
        order = np.lexsort((-wrong, -late, ~self.failed))
        return np.asarray(order[self.made[order]][:count])

    def why(self, number: int) -> str:
        """Return why a run ended, and which monitors did not hold."""
        if failure := str(self["failure"][number]):
            return f"crashed: {failure}"
        margins = self["monitor_margin"][number] if self.monitors else ()
        broken = [name for name, margin in zip(self.monitors, margins, strict=True) if margin < 0]
        return str(self["reason"][number]) + (f"; monitor did not hold: {', '.join(broken)}" if broken else "")

    def command(self, number: int) -> str:
        """Return the command that repeats a run, with its log."""
        return f"{self.results.attributes.get('command', 'psmpc simulate')} --set seed={self['seed'][number]}"


def read_monte_carlo(path: Path) -> MonteCarloRuns:
    """Return the runs of a study, complete or not.

    Raises:
        LogError: The file is missing, damaged, of another version, or no Monte Carlo study.
    """
    results = read_results(path, MONTE_CARLO)
    for name, quantity in results.quantities.items():
        if quantity.dims != (wanted := DIMENSIONS.get(name, ("run",))):
            along = ", ".join(wanted) or "nothing"
            raise LogError(f"{path}: expected {name} along {along}, as psmpc monte-carlo writes it")
    return MonteCarloRuns(results)


def _quantiles(name: str, values: np.ndarray) -> Quantiles:
    known = values[np.isfinite(values)]
    low, middle, high = np.quantile(known, QUANTILES) if len(known) else (np.nan,) * 3
    return Quantiles(name, len(known), (float(low), float(middle), float(high)))
