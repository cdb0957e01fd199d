"""The full rigid-body dynamics under the computed-torque law (7): force held over a tick, Runge-Kutta between ticks."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from psmpc_cli.native.compiled import compiled
from psmpc_cli.native.functions import ArrayFunction
from psmpc_cli.plant.base import Disturbance, ForceLimits, JointFriction, Plant, Setpoints, Ticks
from psmpc_cli.plant.grasp import Capture, PlantSetup
from psmpc_cli.plant.thrusters import ThrusterFiring
from psmpc_cli.plant.tick_functions import TickKind, capture_tick, tick_function
from psmpc_cli.plant.wheels import WheelDrive
from psmpc_cli.robot.model import RobotModel


@dataclass(frozen=True, eq=False)
class _Inputs:
    """The arguments of the compiled function of ticks that differ from tick to tick, for the M ticks of a sample.

    Attributes:
        setpoints: What the law follows, then which coordinates of the base are driven where that varies (M, k).
        disturbances: Noise (M, 2n) and external force (M, n), as far as the function has them as arguments.
        in_task_space: Whether the law follows rates of the velocities J_C v.
        driven_varies: Whether the law is told which coordinates of the base are driven.
    """

    setpoints: np.ndarray
    disturbances: tuple[np.ndarray, ...]
    in_task_space: bool
    driven_varies: bool

    def kind(self, base_kind: TickKind, is_pushed: bool) -> TickKind:
        """Return the kind of function that takes these arguments.

        Args:
            base_kind: Kind of the functions of the plant, whatever the setpoints are.
            is_pushed: Whether thrusters push the base.
        """
        return replace(
            base_kind, in_task_space=self.in_task_space, driven_varies=self.driven_varies, is_pushed=is_pushed
        )

    def arguments(self, ticks: slice) -> list[np.ndarray]:
        """Return the arguments at some ticks: arrays with a row for each of them."""
        return [values[ticks] for values in (self.setpoints, *self.disturbances)]

    def mean_arguments(self, ticks: slice) -> list[np.ndarray]:
        """Return the arguments of one tick with the mean setpoints over some ticks, disturbed as the first of them."""
        first = slice(ticks.start, ticks.start + 1)
        mean = self.setpoints[ticks].mean(axis=0)
        return [mean[None], *(values[first] for values in self.disturbances)]


class _CompiledPlant(ABC):
    """A plant whose ticks between two events are one call of a function, as compiled C where it is `native`.

    Events are the beginnings of periods of pulses, and those that a plant adds, such as the loss of a grasp. Where
    thrusters push the base, the limits of the force on it are fixed to what they give, and the law knows that force.
    """

    def __init__(
        self,
        model: RobotModel,
        tick: float,
        substeps: int,
        native: bool,
        friction: JointFriction | None,
        force_limits: ForceLimits | None,
        firing: ThrusterFiring | None,
        drive: WheelDrive | None,
    ) -> None:
        """Set up a plant; the functions of its ticks are built, and compiled, when a sample first needs them.

        Args:
            model: The robot.
            tick: Length of a tick of the low-level law [s].
            substeps: Steps of the integrator in a tick.
            native: Whether functions run as compiled C, if there is a compiler.
            friction: Friction of joints; None of an undisturbed plant.
            force_limits: Limits at which the force of the law is cut; None without any.
            firing: Thrusters that give the force on the base; None where the plant applies the law's force itself.
            drive: Drive of the reaction wheels; None without any.
        """
        self.model = model
        self.tick = tick
        self.friction = friction
        self.force_limits = force_limits
        self.firing = firing
        self.drive = drive
        self._native = native
        self._kind_of_plant = TickKind(tick, substeps, disturbed=friction is not None, limited=force_limits is not None)
        # what has been built so far; of several ticks by their number
        self._function_of_one_tick: dict[TickKind, ca.Function] = {}
        self._function_of_ticks: dict[tuple[int, TickKind], ArrayFunction] = {}

    @abstractmethod
    def _build_tick(self, kind: TickKind) -> ca.Function:
        """Build the function of one tick: z, `_Inputs`, arguments that are the same at all ticks, limits of the force.

        Its results are z after the tick, the force that acts, the force that was commanded, and others. Limits and the
        commanded force are there only where `kind` is limited.
        """

    def _function_of_tick(self, kind: TickKind) -> ca.Function:
        """Return the function of one tick, built on first use."""
        if kind not in self._function_of_one_tick:
            one = self._build_tick(kind)
            self._function_of_one_tick[kind] = compiled(one) if self._native else one
        return self._function_of_one_tick[kind]

    def _function_over(self, ticks: int, kind: TickKind) -> ArrayFunction:
        """Return the function of a number of ticks, which are integrated one after the other; built on first use."""
        if (ticks, kind) not in self._function_of_ticks:
            self._function_of_ticks[ticks, kind] = ArrayFunction(self._function_of_tick(kind).mapaccum(ticks))
        return self._function_of_ticks[ticks, kind]

    def _begin_span(
        self, first: int, last: int, z: np.ndarray, inputs: _Inputs, fixed: tuple[np.ndarray, ...], setpoints: Setpoints
    ) -> tuple[slice, bool]:
        """Find the ticks that one call of a function can integrate, and begin a period of pulses if one is due.

        They are the ticks from one on in which thrusters are all off, or which are within one period of pulses. Without
        thrusters they are all that are asked for.

        Args:
            first: The first tick.
            last: The tick after the last that may be among them.
            z: Integrated state where the first tick begins; the position of the robot comes first in it.
            inputs: Arguments of the function at each tick of the sample.
            fixed: Arguments of the function that are the same at all ticks.
            setpoints: What is commanded at the ticks of the sample; here, whether something drives the base.

        Returns:
            The ticks, and whether thrusters push the base in them.
        """
        firing = self.firing
        limits = self.force_limits
        if firing is None or limits is None:
            return slice(first, last), False
        span = firing.next_span(setpoints.driven, first, last)
        if span.begins:
            # The pulses are to give the wrench that the law wants for the mean setpoint over the period. It is the
            # commanded force that the function of one tick returns, whose other results are not used.
            law_in_one_tick = self._function_over(1, inputs.kind(self._kind_of_plant, is_pushed=True))
            _, _, wanted_force, *_ = law_in_one_tick(
                z, *inputs.mean_arguments(span.ticks), *fixed, _limits_without_thrust(limits, firing)
            )
            firing.begin_period(limits.limited_base_wrench(self.model.space, z[None, : self.model.nq], wanted_force)[0])
        return span.ticks, span.is_pushed

    def _integrate(
        self, ticks: slice, is_pushed: bool, z: np.ndarray, inputs: _Inputs, fixed: tuple[np.ndarray, ...]
    ) -> list[np.ndarray]:
        """Integrate the ticks that `_begin_span` found, by one call of a function.

        Args:
            ticks: The ticks.
            is_pushed: Whether thrusters push the base in them; then they alone give the force on it.
            z: Integrated state where the first tick begins.
            inputs: Arguments of the function at each tick of the sample.
            fixed: Arguments of the function that are the same at all ticks.

        Returns:
            The results of the function, arrays with a row for each tick: integrated states after the ticks, forces that
            act, commanded forces where there are limits, and others.
        """
        count = ticks.stop - ticks.start
        limits: tuple[np.ndarray, ...] = ()
        if self.force_limits is not None:
            limits = (self.force_limits.vector,)
            if self.firing is not None and is_pushed:
                limits = (_limits_under_thrust(self.force_limits, self.firing, count),)
        integrate_ticks = self._function_over(count, inputs.kind(self._kind_of_plant, is_pushed))
        return integrate_ticks(z, *inputs.arguments(ticks), *fixed, *limits)

    def _record_thrusters(self, states: np.ndarray, commanded: np.ndarray, is_pushed: bool) -> None:
        """Tell the thrusters what the law has commanded over ticks that have passed, so that they owe what is missing.

        Args:
            states: Integrated states where the ticks begin (K, ...); positions of the robot come first in them.
            commanded: Commanded forces (K, n) [N, N m].
            is_pushed: Whether thrusters push the base in them.
        """
        if self.firing is not None and self.force_limits is not None:
            Q = states[:, : self.model.nq]
            self.firing.record_ticks(self.force_limits.limited_base_wrench(self.model.space, Q, commanded), is_pushed)


class Rk4Plant(_CompiledPlant):
    """Integrates state, external impulse and work together, `substeps` steps a tick; `native`, as compiled C.

    With friction it is a disturbed plant: all that differs from what the controller knows is an argument of one
    function, so every draw, with and without a payload, runs the same code. Without one these arguments are constants.
    Force limits are an argument where there are any.
    """

    def __init__(
        self,
        model: RobotModel,
        tick: float,
        substeps: int = 1,
        native: bool = False,
        friction: JointFriction | None = None,
        force_limits: ForceLimits | None = None,
        firing: ThrusterFiring | None = None,
        drive: WheelDrive | None = None,
    ) -> None:
        super().__init__(model, tick, substeps, native, friction, force_limits, firing, drive)
        # most runs need this one: it is compiled here, not in the first sample
        self._function_of_tick(replace(self._kind_of_plant, is_pushed=firing is not None))

    def advance(
        self, start: float, state: np.ndarray, setpoints: Setpoints, disturbance: Disturbance | None = None
    ) -> Ticks:
        """Simulate the robot over one sample, in as few calls of compiled functions as thrusters allow.

        The integrated state is z = [Q; v; external impulse; work; momenta of wheels]; impulse and work begin at 0. A
        tick is one period of the low-level loop.

        Args:
            start: When the sample begins [s].
            state: State [Q; v] when it begins (nq + n,).
            setpoints: What law and actuators are commanded to do, a row for each of the M ticks.
            disturbance: What the controller does not know; None: nothing. Only a plant with friction can have one.

        Returns:
            What happened at each tick.
        """
        M = len(setpoints.u)
        inputs, fixed = self._arguments(setpoints, disturbance)
        if self.firing is not None:
            self.firing.begin_sample(setpoints.shut)
        sums_size = self.model.space.n_twist + 1  # of impulse and work
        z = np.concatenate([state, np.zeros(sums_size), _wheel_momenta(self.model, self.drive)])
        spans = []
        tick = 0
        while tick < M:
            ticks, is_pushed = self._begin_span(tick, M, z, inputs, fixed, setpoints)
            results = self._integrate(ticks, is_pushed, z, inputs, fixed)
            Z = results[0]
            if self.force_limits is not None:  # then results[2] are the commanded forces
                self._record_thrusters(np.vstack([z, Z[:-1]]), results[2], is_pushed)
            spans.append(results)
            z = Z[-1]
            tick = ticks.stop
        Z, F, *others = (np.concatenate(results) for results in zip(*spans, strict=True))
        robot_states, impulse_and_work, momenta = np.split(Z, np.cumsum([len(state), sums_size]), axis=1)
        return Ticks(
            time=start + self.tick * np.arange(M + 1),
            states=np.concatenate([state[None], robot_states]),
            F=F,
            impulse_and_work=impulse_and_work[-1],
            commanded=None if self.force_limits is None else others[0],
            thrusters=None if self.firing is None else self.firing.end_sample(),
            wheels=None if self.drive is None else _record_wheels(self.drive, momenta, others[-1]).end_sample(),
        )

    def _arguments(
        self, setpoints: Setpoints, disturbance: Disturbance | None
    ) -> tuple[_Inputs, tuple[np.ndarray, ...]]:
        """Arrange setpoints and disturbances of a sample as arguments of `tick_function`, the compiled physics.

        Args:
            setpoints: What the low-level law and the actuators are commanded to do.
            disturbance: Differences from what the controller knows; None without any.

        Returns:
            The arguments with a row for each tick; and the arguments that are the same at all ticks. The latter are one
            vector of a disturbed plant, inertial parameters and friction, and none of another.
        """
        followed = setpoints.u if setpoints.twist_rates is None else setpoints.twist_rates
        if setpoints.driven is not None:
            followed = np.hstack([followed, setpoints.driven])
        disturbances: tuple[np.ndarray, ...] = ()
        fixed: tuple[np.ndarray, ...] = ()
        if self.friction is not None and disturbance is not None:
            disturbances = disturbance.noise, disturbance.external_force
            fixed = (np.concatenate([disturbance.robot.vector, disturbance.law.vector, self.friction.vector]),)
        inputs = _Inputs(
            followed,
            disturbances,
            in_task_space=setpoints.twist_rates is not None,
            driven_varies=setpoints.driven is not None,
        )
        return inputs, fixed

    def _build_tick(self, kind: TickKind) -> ca.Function:
        """Build `tick_function`."""
        return tick_function(self.model, kind)


class Rk4CapturePlant(_CompiledPlant):
    """A robot, an object, and the grasps between them, integrated together; the bushings in every stage of a step.

    Ticks between two events of grasps are one call: when grippers close or open, and where a grasp is lost, it ends.

    Attributes:
        capture: The object and its grasps.
    """

    def __init__(
        self,
        capture: Capture,
        substeps: int,
        native: bool,
        friction: JointFriction | None,
        force_limits: ForceLimits | None,
        firing: ThrusterFiring | None = None,
        drive: WheelDrive | None = None,
    ) -> None:
        model = capture.law.model
        super().__init__(model, capture.tick, substeps, native, friction, force_limits, firing, drive)
        self.capture = capture

    def advance(
        self, start: float, state: np.ndarray, setpoints: Setpoints, disturbance: Disturbance | None = None
    ) -> Ticks:
        """Simulate robot and object over one sample, in as few calls of compiled functions as possible.

        One call integrates the ticks until thrusters or the command of the grippers change. If a grasp bears too much
        in one of them it is lost: the ticks before it count, and the integration goes on from there without that grasp.

        Args:
            start: When the sample begins [s].
            state: State [Q; v] of the robot when it begins (nq + n,).
            setpoints: What law, grippers and actuators are commanded to do, a row for each of the M ticks.
            disturbance: What the controller does not know; None: nothing.

        Returns:
            What happened at each tick.
        """
        capture = self.capture
        M, n = setpoints.u.shape
        inputs, parameters = self._arguments(setpoints, disturbance or Disturbance.none(self.model.nominal, M, n))
        if self.firing is not None:
            self.firing.begin_sample(setpoints.shut)
        grippers_close = setpoints.grippers_close
        times = start + self.tick * np.arange(M + 1)
        states = np.vstack([state, np.empty((M, len(state)))])
        F = np.empty((M, n))
        commanded = np.empty((M, n))
        impulse_and_work = np.zeros(self.model.space.n_twist + 1)
        tick = 0
        while tick < M:
            capture.command_grippers(times[tick], states[tick], bool(grippers_close[tick]))
            wheel_momenta = _wheel_momenta(self.model, self.drive)
            z = np.concatenate([states[tick], impulse_and_work, wheel_momenta, capture.state, capture.load.ravel()])
            fixed = np.concatenate([capture.parameters.ravel(), capture.closed]), parameters
            if self.firing is not None:
                self.firing.end_period_if_load_changed(capture.is_known_load)
            ticks, is_pushed = self._begin_span(
                tick, _end_of_equal_values(grippers_close, tick), z, inputs, fixed, setpoints
            )
            Z, F[ticks], commanded[ticks], wrench, *torque = self._integrate(ticks, is_pushed, z, inputs, fixed)
            sizes = [len(state), len(impulse_and_work), len(wheel_momenta), len(capture.state)]
            robot_states, sums, momenta, object_states, load = np.split(Z, np.cumsum(sizes), axis=1)
            ticks_before_loss = capture.record_until_loss(
                times[ticks],
                np.vstack([capture.state, object_states[:-1]]),
                wrench.reshape(len(Z), len(capture.closed), -1),
                load.reshape(len(Z), len(capture.closed), -1),
            )
            if ticks_before_loss:  # otherwise a grasp was lost at once: the same tick again, without it
                states[tick + 1 : tick + 1 + ticks_before_loss] = robot_states[:ticks_before_loss]
                self._record_thrusters(
                    states[tick : tick + ticks_before_loss], commanded[tick : tick + ticks_before_loss], is_pushed
                )
                if self.drive is not None:
                    _record_wheels(self.drive, momenta[:ticks_before_loss], torque[0][:ticks_before_loss])
                impulse_and_work = sums[ticks_before_loss - 1]
                capture.state = object_states[ticks_before_loss - 1]
                tick += ticks_before_loss
        return Ticks(
            time=times,
            states=states,
            F=F,
            impulse_and_work=impulse_and_work,
            target_object=capture.end_sample(),
            commanded=None if self.force_limits is None else commanded,
            thrusters=None if self.firing is None else self.firing.end_sample(),
            wheels=None if self.drive is None else self.drive.end_sample(),
        )

    def _arguments(self, setpoints: Setpoints, disturbance: Disturbance) -> tuple[_Inputs, np.ndarray]:
        """Arrange setpoints and disturbances of a sample as arguments of `capture_tick`, the compiled physics.

        Args:
            setpoints: What the low-level law and the actuators are commanded to do.
            disturbance: Differences from what the controller knows.

        Returns:
            The arguments with a row for each tick; and the vector of parameters that are the same at all ticks: true
            inertial parameters of the robot, those that the law takes for them, friction, the true object, the object
            as the law knows it, and the share by which filtered loads follow the loads in a tick.
        """
        capture = self.capture
        commanded_columns = (setpoints.u, setpoints.twist_rates, setpoints.driven)
        external_force = disturbance.external_force
        inputs = _Inputs(
            np.hstack([column for column in commanded_columns if column is not None]),
            (external_force,) if self.friction is None else (disturbance.noise, external_force),
            in_task_space=setpoints.twist_rates is not None,
            driven_varies=setpoints.driven is not None,
        )
        friction = self.friction or JointFriction.none(self.model.n)
        known_object = capture.described.vector_with(setpoints.load)
        parameters = np.concatenate(
            [
                disturbance.robot.vector,
                disturbance.law.vector,
                friction.vector,
                capture.body.vector,
                known_object,
                [capture.filter_gain],
            ]
        )
        return inputs, parameters

    def _build_tick(self, kind: TickKind) -> ca.Function:
        """Build `capture_tick`."""
        return capture_tick(self.capture, kind)


def _end_of_equal_values(values: np.ndarray, first: int) -> int:
    """Return the index, from one on, at which values (M,) first differ from the one there; M if none does."""
    others = np.flatnonzero(values[first:] != values[first])
    return first + int(others[0]) if others.size else len(values)


def _limits_under_thrust(limits: ForceLimits, firing: ThrusterFiring, ticks: int) -> np.ndarray:
    """Return the limits of ticks in which thrusters push the base, as `tick_function` takes them.

    Returns:
        For each tick, a vector of `ForceLimits` that fixes the force on the base, then the mean wrench over the period
        of pulses (ticks, 2n + n_twist).
    """
    return np.hstack(
        [limits.vectors_fixing_base_wrench(firing.wrenches(ticks)), np.tile(firing.mean_wrench, (ticks, 1))]
    )


def _limits_without_thrust(limits: ForceLimits, firing: ThrusterFiring) -> np.ndarray:
    """Return the limits of one tick in which no thruster fires (1, 2n + n_twist), to compute what the law wants.

    They are arranged as in `_limits_under_thrust`.
    """
    none = np.zeros((1, len(firing.mean_wrench)))
    return np.hstack([limits.vectors_fixing_base_wrench(none), none])


def _wheel_momenta(model: RobotModel, drive: WheelDrive | None) -> np.ndarray:
    """Return what the wheels of a robot store (W,) [N m s]; 0 where nothing drives them."""
    return np.zeros(len(model.spec.wheels)) if drive is None else drive.momentum


def _record_wheels(drive: WheelDrive, momenta: np.ndarray, torques: np.ndarray) -> WheelDrive:
    """Record ticks of wheels: what they store after them (K, W), and the torques over them (K, W); return the drive."""
    for momentum, torque in zip(momenta, torques, strict=True):
        drive.record_tick(momentum, torque)
    return drive


def build(setup: PlantSetup) -> Plant:
    """Build the plant of rigid bodies, of robot and object together where there is something to capture.

    Args:
        setup: What every kind of plant is built from.
    """
    capture = setup.capture
    if capture is None:
        return Rk4Plant(
            setup.model,
            setup.tick,
            setup.substeps,
            setup.native,
            setup.friction,
            setup.force_limits,
            setup.firing,
            setup.drive,
        )
    return Rk4CapturePlant(
        capture, setup.substeps, setup.native, setup.friction, setup.force_limits, setup.firing, setup.drive
    )
