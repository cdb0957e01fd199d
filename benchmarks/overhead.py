"""What a sample of a run costs besides its solve: medians of a run of the transport task, with and without shares.

python benchmarks/overhead.py [nodes]

The rest is all but the solve behind the command, counterfactual solves, plant and log. It should be at most 0.4 of the
solve, and a sample without shares at most 1.8 solves. Times are the least of three runs, which are equal sample by
sample. Run it alone, on an idle machine.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any

import numpy as np
from pages import markdown

from psmpc_cli import load_task
from psmpc_cli.logs.write import LogWriter
from psmpc_cli.simulation.run import build_experiment, closed_loop, header

PARTS = ("solve", "counterfactual solves", "plant", "log", "rest", "whole sample")


@dataclass
class Clock:
    """Adds up the time that calls take [s]."""

    spent: float = 0.0

    def timing(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """Return a function whose calls are timed."""

        def timed(*arguments: Any) -> Any:
            began = perf_counter()
            result = function(*arguments)
            self.spent += perf_counter() - began
            return result

        return timed

    def read(self) -> float:
        """Return the time since the last reading, and begin anew."""
        spent, self.spent = self.spent, 0.0
        return spent


def measure(nodes: int, shares: bool, log: Path) -> np.ndarray:
    """Return what the parts of each sample of a run took (K, parts) [s]."""
    experiment = build_experiment(load_task("transport", {"controller.nodes": nodes, "log.shares": shares}))
    plant, counterfactual, found = Clock(), Clock(), []
    for clock, of, names in (
        (plant, experiment.plant, ["advance"]),
        (counterfactual, experiment.counterfactuals, ["presence", "shares"]),
    ):
        for name in names:
            setattr(of, name, clock.timing(getattr(of, name)))
    with LogWriter(log, header(experiment)) as writer:
        began = perf_counter()
        for sample in closed_loop(experiment):
            decided = perf_counter()
            writer.append(sample)
            ended = perf_counter()
            parts = [sample.command.solve_time, counterfactual.read(), plant.read(), ended - decided]
            found.append([*parts, ended - began - sum(parts), ended - began])
            began = perf_counter()
    return np.array(found)


def main() -> None:
    """Print the table."""
    nodes, runs = int([*sys.argv, "25"][1]), {}
    with TemporaryDirectory() as folder:
        for shares in (False, True):
            repeats = [measure(nodes, shares, Path(folder) / f"{shares}-{k}.h5") for k in range(3)]
            runs[shares] = np.min(repeats, axis=0)
    columns = [1e3 * np.median(runs[shares], axis=0) for shares in (False, True)]
    rows = [(name, *(f"{times[i]:.2f}" for times in columns)) for i, name in enumerate(PARTS)]
    solve, rest, whole = (columns[0][PARTS.index(name)] for name in ("solve", "rest", "whole sample"))
    rows.append(("rest over solve, at most 0.4", f"{rest / solve:.2f}", ""))
    rows.append(("whole sample over solve, at most 1.8", f"{whole / solve:.2f}", ""))
    print("\n".join(markdown((f"median of a sample, N_s = {nodes} [ms]", "without shares", "with shares"), rows)))


if __name__ == "__main__":
    main()
