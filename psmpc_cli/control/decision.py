"""What a controller decides at one sample."""

from dataclasses import dataclass

import numpy as np

from psmpc_cli.control.sequence import Sequence
from psmpc_cli.control.window_solver import SolvedWindow
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.solvers import Outcome


@dataclass(frozen=True, eq=False)
class LevelResult:
    """What one level of a lexicographic controller came to.

    Attributes:
        stage: Index of the stage it minimizes.
        outcome: How its solve ended; if it did not converge, the level before it stands.
        costs: J_i of all levels up to this one at its solution, normalized (levels,).
        iterations: Iterations used.
        wall_time: Time of the solve alone [s].
        plan: The plan after this level.
    """

    stage: int
    outcome: Outcome
    costs: np.ndarray
    iterations: int
    wall_time: float
    plan: Plan

    @property
    def solved(self) -> bool:
        """Whether the solve converged."""
        return self.outcome.usable

    @property
    def objective(self) -> float:
        """Its optimum J_i*, normalized."""
        return float(self.costs[-1])


@dataclass(frozen=True, eq=False)
class Decision:
    """What the controller decided at one sample.

    Attributes:
        plan: The plan in force.
        sequence: The stages in the window.
        solved: The solve behind the plan, or the failed one.
        prediction: The shifted plan the solve started from.
        appended: A stage entered the window at this sample.
        postponed: The next stage was seen, but the window with it had no solution yet.
        fallback: The solve failed and the shifted plan goes on.
        exhausted: The plan is used up; `plan` brakes to rest.
        levels: What each level came to, under lexicographic control.
        unmeasured: The measured state was not finite; where it was not, the plan's own prediction stands in for it.
    """

    plan: Plan
    sequence: Sequence
    solved: SolvedWindow
    prediction: Plan
    appended: bool
    postponed: bool
    fallback: bool
    exhausted: bool
    levels: tuple[LevelResult, ...] = ()
    unmeasured: bool = False

    @property
    def x(self) -> np.ndarray:
        """The state it was made from (2n,)."""
        return self.solved.window.x0
