"""The loads that the low-level law, and the plan with it, know the grippers to hold in a stage.

A payload is lumped into the last links. An object with a mass, in grasps that are `known`, is held by the grippers as
the task describes them.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np

from psmpc_cli.robot.dynamics import InertialParameters
from psmpc_cli.robot.held_load import described_grasps, held_force
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.object import ObjectBody
from psmpc_cli.specs.task import TaskSpec


@dataclass(frozen=True)
class HeldObject:
    """An object with a mass in known grasps.

    Attributes:
        mass: [kg].
        inertia: Principal moments, (1,) or (3,) [kg m^2].
        grippers: That hold it.
        grasps: Of each gripper its pose in the object's frame and both stiffnesses.
    """

    mass: float
    inertia: tuple[float, ...]
    grippers: tuple[str, ...]
    grasps: tuple[tuple[float, ...], ...]

    @classmethod
    def of(cls, body: ObjectBody, model: RobotModel) -> "HeldObject":
        """Return the object of a task as its grippers hold it."""
        grasps = described_grasps(body.grippers, body.grasp)
        return cls(body.mass, body.inertia, body.grippers, tuple(map(tuple, grasps.tolist())))


@dataclass(frozen=True)
class LoadKind:
    """What of a load decides expressions. How heavy it is, and where it is held, are numbers that they take.

    Attributes:
        carries: Whether there is a payload.
        grippers: That hold an object with a mass; none without one.
    """

    carries: bool
    grippers: tuple[str, ...]

    def count(self, model: RobotModel) -> int:
        """Return the number of numbers."""
        space = model.space
        of_object = 1 + space.n_principal + (space.n_pose + 2) * len(self.grippers) if self.grippers else 0
        return 2 * len(model.spec.arms) * self.carries + of_object

    def force(self, model: RobotModel, Q: ca.SX, v: ca.SX, u: ca.SX, numbers: ca.SX) -> ca.SX:
        """Return the generalized force (n,) of the low-level law for accelerations u (n,). Paper eq. (7)."""
        own = model.nominal.vector
        loads = 2 * len(model.spec.arms)  # masses and inertias in the grippers, the last of the inertial parameters
        w = ca.vertcat(own[:-loads], numbers[:loads]) if self.carries else own
        if not self.grippers:
            return ca.SX(model.dynamics.law(Q, v, u, w))
        body, grasps = ca.vertsplit(
            numbers[loads * self.carries :], [0, 1 + model.space.n_principal, self.count(model) - loads * self.carries]
        )
        return ca.SX(held_force(model, self.grippers)(Q, v, u, grasps, w, body))

    def own_force(self, model: RobotModel, Q: ca.SX, Qdot: ca.SX, u: ca.SX, anchor: ca.SX, numbers: ca.SX) -> ca.SX:
        """Return that force (n,) for accelerations u in a chart, the base's along its own axes."""
        space = model.space
        position = space.charted_coordinates(Q, anchor)
        v = space.charted_velocity(Q, Qdot)
        vdot = space.charted_acceleration(Q, Qdot, u)
        F = self.force(model, position, v, vdot, numbers)
        return ca.SX(ca.vertcat(*space.along_base_axes(ca.vertsplit(position), ca.vertsplit(F))))


@dataclass(frozen=True)
class Load:
    """What the grippers are known to hold in a stage.

    Attributes:
        mass: Of the payload at each end-effector, (arms,) [kg].
        inertia: Of the payload about that point, (arms,) [kg m^2].
        held: The object with a mass, or None.
    """

    mass: tuple[float, ...]
    inertia: tuple[float, ...]
    held: HeldObject | None = None

    @property
    def kind(self) -> LoadKind:
        """What of it decides expressions."""
        return LoadKind(any(self.mass), () if self.held is None else self.held.grippers)

    @property
    def numbers(self) -> np.ndarray:
        """The numbers that expressions of its kind take."""
        payload = (*self.mass, *self.inertia) if self.kind.carries else ()
        of_object = () if self.held is None else (self.held.mass, *self.held.inertia, *np.ravel(self.held.grasps))
        return np.array([*payload, *of_object])

    def parameters(self, model: RobotModel) -> InertialParameters:
        """Return the inertial parameters of the robot with the payload."""
        return model.nominal.holding(np.array(self.mass), np.array(self.inertia))

    def momentum(self, model: RobotModel) -> ca.Function:
        """Return x (2n,) in a chart, its anchor -> momentum (n_twist,) of robot and payload. Paper eq. (4)."""

        def build() -> ca.Function:
            x = ca.SX.sym("x", 2 * model.n)
            anchor = ca.SX.sym("anchor", model.space.n_anchor)
            Q = model.space.charted_coordinates(x[: model.n], anchor)
            v = model.space.charted_velocity(x[: model.n], x[model.n :])
            h = model.dynamics.momentum(Q, v, self.parameters(model).vector)
            return ca.Function("momentum", [x, anchor], ca.cse([h]))

        return model.cached((type(self).momentum, self), build)

    def own_force(self, model: RobotModel, Q: ca.SX, Qdot: ca.SX, u: ca.SX, anchor: ca.SX) -> ca.SX:
        """Return the force of the low-level law (n,) for accelerations u in a chart, the base's along its own axes."""
        return self.kind.own_force(model, Q, Qdot, u, anchor, ca.SX(self.numbers))


def known_load(task: TaskSpec, model: RobotModel, stage: int) -> Load:
    """Return what the grippers are known to hold in a stage of a task."""
    payload = task.uncertainty.carried
    nothing = (0.0,) * len(model.spec.arms)
    if stage not in task.held_stages:
        return Load(nothing, nothing)
    if payload.known:
        share = np.array(payload.shares(tuple(model.spec.arms)))
        return Load(tuple((share * payload.mass).tolist()), tuple((share * payload.inertia).tolist()))
    if task.body.grasp.known:
        return Load(nothing, nothing, HeldObject.of(task.body, model))
    return Load(nothing, nothing)
