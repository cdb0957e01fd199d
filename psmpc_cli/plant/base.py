"""The interface of all plants: advance over one sample under the low-level controller, return what happened."""

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from psmpc_cli.robot.dynamics import InertialParameters


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
        X: States [Q; v] at those times (M + 1, nq + n).
        F: Generalized force commanded over each tick, within its limits (M, n) [N, N m].
        gained: Integral of the external wrench over the sample, linear [N s] and angular about the inertial origin
            [N m s], then of F' v of all forces, those between grippers and object included [J], (4,) or (7,). NaN where
            it is not known.
        target_object: What an object with a mass did; None without one.
    """

    time: np.ndarray
    X: np.ndarray
    F: np.ndarray
    gained: np.ndarray = field(default_factory=lambda: np.array(np.nan))
    target_object: ObjectTicks | None = None

    def __repr__(self) -> str:
        ticks, n = self.F.shape
        return f"<Ticks from {self.time[0]:g} s to {self.time[-1]:g} s: {ticks} ticks of {n} forces>"


@dataclass(frozen=True, eq=False)
class Resistance:
    """Joint friction and force limits by coordinate (n,), constant throughout a run.

    Attributes:
        viscous: Coefficients of viscous friction [N m s/rad]; 0 for the base.
        coulomb: Coulomb friction [N m]; 0 for the base.
        width: Rate around 0 within which Coulomb friction changes its sign [rad/s].
        largest: Largest magnitudes of the commanded generalized force [N, N m]; infinite where there is no limit.
    """

    viscous: np.ndarray
    coulomb: np.ndarray
    width: float
    largest: np.ndarray

    @classmethod
    def none(cls, n: int) -> "Resistance":
        """Return that of n coordinates without friction or limits."""
        return cls(np.zeros(n), np.zeros(n), 1.0, np.full(n, np.inf))

    def left_of(self, F: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return what friction at velocities v (n,) leaves of a generalized force F (n,)."""
        return np.asarray(F - self.viscous * v - self.coulomb * np.tanh(v / self.width))

    @property
    def vector(self) -> np.ndarray:
        """All of it in one vector (3n + 1,)."""
        return np.concatenate([self.viscous, self.coulomb, self.largest, [self.width]])


@dataclass(frozen=True, eq=False)
class Disturbance:
    """Differences, over one sample, between the robot and what its controller knows.

    Attributes:
        robot: True inertial parameters, with what is in the grippers.
        law: Inertial parameters that the low-level law (7) uses.
        noise: Of the state that the law reads at each tick: a step of Q, then what is added to v (M, 2n) [m, rad, m/s,
            rad/s].
        push: External generalized force over each tick (M, n) [N, N m].
    """

    robot: InertialParameters
    law: InertialParameters
    noise: np.ndarray
    push: np.ndarray

    @classmethod
    def none(cls, robot: InertialParameters, ticks: int, n: int) -> "Disturbance":
        """Return that of a known robot with n velocities which nothing disturbs."""
        return cls(robot, robot, np.zeros((ticks, 2 * n)), np.zeros((ticks, n)))


class Plant(Protocol):
    """Simulated physics of a robot under its low-level controller."""

    def advance(
        self,
        start: float,
        x: np.ndarray,
        u: np.ndarray,
        disturbance: Disturbance | None = None,
        closed: np.ndarray | None = None,
    ) -> Ticks:
        """Advance from the state x (nq + n,) at `start` [s], the rates u of v (M, n) applied one a tick.

        Without a disturbance nothing disturbs a plant; one is for plants built with a resistance. Those with an object
        close their grippers, and open them, at the ticks at which they are to be closed (M,).
        """
        ...
