"""The low-level law: the generalized force that follows what is commanded, of controllers and plants alike."""

from copy import copy
from typing import Self

import numpy as np

from psmpc_cli.robot.dynamics import InertialParameters
from psmpc_cli.robot.free_body import FreeBody
from psmpc_cli.robot.held_load import HeldLoad
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.object import GraspSpec


class LowLevelLaw:
    """The low-level law of a robot that knows of no object in its hands.

    Attributes:
        model: The robot.
        parameters: Inertial parameters that it counts with for the robot's.
        driven: On which coordinates of the base something acts, see `RobotModel.driven`.
        load: Mass [kg] and principal moments [kg m^2] that it counts with for what hands hold; empty where it knows of
            none.
    """

    knows_load = False
    """Whether the law counts with an object in the hands."""

    grasps: np.ndarray | None = None
    """Those that the law counts with where hands hold an object, see `HeldLoad.force`; None where it knows of none."""

    def __init__(self, model: RobotModel) -> None:
        self.model = model
        self.parameters = model.nominal
        self.driven = model.driven()
        self.load = np.zeros(0)

    def with_load(self, found: np.ndarray) -> Self:
        """Return the law with mass and moments of what hands hold as they were found out, where it knows of that.

        Args:
            found: Mass [kg] and principal moments [kg m^2]; where it is empty those of the description count.
        """
        return self

    def with_parameters(self, parameters: InertialParameters) -> Self:
        """Return the law with other inertial parameters of the robot."""
        other = copy(self)
        other.parameters = parameters
        return other

    def driving(self, driven: tuple[float, ...]) -> Self:
        """Return the law where something acts on other coordinates of the base."""
        other = copy(self)
        other.driven = driven
        return other

    def on_mount(self) -> Self:
        """Return the law of the same robot while a mount holds its base."""
        other = copy(self)
        other.model = self.model.mounted
        other.driven = other.model.driven()
        return other

    def force(
        self,
        Q: np.ndarray,
        v: np.ndarray,
        u: np.ndarray,
        twist_rates: np.ndarray | None = None,
        grasps: np.ndarray | None = None,
        parameters: InertialParameters | None = None,
        driven: tuple[float, ...] | None = None,
        base_force: np.ndarray | None = None,
    ) -> np.ndarray:
        """Compute the generalized force (n,) [N, N m] over a tick.

        That of the base is along the axes of the inertial frame, in space its moment about the base's axes.

        Args:
            Q: Position of the robot (nq,).
            v: Velocity (n,).
            u: Commanded rates of v (n,), by eq. (7); with a known load that all hands hold, those of the closed chain.
            twist_rates: Commanded rates of the velocities J_C v (k,), by (5) and (6), instead of u where the hands do
                not hold a known load; None where u counts.
            grasps: Of the object that all hands hold; None while they do not.
            parameters: Inertial parameters that the law has for the robot's; by default its own.
            driven: On which coordinates of the base something acts in this tick; by default its own.
            base_force: Force that acts on the base in this tick, as that of pulses, and its mean over their period, the
                moments in space about the base's axes (2, n_twist); by default the one that is returned. The torques of
                joints are those under which they accelerate as commanded all the same. The rows of the base are not
                changed by it. The mean counts for a known load alone, see `pushed_held_force`.
        """
        parameters = parameters or self.parameters
        if twist_rates is None:
            now = None if base_force is None else base_force[0]
            return self.model.computed_torque(Q, v, u, parameters, driven or self.driven, now)
        F = self.model.task_space_force(Q, v, twist_rates, parameters)
        if base_force is not None:
            u = self.model.task_space_acceleration(Q, v, twist_rates, parameters)
            joints = self.model.space.joint_rates
            F[joints] = self.model.computed_torque(Q, v, u, parameters, base_force=base_force[0])[joints]
        return F

    def prepare(self) -> None:
        """Derive what `attainable_accelerations` needs, so that no sample waits for it."""

    def attainable_accelerations(
        self, Q: np.ndarray, v: np.ndarray, u: np.ndarray, closed: np.ndarray, tick: float
    ) -> np.ndarray:
        """Return the robot's accelerations (M, n) under commanded ones, see `HeldLoad.attainable_accelerations`."""
        return u


class LoadedLaw(LowLevelLaw):
    """The low-level law of a robot that knows the object in its hands.

    Args:
        model: The robot.
        body: The object.
        grasp: How hands hold it.
    """

    knows_load = True

    def __init__(self, model: RobotModel, body: FreeBody, grasp: GraspSpec) -> None:
        super().__init__(model)
        self._body = body
        self._load = HeldLoad(model, body, grasp)
        self.grasps = self._load.grasps
        self.load = body.vector

    def with_load(self, found: np.ndarray) -> Self:
        """Return the law with mass and moments of what hands hold as they were found out."""
        other = copy(self)
        other.load = self._body.vector_with(found)
        return other

    def force(
        self,
        Q: np.ndarray,
        v: np.ndarray,
        u: np.ndarray,
        twist_rates: np.ndarray | None = None,
        grasps: np.ndarray | None = None,
        parameters: InertialParameters | None = None,
        driven: tuple[float, ...] | None = None,
        base_force: np.ndarray | None = None,
    ) -> np.ndarray:
        """Compute the force of the closed chain while all hands hold the object."""
        if grasps is None:
            return super().force(Q, v, u, twist_rates, grasps, parameters, driven, base_force)
        robot = parameters or self.parameters
        return self._load.force(Q, v, u, robot, grasps, self.load, driven or self.driven, base_force)

    def prepare(self) -> None:
        """Derive what the closed chain leaves of commanded accelerations."""
        self._load.prepare()

    def attainable_accelerations(
        self, Q: np.ndarray, v: np.ndarray, u: np.ndarray, closed: np.ndarray, tick: float
    ) -> np.ndarray:
        """Return what the closed chain leaves of the commanded accelerations."""
        return self._load.attainable_accelerations(Q, v, u, closed, tick) if closed.any() else u


def low_level_law(model: RobotModel, body: FreeBody, grasp: GraspSpec) -> LowLevelLaw:
    """Return the law of a robot that may know an object in its hands."""
    return LoadedLaw(model, body, grasp) if grasp.known else LowLevelLaw(model)
