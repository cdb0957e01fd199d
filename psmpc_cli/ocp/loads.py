"""The loads that the low-level law, and the plan with it, know the grippers to hold in a stage.

A payload is lumped into the last links. An object with a mass, in grasps that are `known`, is held by the grippers as
the task describes them.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np

from psmpc_cli.robot.dynamics import InertialParameters
from psmpc_cli.robot.free_body import FreeBody
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

    def force(self, model: RobotModel, Q: ca.SX, v: ca.SX, u: ca.SX) -> ca.SX:
        """Return the generalized force (n,) of the low-level law for accelerations u (n,). Paper eq. (7)."""
        if self.held is None:
            return ca.SX(model.dynamics.law(Q, v, u, self.parameters(model).vector))
        law = held_force(model, self.held.grippers)
        body = FreeBody(self.held.mass, self.held.inertia).vector
        return ca.SX(law(Q, v, u, np.ravel(self.held.grasps), model.nominal.vector, body))

    def own_force(self, model: RobotModel, Q: ca.SX, Qdot: ca.SX, u: ca.SX, anchor: ca.SX) -> ca.SX:
        """Return that force (n,) for accelerations u in a chart, the base's along its own axes."""
        space = model.space
        position = space.charted_coordinates(Q, anchor)
        v = space.charted_velocity(Q, Qdot)
        vdot = space.charted_acceleration(Q, Qdot, u)
        F = self.force(model, position, v, vdot)
        return ca.SX(ca.vertcat(*space.along_base_axes(ca.vertsplit(position), ca.vertsplit(F))))


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
