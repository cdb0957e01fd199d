"""What a controller decides at one sample."""

from dataclasses import dataclass

import numpy as np

from psmpc_cli.control.sequence import Sequence
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.solvers import Solution


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
        levels: The solution of each level, under lexicographic control: of the current stage first, then of those after
            it. Where a level did not converge, its plan is that of the level before.
        unmeasured: The measured state was not finite; where it was not, the plan's own prediction stands in for it.
    """

    plan: Plan
    sequence: Sequence
    solved: Solution
    prediction: Plan
    appended: bool
    postponed: bool
    fallback: bool
    exhausted: bool
    levels: tuple[Solution, ...] = ()
    unmeasured: bool = False

    @property
    def x(self) -> np.ndarray:
        """The state it was made from (2n,)."""
        return self.solved.window.x0
