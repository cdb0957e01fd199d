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
        """Compute the generalized force (n,) [N, N m] that is applied over a tick, by inverse dynamics.

        It is the computed torque for commanded accelerations u, paper eq. (7); or the law in task space for commanded
        rates of the velocities of base and end-effectors, paper eqs. (5) and (6). The force on the base is along the
        axes of the inertial frame; its moment, in space, is about the base's own axes.

        Args:
            Q: Position of the robot (nq,).
            v: Velocity (n,).
            u: Commanded rates of v (n,); while all hands hold a known load, rates that the closed chain allows.
            twist_rates: Commanded rates of the velocities J_C v (k,), which count instead of u unless the hands hold a
                known load; by default u counts.
            grasps: How hands hold the known object; by default they do not.
            parameters: Inertial parameters that the law assumes for the robot; by default its own.
            driven: 1 for each coordinate of the base on which something acts in this tick, else 0; by default its own.
            base_force: Force that acts on the base in this tick whatever is commanded, such as that of pulses, and its
                mean over their period (2, n_twist); moments in space are about the base's axes. By default the force
                that is returned acts. The torques of the joints are those under which they accelerate as commanded all
                the same, and the rows of the base stay as they are. The mean counts for a known load alone, see
                `pushed_held_force`.
        """
        parameters = parameters or self.parameters
        if twist_rates is None:
            base_force_now = None if base_force is None else base_force[0]
            return self.model.computed_torque(Q, v, u, parameters, driven or self.driven, base_force_now)
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
        """Compute the generalized force over a tick, see `LowLevelLaw.force`.

        While all hands hold the object (`grasps` is given), it is the force of the closed chain of robot and object, by
        `HeldLoad.force`. It then accelerates by u, and `twist_rates` do not count.
        """
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
