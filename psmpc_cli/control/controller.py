"""The controller of one run, which users step: the control law, and what lasts from one sample to the next."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from psmpc_cli.control.control_law import ControlLaw
from psmpc_cli.control.interface import Command, Measurement, NewTarget, State
from psmpc_cli.control.routes.guidance import RouteProgress
from psmpc_cli.control.sequence import MovingSequence
from psmpc_cli.ocp.feasibility.checks import ensure_feasible
from psmpc_cli.ocp.problem import Problem, build_problem
from psmpc_cli.solvers import Solver
from psmpc_cli.specs.arguments import rejected, require
from psmpc_cli.specs.document import plain, quoted
from psmpc_cli.specs.load import Task


class Controller:
    """Priority-based switching MPC, and what it is compared with, for one run.

    Attributes:
        problem: The task made computable.
        law: What decides at each sample.
        memory: What the last sample has left.
    """

    def __init__(self, task: Task | Problem, solver: Solver | None = None) -> None:
        """Build the controller of a task, and compile what its windows need.

        Args:
            task: The task, or its problem: the same with all functions and numbers that solvers need.
            solver: Solves the windows, the optimization problems of single samples; by default what the task names.

        Raises:
            InputError: `task` is neither a task nor a problem, or `solver` is no solver.
        """
        require("task", task, (Task, Problem), "a Task, from load_task")
        require("solver", solver, (Solver, type(None)), "a Solver, or None for the task's own")
        self.problem = task if isinstance(task, Problem) else build_problem(task)
        self.law = ControlLaw(self.problem, solver)
        self.memory = self.law.first
        _ = self.problem.model.dynamics  # before the robot moves: `Command.force` evaluates them

    def __repr__(self) -> str:
        name = f"{self.problem.spec.controller.kind} for {self.problem.spec.name}"
        stage = self.problem.stages[self.sequence.first].name
        began = self.memory.time > -np.inf
        when = f"{'done' if self.done else stage} at {self.memory.time:g} s" if began else "before its first sample"
        return f"<Controller {name}: {len(self.problem.stages)} stages; {when}>"

    def step(
        self,
        time: float,
        state: State,
        object_pose: np.ndarray | None = None,
        holding: Mapping[str, bool] | None = None,
    ) -> Command:
        """Decide what the robot does over the coming sample. Paper Algorithm 1.

        Args:
            time: Of the measurement [s], a sample after the one before.
            state: Measured then. Where it is not finite the plan's own prediction is used, at most until the end of
                the plan in force when the state was last measured completely.
            object_pose: Pose of a task's object with a mass, measured with the state, (3,) or (7,); where it is not
                finite, or not given, the object's motion is predicted.
            holding: Whether each gripper holds that object, by arm, measured with the state: False of one that has
                closed on nothing or has lost it. A gripper that is open, or still moves, or does not report is left
                out. Where a gripper reports False in a stage that holds the object, the sequence returns to an earlier
                stage if the task says so (`if_missed`); else the mission has failed, see `failure`.

        Raises:
            InputError: The time is not after the sample before, the state or the pose is not of the task's robot or
                object, or a gripper is none of the object's grasp.
            RunError: Nothing is measured, and there is no plan yet.
        """
        measurement = Measurement(time, state, object_pose, holding)
        measurement.require_valid_for(self.problem, self.memory.time)
        self.memory, command = self.law.decide(self.memory, measurement)
        return command

    def retarget(self, stage: str, target: Mapping[str, Any], *, feasibility: bool = True) -> None:
        """Change the target of a stage from the next sample on.

        The window is the part of the task that is optimized at a sample: the current stage, and later ones whose
        beginning is planned within the horizon. Stages that come after the changed one leave the window, because its
        end is to be planned anew. The next solve starts from the plan in force. If that leads to no solution, the
        solver makes a cold start, as after any blow.

        Args:
            stage: Name of the stage: the current one, or one that comes later or may come again.
            target: Its target, as a task file has it, or with arrays of numbers.
            feasibility: Whether a target out of reach, or outside limits, is rejected, as in `load_task`; that takes
                up to a second.

        Raises:
            InputError: There is no such stage, or it is over and cannot come again.
            SpecError: Something is wrong with the target; nothing has changed.
        """
        require("feasibility", feasibility, bool, "True or False")
        names = [each.name for each in self.problem.stages]
        # stages that are over may come again where the task says so: after grippers have missed the object
        retries = map(self.problem.spec.retry_after, range(len(names)))
        earliest = min([self.sequence.first, *(back_to for back_to, returns in retries if returns)])
        if stage not in names[earliest:]:
            raise rejected("stage", stage, f"one that is not over: {', '.join(map(quoted, names[earliest:]))}")
        written = plain(target)
        problem = self.problem.retargeted(stage, written)
        if feasibility:
            ensure_feasible(problem.task)
        index = names.index(stage)
        sequence = self.sequence
        if index == sequence.first:
            sequence = sequence.current_only
        elif index in sequence.segments:
            sequence = sequence.up_to(index)
        # signs of quaternions, and progress on routes, of later stages depend on where this one now leads
        signs = {number: of_stage for number, of_stage in self.memory.signs.items() if number < index}
        progress = {number: share for number, share in self.memory.route.progress.items() if number < index}
        self.problem = problem
        self.law = self.law.retargeted(problem)
        self.memory = replace(
            self.memory,
            sequence=sequence,
            signs=signs,
            route=RouteProgress(progress),
            unfinished=None,
            new_targets=(*self.memory.new_targets, NewTarget(stage, written)),
        )

    @property
    def done(self) -> bool:
        """Whether the last stage has met its end condition. A controller that is done holds its target."""
        return bool(np.isfinite(self.sequence.ended_at))

    @property
    def failure(self) -> str:
        """Why the mission cannot succeed any more; empty while it can.

        In the last try grippers have missed or lost the object, or taken too long. A controller whose mission has
        failed goes on to decide as if they held it.
        """
        fault = self.memory.grasp.fault
        if fault is None:
            return ""
        return fault.describe(self.problem.stages[fault.stage].name, self.memory.grasp.tries)

    @property
    def sequence(self) -> MovingSequence:
        """The stages in the window."""
        return self.memory.sequence
