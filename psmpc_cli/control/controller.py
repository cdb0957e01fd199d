"""The switching controllers. PSMPC, SMPC and hard switching are one piece of code with two switches."""

from dataclasses import replace

import numpy as np

from psmpc_cli.control.decision import Decision
from psmpc_cli.control.multistart import solve_from_several
from psmpc_cli.control.sequence import Sequence, Switch, detect, drop_met, drop_passed
from psmpc_cli.errors import RunError
from psmpc_cli.ocp.plan import Plan, braking_plan, resting_plan, shift
from psmpc_cli.ocp.problem import Problem, Stage
from psmpc_cli.ocp.window import SHORTEST, Along, Window, first_counts, node_counts, normalization, own_violations
from psmpc_cli.solvers import FEASIBLE, Outcome, Solution, Solver
from psmpc_cli.specs.task import ControllerSpec

ONE_STAGE = ("hard", "htmpc")
"""Controllers whose window holds the current stage alone."""

BRAKING_TIME = 0.5
"""Time within which a robot without a plan comes to rest [s], longer where acceleration limits ask for it."""


class SwitchingController:
    """Priority-based switching MPC and what it is compared with. Paper Algorithm 1."""

    def __init__(self, problem: Problem, solver: Solver) -> None:
        self.problem, self.solver = problem, solver
        self.spec, self.stages, self.costs = problem.spec.controller, problem.stages, problem.costs
        self._sequence = Sequence(0, np.zeros(0), 0.0)
        self._plan: Plan | None = None
        self._braking: Plan | None = None
        self._solved: Solution | None = None
        self._trusted = np.inf

    @property
    def sequence(self) -> Sequence:
        """The stages in the window."""
        return self._sequence

    @property
    def solved(self) -> Solution | None:
        """The last solve, whose multipliers start the next one; None before the first."""
        return self._solved

    def hand_over(self, now: float, x: np.ndarray) -> tuple[Switch, ...]:
        """Drop the stages that are over at time now [s], by the plan or by the measured state x (2n,)."""
        sequence, passed = drop_passed(self._sequence if self._on_course(now, x) else self._sequence.alone, now)
        self._sequence, met = drop_met(sequence, self.stages, self.costs, now, x)
        return (*passed, *met)

    def decide(self, now: float, x: np.ndarray) -> Decision:
        """Return the decision at time now [s] from the measured state x (2n,).

        Where that is not finite the plan's own prediction stands in for it, but no longer than until the end of the
        plan that was in force when the state was last measured whole.

        Raises:
            RunError: Nothing is measured, and there is no plan yet.
        """
        measured = bool(np.isfinite(x).all())
        x = x if measured else self._stand_in(now, x)
        before, prediction = self._sequence, self._predict(now, x)
        longer = None if self.spec.kind in ONE_STAGE else self._detect(before, prediction)
        sequence, solved = self._first_solvable(before, longer, prediction, x)
        usable = solved.outcome.usable and (measured or not self._used_up(now))
        if usable:
            sequence = Sequence(sequence.first, solved.plan.instants, sequence.entered)
        self._sequence, self._solved = sequence, solved
        plan = self._plan_in_force(solved.plan if usable else None, prediction, now, x)
        self._trusted = plan.end if measured and self._braking is None else self._trusted
        return Decision(
            plan=plan,
            sequence=sequence,
            solved=solved,
            prediction=prediction,
            appended=sequence.last > before.last,
            postponed=sequence.last < (longer or before).last,
            solve_failed=not usable,
            exhausted=self._braking is not None,
            unmeasured=not measured,
        )

    def _first_solvable(
        self, sequence: Sequence, longer: Sequence | None, prediction: Plan, x: np.ndarray
    ) -> tuple[Sequence, Solution]:
        """Return the longest sequence whose window has a solution, and the solve; `sequence` with its own if none has.

        Where a stage has appeared that is the one with it. Where no point meets all constraints, a blow has put the end
        condition of the current stage out of reach for example, the stages that wait are left to be seen again. Soft
        limits make no difference: a window that violates them further than one with fewer stages has no solution.
        """
        solved = self._solve(longer or sequence, prediction, x)
        if longer is not None:
            usable = solved.outcome.usable
            if usable and _in_reach(solved):
                return longer, solved
            shorter = self._solve(sequence, prediction, x)
            if usable and _in_reach(solved, shorter):
                return longer, _after(shorter, solved)
            solved = _after(solved, shorter)
        infeasible = solved.outcome is Outcome.INFEASIBLE
        if sequence.count > 1 and (infeasible or not _in_reach(solved)):
            alone = self._solve(sequence.alone, prediction, x)
            if alone.outcome.usable and (infeasible or not _in_reach(solved, alone)):
                return sequence.alone, _after(solved, alone)
            solved = _after(alone, solved)
        return sequence, solved

    def _on_course(self, now: float, x: np.ndarray) -> bool:
        """Tell whether the plan may end the current stage at time now [s], if it wants to.

        One that could not be renewed may not where the measured state x (2n,) is far from where it had the stage end.
        """
        sequence, stage = self._sequence, self.stages[self._sequence.first]
        renewed = self._solved is None or self._solved.outcome.usable
        if renewed or stage.at is not None or sequence.count == 1 or sequence.instants[0] > now + SHORTEST:
            return True
        return bool(self.costs.met(stage, x[None], self.spec.detection_margin)[0])

    def _plan_in_force(self, solved: Plan | None, prediction: Plan, now: float, x: np.ndarray) -> Plan:
        """Return the solved plan, else the one before it; when that is used up, one that brakes to rest."""
        if solved is not None:
            self._plan, self._braking = solved, None
        elif self._plan is None:
            self._plan = prediction
        elif self._braking is None and self._used_up(now):
            self._braking = self._brake(now, x)
        return self._plan if self._braking is None else self._braking

    def _used_up(self, now: float) -> bool:
        """Tell whether the plan, or the trust in it, ends before the next sample."""
        end = np.inf if self._plan is None else self._plan.end
        return now > min(end, self._trusted) - self.spec.sample_time

    def _stand_in(self, now: float, x: np.ndarray) -> np.ndarray:
        """Return the measured state x (2n,) with the plan's wherever it is not finite."""
        plan = self._plan if self._braking is None else self._braking
        if plan is None:
            raise RunError(f"nothing is measured at {now:g} s and there is no plan yet, so the robot does not move")
        return np.where(np.isfinite(x), x, plan.states_at(np.array([now]))[0])

    def window(self, sequence: Sequence, prediction: Plan, x: np.ndarray, before: Solution | None = None) -> Window:
        """Return the window over a sequence, its costs normalized from the prediction.

        An automatic mesh is for the costs along the prediction, where that comes from a solve `before`.
        """
        spec, stages = self.spec, self.stages[sequence.first : sequence.last + 1]
        offset, scale = self._normalization(stages, sequence.begins, prediction)
        window = Window(
            stages=stages,
            start=prediction.start,
            elapsed=prediction.start - sequence.entered,
            x0=x,
            omega=priorities_in_force(spec, stages),
            offset=offset,
            scale=scale,
            horizon=spec.horizon,
            pending_cost=spec.pending_cost,
            terminal_cost=spec.terminal_cost,
            nodes=(spec.uniform_nodes,) * len(stages),
            discretization=spec.discretization,
            soft=self.problem.spec.limits_are_soft,
        )
        return self._on_its_mesh(window, sequence.instants, prediction, before) if spec.nodes == "auto" else window

    def _on_its_mesh(self, window: Window, instants: np.ndarray, prediction: Plan, before: Solution | None) -> Window:
        """Return a window with the nodes its stages need."""
        spec = self.spec
        if before is None:
            counts = first_counts(window, instants, spec.mesh_tolerance, spec.sample_time)
        else:
            had = {stage.index: N for stage, N in zip(before.window.stages, before.window.nodes, strict=True)}
            along = Along(prediction, self.costs, spec.sample_time)
            counts = node_counts(window, instants, along, spec.mesh_tolerance, had)
        return replace(window, nodes=counts)

    def _normalization(
        self, stages: tuple[Stage, ...], begins: np.ndarray, prediction: Plan
    ) -> tuple[np.ndarray, np.ndarray]:
        spec = self.spec
        return normalization(spec.normalization, spec.zeta, stages, begins, self.costs, prediction, spec.sample_time)

    def _predict(self, now: float, x: np.ndarray) -> Plan:
        if self._plan is None:
            return resting_plan(now, self.spec.horizon, self.spec.uniform_nodes, x)
        return shift(self._plan, now, self.spec.horizon, x)

    def _detect(self, sequence: Sequence, prediction: Plan) -> Sequence | None:
        return detect(sequence, self.stages, self.costs, prediction, self.spec.detection_margin)

    def _solve(self, sequence: Sequence, prediction: Plan, x: np.ndarray) -> Solution:
        window = self.window(sequence, prediction, x, self._solved)
        starts = self.spec.multistart or 1
        guess = replace(prediction, instants=sequence.instants)
        return solve_from_several(self.solver, window, guess, self._solved, starts)

    def _brake(self, now: float, x: np.ndarray) -> Plan:
        Qdot, limits = x[len(x) // 2 :], self.stages[self._sequence.first].limits
        strongest = np.minimum(limits.acceleration_high, -limits.acceleration_low)
        return braking_plan(now, x, max(BRAKING_TIME, float(np.max(np.abs(Qdot) / strongest))))


def priorities_in_force(spec: ControllerSpec, stages: tuple[Stage, ...]) -> np.ndarray:
    """Return omega of each stage (stages,); SMPC knows none but 1."""
    return np.array([1.0 if spec.kind == "smpc" else stage.priority for stage in stages])


def _in_reach(solved: Solution, shorter: Solution | None = None) -> bool:
    """Tell whether a window violates soft limits no further than the measured state, or than one with fewer stages."""
    if not len(solved.violations):
        return True
    least = own_violations(solved.window.x0, solved.window.stages)
    if shorter is not None and shorter.outcome.usable:
        least = np.maximum(least, shorter.violations)
    return bool((solved.violations <= least + FEASIBLE).all())


def _after(other: Solution, solved: Solution) -> Solution:
    """Return a solve whose wall time counts another one in the same sample."""
    return replace(solved, wall_time=other.wall_time + solved.wall_time)
