"""Hierarchical task MPC: at each sample the remaining stages one after another, none at an earlier one's expense.

Paper eq. (32), with J_i <= J_i* for all earlier stages, but for a small part of J_i*. The first level is the window
over the current stage alone; stages advance one by one when their end condition holds. Each later level is a window
over its own stage, which keeps the earlier ones; limits and constraints are those of the current stage. Where the first
level has a planned end, the others have the same mesh, and keep the end condition at that instant.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from psmpc_cli.ocp.plan import Plan
from psmpc_cli.ocp.problem import Problem
from psmpc_cli.ocp.stage import PlacedStage
from psmpc_cli.ocp.window import Kept, Window, normalization
from psmpc_cli.solvers import NlpSolver, Solution
from psmpc_cli.specs.robots.robot import labels

LEAST_COST = 1e-2
"""Least cost of which a level may get worse by a part, so that later levels have an interior where it is zero [1]."""


class Hierarchy(ABC):
    """What is solved at a sample beyond the window that counts."""

    @abstractmethod
    def solve_levels(
        self,
        stages: Sequence[PlacedStage],
        entered: float,
        first: Solution,
        prediction: Plan,
        previous: Sequence[Solution],
        stop_at: float,
    ) -> tuple[Solution, ...]:
        """Refine a solution by further solves, called levels: one for each stage after the current one.

        A level minimizes the cost of its stage over the whole horizon, and may not make the stages of earlier levels
        worse. Each starts from the plan of the level before; a level that fails is the last one. The robot then follows
        the plan of the last level.

        Args:
            stages: The current stage and those after it.
            entered: When the current stage began [s].
            first: The first level: the solution of the window over the current stage.
            prediction: The last plan, shifted to now; costs are normalized by their values along it.
            previous: Solutions of the levels at the sample before, from whose multipliers solves start.
            stop_at: When solves have to stop, an instant of `time.perf_counter` [s].

        Returns:
            The solutions of the levels, `first` included; that of a level that has failed has the plan of the level
            before. Empty for a controller without levels.
        """


class NoLevels(Hierarchy):
    """No levels: windows hold all stages that the controller looks at."""

    def solve_levels(
        self,
        stages: Sequence[PlacedStage],
        entered: float,
        first: Solution,
        prediction: Plan,
        previous: Sequence[Solution],
        stop_at: float,
    ) -> tuple[Solution, ...]:
        """Solve nothing, see `Hierarchy.solve_levels`."""
        return ()


class StrictPriorities(Hierarchy):
    """Strict priorities in the order of the stages: the window holds the current stage, the levels look further."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.spec = problem.spec.controller
        self._solver = NlpSolver(problem, problem.spec.solver.of_levels(), has_duals=True)

    def solve_levels(
        self,
        stages: Sequence[PlacedStage],
        entered: float,
        first: Solution,
        prediction: Plan,
        previous: Sequence[Solution],
        stop_at: float,
    ) -> tuple[Solution, ...]:
        """Solve the levels of HTMPC: one for each stage after the current one, in their order.

        A level minimizes the cost of its stage over the whole horizon, under the constraint that no stage of an earlier
        level gets worse: paper eq. (32). `Hierarchy.solve_levels` explains arguments and result.
        """
        spec = self.spec
        stages = stages[: self.spec.htmpc.depth]
        # a later stage counts as begun at the end of the horizon: its target rests until then, if it moves at all
        begins = np.array([entered, *(prediction.end for _ in stages[1:])])
        _, scale = normalization(
            "nadir", spec.zeta, stages, begins, self.problem.costs, prediction, spec.normalization_step
        )
        solver = self._solver.stopping(stop_at)
        levels = [first]
        preserved = list[Kept]()
        for i, stage in enumerate(stages[1:], start=1):
            preserved.append(self._to_preserve(stages[i - 1], float(scale[i - 1]), levels[-1], begins[i - 1]))
            window = _window_of_level(first.window, stage, scale[i], tuple(preserved))
            # the level of the same stage at the sample before, for its multipliers
            before = next((solution for solution in previous if solution.window.stages[-1].index == stage.index), None)
            solved = solver.solve(window, levels[-1].plan, before, within=0.0)  # 0: switch times stay as they are
            if not solved.outcome.usable:
                levels.append(replace(solved, plan=levels[-1].plan))
                break
            levels.append(solved)
        return tuple(levels)

    def _to_preserve(self, stage: PlacedStage, scale: float, solved: Solution, begins: float) -> Kept:
        """Return the constraint by which later levels do not make the stage of a level worse.

        It bounds either the cost of the stage over the horizon, or each of its errors at each node, as the setting
        `htmpc.constraint` says. The bounds are the values that the level has reached, and a tolerance.

        Args:
            stage: The stage of the level.
            scale: Normalization of its cost.
            solved: The solution of the level.
            begins: When the stage begins [s].
        """
        settings = self.spec.htmpc
        cost = solved.costs_of_stages[-1]
        bound = cost + settings.tolerance * max(cost, LEAST_COST)
        if settings.constraint == "error":
            bound = np.abs(self.problem.costs.errors(stage, solved.plan.X[1:], solved.plan.times[1:] - begins))
            bound += settings.tolerance
            # errors without weight are free, and so are those after the named ones, which are the posture's
            named = len(labels(self.problem.task.robot, stage.space))
            bound[:, (stage.weights == 0) | (np.arange(len(stage.weights)) >= named)] = np.inf
        begun = begins < solved.plan.end
        return Kept(
            stage=stage if begun else _resting_on_first_target(stage),
            scale=scale,
            bound=bound,
            ends=begun and len(solved.plan.switch_times) > 0,
        )


def build_hierarchy(problem: Problem) -> Hierarchy:
    """Return the levels of the controller of a problem, if it has any."""
    return StrictPriorities(problem) if problem.spec.controller.traits.has_levels else NoLevels()


def _resting_on_first_target(stage: PlacedStage) -> PlacedStage:
    """Return a stage that is yet to begin: a moving target rests at the first point of its trajectory."""
    return stage.with_target(stage.reference.points[0])


def _window_of_level(first: Window, stage: PlacedStage, scale: float, kept: tuple[Kept, ...]) -> Window:
    """Return the window of a later level of HTMPC: its own stage, under what the current stage demands.

    Args:
        first: The window of the first level, over the current stage. It has two parts if that stage is planned to end:
            before and after its end. The new window has as many, so that both have the same mesh.
        stage: The stage of the level, whose cost the window has in all of its parts. Limits and constraints are those
            of the current stage, which is the one that the robot is in.
        scale: Normalization of this cost.
        kept: What must not get worse: the stages of all earlier levels.
    """
    current = first.stages[0]
    parts = len(first.stages)
    level_stage = replace(
        _resting_on_first_target(stage),
        limits=current.limits,
        constraints=current.constraints,
        end=stage.end.with_dwell(0.0),
    )
    return replace(
        first,
        stages=(level_stage,) * parts,
        kept=kept,
        ends=False,  # `kept` says what ends
        omega=np.ones(parts),
        offset=np.zeros(parts),
        scale=np.full(parts, scale),
        terminal_cost=0.0,
    )
