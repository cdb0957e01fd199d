"""What a controller decides at one sample."""

from dataclasses import dataclass, fields

import numpy as np

from psmpc_cli.control.sequence import Sequence, Switch
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.ocp.problem import Stage
from psmpc_cli.solvers import Outcome, Solution


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
        solve_failed: The solve failed and the shifted plan goes on.
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
    solve_failed: bool
    exhausted: bool
    levels: tuple[Solution, ...] = ()
    unmeasured: bool = False

    @property
    def x(self) -> np.ndarray:
        """The state it was made from (2n,)."""
        return self.solved.window.x0

    @property
    def events(self) -> frozenset[str]:
        """What happened at the sample."""
        happened = {
            "appended": self.appended,
            "postponed": self.postponed,
            "solve_failed": self.solve_failed,
            "braking": self.exhausted,
            "unmeasured": self.unmeasured,
        }
        return frozenset(name for name, yes in happened.items() if yes)


@dataclass(frozen=True, eq=False, kw_only=True)
class Command(Decision):
    """What the controller commands at one sample.

    Attributes:
        time: Of the sample [s].
        u: Accelerations commanded over its ticks (M, n) [m/s^2, rad/s^2].
        switches: Stages that ended since the sample before.
        disturbance: Estimated acceleration that no plan knows of (n,), zero without offset-free control.
    """

    time: float
    u: np.ndarray
    switches: tuple[Switch, ...]
    disturbance: np.ndarray

    @classmethod
    def of(cls, decision: Decision, u: np.ndarray, switches: tuple[Switch, ...], disturbance: np.ndarray) -> "Command":
        """Return the command of a decision."""
        decided = {field.name: getattr(decision, field.name) for field in fields(Decision)}
        return cls(time=decision.prediction.start, u=u, switches=switches, disturbance=disturbance, **decided)

    @property
    def instants(self) -> np.ndarray:
        """Planned switch times [s], absolute; one fewer than stages in the window."""
        return self.sequence.instants

    @property
    def stage(self) -> Stage:
        """The current stage."""
        return self.solved.window.stages[0]

    @property
    def outcome(self) -> Outcome:
        """How the solve ended; under lexicographic control that of the last level, which alone may have failed."""
        return self.levels[-1].outcome if self.levels else self.solved.outcome

    @property
    def iterations(self) -> int:
        """Iterations of all solves."""
        return sum(level.iterations for level in self.levels) if self.levels else self.solved.iterations

    @property
    def solve_time(self) -> float:
        """Wall time of all solves [s]."""
        return sum(level.wall_time for level in self.levels) if self.levels else self.solved.wall_time

    @property
    def objective(self) -> float:
        """J in the task's own priorities, of the first level under lexicographic control."""
        return self.solved.J

    @property
    def warm(self) -> bool:
        """Whether the solve started from the last solution, shifted."""
        return self.solved.warm

    @property
    def nodes(self) -> np.ndarray:
        """Intervals of each stage in the window (count,)."""
        return np.array(self.solved.window.nodes[: self.sequence.count], float)

    @property
    def nadir(self) -> np.ndarray:
        """Divisor of each window stage's cost (count,)."""
        return self.solved.window.scale[: self.sequence.count]

    @property
    def costs(self) -> np.ndarray:
        """Normalized cost integral of each stage in the window (count,); (0,) after a failed solve."""
        return np.zeros(0) if self.solve_failed else self.solved.costs
