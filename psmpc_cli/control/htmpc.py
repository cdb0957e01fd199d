"""Hierarchical task MPC: at each sample the remaining stages one after another, none at an earlier one's expense.

Paper eq. (32), with J_i <= J_i* for all earlier stages. The first level is the window over the current stage alone;
stages advance one by one when their end condition holds. Where limits are soft, the first level says how far they give
way, and the later ones keep to that.
"""

from dataclasses import replace

import numpy as np

from psmpc_cli.control.controller import SwitchingController
from psmpc_cli.control.decision import Decision, LevelResult
from psmpc_cli.control.window_solver import SolvedWindow, WindowSolver
from psmpc_cli.ocp.lexicographic import (
    Level,
    LevelNlp,
    LevelShape,
    level_bounds,
    level_guess,
    level_parameters,
    level_plan,
    transcribe_level,
)
from psmpc_cli.ocp.normalization import normalization
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.ocp.stage_integrals import stage_integrals
from psmpc_cli.ocp.stages import Stage
from psmpc_cli.solvers import Guess, Solver, attempt, build_solver
from psmpc_cli.specs.task import ControllerSpec, HtmpcSpec


class HierarchicalController(SwitchingController):
    """Strict priorities in the order of the sequence; the window holds the current stage, the levels look further."""

    def __init__(
        self, spec: ControllerSpec, htmpc: HtmpcSpec, stages: tuple[Stage, ...], windows: WindowSolver
    ) -> None:
        super().__init__(spec, stages, windows)
        self.htmpc = htmpc
        self._compiled: dict[LevelShape, tuple[LevelNlp, Solver]] = {}

    def decide(self, now: float, x: np.ndarray) -> Decision:
        """Return the decision at time now [s] from the measured state x (2n,)."""
        first = super().decide(now, x)
        if first.fallback:
            return first
        levels = self._descend(first, x)
        self._plan = levels[-1].plan
        return replace(first, plan=levels[-1].plan, levels=tuple(levels))

    def _descend(self, first: Decision, x: np.ndarray) -> list[LevelResult]:
        """Solve level after level, each from the plan of the one before; a level that fails ends the descent."""
        levels = [self._first_level(first.solved)]
        remaining = self.stages[first.sequence.first :]
        depth = len(remaining) if self.htmpc.depth is None else min(self.htmpc.depth, len(remaining))
        bounds = [self._bound(remaining[0], levels[0], first.sequence.entered)]
        for count in range(2, depth + 1):
            level = self._level(first, remaining[:count], tuple(bounds), x)
            levels.append(self._solve_level(level, levels[-1].plan))
            if not levels[-1].solved:
                break
            bounds.append(self._bound(remaining[count - 1], levels[-1], first.prediction.end))
        return levels

    def _first_level(self, solved: SolvedWindow) -> LevelResult:
        """Return the window over the current stage as a level; its cost without the terminal one."""
        window, solution = solved.window, solved.solution
        nlp, _ = self.windows.compiled_for(window)
        cost = stage_integrals(nlp, self.costs, solution.z, solved.parameters)
        return LevelResult(
            window.stages[0].index, solution.outcome, cost, solution.iterations, solution.wall_time, solved.plan
        )

    def _normalization(
        self, stages: tuple[Stage, ...], begins: np.ndarray, prediction: Plan
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return offset and scale by the nadir, whatever the task says: strict priorities do not depend on the scale.

        The printed range is 0 for a robot at rest, which leaves a cost divided by zeta alone and no solver an answer.
        """
        spec = self.spec
        return normalization("nadir", spec.zeta, stages, begins, self.costs, prediction, spec.sample_time)

    def _level(
        self, first: Decision, stages: tuple[Stage, ...], bounds: tuple[np.ndarray, ...], x: np.ndarray
    ) -> Level:
        prediction, spec = first.prediction, self.spec
        begins = np.full(len(stages), prediction.end)  # a later stage's trajectory has not begun
        begins[0] = first.sequence.entered
        _, scale = self._normalization(stages, begins, prediction)
        return Level(
            stages=stages,
            x0=x,
            start=prediction.start,
            horizon=spec.horizon,
            elapsed=prediction.start - first.sequence.entered,
            scale=scale,
            bounds=bounds,
            tolerance=self.htmpc.tolerance,
            reached=first.solved.plan.X[1:] if self.windows.task.limits_are_soft else None,
        )

    def _solve_level(self, level: Level, plan: Plan) -> LevelResult:
        nlp, solver = self._compile(tuple(stage.space for stage in level.stages))
        parameters = level_parameters(nlp, level)
        solution = attempt(solver, Guess(level_guess(nlp, level, plan)), parameters, level_bounds(nlp, level))
        return LevelResult(
            stage=level.stages[-1].index,
            outcome=solution.outcome,
            costs=np.asarray(nlp.costs(solution.z, parameters)).ravel(),
            iterations=solution.iterations,
            wall_time=solution.wall_time,
            plan=level_plan(nlp, level, solution.z) if solution.outcome.usable else plan,
        )

    def _bound(self, stage: Stage, result: LevelResult, begins: float) -> np.ndarray:
        """Return what later levels must keep of a level's stage: its cost, or its errors at the nodes.

        The stage begins at `begins` [s], at the end of the horizon if it is yet to begin.
        """
        if self.htmpc.constraint == "cost":
            return np.array([result.objective])
        return self.costs.errors(stage, result.plan.X[1:], result.plan.times[1:] - begins)

    def _compile(self, spaces: tuple[str, ...]) -> tuple[LevelNlp, Solver]:
        shape = LevelShape(spaces, self.htmpc.constraint, self.spec.uniform_nodes, self.spec.discretization)
        if shape not in self._compiled:
            nlp = transcribe_level(self.windows.model, shape)
            self._compiled[shape] = nlp, build_solver(nlp, self.windows.task.solver)
        return self._compiled[shape]
