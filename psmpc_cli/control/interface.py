"""What goes into a controller at a sample and what comes out of it: the measured state, and the command."""

from dataclasses import dataclass, field

import numpy as np

from psmpc_cli.control.sequence import MovingSequence, Switch
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.ocp.problem import Stage
from psmpc_cli.robot.closed_chain import ClosedChain
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.solvers import Outcome, Solution


@dataclass(frozen=True, eq=False)
class State:
    """State of the robot: Q (nq,) [m, rad] and its velocity v (n,) [m/s, rad/s], as `RobotModel` has them."""

    Q: np.ndarray
    v: np.ndarray

    @classmethod
    def of(cls, x: np.ndarray) -> "State":
        """Build the state from [Q; v] (nq + n,)."""
        n = len(x) // 2
        return cls(x[: len(x) - n], x[len(x) - n :])

    @property
    def x(self) -> np.ndarray:
        """Both as one vector [Q; v] (nq + n,)."""
        return np.concatenate([self.Q, self.v])


@dataclass(frozen=True, eq=False)
class Command:
    """What the controller decided at one sample.

    Attributes:
        time: When it begins to act [s].
        x: State [Q; v] (nq + n,) it was decided from: the measured one, or the one foreseen over a known delay.
        u: Accelerations over the low-level ticks of the coming sample (M, n) [m/s^2, rad/s^2].
        tick: Length of a tick [s].
        plan: The plan in force.
        sequence: The stages in the window.
        prediction: The shifted plan that the solve started from.
        solution: The solve behind the plan, or the failed one.
        events: Names of what happened: `appended` (a stage entered the window), `postponed` (the next stage was seen,
            but the window with it has no solution yet), `solve_failed` (the shifted plan goes on), `braking` (the plan
            is used up, and `plan` brakes to rest), `unmeasured` (the state was not finite, the plan's was used for it).
        switches: Stages that ended since the sample before.
        disturbance: Estimated acceleration that no plan knows of (n,); zero without offset-free control.
        levels: The solution of each level of HTMPC, of the current stage first. Where a level did not converge, its
            plan is that of the level before.
        model: The robot.
        closed: Whether the grippers are to be closed on the object at each tick (M,).
        load: The law of a robot that knows what it holds, for a task whose grasps are `known`.
    """

    time: float
    x: np.ndarray
    u: np.ndarray
    tick: float
    plan: Plan
    sequence: MovingSequence
    prediction: Plan
    solution: Solution
    events: frozenset[str]
    switches: tuple[Switch, ...]
    disturbance: np.ndarray
    levels: tuple[Solution, ...]
    model: RobotModel = field(repr=False)
    closed: np.ndarray
    load: ClosedChain | None = field(default=None, repr=False)

    @property
    def instants(self) -> np.ndarray:
        """Planned switch times [s], absolute; one fewer than stages in the window."""
        return self.sequence.instants

    @property
    def stage(self) -> Stage:
        """The current stage, with its `name` and `index`."""
        return self.solution.window.stages[0]

    @property
    def outcome(self) -> Outcome:
        """How the solve ended; under HTMPC that of the last level, which alone may have failed."""
        return (self.levels or (self.solution,))[-1].outcome

    @property
    def iterations(self) -> int:
        """Iterations of all solves."""
        return sum(each.iterations for each in self.levels or (self.solution,))

    @property
    def solve_time(self) -> float:
        """Wall time of all solves [s]."""
        return sum(each.wall_time for each in self.levels or (self.solution,))

    def force(self, time: float, state: State) -> np.ndarray:
        """Compute the generalized force (n,) [N, N m] that a low-level controller applies over a tick: computed torque.

        While grippers are to be closed on an object of `known` grasps it counts as held by all of them.

        Args:
            time: Beginning of the tick, in the coming sample [s].
            state: Measured then.
        """
        tick = int(np.clip(np.floor((time - self.time) / self.tick + 1e-6), 0, len(self.u) - 1))
        law = self.load.force if self.load is not None and self.closed[tick] else self.model.inverse_dynamics
        return law(state.Q, state.v, self.u[tick])
