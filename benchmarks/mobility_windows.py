"""Holds `solver: sqp` against IPOPT on windows of two stages from random states, for every mobility of the base.

Then for stages of different mobility, one after the other.

    python benchmarks/mobility_windows.py table 20

Half of the windows are of a planar dual arm, half of a small spatial free-flyer. Free-floating robots have a momentum,
free-flying ones a velocity of the base. Windows in which neither solver finds anything from rest are drawn anew. Both
solvers start from rest; then both start from the plan that `sqp` found, or that of IPOPT where `sqp` found none. Limits
of rates are those in the chart about a guess, so only solves of one guess are of the same problem.
"""

import itertools
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

sys.path.append(str(Path(__file__).parents[1]))

from pages import command_line, markdown

from psmpc_cli.ocp.problem import Problem
from psmpc_cli.solvers import Outcome, Solution
from psmpc_cli.specs.parts import MOBILITIES
from tests.ocp.constraints.floating_windows import drawn, fast_arms_in, problem_of, solved

SAME = 1e-5
"""Largest relative difference of two objectives that count as the same."""


@dataclass(frozen=True)
class Compared:
    """One window.

    Attributes:
        name: Which robot and seed.
        sqp, ipopt: From rest.
        again, judge: `sqp` and IPOPT from the plan of the first of these that has one; None where none has.
    """

    name: str
    sqp: Solution
    ipopt: Solution
    again: Solution | None
    judge: Solution | None

    @property
    def difference(self) -> float:
        """Return J of IPOPT over that of `sqp` from the same plan, minus 1; NaN without."""
        if self.again is None or self.judge is None:
            return float("nan")
        return self.judge.objective / self.again.objective - 1

    @property
    def agrees(self) -> bool:
        """Whether `sqp` and IPOPT from the same plan end at the same optimum."""
        if self.again is None or self.judge is None:
            return False
        return self.again.outcome is self.judge.outcome is Outcome.OPTIMAL and abs(self.difference) <= SAME

    @property
    def is_beaten(self) -> bool:
        """Whether IPOPT finds a better optimum from rest than `sqp` does."""
        return self.gain < -SAME

    @property
    def gain(self) -> float:
        """Return J of IPOPT over that of `sqp`, both from rest, minus 1; NaN unless both solve the window."""
        if not (self.sqp.outcome.usable and self.ipopt.outcome.usable):
            return float("nan")
        return self.ipopt.objective / self.sqp.objective - 1


def compared(problem: Problem, name: str, seed: int) -> Compared:
    """Solve the window of a seed from rest, and from the plan that was found."""
    window = drawn(problem, seed)
    sqp = solved(problem, window, "sqp")
    ipopt = solved(problem, window, "ipopt")
    plans = [solution.plan for solution in (sqp, ipopt) if solution.outcome.usable]
    again, judge = (solved(problem, window, kind, plans[0]) if plans else None for kind in ("sqp", "ipopt"))
    return Compared(f"{name} {seed}", sqp, ipopt, again, judge)


MIXED = (
    ("free-flying", "free-floating"),
    ("free-floating", "free-flying"),
    ("attitude", "free-floating"),
    ("free-floating", "attitude"),
    ("free-flying", "attitude"),
)
"""Mobilities of two stages."""


def windows(mobilities: Sequence[str], count: int) -> Iterator[Compared]:
    """Compare windows until either solver has found a plan in half of so many in the plane, then in space."""
    with TemporaryDirectory() as folder:
        robot = fast_arms_in(Path(folder))
        for where, first in (("plane", 0), ("space", count // 2)):
            problem = problem_of(mobilities[0], robot if where == "plane" else None, mobilities[-1])
            solvable = 0
            for seed in itertools.count(first):
                window = compared(problem, where, seed)
                solvable += window.again is not None
                yield window
                if solvable == count // 2:
                    break


def table(count: str = "20") -> Iterator[str]:
    """Yield the counts of each mobility as rows."""
    rows = []
    for mobilities in (*((mobility,) for mobility in MOBILITIES), *MIXED):
        found = list(windows(mobilities, int(count)))
        solvable = [each for each in found if each.again is not None]
        both = [each for each in found if each.sqp.outcome.usable and each.ipopt.outcome.usable]
        rows.append(
            (
                " then ".join(f"`{mobility}`" for mobility in mobilities),
                f"{len(found)}",
                f"{sum(each.sqp.outcome.usable for each in found)}",
                f"{sum(each.ipopt.outcome.usable for each in found)}",
                f"{sum(each.agrees for each in solvable)} of {len(solvable)}",
                f"{sum(each.is_beaten for each in both)} of {len(both)}",
            )
        )
    from_rest = ("`sqp` solves from rest", "IPOPT solves from rest")
    yield from markdown(rows, "mobility", "drawn", *from_rest, "same J from one plan", "IPOPT's J from rest lower")


if __name__ == "__main__":
    command_line(table)
