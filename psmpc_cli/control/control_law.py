"""The control law, Algorithm 1: PSMPC, SMPC and hard switching are one code with two switches; HTMPC adds levels."""

from copy import copy
from dataclasses import dataclass, replace
from math import isfinite
from time import perf_counter

import numpy as np

from psmpc_cli.control.attempts import Attempt, Attempts
from psmpc_cli.control.estimator import Estimate, Estimator
from psmpc_cli.control.fallback import PlansInForce
from psmpc_cli.control.htmpc import build_hierarchy
from psmpc_cli.control.identification.tracking import Grip, ObjectEstimate, object_estimate, to_be_closed
from psmpc_cli.control.interface import Command, Measurement, State
from psmpc_cli.control.memory import Memory
from psmpc_cli.control.online_identification import identification_steps
from psmpc_cli.control.placement import Placement, Placer
from psmpc_cli.control.routes.guidance import RouteProgress, build_guide
from psmpc_cli.control.sequence import FaultKind, GraspFault, MovingSequence, Switch, detect, drop_met, drop_passed
from psmpc_cli.control.window_builder import WindowBuilder
from psmpc_cli.errors import RunError
from psmpc_cli.ocp.constraints.plumes import PlumeForecast
from psmpc_cli.ocp.end import ROUNDING, PlannedEnd
from psmpc_cli.ocp.plan import Plan, resting_plan, shift
from psmpc_cli.ocp.problem import Problem
from psmpc_cli.ocp.stage import JERK, PlacedStage
from psmpc_cli.robot.configuration import Chart
from psmpc_cli.robot.dynamics import LARGEST_CONDITION
from psmpc_cli.robot.low_level import LowLevelLaw
from psmpc_cli.solvers import Solution, Solver, build_solver
from psmpc_cli.specs.controller import SolverSpec
from psmpc_cli.specs.task import TaskSpec
from psmpc_cli.specs.uncertainty import standard_deviations

MULTISTART_ITERATIONS = 30
"""Iterations of `sqp` where windows are solved from several guesses, whose objectives are compared at their optima."""


@dataclass(frozen=True, eq=False)
class Situation:
    """A sample as the controller sees it.

    Attributes:
        time: When its command begins to act [s].
        estimate: What is known of the robot.
        target_object: What is known of an object that moves, a held one where it is when the command begins to act.
        x_chart: State in the chart in which the command begins to act (2n,); NaN where nothing is known of it.
        is_measured: All of the state was measured.
        placement: The stages with their targets.
        switches: Stages that ended since the sample before.
        grasp_events: `missed` and `returned`, see `Command.events`.
    """

    time: float
    estimate: Estimate
    target_object: ObjectEstimate
    x_chart: np.ndarray
    is_measured: bool
    placement: Placement
    switches: tuple[Switch, ...] = ()
    grasp_events: frozenset[str] = frozenset()

    @property
    def applied(self) -> np.ndarray:
        """The acceleration that was commanded last, as plans count it: with the disturbance (n,).

        In the chart, which is about the attitude now, it is the same.
        """
        return np.asarray(self.estimate.applied + self.estimate.disturbance)

    @property
    def stages(self) -> tuple[PlacedStage, ...]:
        """All stages of the task."""
        return self.placement.stages


@dataclass(frozen=True, eq=False)
class Decision:
    """What became of a sample's solves.

    Attributes:
        solved: The solve counts.
        attempt: The solves, the last of which may count.
        prediction: The last plan, from now on, from which they started.
        sequence: The stages in the window, their switch times those of the solution where it counts.
        levels: Solutions of the levels of HTMPC.
        plan: The plan that is applied.
        plans: The plans that outlast the sample, this one among them.
    """

    solved: bool
    attempt: Attempt
    prediction: Plan
    sequence: MovingSequence
    levels: tuple[Solution, ...]
    plan: Plan
    plans: PlansInForce


class ControlLaw:
    """What decides at a sample; it is the same for all samples of a run.

    Attributes:
        problem: The task made computable.
        solver: Solves its windows.
        builder: Builds them.
    """

    def __init__(self, problem: Problem, solver: Solver | None = None) -> None:
        spec = problem.spec
        rate = spec.plant.low_level_rate
        noise = standard_deviations(spec.measurement_noise, problem.model.spec)
        self.problem = problem
        self.solver = solver or build_solver(problem, _solver_spec(spec))
        problem.law.prepare()
        self.builder = WindowBuilder(problem)
        self._spec = spec.controller
        self._one_stage = spec.controller.traits.one_stage
        self._ticks = np.arange(round(self._spec.sample_time * rate) + 1) / rate
        self._tick = 1 / rate
        self._held_stages = spec.held_stages
        self._has_rates = any(stage.has_rates for stage in problem.stages)
        self._limits_jerk = any(JERK in stage.constraints for stage in problem.stages)
        model = problem.model
        self._driven = [model.driven(stage.moved_by) for stage in problem.stages]
        self._held_by_mount = list(problem.spec.stages_on_mount(model.spec))
        self._plumes = {
            stage.index: PlumeForecast.of(spec, model, stage.index)
            for stage in problem.stages
            if spec.avoids_plumes(stage.index, model.spec)
        }
        actuated = np.any([model.actuated(stage.moved_by) for stage in problem.stages], axis=0)
        self._estimator = Estimator(
            self._spec, model.space, actuated, noise, self._tick, finds_delay=spec.finds_delay(model.spec)
        )
        self._placer = Placer(problem)
        self._identification = tuple(identification_steps(problem, noise[model.n :]))
        self._guide = build_guide(problem)
        self._hierarchy = build_hierarchy(problem)

    def retargeted(self, problem: Problem) -> "ControlLaw":
        """Return the law for the same problem with other targets; its solver goes on."""
        law = copy(self)
        law.problem = problem
        law._placer = Placer(problem)
        law._guide = build_guide(problem)
        return law

    @property
    def first(self) -> Memory:
        """What is known before the first sample."""
        of_object = object_estimate(self.problem.body, self.problem.spec.controller.object_gain)
        memory = Memory(MovingSequence.of(0, 0.0), target_object=of_object)
        for step in self._identification:
            memory = step.begun(memory)
        return memory

    def decide(self, memory: Memory, measurement: Measurement) -> tuple[Memory, Command]:
        """Decide what the robot does over the coming sample. Paper Algorithm 1.

        Args:
            memory: What the sample before has left.
            measurement: What is measured.

        Raises:
            RunError: Nothing is measured, and there is no plan yet.
        """
        stop_at = perf_counter() + self.solver.deadline
        memory, situation = self._measure(memory, measurement)
        memory, situation = self._drop(memory, situation)  # stages that are over leave the window
        memory, situation = self._answer_faults(memory, measurement, situation)  # back where the object was missed
        memory, situation = self._place_at_ends(memory, situation)
        prediction = self._shift(memory, situation)  # the last plan, from now on
        longer = self._detect(memory, situation, prediction)  # the next stage enters when its switch is predicted
        situation = self._with_targets_at(longer, memory, situation)
        attempts = self._attempts(memory, situation, prediction, stop_at)
        attempt = attempts.solve_longest(memory.sequence, longer)
        decision = self._accept(memory, situation, attempt, prediction, stop_at)  # or fall back
        events = self._events(memory, measurement, situation, longer, decision)
        estimate, command = self._command(memory, situation, decision, events)
        return _remembered(memory, situation, decision, estimate), command

    def _measure(self, memory: Memory, measurement: Measurement) -> tuple[Memory, Situation]:
        """Estimate the state of robot and object, and place the stages about it.

        Where the attitude was not measured the chart is about the one that the plan foresees.
        """
        measured_at = measurement.time
        estimate = self._estimated(memory, measurement)
        time = estimate.acts_at
        grip = self._grip(memory.sequence, measured_at, estimate.state)
        target_object = memory.target_object.with_measurement(measured_at, measurement.object_pose, grip)
        foreseen = self._estimator.foreseen(estimate)
        chart = self._chart_about(foreseen, memory.plans.current, time)
        x_chart = np.asarray(chart.to_chart(foreseen.Q[None], foreseen.v[None])[0])
        memory = replace(memory, plans=memory.plans.in_chart(chart), target_object=target_object)
        memory = self._identified(memory, measurement.state, estimate, is_held=grip is not None)
        if time > measured_at:
            then = self._grip(memory.sequence, measured_at, foreseen)
            target_object = target_object.carried(time - measured_at, then)
        route = self._guide.followed(memory.route, memory.sequence.first, time, foreseen, target_object)
        memory = replace(memory, route=route)
        placement = self._place(memory, time, x_chart, chart, target_object)
        is_measured = isfinite(measurement.state.vector @ measurement.state.vector)
        situation = Situation(time, estimate, target_object, x_chart, is_measured, placement)
        return replace(memory, signs=placement.signs), situation

    def _estimated(self, memory: Memory, measurement: Measurement) -> Estimate:
        """Return what is known of the robot after a measurement."""
        return self._estimator.measured(
            memory.estimate,
            measurement.time,
            measurement.state,
            is_unexplained=memory.sequence.moves_grippers(self.problem.held_stages, memory.time, measurement.time)
            or self._is_closed_chain(memory),
            is_loaded=memory.sequence.first in self.problem.held_stages and not self.problem.law.knows_load,
            actuated=self.problem.model.actuated(self.problem.stages[memory.sequence.first].moved_by),
        )

    def _identified(self, memory: Memory, state: State, estimate: Estimate, is_held: bool) -> Memory:
        """Return the memory with what is found out at a sample besides the state.

        Args:
            memory: That of the sample before, with the object as it is now.
            state: As it is measured.
            estimate: What is known of it.
            is_held: Whether a gripper holds the object.
        """
        for step in self._identification:
            law = self._law(memory, memory.sequence.first, is_held=False)
            memory = step.measured(memory, state, estimate, is_held, law)
        return memory

    def _law(self, memory: Memory, stage: int, is_held: bool) -> LowLevelLaw:
        """Return the low-level law of a stage with all that is found out, where hands hold the object or do not."""
        law = self.problem.law.driving(self._driven[stage])
        for step in self._identification:
            law = step.applied(law, memory, is_held)
        return law

    def _is_closed_chain(self, memory: Memory) -> bool:
        """Tell whether several grippers hold the object: what they are commanded to do differently they cannot."""
        return memory.sequence.first in self.problem.held_stages and len(self.problem.body.grippers) > 1

    @staticmethod
    def _stage_at(sequence: MovingSequence, time: float) -> int:
        """Return the index of the stage that the robot was in at a time [s], before what the last command began."""
        return sequence.first - int(sequence.first > 0 and time < sequence.progress.entered)

    def _grip(self, sequence: MovingSequence, time: float, state: State) -> Grip | None:
        """Return the gripper that holds the object at a time [s] in a state; None where none does, or it is unknown."""
        is_held = self._stage_at(sequence, time) in self.problem.held_stages
        if not (is_held and isfinite(state.vector @ state.vector)):
            return None
        return Grip.of(self.problem.model, self.problem.body.holder, state.Q, state.v)

    def _chart_about(self, state: State, plan: Plan | None, time: float) -> Chart:
        space = self.problem.model.space
        if plan is None or np.isfinite(state.Q[space.attitude]).all():
            return space.chart_at(state.Q)
        foreseen, _ = plan.chart.from_chart(plan.states_at(np.array([time])))
        return space.chart_at(foreseen[0])

    def _place(
        self,
        memory: Memory,
        time: float,
        x_chart: np.ndarray,
        chart: Chart,
        target_object: ObjectEstimate,
        at_planned_ends: bool = False,
    ) -> Placement:
        return self._placer.place(
            time=time,
            x=x_chart,
            chart=chart,
            sequence=memory.sequence,
            plan=memory.plans.solved,
            target_object=target_object,
            load=memory.load.numbers,
            signs=memory.signs,
            waypoints=memory.route.waypoints,
            at_planned_ends=at_planned_ends,
        )

    def _drop(self, memory: Memory, situation: Situation) -> tuple[Memory, Situation]:
        """Drop the stages that are over, by the plan or by the measured state."""
        time = situation.time
        x_chart = situation.x_chart
        stages = situation.stages
        costs = self.problem.costs
        sequence = memory.sequence.with_measurement(stages, costs, time, x_chart)
        may_end = stages[sequence.first].end.accepts(self._planned_end(sequence, memory.solution, situation))
        sequence, passed = drop_passed(sequence if may_end else sequence.current_only, time)
        sequence, met = drop_met(sequence.with_measurement(stages, costs, time, x_chart), stages, costs, time, x_chart)
        sequence = sequence.with_measurement(stages, costs, time, x_chart)
        return replace(memory, sequence=sequence), replace(situation, switches=(*passed, *met))

    def _answer_faults(
        self, memory: Memory, measurement: Measurement, situation: Situation
    ) -> tuple[Memory, Situation]:
        """Return to an earlier stage where grippers report that they missed the object or lost it, or take too long.

        Where the task declares no other try, or none is left, the mission has failed, and the sequence goes on.
        """
        if memory.grasp.has_failed:
            return memory, situation
        grasp = memory.grasp
        fault = self._timed_out(memory.sequence, situation.time)
        if measurement.holding is not None and fault is None:
            grasp, fault = grasp.observed(
                memory.sequence,
                held=self.problem.held_stages,
                grippers=self.problem.body.grippers,
                holding=measurement.holding,
                time=measurement.time,
            )
        if fault is None:
            return replace(memory, grasp=grasp), situation
        back_to, times = self.problem.spec.retry_after(fault.stage)
        tried = grasp.returns.get(fault.stage, 0)
        if tried >= times:
            grasp = replace(grasp, fault=fault)
            return replace(memory, grasp=grasp), replace(situation, grasp_events=frozenset({"missed"}))
        grasp = replace(grasp, is_taken=False, returns={**grasp.returns, fault.stage: tried + 1})
        memory, situation = self._returned(replace(memory, grasp=grasp), situation, back_to)
        return memory, replace(situation, grasp_events=frozenset({"missed", "returned"}))

    def _timed_out(self, sequence: MovingSequence, now: float) -> GraspFault | None:
        """Return the fault of a stage whose timeout is over now [s] while it has not taken the object; else None."""
        stage = sequence.first
        if now < sequence.progress.entered + self.problem.spec.timeout_of(stage) - ROUNDING:
            return None
        return GraspFault(self.problem.body.grippers, FaultKind.TIMED_OUT, stage, now)

    def _returned(self, memory: Memory, situation: Situation, stage: int) -> tuple[Memory, Situation]:
        """Return to a stage that has ended: it begins again now, from the state and the object as they are measured.

        The plan in force led on with the object, so the next solve is a cold one. What earlier samples knew of the
        stages to come, such as how far the robot is on their routes, does not count any more.
        """
        time = situation.time
        route = RouteProgress({index: share for index, share in memory.route.progress.items() if index < stage})
        foreseen = self._estimator.foreseen(situation.estimate)
        route = self._guide.followed(route, stage, time, foreseen, memory.target_object)
        memory = replace(
            memory,
            sequence=MovingSequence.of(stage, time),
            plans=replace(memory.plans, sequence=None),
            solution=None,
            levels=(),
            unfinished=None,
            arguments={},
            route=route,
        )
        placement = self._place(memory, time, situation.x_chart, situation.placement.chart, memory.target_object)
        memory = replace(memory, signs=placement.signs)
        return memory, replace(situation, target_object=memory.target_object, placement=placement)

    def _place_at_ends(self, memory: Memory, situation: Situation) -> tuple[Memory, Situation]:
        """Place targets relative to the object where it is when their stage is planned to end.

        What was not measured of the state is completed, and constraints that samples set are set.

        Raises:
            RunError: Nothing is measured, and there is no plan yet.
        """
        time = situation.time
        x_chart = situation.x_chart
        sequence = memory.sequence
        placement = situation.placement
        if self._placer.follows_object:
            placement = self._place(
                memory, time, x_chart, placement.chart, situation.target_object, at_planned_ends=True
            )
            memory = replace(memory, signs=placement.signs)
        x_chart = self._with_predicted(memory, time, x_chart)
        arguments = self._placer.arguments(
            time=time,
            sequence=sequence,
            x=x_chart,
            chart=placement.chart,
            plan=memory.plans.solved,
            target_object=situation.target_object,
            load=memory.load.numbers,
            before=memory.arguments,
            wheels=memory.wheels,
        )
        memory = replace(memory, arguments=arguments)
        placement = placement.with_arguments(arguments)
        return memory, replace(situation, x_chart=x_chart, placement=placement)

    def _planned_end(self, sequence: MovingSequence, solution: Solution | None, situation: Situation) -> PlannedEnd:
        """Return the end of the current stage as the last plan has it."""
        stage = situation.stages[sequence.first]
        holding = self.problem.held_stages
        x_chart = situation.x_chart[None]
        return PlannedEnd(
            instant=sequence.planned_end,
            now=situation.time,
            next_sample=situation.time + self._spec.sample_time,
            is_renewed=solution is None or solution.outcome.usable,
            moves_grippers=sequence.first + 1 in (holding.start, holding.stop),
            is_near=lambda: bool(self.problem.costs.met(stage, x_chart, self._spec.detection_margin)[0]),
        )

    def _with_predicted(self, memory: Memory, time: float, x_chart: np.ndarray) -> np.ndarray:
        """Return the state x (2n,) with that of the plan in force wherever it is not finite."""
        if isfinite(x_chart @ x_chart):
            return x_chart
        plan = memory.plans.current
        if plan is None:
            raise RunError(f"nothing is measured at {time:g} s and there is no plan yet, so the robot does not move")
        return np.where(np.isfinite(x_chart), x_chart, plan.states_at(np.array([time]))[0])

    def _shift(self, memory: Memory, situation: Situation) -> Plan:
        """Return the last plan from now on; before the first, one without control."""
        time = situation.time
        horizon = self._spec.horizon
        plan = memory.plans.solved
        if plan is None:
            chart = situation.placement.chart
            return resting_plan(time, horizon, self._spec.uniform_nodes, situation.x_chart, chart)
        return shift(plan, time, horizon, situation.x_chart)

    def _detect(self, memory: Memory, situation: Situation, prediction: Plan) -> MovingSequence | None:
        """Return the sequence with the next stage, where its switch is predicted; else None.

        Of a controller whose windows are over one stage the current stage follows upon its own end.
        """
        margin = self._spec.detection_margin
        return detect(
            memory.sequence, situation.stages, self.problem.costs, prediction, margin, is_of_one_stage=self._one_stage
        )

    def _with_targets_at(self, longer: MovingSequence | None, memory: Memory, situation: Situation) -> Situation:
        """Return the situation with targets relative to the object where it is when stages of a sequence end."""
        if longer is None or not self._placer.follows_object:
            return situation
        extended = replace(memory, sequence=longer)
        placement = self._place(
            extended,
            situation.time,
            situation.x_chart,
            situation.placement.chart,
            situation.target_object,
            at_planned_ends=True,
        )
        return replace(situation, placement=placement.with_arguments(memory.arguments))

    def _attempts(self, memory: Memory, situation: Situation, prediction: Plan, stop_at: float) -> Attempts:
        return Attempts(
            problem=self.problem,
            solver=self.solver,
            stop_at=stop_at,
            builder=self.builder,
            stages=situation.stages,
            prediction=prediction,
            previous=memory.solution,
            unfinished=memory.unfinished,
            applied=situation.applied if self._has_rates else np.zeros(0),
        )

    def _accept(
        self, memory: Memory, situation: Situation, attempt: Attempt, prediction: Plan, stop_at: float
    ) -> Decision:
        """Take over a solution that counts, refined by the levels of HTMPC; fall back on another plan else.

        Where the current stage awaits the object a plan is followed to its planned end alone: what comes after it, such
        as to move hands apart, is for a stage that has not begun.
        """
        sequence = attempt.sequence
        solution = attempt.solution
        stage = situation.stages[sequence.first]
        expires = memory.plans.expires_before_next(situation.time, self._spec.sample_time)
        levels: tuple[Solution, ...] = ()
        solved = solution.outcome.usable and (situation.is_measured or not expires)
        if solved:
            sequence = replace(sequence, switch_times=solution.plan.switch_times)
            stages = situation.stages[sequence.first :]
            levels = self._hierarchy.solve_levels(
                stages, sequence.progress.entered, solution, prediction, memory.levels, stop_at
            )
            plan = (levels or (solution,))[-1].plan
            plans = memory.plans.on_success(plan, sequence)
        else:
            plans = memory.plans
            if stage.end.awaits_object:
                plans = plans.trusted_to_end_of(sequence.first)
                is_due = sequence.planned_end < situation.time + self._spec.sample_time
                sequence = sequence.current_only if is_due else sequence
            plans, plan = plans.on_failure(
                situation.time,
                situation.x_chart,
                stage.limits,
                horizon=self._spec.horizon,
                sample_time=self._spec.sample_time,
                chart=situation.placement.chart,
                brakes=self.problem.model.actuated(stage.moved_by),
                applied=situation.applied,
            )
        if situation.is_measured:
            plans = plans.measured()
        return Decision(
            solved=solved,
            attempt=attempt,
            prediction=prediction,
            sequence=sequence,
            levels=levels,
            plan=plan,
            plans=plans,
        )

    def _events(
        self,
        memory: Memory,
        measurement: Measurement,
        situation: Situation,
        longer: MovingSequence | None,
        decision: Decision,
    ) -> frozenset[str]:
        """Return the names of what happened, see `Command.events`."""
        happened = {
            "appended": decision.sequence.last > memory.sequence.last,
            "postponed": decision.sequence.last < (longer or memory.sequence).last,
            "solve_failed": not decision.solved,
            "braking": decision.plans.braking is not None,
            "unmeasured": not situation.is_measured,
            "load_dropped": memory.load.dropped,
            "gap": measurement.follows_a_gap(memory.time, self._spec.sample_time),
            "retargeted": bool(memory.new_targets),
        }
        return situation.grasp_events.union(name for name, yes in happened.items() if yes)

    def _command(
        self, memory: Memory, situation: Situation, decision: Decision, events: frozenset[str]
    ) -> tuple[Estimate, Command]:
        """Return the command over the coming sample, and the estimate that counts it."""
        edges = situation.time + self._ticks
        Q, v = situation.placement.chart.from_chart(situation.x_chart[None])
        changes = self._largest_changes(situation, decision, edges)
        closed = to_be_closed(self.problem.held_stages, decision.sequence, edges[:-1])
        if changes is not None and decision.plans.is_solved:
            ramped = np.isfinite(changes).any(axis=(0, 1))
            planned = decision.plan.ramped_rates(edges, situation.applied, ramped)
        elif (
            closed.any()
            and self.problem.law.knows_load
            and decision.sequence.planned_end > edges[-1] + self._spec.sample_time
        ):
            # a jump of the load's force moves light wrists against the dampers of the grasps before springs bear it;
            # averages lag behind the plan, which in the last two samples of a stage could not be made up for
            planned = decision.plan.averaged_rates(edges, situation.applied, self._spec.sample_time)
        else:
            planned = decision.plan.velocity_rates(edges)
        planned = self.problem.law.followed(Q[0], v[0], planned, closed, self._tick)
        stages_of_ticks = _stages_at(decision.sequence, edges[:-1])
        current = decision.sequence.first
        law = self._law(memory, current, is_held=current in self._held_stages)
        estimate, u = self._estimator.command(situation.estimate, planned, changes, law)
        twist_rates = None
        if situation.stages[decision.sequence.first].input == "task":
            if self.problem.model.task_space_condition(Q[0]) > LARGEST_CONDITION:
                events = events | {"near_singular"}
            elif decision.solved:
                twist_rates = self.problem.model.twist_rates(Q[0], v[0], u, self._tick)
        command = Command(
            time=estimate.time,
            delay=estimate.delay.seconds,
            delay_deviation=estimate.delay.deviation,
            state=np.concatenate([Q[0], v[0]]),
            u=u,
            tick=self._tick,
            edges=edges,
            plan=decision.plan,
            sequence=decision.sequence,
            prediction=decision.prediction,
            solution=decision.attempt.solution,
            events=events,
            switches=situation.switches,
            disturbance=estimate.disturbance,
            levels=decision.levels,
            law=law,
            load=memory.load,
            inertia=memory.inertia,
            problem=self.problem,
            new_targets=memory.new_targets,
            stages=situation.stages,
            closed=closed,
            driven=np.array([self._driven[stage] for stage in stages_of_ticks]),
            route_progress=memory.route.progress.get(decision.sequence.first, np.nan),
            twist_rates=twist_rates,
            wheels=np.zeros(0) if memory.wheels is None else memory.wheels.momentum,
            shut=self._shut(situation, stages_of_ticks),
            held=np.isin(stages_of_ticks, self._held_by_mount) if self._held_by_mount else np.zeros(0, bool),
        )
        return estimate, command

    def _shut(self, situation: Situation, stages_of_ticks: list[int]) -> np.ndarray:
        """Return which thrusters must not fire at each tick (M, T), whose stage it says."""
        by_stage = {
            stage: self._plumes[stage].shut_now(situation.stages[stage])
            if stage in self._plumes
            else np.zeros(len(self.problem.model.spec.thrusters), bool)
            for stage in set(stages_of_ticks)
        }
        return np.array([by_stage[stage] for stage in stages_of_ticks])

    def _largest_changes(self, situation: Situation, decision: Decision, edges: np.ndarray) -> np.ndarray | None:
        """Return by how much accelerations may change to each tick, down and up (2, M, n); None without limits of jerk.

        Of a tick those of the stage count that is in force where it begins.
        """
        if not self._limits_jerk:
            return None
        limits = [situation.stages[stage].limits for stage in _stages_at(decision.sequence, edges[:-1])]
        low = np.array([of_tick.jerk_low for of_tick in limits])
        high = np.array([of_tick.jerk_high for of_tick in limits])
        return np.asarray(self._tick * np.array([low, high]))


def _stages_at(sequence: MovingSequence, ticks: np.ndarray) -> list[int]:
    """Return the index of the stage in force at the beginning of each tick (M,) [s], by planned switch times."""
    return [
        sequence.segments[place] for place in np.searchsorted(sequence.switch_times, ticks + ROUNDING, side="right")
    ]


def _remembered(memory: Memory, situation: Situation, decision: Decision, estimate: Estimate) -> Memory:
    """Return what lasts until the next sample."""
    return replace(
        memory,
        sequence=decision.sequence,
        time=situation.estimate.time,
        plans=decision.plans,
        solution=decision.attempt.solution,
        levels=decision.levels,
        unfinished=decision.attempt.unfinished,
        estimate=estimate,
        new_targets=(),
    )


def _solver_spec(task: TaskSpec) -> SolverSpec:
    """Return the settings of a task's solver; windows that are compared have to be solved to their optima."""
    if not task.solver.traits.real_time or (task.controller.multistart or 1) == 1:
        return task.solver
    return task.solver.model_copy(update={"iterations": max(task.solver.iterations, MULTISTART_ITERATIONS)})
