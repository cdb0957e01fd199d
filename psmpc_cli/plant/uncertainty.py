"""What the controller does not know: drawn bodies, friction, noise, external forces, and the payload in the grippers.

What is random is drawn from the task's seed, every item from a stream of its own.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from psmpc_cli.errors import InputError
from psmpc_cli.plant.base import Disturbance, ForceLimits, JointFriction
from psmpc_cli.robot.actuators.thrusters import Thrusters
from psmpc_cli.robot.dynamics import InertialParameters
from psmpc_cli.robot.low_level import LowLevelLaw
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.robots.robot import RobotSpec, resolve_limits, stack
from psmpc_cli.specs.task import TaskSpec
from psmpc_cli.specs.uncertainty import NoiseSpec, UncertaintySpec, standard_deviations

ByPart = float | Mapping[str, float] | Mapping[str, tuple[float, ...]]
"""One number for all, or numbers by part, of which one is for all of it; `arms` is every arm that has none."""


@dataclass(frozen=True, eq=False)
class Contact:
    """Instantaneous effect of taking up or releasing the payload.

    Attributes:
        state: State after it (nq + n,).
        momentum_and_energy: Momentum [N s, N m s] and kinetic energy [J] that the robot gains, with what it holds, (4,)
            or (7,).
    """

    state: np.ndarray
    momentum_and_energy: np.ndarray


class Uncertainty:
    """The uncertainty of one run.

    It holds no state: what is measured follows from seed and sample, and whether the payload is held from the current
    stage.

    Attributes:
        spec: The uncertainty of the task.
        draw: What was drawn for the bodies.
        friction: Friction, to build the plant with; None where nothing disturbs it.
    """

    def __init__(self, task: TaskSpec, model: RobotModel) -> None:
        self.spec = task.uncertainty
        self._stages_with_payload = task.held_stages if task.uncertainty.payload else range(0)
        self._task = task
        self._model = model
        self.draw = draw_bodies(self.spec, model.spec, task.seed)
        self.friction: JointFriction | None = None
        self._ticks = round(task.controller.sample_time * task.plant.low_level_rate)
        self._true_robot = self.draw.true_parameters(model.nominal)
        if disturbs(task):
            self.friction = friction_of(self.spec, model.spec)
            _require_short_step(task, model.mass_matrix(model.neutral, self._true_robot), self.friction)

    def measured(self, sample: int, state: np.ndarray) -> np.ndarray:
        """Return the state that is measured at a sample: the true one (nq + n,) with noise, if the task has any."""
        if not self.spec.measures_with_noise:
            return state
        n = self._model.n
        nq = self._model.nq
        noise = self._measurement_noise(sample)[0]
        return np.concatenate([self._model.space.integrate(state[:nq], noise[:n]), state[nq:] + noise[n:]])

    def holds(self, stage: int) -> bool:
        """Return whether the grippers hold the payload during a stage."""
        return stage in self._stages_with_payload

    def contact(self, state: np.ndarray, before: int, after: int) -> Contact:
        """Return the effect on the true state of a switch from one stage to another, by their indices.

        There is one where the payload is held in only one of them: it is then taken up, or released.
        """
        if self.friction is None or self.holds(before) == self.holds(after):
            return Contact(state, np.zeros(self._model.space.n_twist + 1))
        change = take_up if self.holds(after) else release
        return change(self._model, state, self._true_robot, self._with_payload(self._true_robot))

    def disturbance(self, sample: int, start: float, stage: int, law: LowLevelLaw) -> Disturbance | None:
        """Collect how the true robot differs, over one sample, from what its controller knows, for the plant.

        Args:
            sample: Number of the sample, by which its noise is drawn.
            start: When it begins [s].
            stage: Index of the stage then, which tells whether the payload is held.
            law: The low-level law, with the inertial parameters that it takes for the robot's.

        Returns:
            The differences; None if the task has none.
        """
        if self.friction is None:
            return None
        believed = law.parameters
        # tasks may tell the law mass and inertia of the payload while it is held
        if self.spec.carried.is_told and self.holds(stage):
            believed = self._with_payload(believed)
        return Disturbance(
            robot=self.true_parameters(stage),
            law=believed,
            noise=self._measurement_noise(sample),
            external_force=self._external_force(start),
        )

    def true_parameters(self, stage: int) -> InertialParameters:
        """Return the inertial parameters of the simulated robot and what it holds in a stage."""
        if self.friction is None:
            return self._model.nominal
        return self._with_payload(self._true_robot) if self.holds(stage) else self._true_robot

    @property
    def drawn(self) -> dict[str, ArrayLike]:
        """What was drawn for the bodies, by the path of its dataset in the log."""
        return {
            "uncertainty/body": tuple(body.name for body in self._model.spec.bodies),
            "uncertainty/axis": ("x", "y", "z")[: self._model.dimension],
            "uncertainty/mass_factor": self.draw.mass_factor,
            "uncertainty/inertia_factor": self.draw.inertia_factor,
            "uncertainty/centre_of_mass": self.draw.offset,
        }

    def _with_payload(self, free: InertialParameters) -> InertialParameters:
        """Return inertial parameters of the robot while the grippers hold the payload, each its share."""
        payload = self.spec.carried
        share = np.array(payload.shares(tuple(self._model.spec.arms)))
        return free.holding(share * payload.mass, share * payload.inertia)

    def _measurement_noise(self, sample: int) -> np.ndarray:
        """Return the noise at each tick of a sample (M, 2n), see `measurement_noise`."""
        return measurement_noise(self.spec.noise, self._model.spec, self._task.seed, sample, self._ticks)

    def _external_force(self, start: float) -> np.ndarray:
        """Return the external generalized force at each tick of the sample that begins at `start` (M, n)."""
        external_force = np.zeros((self._ticks, self._model.n))
        impulse = self.spec.impulse
        if impulse is not None:
            rate = self._task.plant.low_level_rate
            # the tick in which the impulse acts; 1e-6 of a tick is for the rounding of the quotient
            tick = int(np.floor((impulse.at - start) * rate + 1e-6))
            if 0 <= tick < self._ticks:
                d = self._model.dimension
                base = self._model.space.n_twist
                # impulse over the length of a tick, 1 / rate
                external_force[tick, :d] = rate * np.array(impulse.linear)
                external_force[tick, d:base] = rate * np.array(impulse.angular)
        return external_force


def disturbs(task: TaskSpec) -> bool:
    """Return whether plant and low-level law of a task differ from what the controller knows."""
    spec = task.uncertainty
    is_disturbed = spec.changes_the_plant or spec.measures_with_noise or task.finds_masses
    return task.plant.traits.has_forces and is_disturbed


def take_up(model: RobotModel, state: np.ndarray, free: InertialParameters, holding: InertialParameters) -> Contact:
    """Compute how velocities and energy jump when the robot takes up an object at rest: H_holding v+ = H_free v-.

    The object has no momentum, so the generalized momentum stays. The energy lost is that of the lost velocities, by
    Carnot's theorem: 1/2 (v- - v+)' H_free (v- - v+) + 1/2 v+' (H_holding - H_free) v+.

    Args:
        model: The robot.
        state: State [Q; v-] before the contact (nq + n,).
        free: Inertial parameters of the robot with empty grippers.
        holding: Inertial parameters of the robot with the object in its grippers.

    Returns:
        The state [Q; v+] after the contact, and the change of momentum, which is 0, and of kinetic energy.
    """
    Q, v_before = np.split(state, [model.nq])
    H_free = model.mass_matrix(Q, free)
    H_holding = model.mass_matrix(Q, holding)
    v_after = np.linalg.solve(H_holding, H_free @ v_before)
    v_lost = v_before - v_after
    energy_lost = (v_lost @ H_free @ v_lost + v_after @ (H_holding - H_free) @ v_after) / 2
    return Contact(np.concatenate([Q, v_after]), np.append(np.zeros(model.space.n_twist), -energy_lost))


def release(model: RobotModel, state: np.ndarray, free: InertialParameters, holding: InertialParameters) -> Contact:
    """Compute the effect of releasing an object: velocities stay, and its momentum and energy leave with it.

    Args:
        model: The robot.
        state: State [Q; v] at the release (nq + n,).
        free: Inertial parameters of the robot with empty grippers.
        holding: Inertial parameters of the robot with the object in its grippers.
    """
    Q, v = np.split(state, [model.nq])
    return Contact(state, model.balance(Q, v, free) - model.balance(Q, v, holding))


STREAMS = ("mass", "inertia", "centre_of_mass", "noise", "object", "object noise", "delay")
"""Random streams of a seed, by number; a new item goes to the end, so that what is drawn for the others stays."""


@dataclass(frozen=True, eq=False)
class Draw:
    """What was drawn for the bodies of a robot, in their order.

    Attributes:
        mass_factor: True mass over the nominal one (bodies,).
        inertia_factor: True inertia over the nominal one (bodies,).
        offset: Of the true centre of mass, along the axes of the body (bodies, dimension) [m].
    """

    mass_factor: np.ndarray
    inertia_factor: np.ndarray
    offset: np.ndarray

    def true_parameters(self, nominal: InertialParameters) -> InertialParameters:
        """Return the true inertial parameters, with empty grippers."""
        mass = self.mass_factor * nominal.mass
        inertia = self.inertia_factor[:, None] * nominal.inertia
        return replace(nominal, mass=mass, inertia=inertia, offset=self.offset)


def draw_bodies(spec: UncertaintySpec, robot: RobotSpec, seed: int) -> Draw:
    """Draw the bodies of a robot, uniformly within their ranges."""
    count = len(robot.bodies)
    return Draw(
        mass_factor=1 + _by_body(spec.mass, robot) * stream(seed, "mass").uniform(-1, 1, count),
        inertia_factor=1 + _by_body(spec.inertia, robot) * stream(seed, "inertia").uniform(-1, 1, count),
        offset=_by_body(spec.centre_of_mass, robot)[:, None]
        * stream(seed, "centre_of_mass").uniform(-1, 1, (count, robot.dimension)),
    )


def measurement_noise(spec: NoiseSpec, robot: RobotSpec, seed: int, sample: int, ticks: int) -> np.ndarray:
    """Return the noise of the measured state at each tick of a sample: a displacement of Q, then what is added to v.

    It is a function of seed and sample alone, so a run that is repeated or continued has the same noise.

    Returns:
        (ticks, 2n) [m, rad, m/s, rad/s].
    """
    deviation = standard_deviations(spec, robot)
    drawn = stream(seed, "noise", sample).standard_normal((ticks, len(deviation)))
    return np.asarray(drawn * deviation)


def friction_of(spec: UncertaintySpec, robot: RobotSpec) -> JointFriction:
    """Return the friction of the joints by coordinate of the robot; the base has none."""
    viscous, coulomb = (
        _by_coordinate(coefficients, robot, 0.0) for coefficients in (spec.friction.viscous, spec.friction.coulomb)
    )
    base = slice(robot.parts["base"])
    viscous[base] = 0.0
    coulomb[base] = 0.0
    return JointFriction(viscous, coulomb, spec.friction.width)


def force_limits_of(task: TaskSpec, robot: RobotSpec) -> ForceLimits | None:
    """Return the limits at which a plant cuts the forces of the low-level law, as actuators do.

    They are the hard limits of robot and task, and the largest wrench components that thrusters can give, scaled by the
    share of them that the task leaves to actuators which are weaker than the controller believes. Limits of a single
    skill are not among them: plans keep to those, but actuators do not know them.

    Args:
        task: The task.
        robot: The robot.

    Returns:
        The limits by coordinate; None if no force is limited.
    """
    moved_by_in_stages = [task.moved_by(stage, robot) for stage in range(len(task.stages))]
    # a plant has the same limits in all stages: of all that moves the base in any of them
    moved_by_any = replace(
        robot.moved_by,
        is_pushed=any(moved_by.is_pushed for moved_by in moved_by_in_stages),
        is_turned=any(moved_by.is_turned for moved_by in moved_by_in_stages),
    )
    declared = resolve_limits(robot, task.limits, moved_by=moved_by_any)
    low = declared.force_low.copy()
    high = declared.force_high.copy()
    if task.fires(robot):
        wrench_low, wrench_high = Thrusters.of(robot.thrusters).extent
        # Where wheels turn the base in some stage, thrusters limit the force on it alone, and not the moment.
        has_wheels = any(moved_by.is_turned and not moved_by.is_pushed for moved_by in moved_by_in_stages)
        thruster_rows = slice(robot.dimension if has_wheels else len(wrench_low))
        low[thruster_rows] = np.maximum(low[thruster_rows], wrench_low[thruster_rows])
        high[thruster_rows] = np.minimum(high[thruster_rows], wrench_high[thruster_rows])
    if not (np.isfinite(low) | np.isfinite(high)).any():
        return None
    share = _by_coordinate(task.uncertainty.force_share, robot, 1.0)
    return ForceLimits(share * low, share * high)


def _require_short_step(task: TaskSpec, inertia: np.ndarray, friction: JointFriction) -> None:
    """Make sure that the integrator's step is short enough for the friction, which is stiffest near rest.

    A step is short enough if it is no longer than the shortest time constant of the velocities under friction.

    Args:
        task: The task, with its plant's step.
        inertia: Mass matrix of the true robot (n, n).
        friction: Friction of its joints.

    Raises:
        InputError: The step is too long, or the mass matrix is numerically singular. The message says the longest step
            that would do.
    """
    # "not less", since the condition number may be NaN
    if not np.linalg.cond(inertia) < 1 / np.finfo(float).eps:
        raise InputError(
            "uncertainty: found bodies whose inertia matrix is numerically singular, expected masses and centres of "
            "mass nearer to the nominal ones"
        )
    step = task.plant.step or 1 / task.plant.low_level_rate
    # Coulomb friction tanh(v / width) has the slope coulomb / width at rest, like a viscous one
    fastest_rate = _fastest_rate(inertia, friction.viscous + friction.coulomb / friction.width)
    if step * fastest_rate > 1.0:
        viscous_is_stable = step * _fastest_rate(inertia, friction.viscous) <= 1.0  # then a wider tanh would do, too
        wider = ", a larger uncertainty.friction.width" if viscous_is_stable else ""
        allowed_step = 0.95 / fastest_rate  # less than 1: printed with two digits, it must not be rounded up beyond
        raise InputError(
            f"uncertainty.friction: found a step of {step:g} s, expected at most {allowed_step:.2g} s for this "
            f"friction: take a smaller plant.step{wider}, or less friction"
        )


def _fastest_rate(inertia: np.ndarray, damping: np.ndarray) -> float:
    """Return the largest rate [1/s] at which damping (n,) [N m s/rad] brakes an inertia (n, n)."""
    return float(np.abs(np.linalg.eigvals(np.linalg.solve(inertia, np.diag(damping)))).max())


def stream(seed: int, item: str, *key: int) -> np.random.Generator:
    """Return a generator of the random numbers of one item, independent of those of all others.

    Args:
        seed: Seed of the task.
        item: What is drawn, one of `STREAMS`.
        key: Numbers that distinguish draws of the same item, such as that of a sample.
    """
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(STREAMS.index(item), *key)))


def _by_body(given: ByPart, robot: RobotSpec) -> np.ndarray:
    """Return one number for each body (bodies,), 0 where none is given."""
    # a link has the number of its joint, and the base that of the last of its coordinates, which all have the same
    return _by_coordinate(given, robot, 0.0)[robot.parts["base"] - 1 :]


def _by_coordinate(given: ByPart, robot: RobotSpec, missing: float) -> np.ndarray:
    """Return one number for each coordinate (n,).

    Args:
        given: A number for all, or numbers by part of the robot.
        robot: The robot.
        missing: The number where none is given.
    """
    parts = given if isinstance(given, Mapping) else {"base": given, "arms": given}
    values_by_part = {part: tuple(np.ravel(values).tolist()) for part, values in parts.items()}
    return stack(values_by_part, robot, "joint", missing, of_error=True)
