"""What a sample of a run costs besides its solve: medians of a run of the transport task, with and without shares.

python benchmarks/overhead.py [--nodes 25]

The rest is all that is neither the solve behind the command, nor a counterfactual solve, nor the plant, nor the log. It
should be at most 0.4 of the median solve, and a sample without shares at most 1.8 times its solve. Run it alone, on an
idle machine.
"""

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any

import numpy as np

from psmpc_cli import load_task
from psmpc_cli.logs.write import LogWriter
from psmpc_cli.simulation.loop import closed_loop
from psmpc_cli.simulation.run import header
from psmpc_cli.simulation.setup import build_experiment

PARTS = ("solve", "counterfactual solves", "plant", "log", "rest", "whole sample")

REST, WHOLE = 0.4, 1.8
"""How large the rest and a sample without shares may be, in median solves."""


@dataclass
class Clock:
    """Adds up the time that calls take [s]."""

    spent: float = 0.0

    def timing(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """Return a function whose calls are timed."""

        @wraps(function)
        def timed(*arguments: Any) -> Any:
            began = perf_counter()
            try:
                return function(*arguments)
            finally:
                self.spent += perf_counter() - began

        return timed

    def read(self) -> float:
        """Return the time since the last reading, and begin anew."""
        spent, self.spent = self.spent, 0.0
        return spent


def measure(nodes: int, shares: bool, log: Path) -> np.ndarray:
    """Return what the parts of each sample of a run took (K, parts) [s]."""
    experiment = build_experiment(load_task("transport", {"controller.nodes": nodes, "log.shares": shares}))
    plant, counterfactuals, found = Clock(), Clock(), []
    for clock, part, names in (
        (plant, experiment.plant, ["advance"]),
        (counterfactuals, experiment.counterfactuals, ["presence", "shares"]),
    ):
        for name in names:
            setattr(part, name, clock.timing(getattr(part, name)))
    with LogWriter(log, header(experiment)) as writer:
        began = perf_counter()
        for sample in closed_loop(experiment):
            decided = perf_counter()
            writer.append(sample)
            ended = perf_counter()
            parts = [sample.command.solve_time, counterfactuals.read(), plant.read(), ended - decided]
            found.append([*parts, ended - began - sum(parts), ended - began])
            began = perf_counter()
    return np.array(found)


def least(nodes: int, shares: bool, repeats: int = 3) -> np.ndarray:
    """Return the least of several runs, which are equal sample by sample, (K, parts) [s]."""
    with TemporaryDirectory() as folder:
        return np.min([measure(nodes, shares, Path(folder) / f"{k}.h5") for k in range(repeats)], axis=0)


def main() -> int:
    """Print the table; return 1 if a limit is exceeded."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else None)
    parser.add_argument("--nodes", type=int, default=25)
    nodes = parser.parse_args().nodes
    runs = {shares: least(nodes, shares) for shares in (False, True)}
    medians = {shares: np.median(parts, axis=0) for shares, parts in runs.items()}
    print(f"{'median of a sample [ms]':24}{'without shares':>16}{'with shares':>14}")
    for part, name in enumerate(PARTS):
        print(f"{name:24}{1e3 * medians[False][part]:16.2f}{1e3 * medians[True][part]:14.2f}")
    rest, whole = medians[False][4] / medians[False][0], np.median(runs[False][:, 5] / runs[False][:, 0])
    print(f"without shares, over the solve: rest {rest:.2f} (limit {REST}), whole sample {whole:.2f} (limit {WHOLE})")
    return int(rest > REST or whole > WHOLE)


if __name__ == "__main__":
    raise SystemExit(main())
