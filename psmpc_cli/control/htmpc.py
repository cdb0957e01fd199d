"""Hierarchical task MPC: at each sample the remaining stages one after another, none at an earlier one's expense.

Paper eq. (32), with J_i <= J_i* for all earlier stages. The first level is the window over the current stage alone;
stages advance one by one when their end condition holds. Where limits are soft, the first level says how far they give
way, and the later ones keep to that.
"""

from dataclasses import replace

import numpy as np

from psmpc_cli.control.sequence import MovingSequence
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.ocp.problem import Problem, Stage
from psmpc_cli.ocp.window import normalization
from psmpc_cli.solvers import Level, LevelSolver, Solution


class Hierarchy:
    """Strict priorities in the order of the stages: the window holds the current stage, the levels look further."""

    def __init__(self, problem: Problem) -> None:
        self.problem, self.spec = problem, problem.spec.controller
        self._solver = LevelSolver(problem, problem.spec.solver)

    def descend(self, sequence: MovingSequence, first: Solution, prediction: Plan) -> tuple[Solution, ...]:
        """Solve level after level, each from the plan of the one before; a level that fails ends the descent.

        Args:
            sequence: The current stage, and when it began.
            first: The first level: the solution of the window over the current stage.
            prediction: The shifted plan; it normalizes the costs.
        """
        levels, depth = [first], self.spec.htmpc.depth
        stages = self.problem.stages[sequence.first :][:depth]
        begins = np.array(
            [sequence.entered, *(prediction.end for _ in stages[1:])]
        )  # trajectories of later stages wait
        bounds = [self._bound(stages[0], first, begins[0])]
        for count in range(2, len(stages) + 1):
            level = self._level(first, stages[:count], tuple(bounds), begins[:count], prediction)
            solved = self._solver.solve(level, levels[-1].plan)
            if not solved.outcome.usable:
                levels.append(replace(solved, plan=levels[-1].plan))
                break
            levels.append(solved)
            bounds.append(self._bound(stages[count - 1], solved, prediction.end))
        return tuple(levels)

    def _level(
        self,
        first: Solution,
        stages: tuple[Stage, ...],
        bounds: tuple[np.ndarray, ...],
        begins: np.ndarray,
        prediction: Plan,
    ) -> Level:
        spec, costs = self.spec, self.problem.costs
        _, scale = normalization("nadir", spec.zeta, stages, begins, costs, prediction, spec.sample_time)
        return Level(
            window=first.window,
            stages=stages,
            scale=scale,
            constraint=spec.htmpc.constraint,
            bounds=bounds,
            tolerance=spec.htmpc.tolerance,
            reached=first.plan.X[1:] if first.window.soft else None,
        )

    def _bound(self, stage: Stage, solved: Solution, begins: float) -> np.ndarray:
        """Return what later levels must keep of a level's stage: its cost, or its errors at the nodes.

        The stage begins at `begins` [s], at the end of the horizon if it is yet to begin.
        """
        if self.spec.htmpc.constraint == "cost":
            return solved.costs[-1:]
        return self.problem.costs.errors(stage, solved.plan.X[1:], solved.plan.times[1:] - begins)
