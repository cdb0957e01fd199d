"""What a sample sets of the task's stages: the chart of the attitude, and where targets are in it."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from psmpc_cli.control.identification.tracking import ObjectEstimate
from psmpc_cli.control.identification.wheels import WheelEstimate, WheelEstimator
from psmpc_cli.control.sequence import MovingSequence
from psmpc_cli.ocp.plan import Plan, resting_plan
from psmpc_cli.ocp.problem import Problem
from psmpc_cli.ocp.stage import ConstraintNumbers, PlacedStage, SampleContext
from psmpc_cli.robot.configuration import Chart
from psmpc_cli.robot.model import RobotModel

QUATERNION_FLIP_THRESHOLD = -0.17
"""Real part of an attitude's error at which the other sign of its quaternion is taken: an error of some 200 deg."""

RECENT_SAMPLES = 1.5
"""Age in samples up to which a measurement of the held object counts: that of the sample before does."""

PREDICTION_SAMPLES = 9
"""Number of states of the plan in force at which constraints look for what comes near."""

Signs = Mapping[int, Mapping[str, float]]
"""Signs of the quaternions in spatial targets, by stage index and frame."""


@dataclass(frozen=True, eq=False)
class Placement:
    """The stages of a task at a sample.

    Attributes:
        chart: The chart that state, plans and targets are in.
        stages: All stages of the task, with the numbers of their targets.
        signs: Of their quaternions.
    """

    chart: Chart
    stages: tuple[PlacedStage, ...]
    signs: Signs

    def with_arguments(self, arguments: Mapping[str, np.ndarray]) -> "Placement":
        """Return the placement with the arguments of constraints that samples set, by name."""
        return replace(self, stages=tuple(stage.with_arguments(arguments) for stage in self.stages))


class Placer:
    """Places the stages of a problem.

    In space a target's attitude is one of two quaternions; the nearer one where the stage begins in the plan is taken,
    and kept until the error passes 200 deg, so that an error that passes 180 deg within a horizon stays smooth.

    Attributes:
        follows_object: Some target is relative to an object that moves.
    """

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        self._stages = tuple(stage.unplaced_copy() for stage in problem.stages)
        self._horizon = problem.spec.controller.horizon
        self._wheels = WheelEstimator(problem)
        self.follows_object = any(stage.on_object for stage in problem.stages)

    def place(
        self,
        time: float,
        x: np.ndarray,
        chart: Chart,
        sequence: MovingSequence,
        plan: Plan | None,
        target_object: ObjectEstimate,
        load: np.ndarray,
        signs: Signs,
        waypoints: Mapping[int, np.ndarray],
        speed_reserve: np.ndarray,
        at_planned_ends: bool = False,
    ) -> Placement:
        """Return the stages of the task with their targets as numbers in the chart, which solvers need.

        A target may be relative to an object, and its attitude is one of two quaternions, q and -q. So the numbers
        depend on where the object is, and on the robot's attitude. By default targets relative to the object are where
        it is now.

        Args:
            time: Of the sample [s].
            x: Measured state in the chart (2n,).
            chart: The chart, in which attitudes are rotation vectors from the measured one.
            sequence: The stages in the window.
            plan: The plan in force, in the chart; None before the first.
            target_object: What is known of the object.
            load: Mass [kg] and principal moments [kg m^2] that a load is taken to have; empty where the task says them.
            signs: Signs of the targets' quaternions at the sample before.
            waypoints: By stage index, points of routes as targets, which costs follow while the robot is on a route.
            speed_reserve: By how much plans are to stay below limits of velocities, (n,) [m/s, rad/s]; (0,) where they
                need not.
            at_planned_ends: Targets relative to the object are where it is when their stage is planned to end, or at
                the end of the horizon. A current stage whose end is never planned follows the object over the horizon.
        """
        stages: Sequence[PlacedStage] = self._stages
        if self.follows_object:
            stages = self._with_targets_on_object(time, sequence, target_object, at_planned_ends)
        if self._problem.spec.routes is not None:
            stages = tuple(stage.with_waypoint(waypoints.get(stage.index)) for stage in stages)
        plan = plan or resting_plan(time, self._horizon, nodes=1, x=x, chart=chart)
        # when stages begin, by index: the current one counts from now
        begins = dict(enumerate([time, *sequence.switch_times][: sequence.count], start=sequence.first))
        all_signs = {
            stage.index: self._quaternion_signs(
                stage, plan, begins.get(stage.index), sequence, signs.get(stage.index, {})
            )
            for stage in stages
        }
        model = self._problem.model
        if sequence.first in self._problem.held_stages:
            stages = self._with_held_object(stages, time, x, chart, target_object)
        if len(load):
            stages = tuple(stage.with_load(load) for stage in stages)
        if len(speed_reserve):
            stages = self._with_speed_reserve(stages, speed_reserve, x, chart)
        posture = model.space.posture(x[model.space.joint_rates])
        charted = tuple(stage.in_chart(chart.anchor, posture, all_signs[stage.index]) for stage in stages)
        return Placement(chart, charted, all_signs)

    def _with_speed_reserve(
        self, stages: Sequence[PlacedStage], wanted: np.ndarray, x: np.ndarray, chart: Chart
    ) -> tuple[PlacedStage, ...]:
        """Return the stages with limits of velocities tightened as far as the measured velocities allow.

        Args:
            stages: The stages.
            wanted: By how much limits are to be tighter, (n,) [m/s, rad/s].
            x: Measured state in the chart (2n,).
            chart: The chart.
        """
        _, v = chart.from_chart(x[None])
        sample_time = self._problem.spec.controller.sample_time
        return tuple(
            stage.with_speed_reserve(stage.limits.available_speed_reserve(wanted, v[0], sample_time))
            for stage in stages
        )

    def sampled_arguments(
        self,
        time: float,
        sequence: MovingSequence,
        x: np.ndarray,
        chart: Chart,
        plan: Plan | None,
        target_object: ObjectEstimate,
        load: np.ndarray,
        arguments_before: Mapping[str, np.ndarray],
        wheels: WheelEstimate | None = None,
    ) -> dict[str, np.ndarray]:
        """Return the numbers of constraints that are set anew at every sample, their arguments, by constraint.

        An example is the pose of a moving obstacle from which the robot keeps clear. All stages in the window share an
        argument: the first stage from the current one on in which the constraint has one sets it.

        Args:
            time: Of the sample [s].
            sequence: The stages in the window.
            x: State in the chart (2n,).
            chart: The chart.
            plan: The plan in force, in the chart; None before the first.
            target_object: What is known of the object.
            load: Mass [kg] and principal moments [kg m^2] that a load is taken to have; empty where the task says them.
            arguments_before: The arguments at the sample before.
            wheels: Momenta that reaction wheels store at the time of the measurement; None of a robot without any.

        Returns:
            Arrays by name of the constraint; empty if no stage has such a constraint.
        """
        arguments = dict[str, np.ndarray]()
        sampled = [(stage, stage.sampled_constraints) for stage in self._stages[sequence.first :]]
        if not any(constraints for _, constraints in sampled):
            return arguments
        view = SampleContext(
            time=time,
            x=x,
            anchor=chart.anchor,
            prediction=None if plan is None else _sampled_prediction(plan, time),
            object_state=target_object.at(time),
            load=load,
            plan=plan,
        )
        stored: Mapping[int, np.ndarray] = {}
        if wheels is not None:
            view = replace(view, unseen=self._wheels.unseen(wheels))
            stored = self._wheel_momenta_by_stage(wheels, sequence, plan)
        for stage, constraints in sampled:
            for name in constraints.keys() - arguments.keys():
                at_stage = replace(
                    view,
                    is_current=stage.index == sequence.first,
                    argument_before=arguments_before.get(name),
                    stored=stored.get(stage.index),
                )
                argument = _sampled_argument(constraints[name], self._problem.model, at_stage)
                if argument is not None:
                    arguments[name] = argument
        return arguments

    def _wheel_momenta_by_stage(
        self, wheels: WheelEstimate, sequence: MovingSequence, plan: Plan | None
    ) -> dict[int, np.ndarray]:
        """Return what reaction wheels store in the current stage and in those after it, by index of the stage.

        Limits on wheels start from it, see `WheelEstimator.stored_in_stages`. It depends on the state in which a stage
        begins. For a later stage that is the state of the plan in force at the planned switch time, or at the end of
        the plan if no switch is planned. Without a plan it is the measured state.
        """
        begins = dict(zip(range(sequence.first + 1, len(self._stages)), sequence.switch_times, strict=False))

        def states() -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
            yield sequence.first, wheels.Q, wheels.v
            for stage in self._stages[sequence.first + 1 :]:
                if plan is None:
                    yield stage.index, wheels.Q, wheels.v
                    continue
                X = plan.states_at(np.array([begins.get(stage.index, plan.end)]))
                Q, v = plan.chart.from_chart(X)
                yield stage.index, Q[0], v[0]

        return self._wheels.stored_in_stages(wheels, states())

    def _with_held_object(
        self,
        stages: Sequence[PlacedStage],
        time: float,
        x: np.ndarray,
        chart: Chart,
        target_object: ObjectEstimate,
    ) -> tuple[PlacedStage, ...]:
        """Return the stages with the object at the place in the grippers where it was measured.

        A grasp gives way, so that the object is not exactly where the task says it is held. If the object was not
        measured at this sample or the one before, or the state is not known, the stages stay as they are.

        Args:
            stages: The stages of the task.
            time: Of the sample [s].
            x: Measured state in the chart (2n,).
            chart: The chart.
            target_object: What is known of the object.
        """
        controller = self._problem.spec.controller
        oldest = time - RECENT_SAMPLES * controller.sample_time
        if target_object.measured_at < oldest or not np.isfinite(x).all():
            return tuple(stages)
        model = self._problem.model
        xi = np.asarray(model.charted(x[: model.n], chart.anchor)).ravel()
        return target_object.hold(stages, time, {frame: xi[rows] for frame, rows in model.pose_rows.items()})

    def _with_targets_on_object(
        self, time: float, sequence: MovingSequence, target_object: ObjectEstimate, at_planned_ends: bool
    ) -> tuple[PlacedStage, ...]:
        ends = dict(enumerate(sequence.switch_times, start=sequence.first))
        placed = list(self._stages)
        for stage in placed[sequence.first :]:
            when = float(ends.get(stage.index, time + self._horizon)) if at_planned_ends else time
            placed[stage.index] = target_object.place(stage, when)
        current = placed[sequence.first]
        if at_planned_ends and not current.end.is_planned:
            elapsed = time - sequence.progress.entered
            placed[sequence.first] = target_object.follow(current, time, elapsed, self._horizon)
        return tuple(placed)

    def _quaternion_signs(
        self, stage: PlacedStage, plan: Plan, begins: float | None, sequence: MovingSequence, signs: Mapping[str, float]
    ) -> Mapping[str, float]:
        """Choose between the quaternions q and -q of each attitude in a stage's target, by frame.

        Both are the same attitude. The one is taken that is nearer to the robot's attitude when the stage begins, so
        that the error is the shorter turn. The sign of the sample before is kept until that error passes 200 degrees:
        errors that pass 180 degrees within a horizon stay smooth.

        Args:
            stage: The stage, with its target in numbers of before this sample.
            plan: The plan in force, in which the robot's attitude is looked up.
            begins: When the stage begins in the plan [s]; None if it does not, then the end of the plan counts.
            sequence: The stages in the window.
            signs: Signs at the sample before, 1 or -1 by frame.

        Returns:
            1 or -1 by frame; what was given for a stage without attitudes.
        """
        if not stage.attitudes:
            return signs
        time = plan.end if begins is None else begins
        # a target that moves along a trajectory counts where it is so long after the stage has begun [s]
        since = time - sequence.progress.entered if stage.index == sequence.first else 0.0
        wanted = stage.wanted(since)
        model = self._problem.model
        Q = plan.states_at(np.array([time]))[0, : model.n]
        xi = np.asarray(model.charted(Q, plan.chart.anchor)).ravel()
        new_signs = dict(signs)
        for frame, row in stage.attitudes.items():
            # the inner product of two unit quaternions is the real part of the one that turns one into the other
            real_part = float(wanted[row : row + 4] @ xi[model.pose_rows[frame]][model.space.pose_attitude])
            sign = signs.get(frame)
            if sign is None or begins is None or sign * real_part < QUATERNION_FLIP_THRESHOLD:
                new_signs[frame] = 1.0 if real_part >= 0 else -1.0
        return new_signs


def _sampled_prediction(plan: Plan, time: float) -> tuple[np.ndarray, np.ndarray]:
    """Return times and states of a plan from a time on [s], some of them."""
    times = np.linspace(time, max(time, plan.end), PREDICTION_SAMPLES)
    return times, plan.states_at(times)


def _sampled_argument(constraint: ConstraintNumbers, model: RobotModel, sample: SampleContext) -> np.ndarray | None:
    return None if constraint.at_sample is None else constraint.at_sample(model, sample)
