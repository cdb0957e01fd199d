"""What the controller finds out at each sample besides the state, and the low-level law that counts with it.

Each kind of it is one step. A task has the steps that its robot, its object and its keys ask for; most have none.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import replace
from math import isfinite

import numpy as np

from psmpc_cli.control.estimator import Estimate
from psmpc_cli.control.identification.inertia import InertiaEstimator, MeasuredMotion
from psmpc_cli.control.identification.load import LoadEstimator, RobotAlone, RobotAndObject, RobotAndPayload
from psmpc_cli.control.identification.wheels import WheelEstimator
from psmpc_cli.control.interface import State
from psmpc_cli.control.memory import Memory
from psmpc_cli.ocp.loads import prior_of_load
from psmpc_cli.ocp.problem import Problem
from psmpc_cli.robot.low_level import LowLevelLaw


class IdentificationStep(ABC):
    """Finds out one kind of thing while the robot moves; what is known of it lasts in the memory."""

    def begun(self, memory: Memory) -> Memory:
        """Return the memory with what is known before the first sample."""
        return memory

    @abstractmethod
    def after_measurement(
        self, memory: Memory, state: State, estimate: Estimate, is_held: bool, law: LowLevelLaw
    ) -> Memory:
        """Return the memory with what is known after a measurement.

        Args:
            memory: That of the sample before, with what the steps before this one have found out.
            state: As it is measured.
            estimate: What is known of the state.
            is_held: Whether a gripper holds the object, whose state is known.
            law: The law that counts with what is known so far, of empty hands.
        """

    @abstractmethod
    def applied(self, law: LowLevelLaw, memory: Memory, is_held: bool) -> LowLevelLaw:
        """Return a law that counts with what is known, where hands hold the object or do not."""


def identification_steps(problem: Problem, noise: np.ndarray) -> Iterator[IdentificationStep]:
    """Yield what a controller estimates at each sample besides the state of robot and object, in the order of use.

    Masses of the robot come first, then the momentum of reaction wheels, then the load: a step uses what the steps
    before it have found. A task has the steps that its robot and its keys ask for; most have none.

    Args:
        problem: The task made computable.
        noise: Standard deviations of measured velocities (n,) [m/s, rad/s].
    """
    if problem.spec.finds_masses:
        yield _Inertias(problem, noise)
    if problem.model.spec.wheels:
        yield _Wheels(problem)
    if problem.spec.uncertainty.carried.is_estimated:
        yield _Payload(problem, noise)
    elif problem.spec.finds_load:
        yield _HeldObject(problem, noise)


class _Inertias(IdentificationStep):
    """Masses and inertias of the robot's bodies, and of what its grippers hold."""

    def __init__(self, problem: Problem, noise: np.ndarray) -> None:
        self._space = problem.model.space
        self._knows_load = problem.law.knows_load or problem.spec.uncertainty.carried.is_told
        self._held_stages = problem.spec.held_stages
        self._estimator = InertiaEstimator(problem.model, noise)

    def begun(self, memory: Memory) -> Memory:
        """Return the memory with the described masses and inertias, and their deviations."""
        return replace(memory, inertia=self._estimator.first)

    def after_measurement(
        self, memory: Memory, state: State, estimate: Estimate, is_held: bool, law: LowLevelLaw
    ) -> Memory:
        """Return the memory with what the motion since the sample before tells of masses and inertias.

        Nothing is learned at the first sample, nor while grippers hold an object that the low-level law knows: robot
        and object are a closed chain then.

        If the delay of commands is uncertain, so are the accelerations that acted whenever commands changed. Their
        deviation is the range of the commands that may have acted, times the part of the time that is in doubt; and it
        is infinite if nothing is known of the delay.

        Args:
            memory: That of the sample before.
            state: As it is measured; not used here.
            estimate: The estimated state, and the commands that were sent.
            is_held: Whether a gripper holds the object; not used here.
            law: The low-level law; not used here, since commands remember the law that applied them.
        """
        before = memory.estimate
        is_loaded = memory.sequence.first in self._held_stages
        if before is None or (is_loaded and self._knows_load):
            return memory
        inertia = self._estimator.holding(memory.inertia, is_loaded, memory.time)
        # what acted between two measurements was sent earlier by the delay
        delay = estimate.delay.seconds
        duration = estimate.time - before.time
        acting = list(estimate.commands.acting(before.time - delay, estimate.time - delay))
        changes = np.ptp(estimate.commands.commanded(before.time - delay - duration, estimate.time - delay), axis=0)
        is_known = np.isfinite(estimate.delay.deviation)
        uncertain = (
            changes * min(estimate.delay.deviation / duration, 1.0) if is_known else np.full(len(changes), np.inf)
        )
        step = np.array(self._space.difference(before.state.Q, estimate.state.Q))
        motion = MeasuredMotion(
            begin=before.time,
            end=estimate.time,
            Q=np.array(self._space.integrate(before.state.Q, step / 2)),
            v=(before.velocity + estimate.velocity) / 2,
            vdot=(estimate.velocity - before.velocity) / duration,
        )
        return replace(memory, inertia=self._estimator.after_measurement(inertia, motion, acting, uncertain))

    def applied(self, law: LowLevelLaw, memory: Memory, is_held: bool) -> LowLevelLaw:
        """Return a law that counts with the most likely masses and inertias."""
        return law.with_parameters(self._estimator.parameters(memory.inertia, is_held))


class _Wheels(IdentificationStep):
    """What reaction wheels store."""

    def __init__(self, problem: Problem) -> None:
        self._estimator = WheelEstimator(problem)

    def after_measurement(
        self, memory: Memory, state: State, estimate: Estimate, is_held: bool, law: LowLevelLaw
    ) -> Memory:
        """Return the memory with what wheels store.

        Where the robot was not measured what is known stays: angular momentum stays, too.
        """
        known = estimate.state
        if not isfinite(known.vector @ known.vector):
            return memory
        stage = memory.sequence.first
        wheels = self._estimator.after_measurement(memory.wheels, stage, estimate.time, known.Q, known.v, state.wheels)
        return replace(memory, wheels=wheels)

    def applied(self, law: LowLevelLaw, memory: Memory, is_held: bool) -> LowLevelLaw:
        """Return a law that counts with the momentum of the wheels; before the first sample with that of its own."""
        if memory.wheels is None:
            return law
        stored = np.array(self._estimator.wheels.along_base(memory.wheels.momentum.tolist()))
        return law.with_parameters(law.parameters.storing(stored))


class _Load(IdentificationStep):
    """Mass and moments of inertia of what the grippers hold."""

    def __init__(self, problem: Problem, noise: np.ndarray) -> None:
        self._estimator = LoadEstimator(problem.model, prior_of_load(problem.spec), noise)
        self._held_stages = problem.spec.held_stages

    @abstractmethod
    def _motion(self, memory: Memory, estimate: Estimate, is_held: bool) -> RobotAlone:
        """Return the robot at a sample with what it holds."""

    def begun(self, memory: Memory) -> Memory:
        """Return the memory with the prior of the load."""
        return replace(memory, load=self._estimator.first)

    def after_measurement(
        self, memory: Memory, state: State, estimate: Estimate, is_held: bool, law: LowLevelLaw
    ) -> Memory:
        """Return the memory with what the momentum of robot and load tells of the load."""
        load = memory.load
        motion = self._motion(memory, estimate, is_held)
        if memory.motion is not None:
            if memory.sequence.moves_grippers(self._held_stages, memory.time, estimate.time):
                load = self._estimator.unsettled(load, estimate.time)
            late = estimate.delay.seconds
            u = estimate.commands.commanded(memory.motion.time - late, estimate.time - late)
            law = self.applied(law, memory, motion.is_loaded)
            load = self._estimator.after_measurement(load, memory.motion, motion, u, law)
        return replace(memory, load=load, motion=motion)


class _HeldObject(_Load):
    """Mass and principal moments of inertia of the object in the grippers, whose pose is measured."""

    def _motion(self, memory: Memory, estimate: Estimate, is_held: bool) -> RobotAlone:
        """Return robot and object, where a gripper holds it and its state is known."""
        state = estimate.state
        object_state = memory.target_object.at(estimate.time)
        if is_held and object_state is not None:
            return RobotAndObject(estimate.time, state.Q, state.v, object_state)
        return RobotAlone(estimate.time, state.Q, state.v)

    def applied(self, law: LowLevelLaw, memory: Memory, is_held: bool) -> LowLevelLaw:
        """Return a law that counts with the most likely mass and moments."""
        return law.with_load(memory.load.numbers)


class _Payload(_Load):
    """Mass and moment of inertia of a payload, which is part of the last links while it is held."""

    def __init__(self, problem: Problem, noise: np.ndarray) -> None:
        super().__init__(problem, noise)
        payload = problem.spec.uncertainty.carried
        self._shares = np.array(payload.shares(tuple(problem.model.spec.arms)))

    def _motion(self, memory: Memory, estimate: Estimate, is_held: bool) -> RobotAlone:
        """Return robot and payload in the stages that hold it."""
        state = estimate.state
        if memory.sequence.first in self._held_stages:
            return RobotAndPayload(estimate.time, state.Q, state.v, self._shares)
        return RobotAlone(estimate.time, state.Q, state.v)

    def applied(self, law: LowLevelLaw, memory: Memory, is_held: bool) -> LowLevelLaw:
        """Return a law that counts with the most likely payload while it is held."""
        if not is_held:
            return law
        mass, inertia = np.outer(memory.load.numbers, self._shares)
        return law.with_parameters(law.parameters.holding(mass, inertia))
