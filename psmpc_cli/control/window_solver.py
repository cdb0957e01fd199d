"""Solves windows: one compiled NLP and back-end for each shape, kept for all later windows of that shape."""

from dataclasses import dataclass, field

import numpy as np

from psmpc_cli.control.multipliers import Before, shift_multipliers
from psmpc_cli.ocp.costs import StageCosts
from psmpc_cli.ocp.layout import WindowShape
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.ocp.soft_limits import worst_violations
from psmpc_cli.ocp.stages import Stage
from psmpc_cli.ocp.transcription import Nlp, transcribe
from psmpc_cli.ocp.window import Bounds, Window, bounds, pack_guess, parameter_vector, unpack_plan, window_shape
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.solvers import Guess, Solution, Solver, attempt, build_solver
from psmpc_cli.specs.task import TaskSpec


@dataclass(frozen=True, eq=False)
class SolvedWindow:
    """A window, what its solve started from, and what came out.

    Attributes:
        window: The window.
        guess: Where the solve started.
        parameters: The NLP's parameter vector.
        solution: What the back-end returned.
        plan: The solution as a plan.
        basin: Which guess of the instants won, 0 the shifted plan's own; -1 where there was no other. See `multistart`.
        violations: By how much nodes violate soft limits at worst, (2n,) [m, rad, m/s, rad/s]; (0,) if hard.
    """

    window: Window
    guess: Guess
    parameters: np.ndarray
    solution: Solution
    plan: Plan
    basin: int = -1
    violations: np.ndarray = field(default_factory=lambda: np.zeros(0))


class WindowSolver:
    """Compiles and solves the windows of one task and robot."""

    def __init__(self, task: TaskSpec, model: RobotModel, costs: StageCosts) -> None:
        self.task, self.model, self.costs = task, model, costs
        self._compiled: dict[WindowShape, tuple[Nlp, Solver]] = {}
        self._by_stages: dict[tuple[tuple[Stage, ...], tuple[int, ...]], tuple[Nlp, Solver]] = {}

    def shape(self, window: Window) -> WindowShape:
        """Return the shape of a window."""
        controller = self.task.controller
        return window_shape(window.stages, window.nodes, controller.discretization, self.task.limits_are_soft)

    def compiled_for(self, window: Window) -> tuple[Nlp, Solver]:
        """Return the NLP and back-end of a window, compiled on first use."""
        key = window.stages, window.nodes
        if key not in self._by_stages:
            self._by_stages[key] = self.compiled(self.shape(window))
        return self._by_stages[key]

    def compiled(self, shape: WindowShape) -> tuple[Nlp, Solver]:
        """Return the NLP and back-end of a shape, compiled on first use."""
        if shape not in self._compiled:
            nlp = transcribe(self.model, shape)
            self._compiled[shape] = nlp, build_solver(nlp, self.task.solver)
        return self._compiled[shape]

    def solve(
        self,
        window: Window,
        prediction: Plan,
        instants: np.ndarray,
        previous: SolvedWindow | None = None,
        within: float = np.inf,
    ) -> SolvedWindow:
        """Solve a window, started from a predicted plan with the given instants (S,) [s].

        The multipliers of `previous`, shifted in time, start the solve too where its stages are the same. Durations are
        kept within so many seconds of those between the given instants.
        """
        nlp, solver = self.compiled_for(window)
        z = pack_guess(nlp, window, prediction, instants, self.costs)
        guess = shift_multipliers(nlp, z, window, self._before(previous)) if previous else Guess(z)
        parameters = parameter_vector(nlp, window, instants)
        solution = attempt(solver, guess, parameters, _kept_near(bounds(nlp, window), z, nlp, within))
        plan, violations = unpack_plan(nlp, window, solution.z), worst_violations(nlp.layout, solution.z)
        return SolvedWindow(window, guess, parameters, solution, plan, violations=violations)

    def _before(self, previous: SolvedWindow) -> Before:
        nlp, _ = self.compiled_for(previous.window)
        return Before(nlp, previous.window, previous.solution)


def _kept_near(free: Bounds, z: np.ndarray, nlp: Nlp, within: float) -> Bounds:
    """Return the bounds with durations within so many seconds of those of z."""
    lbx, ubx, rows = free.lbx.copy(), free.ubx.copy(), nlp.layout.duration_index[0]
    lbx[rows], ubx[rows] = np.maximum(lbx[rows], z[rows] - within), np.minimum(ubx[rows], z[rows] + within)
    return Bounds(lbx, ubx, free.lbg, free.ubg)
