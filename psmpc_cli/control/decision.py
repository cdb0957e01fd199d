"""What a controller decides at one sample."""

from dataclasses import dataclass

import numpy as np

from psmpc_cli.control.sequence import Sequence
from psmpc_cli.control.window_solver import SolvedWindow
from psmpc_cli.ocp.plan import Plan


@dataclass(frozen=True, eq=False)
class LevelResult:
    """What one level of a lexicographic controller came to.

    Attributes:
        stage: Index of the stage it minimizes.
        objective: Its optimum J_i*, normalized.
        wall_time: Time of the solve alone [s].
        solved: Whether the solve converged; if not, the level before it stands.
        costs: J_i of this and all earlier levels at the level's solution, normalized as there (levels,).
    """

    stage: int
    objective: float
    wall_time: float
    solved: bool
    costs: np.ndarray


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
