"""The switching controller: PSMPC, SMPC and hard switching are one code with two switches; HTMPC adds levels."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import isfinite
from time import perf_counter

import numpy as np

from psmpc_cli.control.estimator import Estimate, Estimator
from psmpc_cli.control.htmpc import Hierarchy
from psmpc_cli.control.interface import Command, Measurement, State
from psmpc_cli.control.multistart import solve_from_several
from psmpc_cli.control.sequence import MovingSequence, Switch, detect, drop_met, drop_passed, is_over
from psmpc_cli.control.tracking import Tracker, to_be_closed
from psmpc_cli.errors import RunError
from psmpc_cli.ocp.plan import ATTITUDE, PLANAR, Chart, Plan, braking_plan, resting_plan, shift
from psmpc_cli.ocp.problem import Problem, Stage, build_problem
from psmpc_cli.ocp.window import (
    SHORTEST,
    Window,
    first_counts,
    node_counts,
    normalization,
    own_violations,
)
from psmpc_cli.robot.closed_chain import ClosedChain
from psmpc_cli.robot.free_body import body_of
from psmpc_cli.solvers import FEASIBLE, Outcome, Solution, Solver, build_solver
from psmpc_cli.specs.arguments import require
from psmpc_cli.specs.load import Task
from psmpc_cli.specs.task import ControllerSpec, SolverSpec, TaskSpec
from psmpc_cli.specs.uncertainty import standard_deviations

KEPT_UNTIL = -0.17
"""Real part of an attitude's error at which the other sign of its quaternion is taken: an error of some 200 deg."""

ONE_STAGE = ("hard", "htmpc")
"""Controllers whose window holds the current stage alone."""

BRAKING_TIME = 0.5
"""Time within which a robot without a plan comes to rest [s], longer where acceleration limits ask for it."""

COMPARED = 30
"""Iterations of `sqp` where windows are solved from several guesses, whose objectives are compared at their optima."""


class Controller:
    """Priority-based switching MPC, and what it is compared with, for one run.

    Attributes:
        problem: The task made computable.
        sequence: The stages in the window.
        done: Whether the last stage has met its end condition. A controller that is done holds its target.
    """

    def __init__(self, task: Task | Problem, solver: Solver | None = None) -> None:
        """Build the controller of a task.

        Args:
            task: The task, or its problem.
            solver: Solves the windows; by default what the task names.

        Raises:
            InputError: The task or the solver is none.
        """
        require("task", task, (Task, Problem), "a Task, from load_task")
        require("solver", solver, (Solver, type(None)), "a Solver, or None for the task's own")
        self.problem = task if isinstance(task, Problem) else build_problem(task)
        self.spec, self.stages, self.costs = self.problem.spec.controller, self.problem.stages, self.problem.costs
        self.solver = solver or build_solver(self.problem, _solver_spec(self.problem.spec))
        self.sequence, self.done = MovingSequence(0, np.zeros(0), 0.0), False
        self._rate = self.problem.spec.plant.low_level_rate
        self._ticks = np.arange(round(self.spec.sample_time * self._rate) + 1) / self._rate
        noise = standard_deviations(self.problem.spec.measurement_noise, self.problem.model.spec)
        self._estimator = Estimator(self.spec, noise, 1 / self._rate)
        self._estimate: Estimate | None = None
        self._soft, self._starts = self.problem.spec.limits_are_soft, self.spec.multistart or 1
        self._nodes, self._priorities = self.spec.uniform_nodes, priorities_in_force(self.spec, self.stages)
        self._hierarchy = Hierarchy(self.problem) if self.spec.kind == "htmpc" else None
        self._chart, self._known_signs = PLANAR, dict[int, dict[str, float]]()
        thing = self.problem.spec.object
        body = None if thing is None else body_of(thing)
        self._tracker = None if thing is None or body is None else Tracker(thing, body)
        grasp = None if thing is None else thing.grasp
        self._load: ClosedChain | None = None
        if body is not None and grasp is not None and grasp.known:
            self._load = ClosedChain(self.problem.model, body, grasp)
        self._follows = self._tracker is not None and any(stage.on_object for stage in self.stages)
        self._plan: Plan | None = None
        self._braking: Plan | None = None
        self._of_sample, self._time = self.solver, -np.inf
        self._solved: Solution | None = None
        self._unfinished: Solution | None = None
        self._trusted = np.inf

    def step(self, time: float, state: State, object_pose: np.ndarray | None = None) -> Command:
        """Decide what the robot does over the coming sample. Paper Algorithm 1.

        Args:
            time: When the command begins to act [s], a sample after the one before.
            state: Measured then, or `known_delay` samples before. Where it is not finite the plan's own prediction is
                used, at most until the end of the plan in force when the state was last measured completely.
            object_pose: Pose of a task's object with a mass, measured with the state, (3,) or (7,); where it is not
                finite, or not given, the object's motion is predicted.

        Raises:
            InputError: The time is not after the sample before, or the state or the pose is not of the task's robot or
                object.
            RunError: Nothing is measured, and there is no plan yet.
        """
        measurement, before_this = Measurement(time, state, object_pose), self._time
        measurement.check(self.problem, before_this)
        self._time = time
        if self._tracker is not None and object_pose is not None:
            self._tracker.see(time - self.spec.known_delay * self.spec.sample_time, object_pose)
        until = perf_counter() + self.solver.deadline
        self._of_sample = self.solver.stopping(until)
        estimate = self._estimator.measured(self._estimate, state)
        seen = self._in_chart(time, self._estimator.foreseen(estimate))
        switches = self._drop_stages(time, seen)  # stages that are over leave the window
        if self._follows:
            self.stages = self._placed_stages(time, seen, ahead=True)
        measured = isfinite(state.x @ state.x)
        x = seen if isfinite(seen @ seen) else self._completed(time, seen)
        prediction, before = self._predict(time, x), self.sequence  # the last plan, shifted
        longer = self._detect(prediction)  # the next stage enters when its switch is predicted
        sequence, solution = self._solve_longest(before, longer, prediction, x)
        solved = solution.outcome.usable and (measured or not self._is_used_up(time))
        if solved and sequence.count > 1:
            sequence = replace(sequence, instants=solution.plan.instants)
        levels: tuple[Solution, ...] = ()
        if self._hierarchy and solved:
            levels = self._hierarchy.descend(
                self.stages[sequence.first :], sequence.entered, solution, prediction, until
            )
        self.sequence, self._solved = sequence, solution
        plan = self._plan_in_force((levels or (solution,))[-1].plan if solved else None, prediction, time, x)
        self._trusted = plan.end if measured and self._braking is None else self._trusted
        x, planned = self._over_sample(plan, time, x)
        self._estimate, u = self._estimator.command(estimate, planned, state.v)
        happened = {
            "appended": sequence.last > before.last,
            "postponed": sequence.last < (longer or before).last,
            "solve_failed": not solved,
            "braking": self._braking is not None,
            "unmeasured": not measured,
            "gap": measurement.follows_a_gap(before_this, self.spec.sample_time),
        }
        events, d = frozenset(name for name, yes in happened.items() if yes), self._estimate.disturbance
        tick, model = 1 / self._rate, self.problem.model
        closed, load = self._closed(sequence, time), self._load
        decided = sequence, prediction, solution, events, switches, d, levels
        return Command(time, x, u, tick, plan, *decided, model, closed, load)

    def _over_sample(self, plan: Plan, time: float, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return x (2n,) in the chart as [Q; v] (nq + n,), and the rates of v that the plan has at the ticks (M, n)."""
        edges = self.edges(time)
        if not self._chart.spatial:
            return x, plan.mean_control(edges)
        Q, v = self._chart.leave(np.vstack([x, plan.states_at(edges)]))
        return np.r_[Q[0], v[0]], np.diff(v[1:], axis=0) * self._rate

    def _closed(self, sequence: MovingSequence, time: float) -> np.ndarray:
        thing = self.problem.spec.object
        if thing is None or self._tracker is None:
            return np.zeros(len(self._ticks) - 1, bool)
        return to_be_closed(thing, [stage.name for stage in self.stages], sequence, self.edges(time)[:-1])

    def _in_chart(self, time: float, state: State) -> np.ndarray:
        """Return a measured state in the chart about its attitude (2n,), in which plan and stages are from now on.

        Where the attitude is not finite the chart is about the one that the plan foresees.
        """
        model = self.problem.model
        if model.dimension == 2:
            if self._follows:
                self.stages = self._placed_stages(time, state.x)
            return state.x
        Q, plan = state.Q, self._plan if self._braking is None else self._braking
        if not np.isfinite(Q[ATTITUDE]).all() and plan is not None:
            Q = np.r_[Q[:3], plan.chart.leave(plan.states_at(np.array([time])))[0][0, ATTITUDE], Q[7:]]
        self._chart = Chart.at(Q, model.n)
        x = np.asarray(self._chart.enter(Q[None], state.v[None])[0])
        self._plan = self._plan and self._plan.in_chart(self._chart)
        self._braking = self._braking and self._braking.in_chart(self._chart)
        self.stages = self._placed_stages(time, x)
        return x

    def _placed_stages(self, time: float, x: np.ndarray, ahead: bool = False) -> tuple[Stage, ...]:
        """Return the stages with the numbers of their targets that a sample sets, x (2n,) being measured.

        Targets relative to the object are where it is now; with `ahead`, where it is when their stage is planned to
        end, or at the end of the horizon. A current stage whose end is never planned follows it over the horizon.
        """
        model, first, stages = self.problem.model, self.sequence.first, self.problem.stages
        if self._tracker is not None and self._follows:
            end = time + self.spec.horizon
            ends = dict(enumerate(self.sequence.instants, start=first))
            poses = {s: self._tracker.at(float(ends.get(s, end)) if ahead else time) for s in range(first, len(stages))}
            stages = tuple(
                stage.at_object(model.pose_rows, *poses[stage.index])
                if stage.index in poses and stage.on_object
                else stage
                for stage in stages
            )
            if ahead and stages[first].on_object and not ends_in_plan(self.spec.kind, first, stages):
                now, elapsed = np.concatenate(self._tracker.at(time)), time - self.sequence.entered
                current = stages[first].following(model.pose_rows, self._tracker.body, now, elapsed, self.spec.horizon)
                stages = (*stages[:first], current, *stages[first + 1 :])
        if model.dimension == 2:
            return stages
        plan = self._plan or resting_plan(time, self.spec.horizon, 1, x, self._chart)
        begins = dict(enumerate([time, *self.sequence.instants], start=first))
        return tuple(
            stage.in_chart(self._chart.anchor, x[6 : model.n], self._signs(stage, plan, begins.get(stage.index)))
            for stage in stages
        )

    def _signs(self, stage: Stage, plan: Plan, begins: float | None) -> Mapping[str, float]:
        """Choose the signs of the quaternions in a spatial target, by frame: of q and -q the nearer one.

        The nearer where the stage begins in the plan; then kept until the error passes 200 deg, so that an error that
        passes 180 deg within a horizon stays smooth. A trajectory counts where it is then.
        """
        time = plan.end if begins is None else begins
        since = time - self.sequence.entered if stage.index == self.sequence.first else 0.0
        wanted = stage.reference(since)
        xi = np.asarray(
            self.problem.model.charted(plan.states_at(np.array([time]))[0, : self.problem.model.n], self._chart.anchor)
        )
        rows, known = self.problem.model.pose_rows, self._known_signs.setdefault(stage.index, {})
        for frame, at in stage.attitudes.items():
            w = float(wanted[at : at + 4] @ xi.ravel()[rows[frame]][3:7])
            sign = known.get(frame)
            if sign is None or begins is None or sign * w < KEPT_UNTIL:
                known[frame] = 1.0 if w >= 0 else -1.0
        return known

    def edges(self, time: float) -> np.ndarray:
        """Return the beginnings of the low-level ticks in the sample at a time [s], and its end (M + 1,)."""
        return np.asarray(time + self._ticks)

    def _drop_stages(self, time: float, x: np.ndarray) -> tuple[Switch, ...]:
        """Drop the stages that are over at a time [s], by the plan or by the measured state x (2n,)."""
        stages, costs = self.stages, self.costs
        self.sequence = self.sequence.noticed(stages, costs, time, x)
        sequence, passed = drop_passed(self.sequence if self._on_course(time, x) else self.sequence.alone, time)
        sequence, met = drop_met(sequence.noticed(stages, costs, time, x), stages, costs, time, x)
        self.sequence = sequence.noticed(stages, costs, time, x)
        if not self.done and self.sequence.first == len(self.stages) - 1:
            self.done = is_over(self.sequence, self.stages, self.costs, time, x)
            met += [Switch(self.sequence.first, time)] if self.done else []
        return (*passed, *met)

    def _on_course(self, time: float, x: np.ndarray) -> bool:
        """Tell whether the plan may end the current stage at a time [s], if it wants to.

        One that could not be renewed may not where the measured state x (2n,) is far from where it had the stage end.
        """
        sequence, stage = self.sequence, self.stages[self.sequence.first]
        renewed = self._solved is None or self._solved.outcome.usable
        if renewed or stage.at is not None or sequence.count == 1 or sequence.instants[0] > time + SHORTEST:
            return True
        return bool(self.costs.met(stage, x[None], self.spec.detection_margin)[0])

    def _completed(self, time: float, x: np.ndarray) -> np.ndarray:
        """Return the measured state x (2n,) with the plan's wherever it is not finite."""
        plan = self._plan if self._braking is None else self._braking
        if plan is None:
            raise RunError(f"nothing is measured at {time:g} s and there is no plan yet, so the robot does not move")
        return np.where(np.isfinite(x), x, plan.states_at(np.array([time]))[0])

    def _predict(self, time: float, x: np.ndarray) -> Plan:
        if self._plan is None:
            return resting_plan(time, self.spec.horizon, self.spec.uniform_nodes, x, self._chart)
        return shift(self._plan, time, self.spec.horizon, x, self.sequence.instants)

    def _detect(self, prediction: Plan) -> MovingSequence | None:
        if self.spec.kind in ONE_STAGE:
            return None
        return detect(self.sequence, self.stages, self.costs, prediction, self.spec.detection_margin)

    def _solve_longest(
        self, sequence: MovingSequence, longer: MovingSequence | None, prediction: Plan, x: np.ndarray
    ) -> tuple[MovingSequence, Solution]:
        """Solve the window over the longest sequence that has a solution; over `sequence` if none has.

        Where a stage has appeared that is the one with it. Where no point meets all constraints, an impact has put the
        end condition of the current stage out of reach for example, the stages that wait are left to be seen again.
        Soft limits make no difference: a window that violates them further than one with fewer stages has no solution.
        A switch that is planned before the next sample takes place as planned all the same, by the plan in force, where
        the measured state meets the end condition within the detection margin: what is left of the stage is too short
        to correct what the measurement is off by.
        Where the solve with a stage that has appeared runs out of iterations or time, the next sample goes on from it.
        """
        solved = self._solve(longer or sequence, prediction, x)
        unfinished = longer is not None and solved.outcome in (Outcome.ITERATION_LIMIT, Outcome.DEADLINE)
        self._unfinished = solved if unfinished else None
        if longer is not None:
            usable = solved.outcome.usable
            if usable and _in_reach(solved):
                return longer, solved
            shorter = self._solve(sequence, prediction, x)
            if usable and _in_reach(solved, shorter):
                return longer, _after(shorter, solved)
            solved = _after(solved, shorter)
        infeasible = solved.outcome is Outcome.INFEASIBLE
        if self._hands_over(sequence, prediction.start, x) and (infeasible or not _in_reach(solved)):
            return sequence, replace(solved, outcome=Outcome.INFEASIBLE)
        if sequence.count > 1 and (infeasible or not _in_reach(solved)):
            alone = self._solve(sequence.alone, prediction, x)
            if alone.outcome.usable and (infeasible or not _in_reach(solved, alone)):
                return sequence.alone, _after(solved, alone)
            solved = _after(alone, solved)
        return sequence, solved

    def _hands_over(self, sequence: MovingSequence, time: float, x: np.ndarray) -> bool:
        """Tell whether the next stage begins before the next sample, from near the target of the current one."""
        if sequence.count == 1 or sequence.instants[0] > time + self.spec.sample_time:
            return False
        return bool(self.costs.met(self.stages[sequence.first], x[None], self.spec.detection_margin)[0])

    def _solve(self, sequence: MovingSequence, prediction: Plan, x: np.ndarray) -> Solution:
        window, guess = self.window(sequence, prediction, x, self._solved), self._guess(sequence, prediction)
        if self._starts == 1:
            return self._of_sample.solve(window, guess, self._solved)
        return solve_from_several(self._of_sample, window, guess, self._solved, self._starts)

    def _guess(self, sequence: MovingSequence, prediction: Plan) -> Plan:
        """Return the guess of a window: the prediction, or the unfinished iterate over the same stages, shifted."""
        before = self._unfinished
        if before is not None and before.window.stages[-1].index == sequence.last and np.isfinite(before.plan.X).all():
            chart, x = prediction.chart, prediction.X[0]
            iterate = shift(before.plan.in_chart(chart), prediction.start, self.spec.horizon, x)
            if len(iterate.instants) == len(sequence.instants):
                return iterate
        same = prediction.instants is sequence.instants
        return prediction if same else replace(prediction, instants=sequence.instants)

    def window(
        self, sequence: MovingSequence, prediction: Plan, x: np.ndarray, before: Solution | None = None
    ) -> Window:
        """Build the window over a sequence, its costs normalized from the prediction.

        An automatic mesh is for the costs along the prediction, where that comes from a solve `before`.
        """
        spec, stages = self.spec, self.stages[sequence.first : sequence.last + 1]
        # strict priorities do not depend on the scale; the printed range is 0 for a robot at rest
        kind = "nadir" if spec.kind == "htmpc" else spec.normalization
        offset, scale = normalization(
            kind, spec.zeta, stages, sequence.begins, self.costs, prediction, spec.sample_time
        )
        window = Window(
            stages=stages,
            start=prediction.start,
            elapsed=prediction.start - sequence.entered,
            hold=sequence.hold_left(self.stages, prediction.start),
            x0=x,
            omega=self._priorities[sequence.first : sequence.last + 1],
            offset=offset,
            scale=scale,
            horizon=spec.horizon,
            pending_cost=spec.pending_cost,
            terminal_cost=spec.terminal_cost,
            nodes=(self._nodes,) * len(stages),
            discretization=spec.discretization,
            soft=self._soft,
            chart=self._chart,
        )
        if spec.nodes != "auto":
            return window
        if before is None:
            return replace(window, nodes=first_counts(window, sequence.instants, spec.mesh_tolerance, spec.sample_time))
        had = {stage.index: N for stage, N in zip(before.window.stages, before.window.nodes, strict=True)}
        plan = replace(prediction, instants=sequence.instants)
        counts = node_counts(window, plan, self.costs, spec.sample_time, spec.mesh_tolerance, had)
        return replace(window, nodes=counts)

    def _plan_in_force(self, solved: Plan | None, prediction: Plan, time: float, x: np.ndarray) -> Plan:
        """Return the solved plan, else the one before it; when that is used up, one that brakes to rest."""
        if solved is not None:
            self._plan, self._braking = solved, None
        elif self._plan is None:
            self._plan = self._brake(time, x, self.spec.horizon)
        elif self._braking is None and self._is_used_up(time):
            self._braking = self._brake(time, x)
        return self._plan if self._braking is None else self._braking

    def _is_used_up(self, time: float) -> bool:
        """Tell whether the plan, or the trust in it, ends before the next sample."""
        end = np.inf if self._plan is None else self._plan.end
        return time > min(end, self._trusted) - self.spec.sample_time

    def _brake(self, time: float, x: np.ndarray, horizon: float = 0.0) -> Plan:
        """Return the plan that brakes as fast as limits allow, and then rests until the end of a horizon [s]."""
        v, limits = x[len(x) // 2 :], self.stages[self.sequence.first].limits
        strongest = np.minimum(limits.acceleration_high, -limits.acceleration_low)
        duration = max(BRAKING_TIME, float(np.max(np.abs(v) / strongest)))
        return braking_plan(time, x, duration, horizon, self._chart)


def ends_in_plan(kind: str, first: int, stages: Sequence[Stage]) -> bool:
    """Tell whether the end of a current stage, the first in the window, is ever planned under a controller."""
    return kind not in ONE_STAGE and first < len(stages) - 1


def priorities_in_force(spec: ControllerSpec, stages: tuple[Stage, ...]) -> np.ndarray:
    """Return omega of each stage (stages,); SMPC knows none but 1."""
    return np.array([1.0 if spec.kind == "smpc" else stage.priority for stage in stages])


def _solver_spec(task: TaskSpec) -> SolverSpec:
    if task.solver.kind != "sqp" or (task.controller.multistart or 1) == 1:
        return task.solver
    return task.solver.model_copy(update={"iterations": max(task.solver.iterations, COMPARED)})


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
