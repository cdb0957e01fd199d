"""What is random about an uncertain robot, drawn from a task's seed: every item from a stream of its own."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from psmpc_cli.plant.disturbance import Resistance
from psmpc_cli.robot.inertial import Inertials, body_names, described
from psmpc_cli.specs.robot import RobotSpec
from psmpc_cli.specs.task import FrictionSpec, NoiseSpec, PayloadSpec, UncertaintySpec

ByPart = float | Mapping[str, float] | Mapping[str, tuple[float, ...]]
"""One number for all, or numbers by part, `arms` for every arm that has none of its own."""


class Stream(IntEnum):
    """The streams of a seed; a new item takes a new number, so that what is drawn for the others stays."""

    MASS = 0
    INERTIA = 1
    CENTRE_OF_MASS = 2
    NOISE = 3


@dataclass(frozen=True, eq=False)
class Draw:
    """What was drawn for the bodies of a robot, in the order of `body_names`.

    Attributes:
        mass_factor: True mass over the described one (bodies,).
        inertia_factor: True inertia over the described one (bodies,).
        offset: Of the true centre of mass, along the axes of the body (bodies, 2) [m].
    """

    mass_factor: np.ndarray
    inertia_factor: np.ndarray
    offset: np.ndarray

    def applied(self, robot: RobotSpec) -> Inertials:
        """Return what the robot really weighs, with nothing in its grippers."""
        free = described(robot)
        mass, inertia = self.mass_factor * free.mass, self.inertia_factor * free.inertia
        return Inertials(mass, inertia, self.offset, free.held_mass, free.held_inertia)


def draw(spec: UncertaintySpec, robot: RobotSpec, seed: int) -> Draw:
    """Draw the bodies of a robot, uniformly within their ranges."""
    count = len(body_names(robot))
    return Draw(
        mass_factor=1 + _by_body(spec.mass, robot) * _stream(seed, Stream.MASS).uniform(-1, 1, count),
        inertia_factor=1 + _by_body(spec.inertia, robot) * _stream(seed, Stream.INERTIA).uniform(-1, 1, count),
        offset=_by_body(spec.centre_of_mass, robot)[:, None]
        * _stream(seed, Stream.CENTRE_OF_MASS).uniform(-1, 1, (count, 2)),
    )


def measurement_noise(spec: NoiseSpec, robot: RobotSpec, seed: int, sample: int, ticks: int) -> np.ndarray:
    """Return the noise of what is measured at each tick of a sample (ticks, 2n) [m, rad, m/s, rad/s].

    It is a function of seed and sample alone: a run that goes on later meets the same.
    """
    joints = sum(robot.parts.values()) - robot.parts["base"]
    deviation = [spec.position] * 2 + [spec.angle] * (1 + joints)
    deviation += [spec.velocity] * 2 + [spec.angular_velocity] * (1 + joints)
    drawn = _stream(seed, Stream.NOISE, sample).standard_normal((ticks, len(deviation)))
    return np.asarray(drawn * deviation)


def resistance(friction: FrictionSpec, force_limits: Mapping[str, tuple[float, ...]], robot: RobotSpec) -> Resistance:
    """Return friction and limits of the forces by coordinate."""
    return Resistance(
        viscous=_by_coordinate(friction.viscous, robot, base=0.0, missing=0.0),
        coulomb=_by_coordinate(friction.coulomb, robot, base=0.0, missing=0.0),
        width=friction.width,
        largest=_by_coordinate(force_limits, robot, base=None, missing=np.inf),
    )


def shares(payload: PayloadSpec, robot: RobotSpec) -> np.ndarray:
    """Return what each gripper holds of a payload (arms,), 1 altogether."""
    arms = list(robot.arms)
    return np.full(len(arms), 1 / len(arms)) if payload.share is None else _numbers(payload.share, arms, 0.0)


def _stream(seed: int, *key: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


def _by_body(given: float | Mapping[str, float], robot: RobotSpec) -> np.ndarray:
    """Return one number a body (bodies,)."""
    sizes = [1, *(len(arm.links) for arm in robot.arms.values())]
    return np.repeat(_numbers(given, list(robot.parts), 0.0), sizes)


def _numbers(given: float | Mapping[str, float], parts: Sequence[str], missing: float) -> np.ndarray:
    """Return one number a part."""
    if not isinstance(given, Mapping):
        return np.full(len(parts), given)
    return np.array([given.get(part, missing if part == "base" else given.get("arms", missing)) for part in parts])


def _by_coordinate(given: ByPart, robot: RobotSpec, base: float | None, missing: float) -> np.ndarray:
    """Return one number a coordinate (n,); with `base` given, that for the base's."""
    found = []
    for part, size in robot.parts.items():
        values: float | tuple[float, ...]
        if part == "base" and base is not None:
            values = base
        elif isinstance(given, Mapping):
            values = given.get(part, missing if part == "base" else given.get("arms", missing))
        else:
            values = given
        found.append(np.broadcast_to(values, size))
    return np.concatenate(found)
