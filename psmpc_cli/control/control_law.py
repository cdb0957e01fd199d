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
from psmpc_cli.control.sequence import (
    FaultKind,
    GraspFault,
    MovingSequence,
    Switch,
    drop_met_stage,
    drop_passed_stages,
    with_detected_stage,
)
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

    What changes from sample to sample is in the `Memory` that `decide` takes and returns.

    Attributes:
        problem: The task made computable.
        solver: Solves its windows.
        builder: Builds them.
    """

    def __init__(self, problem: Problem, solver: Solver | None = None) -> None:
        """Build all that depends on the task alone, so that no sample waits for it.

        Args:
            problem: The task made computable.
            solver: Solves its windows; by default what the task names.
        """
        spec = problem.spec
        rate = spec.plant.low_level_rate
        noise = standard_deviations(spec.measurement_noise, problem.model.spec)
        self.problem = problem
        self.solver = solver or build_solver(problem, _solver_spec(spec))
        problem.law.prepare()  # derives CasADi functions, which takes seconds
        self.builder = WindowBuilder(problem)
        self._spec = spec.controller
        self._one_stage = spec.controller.traits.one_stage
        # beginnings of the low-level ticks of a sample, and the end of the last one, from the sample's time on [s]
        self._tick_offsets = np.arange(round(self._spec.sample_time * rate) + 1) / rate
        self._tick = 1 / rate
        self._held_stages = spec.held_stages
        self._timeouts = [spec.timeout_of(stage) for stage in range(len(spec.stages))]  # of stages that take the object
        self._has_rates = any(stage.has_rates for stage in problem.stages)
        self._limits_jerk = any(JERK in stage.constraints for stage in problem.stages)
        model = problem.model
        # 1 for each coordinate of the base that something moves in a stage, else 0
        self._driven = [model.driven(stage.moved_by) for stage in problem.stages]
        self._held_by_mount = list(problem.spec.stages_on_mount(model.spec))
        self._plumes = {
            stage.index: PlumeForecast.of(spec, model, stage.index)
            for stage in problem.stages
            if spec.avoids_plumes(stage.index, model.spec)
        }
        # coordinates that have a force of their own in some stage
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

        Returns:
            What the next sample needs, and the command to send to the robot.

        Raises:
            RunError: Nothing is measured, and there is no plan yet.
        """
        stop_at = perf_counter() + self.solver.deadline  # infinite without a deadline
        memory, situation = self._estimate_situation(memory, measurement)
        memory, situation = self._drop_ended_stages(memory, situation)
        memory, situation = self._retry_missed_grasp(memory, measurement, situation)
        memory, situation = self._complete_for_solves(memory, situation)
        prediction = self._shifted_plan(memory, situation)  # the last plan, from now on
        # the next stage enters the window when its switch is predicted; targets on an object are then placed anew
        longer = self._detect_next_stage(memory, situation, prediction)
        situation = self._with_targets_at_stage_ends(longer, memory, situation)
        attempts = self._attempts(memory, situation, prediction, stop_at)
        attempt = attempts.solve_longest(memory.sequence, longer)
        decision = self._accept_or_fall_back(memory, situation, attempt, prediction, stop_at)
        events = self._names_of_events(memory, measurement, situation, longer, decision)
        estimate, command = self._build_command(memory, situation, decision, events)
        return _memory_after(memory, situation, decision, estimate), command

    def _estimate_situation(self, memory: Memory, measurement: Measurement) -> tuple[Memory, Situation]:
        """Estimate the state in which the coming command begins to act, and place the stages' targets about it.

        A command reaches the robot after a delay. So the robot's estimated state, and an object in its grippers, are
        predicted from the time of the measurement to the time at which the command begins to act. Solvers work in a
        chart: three numbers for each attitude near that of this state. If the attitude was not measured, the chart is
        about the attitude that the plan in force has then.

        Returns:
            The memory with the new estimates, and the sample as all later steps of `decide` see it.
        """
        measured_at = measurement.time
        estimate = self._estimate_robot(memory, measurement)
        time = estimate.acts_at  # when the command begins to act
        grip = self._holding_gripper(memory.sequence, measured_at, estimate.state)
        target_object = memory.target_object.with_measurement(measured_at, measurement.object_pose, grip)
        expected = self._estimator.predicted_over_delay(estimate)
        chart = self._chart_about(expected, memory.plans.current, time)
        x_chart = np.asarray(chart.to_chart(expected.Q[None], expected.v[None])[0])
        memory = replace(memory, plans=memory.plans.in_chart(chart), target_object=target_object)
        memory = self._with_identified_parameters(memory, measurement.state, estimate, is_held=grip is not None)
        if time > measured_at:
            grip_then = self._holding_gripper(memory.sequence, measured_at, expected)
            target_object = target_object.carried(time - measured_at, grip_then)
        route = self._guide.updated_progress(memory.route, memory.sequence.first, time, expected, target_object)
        memory = replace(memory, route=route)
        placement = self._place_stages(memory, time, x_chart, chart, target_object, estimate.speed_reserve)
        is_measured = isfinite(measurement.state.vector @ measurement.state.vector)
        situation = Situation(time, estimate, target_object, x_chart, is_measured, placement)
        return replace(memory, signs=placement.signs), situation

    def _estimate_robot(self, memory: Memory, measurement: Measurement) -> Estimate:
        """Return what is known of the robot after a measurement: its state, a disturbance, the delay of commands."""
        return self._estimator.after_measurement(
            memory.estimate,
            measurement.time,
            measurement.state,
            grippers_moved=memory.sequence.moves_grippers(self.problem.held_stages, memory.time, measurement.time),
            shares_load=self._several_grippers_hold(memory),
            is_loaded=memory.sequence.first in self.problem.held_stages and not self.problem.law.knows_load,
            actuated=self.problem.model.actuated(self.problem.stages[memory.sequence.first].moved_by),
        )

    def _with_identified_parameters(self, memory: Memory, state: State, estimate: Estimate, is_held: bool) -> Memory:
        """Return the memory with what is estimated besides the state: masses, what wheels store, a load.

        Args:
            memory: That of the sample before, with the object as it is now.
            state: As it is measured.
            estimate: What is known of it.
            is_held: Whether a gripper holds the object.
        """
        for step in self._identification:
            law = self._low_level_law(memory, memory.sequence.first, is_held=False)
            memory = step.after_measurement(memory, state, estimate, is_held, law)
        return memory

    def _low_level_law(self, memory: Memory, stage: int, is_held: bool) -> LowLevelLaw:
        """Return the low-level law of a stage with all that is found out, where hands hold the object or do not."""
        law = self.problem.law.driving(self._driven[stage])
        for step in self._identification:
            law = step.applied(law, memory, is_held)
        return law

    def _several_grippers_hold(self, memory: Memory) -> bool:
        """Tell whether several grippers hold the object: what they are commanded to do differently they cannot."""
        return memory.sequence.first in self.problem.held_stages and len(self.problem.body.grippers) > 1

    @staticmethod
    def _stage_at(sequence: MovingSequence, time: float) -> int:
        """Return the index of the stage that the robot was in at a time [s], before what the last command began."""
        return sequence.first - int(sequence.first > 0 and time < sequence.progress.entered)

    def _holding_gripper(self, sequence: MovingSequence, time: float, state: State) -> Grip | None:
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

    def _place_stages(
        self,
        memory: Memory,
        time: float,
        x_chart: np.ndarray,
        chart: Chart,
        target_object: ObjectEstimate,
        speed_reserve: np.ndarray,
        at_planned_ends: bool = False,
    ) -> Placement:
        """Return all stages of the task with their targets in a chart.

        This is `Placer.place` with what the memory has for it.

        Args:
            memory: Has the sequence of stages, the plan, and the signs of quaternions of the sample before.
            time: When the coming command begins to act [s].
            x_chart: The state then, in the chart (2n,).
            chart: The chart.
            target_object: What is known of the task's object, to which targets may be relative.
            speed_reserve: By how much plans stay below limits of velocities, see `Estimate`.
            at_planned_ends: Such targets are where the object is when their stage is planned to end; else where it is
                at the time.
        """
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
            speed_reserve=speed_reserve,
            at_planned_ends=at_planned_ends,
        )

    def _drop_ended_stages(self, memory: Memory, situation: Situation) -> tuple[Memory, Situation]:
        """Drop the stages that are over, by the plan or by the measured state."""
        time = situation.time
        x_chart = situation.x_chart
        stages = situation.stages
        costs = self.problem.costs
        sequence = memory.sequence.with_measurement(stages, costs, time, x_chart)
        may_end = stages[sequence.first].end.accepts(self._planned_end(sequence, memory.solution, situation))
        sequence, passed = drop_passed_stages(sequence if may_end else sequence.current_only, time)
        sequence, met = drop_met_stage(
            sequence.with_measurement(stages, costs, time, x_chart), stages, costs, time, x_chart
        )
        sequence = sequence.with_measurement(stages, costs, time, x_chart)
        return replace(memory, sequence=sequence), replace(situation, switches=(*passed, *met))

    def _retry_missed_grasp(
        self, memory: Memory, measurement: Measurement, situation: Situation
    ) -> tuple[Memory, Situation]:
        """Return to an earlier stage if grippers report that they missed the object or lost it, or take too long.

        The task says in `if_missed` to which stage, and how many times. If it allows no return, or none is left, the
        memory's grasp keeps the fault, which says that the mission has failed, and the sequence goes on. Nothing
        changes without such a report or a timeout that is over, nor after the mission has failed.

        Returns:
            The memory with what grippers have reported, after a return with the earlier stage as the current one; and
            the situation with the events `missed` and `returned`, if there was such a report.
        """
        if memory.grasp.has_failed:
            return memory, situation
        grasp = memory.grasp
        fault = self._fault_of_timeout(memory.sequence, situation.time)
        if measurement.holding is not None and fault is None:
            grasp, fault = grasp.after_report(
                memory.sequence,
                held=self.problem.held_stages,
                grippers=self.problem.body.grippers,
                holding=measurement.holding,
                time=measurement.time,
            )
        if fault is None:
            return replace(memory, grasp=grasp), situation
        back_to, allowed_returns = self.problem.spec.retry_after(fault.stage)
        returns = grasp.returns.get(fault.stage, 0)
        if returns >= allowed_returns:
            grasp = replace(grasp, fault=fault)
            return replace(memory, grasp=grasp), replace(situation, grasp_events=frozenset({"missed"}))
        grasp = replace(grasp, is_taken=False, returns={**grasp.returns, fault.stage: returns + 1})
        memory, situation = self._return_to_stage(replace(memory, grasp=grasp), situation, back_to)
        return memory, replace(situation, grasp_events=frozenset({"missed", "returned"}))

    def _fault_of_timeout(self, sequence: MovingSequence, now: float) -> GraspFault | None:
        """Return the fault of a stage whose timeout is over now [s] and that has not taken the object yet; else None.

        The task sets the timeout in `if_missed`: how long a stage may try to take the object.
        """
        stage = sequence.first
        if now < sequence.progress.entered + self._timeouts[stage] - ROUNDING:
            return None
        return GraspFault(self.problem.body.grippers, FaultKind.TIMED_OUT, stage, now)

    def _return_to_stage(self, memory: Memory, situation: Situation, stage: int) -> tuple[Memory, Situation]:
        """Make a stage that has ended the current one again, after grippers have missed or lost the object.

        The stage begins now. The last solve assumed that the grippers hold the object, so the next solve does not start
        from it: it is a cold one. The targets of all stages are placed anew, as numbers in the chart of this sample,
        relative to the object where it is measured. How far the robot has come on the routes of this stage and of those
        after it is found anew, from where it will be when the command acts. A route is a path of straight motions
        around obstacles; its progress is the share of its length that lies behind the robot.

        Args:
            memory: What is known so far.
            situation: This sample, with the stages placed for the stage that was the current one.
            stage: Index of the stage to return to.

        Returns:
            Both with this stage as the current one.
        """
        time = situation.time
        earlier = {index: progress for index, progress in memory.route.progress.items() if index < stage}
        expected = self._estimator.predicted_over_delay(situation.estimate)
        route = self._guide.updated_progress(RouteProgress(earlier), stage, time, expected, memory.target_object)
        memory = replace(
            memory,
            sequence=MovingSequence.of(stage, time),
            route=route,
            plans=replace(memory.plans, sequence=None),  # followed until the next solve, but of other stages
            # what solves would start from: the last solution, those of HTMPC's levels, and an unfinished one
            solution=None,
            levels=(),
            unfinished=None,
            arguments={},  # of constraints: the first sample of a stage sets them
        )
        placement = self._place_stages(
            memory,
            time,
            situation.x_chart,
            situation.placement.chart,
            memory.target_object,
            situation.estimate.speed_reserve,
        )
        memory = replace(memory, signs=placement.signs)
        return memory, replace(situation, target_object=memory.target_object, placement=placement)

    def _complete_for_solves(self, memory: Memory, situation: Situation) -> tuple[Memory, Situation]:
        """Complete the situation for the solves: state, targets relative to the object, arguments of constraints.

        - Targets relative to a moving object are placed where the object will be when their stage is planned to end.
        - Where the state was not measured, that of the plan in force takes its place.
        - Some constraints have numbers that are set anew at every sample, their *arguments*, such as the place of a
          moving obstacle.

        Returns:
            Memory and situation with these.

        Raises:
            RunError: Nothing is measured, and there is no plan yet.
        """
        time = situation.time
        x_chart = situation.x_chart
        sequence = memory.sequence
        placement = situation.placement
        if self._placer.follows_object:
            placement = self._place_stages(
                memory,
                time,
                x_chart,
                placement.chart,
                situation.target_object,
                situation.estimate.speed_reserve,
                at_planned_ends=True,
            )
            memory = replace(memory, signs=placement.signs)
        x_chart = self._with_predicted(memory, time, x_chart)
        arguments = self._placer.sampled_arguments(
            time=time,
            sequence=sequence,
            x=x_chart,
            chart=placement.chart,
            plan=memory.plans.solved,
            target_object=situation.target_object,
            load=memory.load.numbers,
            arguments_before=memory.arguments,
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

    def _shifted_plan(self, memory: Memory, situation: Situation) -> Plan:
        """Return the last plan from now on; before the first plan, one without control."""
        time = situation.time
        horizon = self._spec.horizon
        plan = memory.plans.solved
        if plan is None:
            chart = situation.placement.chart
            return resting_plan(time, horizon, self._spec.uniform_nodes, situation.x_chart, chart)
        return shift(plan, time, horizon, situation.x_chart)

    def _detect_next_stage(self, memory: Memory, situation: Situation, prediction: Plan) -> MovingSequence | None:
        """Return the sequence with one stage more if the prediction reaches the end of its last stage; else None.

        A controller whose windows hold one stage alone has the current stage continue after its own planned end.
        """
        margin = self._spec.detection_margin
        return with_detected_stage(
            memory.sequence, situation.stages, self.problem.costs, prediction, margin, is_of_one_stage=self._one_stage
        )

    def _with_targets_at_stage_ends(
        self, longer: MovingSequence | None, memory: Memory, situation: Situation
    ) -> Situation:
        """Return the situation with targets placed for a longer sequence: where the object is when its stages end."""
        if longer is None or not self._placer.follows_object:
            return situation
        extended = replace(memory, sequence=longer)
        placement = self._place_stages(
            extended,
            situation.time,
            situation.x_chart,
            situation.placement.chart,
            situation.target_object,
            situation.estimate.speed_reserve,
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

    def _accept_or_fall_back(
        self, memory: Memory, situation: Situation, attempt: Attempt, prediction: Plan, stop_at: float
    ) -> Decision:
        """Decide which plan is applied: that of this sample's solve if it succeeded, else a fallback.

        A solution of HTMPC is first refined by its *levels*: further solves, one for each later stage, none of which
        may make an earlier stage worse. The fallback is the last solved plan, shifted in time; once it is used up, it
        is a plan that brakes the robot to rest.

        A solution does not count if the state was not measured and the last solved plan is used up before the next
        sample: it would start from a state that this plan predicts, which no measurement has confirmed for long.

        If the current stage ends when the object in the grippers is delivered, and it is not yet, the fallback follows
        the last solved plan to the planned end of this stage alone. What the plan does later, such as move the hands
        apart, belongs to a stage that has not begun.

        Args:
            memory: What the sample before has left.
            situation: This sample.
            attempt: The solve that counts, and its stages.
            prediction: The last plan from now on, from which the solves have started.
            stop_at: When solves have to stop, an instant of `time.perf_counter` [s].
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
            plan = (levels or (solution,))[-1].plan  # only HTMPC has levels
            plans = memory.plans.on_success(plan, sequence)
        else:
            plans = memory.plans
            if stage.end.awaits_object:
                plans = plans.trusted_to_end_of(sequence.first)
                # a switch that is due without the object is planned anew
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
            plans = plans.fully_trusted()
        return Decision(
            solved=solved,
            attempt=attempt,
            prediction=prediction,
            sequence=sequence,
            levels=levels,
            plan=plan,
            plans=plans,
        )

    def _names_of_events(
        self,
        memory: Memory,
        measurement: Measurement,
        situation: Situation,
        longer: MovingSequence | None,
        decision: Decision,
    ) -> frozenset[str]:
        """Return the names of the events of this sample, which `Command.events` explains and logs record.

        Args:
            memory: Before the decision: its sequence has the stages that were in the window.
            measurement: What was measured.
            situation: This sample; has the events of grippers.
            longer: The sequence with the stage that has appeared, which was tried first; None where none has.
            decision: What came of the solves.
        """
        happened = {
            "appended": decision.sequence.last > memory.sequence.last,
            "postponed": decision.sequence.last < (longer or memory.sequence).last,  # fewer stages than tried first
            "solve_failed": not decision.solved,
            "braking": decision.plans.braking is not None,
            "unmeasured": not situation.is_measured,
            "load_dropped": memory.load.dropped,
            "gap": measurement.follows_a_gap(memory.time, self._spec.sample_time),
            "retargeted": bool(memory.new_targets),
        }
        return situation.grasp_events.union(name for name, yes in happened.items() if yes)

    def _build_command(
        self, memory: Memory, situation: Situation, decision: Decision, events: frozenset[str]
    ) -> tuple[Estimate, Command]:
        """Return the command over the coming sample, and the estimate that counts it."""
        edges = situation.time + self._tick_offsets
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
        planned = self.problem.law.attainable_accelerations(Q[0], v[0], planned, closed, self._tick)
        stages_of_ticks = _stages_in_force(decision.sequence, edges[:-1])
        current = decision.sequence.first
        law = self._low_level_law(memory, current, is_held=current in self._held_stages)
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
            shut=self._shut_thrusters(situation, stages_of_ticks),
            held=np.isin(stages_of_ticks, self._held_by_mount) if self._held_by_mount else np.zeros(0, bool),
        )
        return estimate, command

    def _shut_thrusters(self, situation: Situation, stages_of_ticks: list[int]) -> np.ndarray:
        """Return which of T thrusters must not fire at each of M ticks (M, T), because of what their plumes reach.

        Args:
            situation: This sample, with the stages as they are placed.
            stages_of_ticks: Index of the stage that is in force at each tick.
        """
        by_stage = {
            stage: self._plumes[stage].shut_now(situation.stages[stage])
            if stage in self._plumes
            else np.zeros(len(self.problem.model.spec.thrusters), bool)
            for stage in set(stages_of_ticks)
        }
        return np.array([by_stage[stage] for stage in stages_of_ticks])

    def _largest_changes(self, situation: Situation, decision: Decision, edges: np.ndarray) -> np.ndarray | None:
        """Return by how much accelerations may change to each tick, down and up (2, M, n); None without limits of jerk.

        The limits of a tick are those of the stage that is in force when the tick begins.
        """
        if not self._limits_jerk:
            return None
        limits = [situation.stages[stage].limits for stage in _stages_in_force(decision.sequence, edges[:-1])]
        low = np.array([of_tick.jerk_low for of_tick in limits])
        high = np.array([of_tick.jerk_high for of_tick in limits])
        return np.asarray(self._tick * np.array([low, high]))


def _stages_in_force(sequence: MovingSequence, ticks: np.ndarray) -> list[int]:
    """Return the index of the stage in force at the beginning of each tick (M,) [s], by planned switch times."""
    return [
        sequence.segments[place] for place in np.searchsorted(sequence.switch_times, ticks + ROUNDING, side="right")
    ]


def _memory_after(memory: Memory, situation: Situation, decision: Decision, estimate: Estimate) -> Memory:
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
