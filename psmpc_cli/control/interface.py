"""What goes into a controller at a sample and what comes out of it: the measurement, and the command."""

from collections.abc import Mapping
from dataclasses import dataclass, field, is_dataclass
from math import isfinite
from numbers import Real
from typing import Any, NamedTuple

import numpy as np

from psmpc_cli.control.identification.inertia import NO_INERTIA, InertiaEstimate
from psmpc_cli.control.identification.load import NO_LOAD, LoadEstimate
from psmpc_cli.control.sequence import MovingSequence, Switch
from psmpc_cli.errors import InputError
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.ocp.problem import Problem
from psmpc_cli.ocp.stage import PlacedStage
from psmpc_cli.robot.actuators.wheels import Wheels
from psmpc_cli.robot.configuration import space_of_pose
from psmpc_cli.robot.low_level import LowLevelLaw
from psmpc_cli.robot.model import RobotModel, shape_of
from psmpc_cli.solvers import Outcome, Solution
from psmpc_cli.specs.arguments import rejected
from psmpc_cli.specs.document import LARGEST

UNIT = 1e-3
"""By how much the length of a measured quaternion may differ from 1: that of one of three decimals does by less."""

LATE = 0.01
"""Part of a sample by which the next one may be late without a gap: clocks jitter, and times are rounded."""


@dataclass(frozen=True, eq=False)
class State:
    """State of the robot: Q (nq,) [m, rad] and its velocity v (n,) [m/s, rad/s], as `RobotModel` has them.

    Of a robot with W reaction wheels also what they store, `wheels` (W,) [N m s]: J (Omega + a . omega) of a wheel with
    inertia J that spins at Omega about its axis a on a base that turns at omega. By default it is what follows from the
    sample before (docs/mobility_model.md).

    It has copies of the arrays that it is given. Numbers that are not finite say that nothing was measured.

    Raises:
        InputError: Q, v or wheels is no vector of numbers.
    """

    Q: np.ndarray
    v: np.ndarray
    wheels: np.ndarray | None = None

    def __repr__(self) -> str:
        Q, v = (np.array2string(array, max_line_width=10_000, precision=4, threshold=100) for array in (self.Q, self.v))
        return f"State(Q={Q}, v={v})"

    def __post_init__(self) -> None:
        for name in ("Q", "v", *(["wheels"] if self.wheels is not None else [])):
            value = getattr(self, name)
            if len(shape_of(value) or ()) != 1:
                raise rejected(f"State.{name}", value, "a vector of numbers")
            object.__setattr__(self, name, np.array(value, dtype=float))

    @classmethod
    def of(cls, state: np.ndarray, wheels: np.ndarray | None = None) -> "State":
        """Build the state from [Q; v] (nq + n,), and what wheels store (W,)."""
        n = len(state) // 2
        return cls(state[: len(state) - n], state[len(state) - n :], wheels)

    @property
    def vector(self) -> np.ndarray:
        """Both as one vector [Q; v] (nq + n,)."""
        return np.concatenate([self.Q, self.v])


@dataclass(frozen=True, eq=False)
class Measurement:
    """What is measured for one sample.

    Attributes:
        time: When it is measured [s].
        state: Measured then.
        object_pose: Pose of the object, measured with the state, (3,) or (7,); None where there is none.
        holding: Whether each gripper holds the object, by arm, measured with the state. A gripper that is open, or
            still moves, or does not report is left out; None where none reports.
    """

    time: float
    state: State
    object_pose: np.ndarray | None
    holding: Mapping[str, bool] | None = None

    def require_valid_for(self, problem: Problem, before: float) -> None:
        """Raise an error if this is no measurement of a task's robot and object, or if time does not go on.

        Args:
            problem: The task made computable.
            before: Time of the sample before [s]; minus infinity at the first.

        Raises:
            InputError: The time is not finite or not after the one before; the state has another robot's size; the pose
                has another size than that of the task's object, or there is no object with a mass; a gripper that
                reports is none of those that hold the object.
        """
        require_finite_time(self.time)
        if self.time <= before:
            raise InputError(f"time: found {self.time:g} s after {before:g} s, expected a time after the sample before")
        require_state_of(self.state, problem.model)
        if self.holding is not None:
            self._require_known_grippers(self.holding, problem)
        if self.object_pose is None:
            return
        size = len(problem.body.pose)
        if size == 0:
            raise rejected("object_pose", self.object_pose, "none: the task has no object with a mass")
        if shape_of(self.object_pose) != (size,):
            expected = f"{space_of_pose(size).pose_text} ({size},)"
            raise rejected("object_pose", self.object_pose, expected)
        _require_unit_quaternion("object_pose", self.object_pose[problem.model.space.pose_attitude])

    def _require_known_grippers(self, holding: Mapping[str, bool], problem: Problem) -> None:
        """Raise an error if reports of grippers are not about the grippers that are to hold the task's object.

        Args:
            holding: Whether each gripper holds the object, by arm.
            problem: The task made computable.

        Raises:
            InputError: The task has no object with a mass, there is no such gripper, or a report is neither True nor
                False.
        """
        grippers = problem.body.grippers
        if not grippers:
            raise rejected("holding", holding, "none: the task has no object with a mass")
        is_mapping = isinstance(holding, Mapping)
        if not (is_mapping and all(gripper in grippers for gripper in holding)):
            raise rejected("holding", holding, f"a mapping of {', '.join(grippers)} to True or False")
        for gripper, holds in holding.items():
            if not isinstance(holds, bool | np.bool_):
                raise rejected(f"holding[{gripper!r}]", holds, "True or False; a gripper that does not report left out")

    def follows_a_gap(self, before: float, sample_time: float) -> bool:
        """Tell whether more than a sample [s] has passed since the one before [s]."""
        return isfinite(before) and self.time - before > (1 + LATE) * sample_time


def require_finite_time(time: float) -> None:
    """Raise an error if a time is no finite number.

    Raises:
        InputError: It is none.
    """
    is_number = isinstance(time, Real) and not isinstance(time, bool)
    if not (is_number and abs(time) <= LARGEST):
        raise rejected("time", time, f"a finite number up to {LARGEST:g} [s]")


def require_state_of(state: State, model: RobotModel) -> None:
    """Raise an error if a state is not one of this robot: of its sizes, with a unit quaternion in space.

    Numbers that are not finite are allowed: they were not measured.

    Raises:
        InputError: It is no `State`, or Q, v or what wheels store have other sizes than the robot's, or the quaternion
            of the base is not of length 1.
    """
    if not isinstance(state, State):
        raise rejected("state", state, "a State(Q, v)")
    if state.Q.shape != (model.nq,) or state.v.shape != (model.n,):
        sizes = f"Q {state.Q.shape} and v {state.v.shape}"
        raise InputError(f"state: found {sizes}, expected Q ({model.nq},) and v ({model.n},) of {model.spec.name}")
    count = len(model.spec.wheels)
    if state.wheels is not None and state.wheels.shape != (count,):
        wanted = f"({count},), one of each wheel of {model.spec.name}" if count else f"none: {model.spec.name} has none"
        raise InputError(f"state: found wheels {state.wheels.shape}, expected {wanted}")
    _require_unit_quaternion("state", state.Q[model.space.attitude])


def _require_unit_quaternion(name: str, quaternion: np.ndarray) -> None:
    """Raise an error if a measured quaternion is not of length 1; an empty one, or NaN, is none."""
    norm = float(np.linalg.norm(quaternion))
    if len(quaternion) and np.isfinite(norm) and abs(norm - 1) > UNIT:
        raise InputError(f"{name}: found a quaternion of length {norm:.4g}, expected a unit quaternion w, x, y, z")


def make_read_only(*values: object) -> None:
    """Make arrays read-only, also those in tuples, lists and dataclasses: what is handed out is what is recorded."""
    for value in values:
        if isinstance(value, np.ndarray):
            value.flags.writeable = False
        elif isinstance(value, tuple | list):
            make_read_only(*value)
        elif is_dataclass(value):
            make_read_only(*vars(value).values())


class NewTarget(NamedTuple):
    """A stage has another target since the sample before.

    Attributes:
        stage: Its name.
        target: The target as a task file has it, of plain mappings, lists, texts and numbers.
    """

    stage: str
    target: Any


@dataclass(frozen=True, eq=False)
class Command:
    """What the controller decided at one sample. Its arrays are read-only.

    Attributes:
        time: Of the measurement that it was decided from [s].
        delay: By how much later it is expected to begin to act [s]: as given, or as found out.
        delay_deviation: Standard deviation of that [s]; 0 where it is given, infinite before anything tells of it.
        state: State [Q; v] (nq + n,) in which it begins to act: the measured one, or the one foreseen over the delay.
        u: Accelerations over the low-level ticks of a sample (M, n) [m/s^2, rad/s^2].
        tick: Length of a tick [s].
        edges: When the ticks are expected to begin, and the last one to end (M + 1,) [s].
        plan: The plan in force.
        sequence: The stages in the window.
        prediction: The shifted plan that the solve started from.
        solution: The solve behind the plan, or the failed one.
        events: Names of what happened: `appended` (a stage entered the window), `postponed` (the next stage was seen,
            but the window with it has no solution yet), `solve_failed` (the shifted plan goes on), `braking` (the plan
            is used up, and `plan` brakes to rest), `unmeasured` (the state was not finite, the plan's was used for it),
            `gap` (more than a sample has passed since the last one), `near_singular` (J_C is too near a singular one
            for the law in task space, and that in joint space applies the plan), `load_dropped` (what had been found
            out of the load did not explain the last measurements, and was given up for the prior), `missed` (grippers
            report that they missed the object or lost it, or they took too long), `returned` (the sequence has
            therefore returned to an earlier stage), `retargeted` (a stage has another target since the sample before).
        switches: Stages that ended since the sample before.
        disturbance: Estimated acceleration that no plan knows of (n,); zero without offset-free control.
        levels: The solution of each level of HTMPC, of the current stage first. Where a level did not converge, its
            plan is that of the level before.
        stages: All stages of the task, with their targets at this sample.
        closed: Whether the grippers are to be closed on the object at each tick (M,).
        driven: Whether something acts on each coordinate of the base at each tick, 1 or 0 (M, n_twist).
        law: The law that applies it.
        problem: The problem, with the targets in force.
        new_targets: Targets that have changed since the sample before.
        route_progress: Share of the length of the current stage's route from which on it counts; NaN without one.
        load: What is known of the load; `NO_LOAD`, without numbers, where it is not to be found out.
        inertia: What is known of masses and inertias of the robot; `NO_INERTIA`, of no bodies, where they are not to be
            found out.
        twist_rates: Rates of the velocities J_C v of base and end-effectors over the ticks (M, k) [m/s^2, rad/s^2] to
            which u leads: what the law in task space applies, of a stage with `input: task`; None where the law is that
            in joint space.
        wheels: What wheels are taken to store at the time of the measurement (W,) [N m s]; (0,) without any.
        shut: Which thrusters must not fire at each tick (M, T), because the stage avoids plumes that reach something.
        held: Whether a mount holds a base that moves otherwise, at each tick (M,); empty: at none.
    """

    time: float
    delay: float
    delay_deviation: float
    state: np.ndarray
    u: np.ndarray
    tick: float
    edges: np.ndarray
    plan: Plan
    sequence: MovingSequence
    prediction: Plan
    solution: Solution
    events: frozenset[str]
    switches: tuple[Switch, ...]
    disturbance: np.ndarray
    levels: tuple[Solution, ...]
    law: LowLevelLaw = field(repr=False)
    problem: Problem = field(repr=False)
    stages: tuple[PlacedStage, ...] = field(repr=False)
    closed: np.ndarray
    driven: np.ndarray
    route_progress: float = np.nan
    load: LoadEstimate = NO_LOAD
    inertia: InertiaEstimate = NO_INERTIA
    twist_rates: np.ndarray | None = None
    new_targets: tuple[NewTarget, ...] = ()
    wheels: np.ndarray = field(default_factory=lambda: np.zeros(0))
    shut: np.ndarray = field(default_factory=lambda: np.zeros((0, 0), bool))
    held: np.ndarray = field(default_factory=lambda: np.zeros(0, bool))

    def __post_init__(self) -> None:
        """Make the arrays read-only: the controller goes on from them, and logs are written from them later."""
        make_read_only(self.state, self.u, self.edges, self.plan, self.prediction, self.disturbance, self.closed)
        make_read_only(self.driven, self.twist_rates, self.wheels, self.shut, self.held)
        for solution in (self.solution, *self.levels):
            make_read_only(solution.plan, solution.guess, solution.costs, solution.violations, solution.duals)

    def __repr__(self) -> str:
        ticks, n = self.u.shape
        stages = ", ".join(stage.name for stage in self.solution.window.stages)
        happened = f"; {', '.join(sorted(self.events))}" if self.events else ""
        return f"<Command at {self.time:g} s: {ticks} ticks of {n} accelerations, stages {stages}{happened}>"

    @property
    def acts_at(self) -> float:
        """When it is expected to begin to act [s]."""
        return float(self.edges[0])

    @property
    def switch_times(self) -> np.ndarray:
        """Planned switch times [s], absolute; see `MovingSequence`."""
        return self.sequence.switch_times

    @property
    def stage(self) -> PlacedStage:
        """The current stage, with its `name` and `index`."""
        return self.solution.window.stages[0]

    @property
    def outcome(self) -> Outcome:
        """How the solve ended; under HTMPC that of the last level, which alone may have failed."""
        return (self.levels or (self.solution,))[-1].outcome

    @property
    def iterations(self) -> int:
        """Iterations of all solves."""
        return sum(solve.iterations for solve in self.levels or (self.solution,))

    @property
    def solve_time(self) -> float:
        """Wall time of all solves [s]."""
        return sum(solve.wall_time for solve in self.levels or (self.solution,))

    def force(self, time: float, state: State) -> np.ndarray:
        """Compute the generalized force (n,) [N, N m] that a low-level controller applies over a tick: computed torque.

        The force on the base is along the axes of the inertial frame, as Qdot is; its moment, in space, is about the
        base's own axes. Limits of the base's force are along its own axes: `model.space.along_base_axes(Q, F)` turns
        the force into these.

        The moment on the base of a robot with reaction wheels includes the gyroscopic moment of the momenta that they
        store: `state.wheels`, or those at the sample where the state has none. If wheels turn the base, this moment is
        for their motors, see `motor_torques`. If thrusters push the base, they give it, and with it what balances the
        motors that unload wheels.

        While grippers are to be closed on an object whose grasps are `known`, the robot is taken to hold it with all of
        them. Otherwise, in a stage with `input: task`, the law is that in task space.

        Args:
            time: When the tick is expected to begin [s], see `edges`.
            state: Measured then.

        Raises:
            InputError: The time is not finite, or the state is not one of the robot.
        """
        require_finite_time(time)
        require_state_of(state, self.law.model)
        tick = self._tick_at(time)
        twist_rates = None if self.twist_rates is None else self.twist_rates[tick]
        grasps = self.law.grasps if self.closed[tick] else None
        driven = tuple(self.driven[tick].tolist())
        parameters = None  # those of the law
        if len(self.wheels):
            stored = Wheels.of(self.law.model.spec).along_base(self._momenta(state).tolist())
            parameters = self.law.parameters.storing(np.array(stored))
        law = self.law.on_mount() if len(self.held) and self.held[tick] else self.law
        return law.force(state.Q, state.v, self.u[tick], twist_rates, grasps, parameters, driven)

    def motor_torques(self, time: float, state: State) -> np.ndarray:
        """Compute the torques of the motors of the W reaction wheels over a tick (W,) [N m].

        If wheels turn the base, the torques are the smallest ones that give the moment of `force`. If thrusters push
        the base, they unload the wheels: they bring the stored momenta back to the first ones, and the thrusters
        balance their moment. Otherwise they are 0. All are within what the motors can give. A torque accelerates its
        wheel, and the base feels the opposite.

        Args:
            time: When the tick is expected to begin [s], see `edges`.
            state: Measured then.

        Raises:
            InputError: The time is not finite, the state is not one of the robot, or the robot has no wheels.
        """
        model = self.law.model
        if not model.spec.wheels:
            raise InputError(f"motor_torques: found {model.spec.name}, expected a robot with wheels")
        wheels = Wheels.of(model.spec)
        F = self.force(time, state)
        driven = tuple(self.driven[self._tick_at(time)].tolist())
        h = self._momenta(state)
        F, unloading_torques = wheels.with_unloading(F, h, driven, self.tick)
        _, torques = wheels.with_turning(F, h, driven, self.tick, unloading_torques)
        return torques

    def _tick_at(self, time: float) -> int:
        """Return the number of the tick at a time [s]."""
        return int(np.clip(np.floor((time - self.acts_at) / self.tick + 1e-6), 0, len(self.u) - 1))

    def _momenta(self, state: State) -> np.ndarray:
        """Return what wheels store in a state (W,), by default what they stored at the sample."""
        return self.wheels if state.wheels is None else np.where(np.isfinite(state.wheels), state.wheels, self.wheels)
