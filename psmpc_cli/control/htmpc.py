"""Hierarchical task MPC: at each sample the remaining stages one after another, none at an earlier one's expense.

Paper eq. (32), with J_i <= J_i* for all earlier stages. The first level is the window over the current stage alone;
stages advance one by one when their end condition holds. Where limits are soft, the first level says how far they give
way, and the later ones keep to that.
"""

from dataclasses import replace

import numpy as np

from psmpc_cli.control.controller import SwitchingController
from psmpc_cli.control.decision import Decision
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.ocp.problem import Problem, Stage
from psmpc_cli.ocp.window import normalization
from psmpc_cli.solvers import Level, LevelSolver, Solution, Solver


class HierarchicalController(SwitchingController):
    """Strict priorities in the order of the sequence; the window holds the current stage, the levels look further."""

    def __init__(self, problem: Problem, solver: Solver, levels: LevelSolver) -> None:
        super().__init__(problem, solver)
        self.htmpc, self._levels = problem.spec.controller.htmpc, levels

    def decide(self, now: float, x: np.ndarray) -> Decision:
        """Return the decision at time now [s] from the measured state x (2n,)."""
        first = super().decide(now, x)
        if first.solve_failed:
            return first
        levels = self._descend(first)
        self._plan = levels[-1].plan
        return replace(first, plan=levels[-1].plan, levels=tuple(levels))

    def _descend(self, first: Decision) -> list[Solution]:
        """Solve level after level, each from the plan of the one before; a level that fails ends the descent."""
        levels = [first.solved]
        remaining = self.stages[first.sequence.first :]
        depth = len(remaining) if self.htmpc.depth is None else min(self.htmpc.depth, len(remaining))
        bounds = [self._bound(remaining[0], levels[0], first.sequence.entered)]
        for count in range(2, depth + 1):
            solved = self._levels.solve(self._level(first, remaining[:count], tuple(bounds)), levels[-1].plan)
            if not solved.outcome.usable:
                levels.append(replace(solved, plan=levels[-1].plan))
                break
            levels.append(solved)
            bounds.append(self._bound(remaining[count - 1], solved, first.prediction.end))
        return levels

    def _normalization(
        self, stages: tuple[Stage, ...], begins: np.ndarray, prediction: Plan
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return offset and scale by the nadir, whatever the task says: strict priorities do not depend on the scale.

        The printed range is 0 for a robot at rest, which leaves a cost divided by zeta alone and no solver an answer.
        """
        spec = self.spec
        return normalization("nadir", spec.zeta, stages, begins, self.costs, prediction, spec.sample_time)

    def _level(self, first: Decision, stages: tuple[Stage, ...], bounds: tuple[np.ndarray, ...]) -> Level:
        begins = np.full(len(stages), first.prediction.end)  # a later stage's trajectory has not begun
        begins[0] = first.sequence.entered
        _, scale = self._normalization(stages, begins, first.prediction)
        return Level(
            window=first.solved.window,
            stages=stages,
            scale=scale,
            constraint=self.htmpc.constraint,
            bounds=bounds,
            tolerance=self.htmpc.tolerance,
            reached=first.solved.plan.X[1:] if first.solved.window.soft else None,
        )

    def _bound(self, stage: Stage, solved: Solution, begins: float) -> np.ndarray:
        """Return what later levels must keep of a level's stage: its cost, or its errors at the nodes.

        The stage begins at `begins` [s], at the end of the horizon if it is yet to begin.
        """
        if self.htmpc.constraint == "cost":
            return solved.costs[-1:]
        return self.costs.errors(stage, solved.plan.X[1:], solved.plan.times[1:] - begins)
