"""The interface of all plants: advance over one sample under the low-level controller, return what happened."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from psmpc_cli.plant.thrusters import ThrusterFiring, ThrusterTicks
from psmpc_cli.plant.wheels import WheelDrive, WheelTicks
from psmpc_cli.robot.configuration import ConfigurationSpace
from psmpc_cli.robot.dynamics import InertialParameters
from psmpc_cli.robot.low_level import LowLevelLaw


@dataclass(frozen=True)
class GraspEvent:
    """What a gripper did.

    Attributes:
        gripper: Its arm.
        time: When [s].
        what: `closed`, `missed` (it was outside its envelope), `let go` or `lost`.
        values: Of the first two, distance [m], angle [rad], velocity [m/s] and angular velocity [rad/s] relative to its
            grasp; of the others, the filtered loads [N, N, N m].
    """

    gripper: str
    time: float
    what: str
    values: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class ObjectTicks:
    """What an object with a mass, and the A grippers of its grasp, did over one sample.

    Attributes:
        pose: At each tick and at the end (M + 1, 3 or 7).
        v: Velocity then, angular about the object's own axes (M + 1, 3 or 6).
        wrench: Force and moment that each gripper puts on the object at its own point, inertial frame (M, A, 3 or 6)
            [N, N m].
        load: Filtered pull, shear and moment on each grasp (M, A, 3) [N, N, N m].
        closed: Whether each gripper is closed (M, A).
        events: What the grippers did.
    """

    pose: np.ndarray
    v: np.ndarray
    wrench: np.ndarray
    load: np.ndarray
    closed: np.ndarray
    events: tuple[GraspEvent, ...]


@dataclass(frozen=True, eq=False)
class Ticks:
    """What the physics did over one sample, tick by tick.

    Attributes:
        time: (M + 1,) [s], the first is the sample's start.
        states: States [Q; v] at those times (M + 1, nq + n).
        F: Generalized force applied over each tick, within the limits of the plant (M, n) [N, N m]; on the base that
            of thrusters and of the motors of wheels.
        impulse_and_work: Integral of the external wrench over the sample, linear [N s] and angular about the inertial
            origin [N m s]; last, the work of all forces, those between grippers and object included: the integral of
            F' v [J]. (4,) or (7,); NaN where it is not known.
        target_object: What an object with a mass did; None without one.
        commanded: Generalized force that the law commanded, before the plant cut it at its limits (M, n) [N, N m];
            None of a plant without limits, where it is F.
        thrusters: What thrusters did; None where none fire.
        wheels: What reaction wheels did; None of a robot without any.
    """

    time: np.ndarray
    states: np.ndarray
    F: np.ndarray
    impulse_and_work: np.ndarray = field(default_factory=lambda: np.array(np.nan))
    target_object: ObjectTicks | None = None
    commanded: np.ndarray | None = None
    thrusters: ThrusterTicks | None = None
    wheels: WheelTicks | None = None

    @classmethod
    def joined(cls, parts: Sequence["Ticks"]) -> "Ticks":
        """Return what happened over a sample whose ticks were advanced part by part, without object and wheels."""
        first, *others = parts
        commanded = [part.commanded for part in parts if part.commanded is not None]
        thrusters = [part.thrusters for part in parts if part.thrusters is not None]
        return cls(
            time=np.concatenate([first.time, *(part.time[1:] for part in others)]),
            states=np.concatenate([first.states, *(part.states[1:] for part in others)]),
            F=np.concatenate([part.F for part in parts]),
            impulse_and_work=np.sum([part.impulse_and_work for part in parts], axis=0),
            commanded=np.concatenate(commanded) if commanded else None,
            thrusters=ThrusterTicks.joined(thrusters) if thrusters else None,
        )

    def __repr__(self) -> str:
        ticks, n = self.F.shape
        return f"<Ticks from {self.time[0]:g} s to {self.time[-1]:g} s: {ticks} ticks of {n} forces>"


@dataclass(frozen=True, eq=False)
class JointFriction:
    """Joint friction by coordinate (n,), constant throughout a run.

    Attributes:
        viscous: Coefficients of viscous friction [N m s/rad]; 0 for the base.
        coulomb: Coulomb friction [N m]; 0 for the base.
        width: Rate around 0 within which Coulomb friction changes its sign [rad/s].
    """

    viscous: np.ndarray
    coulomb: np.ndarray
    width: float

    @classmethod
    def none(cls, n: int) -> "JointFriction":
        """Return the friction of n coordinates that have none."""
        return cls(np.zeros(n), np.zeros(n), 1.0)

    def net_force(self, F: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return a generalized force F (n,) less the friction at velocities v (n,) [N, N m]."""
        return np.asarray(F - self.viscous * v - self.coulomb * np.tanh(v / self.width))

    @property
    def vector(self) -> np.ndarray:
        """All of it in one vector (2n + 1,)."""
        return np.concatenate([self.viscous, self.coulomb, [self.width]])


@dataclass(frozen=True, eq=False)
class ForceLimits:
    """Limits at which a plant cuts the generalized force of the low-level law, by coordinate (n,).

    The force on the base is limited along the base's own axes: there its thrusters are.

    Attributes:
        low, high: Around 0 [N, N m]; infinite where there is no limit.
    """

    low: np.ndarray
    high: np.ndarray

    @property
    def vector(self) -> np.ndarray:
        """Both in one vector (2n,)."""
        return np.concatenate([self.low, self.high])

    def limited(self, space: ConfigurationSpace, Q: np.ndarray, F: np.ndarray) -> np.ndarray:
        """Return a generalized force F (n,) cut at the limits, where the robot is at Q (nq,) [N, N m]."""
        if self._is_surely_within(space, F):
            return F
        # a dozen numbers at every tick: as such they take half the time of arrays
        return np.array(limited_force(space, Q.tolist(), F.tolist(), self.low.tolist(), self.high.tolist(), clipped))

    def _is_surely_within(self, space: ConfigurationSpace, F: np.ndarray) -> bool:
        """Tell whether a force F (n,) is within the limits however the base is turned.

        Most forces are, and this test is much faster than `limited_force`.
        """
        # the force on the base is a vector: its norm bounds its components along whatever axes the base has
        on_base = F[: space.dimension]
        least = self._nearer_limit[: space.dimension].min()
        others = slice(space.dimension, None)
        return bool(
            least >= 0 and on_base @ on_base <= least**2 and (np.abs(F[others]) <= self._nearer_limit[others]).all()
        )

    @cached_property
    def _nearer_limit(self) -> np.ndarray:
        """The distance from 0 to the nearer limit of each coordinate, (n,)."""
        return np.asarray(np.minimum(-self.low, self.high))

    def limited_base_wrench(self, space: ConfigurationSpace, Q: np.ndarray, F: np.ndarray) -> np.ndarray:
        """Cut the wrench on the base at its limits: what thrusters are to give of the forces of the low-level law.

        Args:
            space: Coordinates of the robot.
            Q: Positions of the robot (K, nq).
            F: Generalized forces (K, n) [N, N m], on the base along inertial axes.

        Returns:
            The limited wrenches on the base, along its own axes (K, 3) or (K, 6) [N, N m].
        """
        base = space.base
        in_base_axes = np.column_stack(space.along_base_axes(Q.T, F.T)[base])
        return np.asarray(np.clip(in_base_axes, self.low[base], self.high[base]))

    def vectors_fixing_base_wrench(self, wrenches: np.ndarray) -> np.ndarray:
        """Return vectors of limits that leave the base exactly a given wrench, by a lower limit equal to the upper one.

        So the force of the law on the base is replaced by what thrusters give.

        Args:
            wrenches: Wrenches on the base, along its own axes (K, 3) or (K, 6) [N, N m].

        Returns:
            One vector as in `ForceLimits.vector` for each wrench (K, 2n); the joints keep their limits.
        """
        count, d = wrenches.shape
        low = np.tile(self.low, (count, 1))
        high = np.tile(self.high, (count, 1))
        low[:, :d] = wrenches
        high[:, :d] = wrenches
        return np.hstack([low, high])

    def utilization(self, space: ConfigurationSpace, Q: np.ndarray, F: np.ndarray) -> np.ndarray:
        """Return how large generalized forces are in parts of their limits: 1 is at the limit.

        Args:
            space: Coordinates of the robot.
            Q: Positions of the robot (..., nq).
            F: Generalized forces (..., n) [N, N m], on the base along inertial axes.

        Returns:
            |F| over the limit on its side of 0 (..., n), the base's along its own axes. NaN of a coordinate without a
            limit; infinite where a force is in a direction in which none is possible.
        """
        F_in_base_axes = np.stack(space.along_base_axes(np.moveaxis(Q, -1, 0), np.moveaxis(F, -1, 0)), axis=-1)
        limit_on_its_side = np.abs(np.where(F_in_base_axes < 0, self.low, self.high))
        with np.errstate(divide="ignore"):
            ratio = np.divide(
                np.abs(F_in_base_axes),
                limit_on_its_side,
                out=np.zeros(F_in_base_axes.shape),
                where=F_in_base_axes != 0,  # no force at a limit of 0 is no use of it, rather than 0 / 0
            )
        return np.where(np.isfinite(self.low) | np.isfinite(self.high), ratio, np.nan)


def clipped(value: float, low: float, high: float) -> float:
    """Return a value, or the limit that it is beyond."""
    return min(max(value, low), high)


def limited_force(
    space: ConfigurationSpace, Q: Any, F: Any, low: Any, high: Any, clip: Callable[[Any, Any, Any], Any]
) -> list[Any]:
    """Cut the components of a generalized force at limits, as the actuators of a plant do.

    Thrusters are fixed to the base, so the force on the base is cut along the base's own axes. There the excess is
    subtracted from the given force, rather than the cut force turned back: so a force within the limits stays equal to
    the last bit. Plants call this with numbers, and their compiled functions with CasADi expressions.

    Args:
        space: Coordinates of the robot.
        Q: Position of the robot (nq,).
        F: The force (n,) [N, N m], on the base along inertial axes.
        low: Lower limits (n,) [N, N m], on the base along its own axes.
        high: Upper limits (n,) [N, N m].
        clip: The function (value, low, high) that returns the value, or the limit that it is beyond.

    Returns:
        The n components of the limited force, on the base along inertial axes.
    """
    in_base_axes = space.along_base_axes(Q, F)
    within = [clip(in_base_axes[i], low[i], high[i]) for i in range(space.n)]
    excess_in_base_axes = [wanted - kept for wanted, kept in zip(in_base_axes, within, strict=True)]
    # only the force on the base depends on the axes: its moment is about the base's own axes in F, too
    excess_in_inertial_axes = space.along_inertial_axes(Q, excess_in_base_axes)[: space.dimension]
    return [*(F[i] - excess for i, excess in enumerate(excess_in_inertial_axes)), *within[space.dimension :]]


@dataclass(frozen=True, eq=False)
class Disturbance:
    """Differences, over one sample, between the robot and what its controller knows.

    Attributes:
        robot: True inertial parameters, with what is in the grippers.
        law: Inertial parameters that the low-level law (7) uses.
        noise: Errors of the state that the law reads at each tick (M, 2n): a displacement of Q, then what is added to v
            [m, rad, m/s, rad/s].
        external_force: External generalized force over each tick (M, n) [N, N m].
    """

    robot: InertialParameters
    law: InertialParameters
    noise: np.ndarray
    external_force: np.ndarray

    def part(self, ticks: slice) -> "Disturbance":
        """Return the disturbance over some ticks of the sample."""
        return replace(self, noise=self.noise[ticks], external_force=self.external_force[ticks])

    @classmethod
    def none(cls, robot: InertialParameters, ticks: int, n: int) -> "Disturbance":
        """Return the disturbance of a robot with n velocities that is exactly known and that nothing disturbs."""
        return cls(robot, robot, np.zeros((ticks, 2 * n)), np.zeros((ticks, n)))

    @cached_property
    def is_noisy(self) -> bool:
        """Whether the law reads another state than the true one at any tick."""
        return bool(self.noise.any())


@dataclass(frozen=True, eq=False)
class Setpoints:
    """What the low-level law and the actuators are commanded to do over one sample, a row for each of its M ticks.

    Attributes:
        u: Rates of v (M, n) [m/s^2, rad/s^2].
        closed: Whether the grippers are to be closed on the object (M,); None: at no tick.
        twist_rates: Rates of the velocities J_C v of base and end-effectors (M, k) [m/s^2, rad/s^2], which the law in
            task space follows instead of u; None where the law is that in joint space.
        driven: Whether something acts on each coordinate of the base, 1 or 0 (M, n_twist); None: always on those of
            the robot's description.
        shut: Which thrusters must not fire (M, T); None: all may.
        held: Whether a mount holds a base that moves otherwise (M,); None: at no tick.
        load: Mass [kg] and principal moments [kg m^2] of what closed grippers hold, as the law assumes them; empty:
            those of the object as described.
    """

    u: np.ndarray
    closed: np.ndarray | None = None
    twist_rates: np.ndarray | None = None
    driven: np.ndarray | None = None
    shut: np.ndarray | None = None
    load: np.ndarray = field(default_factory=lambda: np.zeros(0))
    held: np.ndarray | None = None

    @property
    def grippers_close(self) -> np.ndarray:
        """Whether the grippers are to be closed at each tick (M,)."""
        return np.zeros(len(self.u), bool) if self.closed is None else self.closed

    @property
    def base_is_held(self) -> np.ndarray:
        """Whether a mount holds the base at each tick (M,)."""
        return np.zeros(len(self.u), bool) if self.held is None else self.held

    def part(self, ticks: slice) -> "Setpoints":
        """Return the setpoints of some ticks of the sample."""
        by_tick = {
            name: values[ticks]
            for name in ("u", "closed", "twist_rates", "driven", "shut", "held")
            if (values := getattr(self, name)) is not None
        }
        return replace(self, **by_tick)

    def law_setpoint(self, tick: int) -> tuple[np.ndarray, np.ndarray | None]:
        """Return what the law follows at a tick: u (n,), and the rates in task space (k,); None if it follows u."""
        return self.u[tick], None if self.twist_rates is None else self.twist_rates[tick]

    def mean_law_setpoint(self, ticks: slice) -> tuple[np.ndarray, np.ndarray | None]:
        """Return the mean over ticks of what the law follows, as `law_setpoint` does."""
        rates = None if self.twist_rates is None else self.twist_rates[ticks].mean(axis=0)
        return self.u[ticks].mean(axis=0), rates


class Plant(Protocol):
    """Simulated physics of a robot under its low-level controller."""

    def advance(
        self, start: float, state: np.ndarray, setpoints: Setpoints, disturbance: Disturbance | None = None
    ) -> Ticks:
        """Advance over one sample, the setpoints of one tick after the other in force.

        Args:
            start: When the sample begins [s].
            state: State [Q; v] when it begins (nq + n,).
            setpoints: What is commanded at its ticks. Grippers are those of plants with an object.
            disturbance: What the controller does not know; None: nothing. Only plants built with friction have it.
        """
        ...


@dataclass(frozen=True, eq=False)
class _TickLaw:
    """The low-level law in one tick: what it reads of the robot, and what it assumes of it.

    Attributes:
        law: The law.
        Q, v: Measured position (nq,) and velocity (n,).
        grasps: Parameters of the grasps of an object that all hands hold; None while they do not.
        parameters: Inertial parameters that the law takes for the robot's.
        driven: 1 for each coordinate of the base on which something acts, else 0 (n_twist,).
        drive: The wheels; None without any.
    """

    law: LowLevelLaw
    Q: np.ndarray
    v: np.ndarray
    grasps: np.ndarray | None
    parameters: InertialParameters
    driven: tuple[float, ...]
    drive: WheelDrive | None

    @property
    def accounts_for_load(self) -> bool:
        """Whether the hands hold a load that the law knows of."""
        return self.law.knows_load and self.grasps is not None

    def joint_force(self, u: np.ndarray, twist_rates: np.ndarray | None, base_force: np.ndarray) -> np.ndarray:
        """Return the force (n,) with which joints follow their setpoints under a given force on the base.

        Args:
            u: Setpoint (n,).
            twist_rates: Setpoint of the law in task space (k,), or None.
            base_force: Force on the base and its mean over a period of pulses, see `LowLevelLaw.force`.
        """
        return self.law.force(
            self.Q, self.v, u, twist_rates, self.grasps, self.parameters, self.driven, base_force=base_force
        )

    def force(self, u: np.ndarray, twist_rates: np.ndarray | None) -> np.ndarray:
        """Return the force (n,) that follows a setpoint, with what balances motors that unload wheels in this tick.

        Args:
            u: Setpoint (n,).
            twist_rates: Setpoint of the law in task space (k,), or None.
        """
        F = self.law.force(self.Q, self.v, u, twist_rates, self.grasps, self.parameters, self.driven)
        return F if self.drive is None else self.drive.with_unloading(F, self.driven)


class TickedPlant(ABC):
    """A plant that advances one tick after the other: the low-level law reads the state, its force is cut and held.

    What plants differ in are the methods below `advance`.
    """

    def __init__(
        self,
        law: LowLevelLaw,
        tick: float,
        force_limits: ForceLimits | None,
        firing: ThrusterFiring | None = None,
        drive: WheelDrive | None = None,
    ) -> None:
        self.law = law
        self.model = law.model
        self.tick = tick
        self.force_limits = force_limits
        self.firing = firing
        self.drive = drive

    def advance(
        self, start: float, state: np.ndarray, setpoints: Setpoints, disturbance: Disturbance | None = None
    ) -> Ticks:
        """Advance over a sample, tick by tick: the low-level law sets a force, which is limited and held over the tick.

        A tick is one period of the low-level loop, such as a millisecond. In it, in this order: grippers close or open,
        the law reads the (noisy) state, thrusters and limits turn its force into the one that acts, wheels take their
        part of the moment on the base, and the physics advances.

        Args:
            start: When the sample begins [s].
            state: State [Q; v] when it begins (nq + n,).
            setpoints: What law and actuators are commanded to do, a row for each of the M ticks.
            disturbance: What the controller does not know; None: nothing.

        Returns:
            What happened at each tick.
        """
        M, n = setpoints.u.shape
        nq = self.model.nq
        drive = self.drive
        grippers_close = setpoints.grippers_close
        disturbance = disturbance or Disturbance.none(self.model.nominal, M, n)
        law = self.law.with_load(setpoints.load)
        if self.firing is not None:
            self.firing.begin_sample(setpoints.shut)
        time = start + self.tick * np.arange(M + 1)
        states = np.vstack([state, np.empty((M, nq + n))])
        commanded = np.empty((M, n))
        F = np.empty((M, n))
        external_force = np.empty((M, n))
        impulse_and_work = np.zeros(self.model.space.n_twist + 1)  # of the external wrench; of all forces
        for k in range(M):
            grasps = self.begin_tick(float(time[k]), states[k], bool(grippers_close[k]))
            tick_law = self._tick_law(law, k, states[k], grasps, setpoints, disturbance)
            commanded[k] = tick_law.force(*setpoints.law_setpoint(k))
            commanded[k], limits = self._apply_thrusters(k, states[k], commanded[k], tick_law, setpoints)
            F[k] = commanded[k] if limits is None else limits.limited(self.model.space, states[k, :nq], commanded[k])
            if drive is not None:
                F[k] = drive.begin_tick(F[k], tick_law.driven)
            # motors of wheels act between parts of the robot: they are in F, but not external
            external_force[k] = F[k] if drive is None else drive.without_motors(F[k])
            external_force[k] += disturbance.external_force[k]
            states[k + 1], of_this_tick = self.step(states[k], F[k] + disturbance.external_force[k], disturbance.robot)
            impulse_and_work += of_this_tick
            if drive is not None:
                drive.end_tick()
        return Ticks(
            time=time,
            states=states,
            F=F,
            impulse_and_work=self.impulse_and_work(impulse_and_work, states, external_force),
            target_object=self.end_sample(),
            commanded=None if self.force_limits is None else commanded,
            thrusters=None if self.firing is None else self.firing.end_sample(),
            wheels=None if drive is None else drive.end_sample(),
        )

    def _tick_law(
        self,
        law: LowLevelLaw,
        tick: int,
        state: np.ndarray,
        grasps: np.ndarray | None,
        setpoints: Setpoints,
        disturbance: Disturbance,
    ) -> _TickLaw:
        """Prepare the low-level law for one tick: the noisy state that it reads, and what it assumes of the robot.

        Args:
            law: The law, with the load (the held object's mass and moments) that the sample's setpoints name.
            tick: Number of the tick in its sample.
            state: True state [Q; v] where the tick begins (nq + n,).
            grasps: Parameters of the grasps of an object that all hands hold; None while they do not.
            setpoints: Those of the sample; here they say which coordinates of the base are driven at each tick.
            disturbance: Noise of the state, and the inertial parameters that the law takes for the robot's.
        """
        n = self.model.n
        Q = state[: self.model.nq]
        v = state[self.model.nq :]
        if disturbance.is_noisy:
            # noise is a displacement, which for an attitude is a rotation and cannot be added
            Q = np.array(self.model.space.integrate(Q, disturbance.noise[tick, :n]))
            v = v + disturbance.noise[tick, n:]
        return _TickLaw(
            law=law,
            Q=Q,
            v=v,
            grasps=grasps,
            parameters=disturbance.law if self.drive is None else disturbance.law.storing(self.drive.stored),
            driven=law.driven if setpoints.driven is None else tuple(setpoints.driven[tick].tolist()),
            drive=self.drive,
        )

    def _apply_thrusters(
        self, tick: int, state: np.ndarray, commanded: np.ndarray, law: _TickLaw, setpoints: Setpoints
    ) -> tuple[np.ndarray, ForceLimits | None]:
        """Replace the force that the law commands on the base by what its thrusters give in a tick.

        Thrusters fire pulses, so the base gets another force than the law wants. Joints then have to follow their
        setpoints under the real one. Without thrusters the command stays as it is, and so do the limits.

        Args:
            tick: Number of the tick in its sample.
            state: State [Q; v] where it begins (nq + n,).
            commanded: Generalized force that the law commands (n,) [N, N m].
            law: The law in this tick.
            setpoints: Those of the sample.

        Returns:
            The force that is now commanded (n,) [N, N m], and the limits at which it is to be cut: where thrusters
            push, they fix the force on the base to what the thrusters give. None without limits.
        """
        firing = self.firing
        limits = self.force_limits
        if firing is None or limits is None:
            return commanded, limits
        Q = state[None, : self.model.nq]
        space = self.model.space
        firing.end_period_if_load_changed(law.accounts_for_load)
        span = firing.next_span(setpoints.driven, tick, len(setpoints.u))
        if span.begins:  # a period of pulses, which are to give the mean of what the law wants over it
            mean_wanted = law.force(*setpoints.mean_law_setpoint(span.ticks))
            firing.begin_period(limits.limited_base_wrench(space, Q, mean_wanted[None])[0])
        wanted_on_base = limits.limited_base_wrench(space, Q, commanded[None])
        if span.is_pushed:
            wrench = firing.wrenches(1)
            base_force = np.array(
                [
                    self._base_force_of_thrusters(law.Q, wrench[0]),
                    self._base_force_of_thrusters(law.Q, firing.mean_wrench),
                ]
            )
            joint_force = law.joint_force(*setpoints.law_setpoint(tick), base_force)
            commanded = commanded.copy()  # the caller keeps it in its log
            commanded[space.joint_rates] = joint_force[space.joint_rates]
            (limits_as_vector,) = limits.vectors_fixing_base_wrench(wrench)
            limits = ForceLimits(*np.split(limits_as_vector, 2))
        firing.record_ticks(wanted_on_base, span.is_pushed)
        return commanded, limits

    def _base_force_of_thrusters(self, Q: np.ndarray, wrench: np.ndarray) -> np.ndarray:
        """Return the force on the base (n_twist,) of a wrench of thrusters, less what balances the unloading of wheels.

        Args:
            Q: Measured position of the robot (nq,).
            wrench: Wrench of the thrusters, along the base's own axes (n_twist,) [N, N m].
        """
        space = self.model.space
        F = np.array(space.along_inertial_axes(Q, [*wrench, *np.zeros(space.joints)]))
        return (F if self.drive is None else self.drive.without_unloading(F))[space.base]

    @abstractmethod
    def step(self, state: np.ndarray, F: np.ndarray, robot: InertialParameters) -> tuple[np.ndarray, np.ndarray]:
        """Return the state (nq + n,) after a tick under a held external force F (n,), its impulse and its work.

        A robot with wheels also feels the gyroscopic moment of what they store, by its `drive`, whose motors give a
        part of F.

        Args:
            state: State [Q; v].
            F: Generalized force of the actuators and of what pushes the robot [N, N m].
            robot: True inertial parameters.

        Returns:
            The state, and impulse and work as in `Ticks.impulse_and_work`.
        """

    def begin_tick(self, time: float, state: np.ndarray, closed: bool) -> np.ndarray | None:
        """Close and open grippers where a tick begins; here there is no object, so they hold nothing.

        Args:
            time: When the tick begins [s].
            state: State [Q; v] of the robot.
            closed: Whether the grippers are to be closed.

        Returns:
            Parameters of the grasps of an object that all hands hold, see `HeldLoad.force`; None while they do not.
        """
        return None

    def impulse_and_work(self, sum_of_ticks: np.ndarray, states: np.ndarray, F: np.ndarray) -> np.ndarray:
        """Return impulse and work over a sample; here they are what `step` returns, summed over the ticks.

        Args:
            sum_of_ticks: That sum, (4,) or (7,).
            states: States at the ticks and at the end (M + 1, nq + n).
            F: External generalized forces over the ticks (M, n) [N, N m].
        """
        return sum_of_ticks

    def end_sample(self) -> ObjectTicks | None:
        """Return what an object with a mass did over the sample that ends; None without one."""
        return None
