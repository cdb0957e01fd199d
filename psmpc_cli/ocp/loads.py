"""The loads that the low-level law, and the plan with it, know the grippers to hold in a stage.

A payload is lumped into the last links. An object with a mass, in grasps that are `known`, is held by the grippers as
the task describes them.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np

from psmpc_cli.robot.configuration import ConfigurationSpace
from psmpc_cli.robot.dynamics import InertialParameters
from psmpc_cli.robot.held_load import described_grasps, held_force, held_force_jacobian, held_momentum
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
    """What of a load, and of what moves it, decides expressions.

    How heavy it is, and where it is held, are numbers that they take.

    Attributes:
        carries: Whether there is a payload.
        grippers: That hold an object with a mass; none without one.
        driven: On which coordinates of the base something acts, see `RobotModel.driven`; None: as the robot's
            description says.
    """

    carries: bool
    grippers: tuple[str, ...]
    driven: tuple[float, ...] | None = None

    def count(self, model: RobotModel) -> int:
        """Return the number of numbers."""
        space = model.space
        of_object = 1 + space.n_principal + (space.n_pose + 2) * len(self.grippers) if self.grippers else 0
        return 2 * len(model.spec.arms) * self.carries + of_object

    def force(self, model: RobotModel, Q: ca.SX, v: ca.SX, u: ca.SX, numbers: ca.SX) -> ca.SX:
        """Return the generalized force (n,) of the low-level law for accelerations u (n,). Paper eq. (7).

        A base that is not driven reacts. With an object in the grippers it accelerates as u says, which a plan has from
        the momentum at its nodes.
        """
        w, grasps, body = self._split(model, numbers)
        if not self.grippers:
            return ca.SX(model.law(self.driven)(Q, v, u, w))
        return ca.SX(held_force(model, self.grippers)(Q, v, u, grasps, w, body))

    def own_force(self, model: RobotModel, motion: "OwnMotion", numbers: ca.SX) -> ca.SX:
        """Return that force (n,), the base's along its own axes."""
        return self.force(model, model.space.at_neutral_base(motion.joints), motion.v, motion.vdot, numbers)

    def own_force_jacobian(self, model: RobotModel, motion: "OwnMotion", numbers: ca.SX, by: ca.SX) -> ca.SX:
        """Return the derivatives of that force by symbols that the motion is an expression of, (n, symbols).

        They are equal to those that CasADi derives, and shorter: see `held_force_jacobian` and
        `RobotModel.law_jacobian`.
        """
        w, grasps, body = self._split(model, numbers)
        arguments = [motion.joints, motion.v, motion.vdot]
        if self.grippers:
            F_by = held_force_jacobian(model, self.grippers)(*arguments, grasps, w, body)
        else:
            F_by = model.law_jacobian(self.driven)(*arguments, w)
        return ca.SX(ca.sparsify(F_by) @ ca.cse(ca.jacobian(ca.vertcat(*arguments), by)))

    def momentum(self, model: RobotModel) -> ca.Function:
        """Return x (2n,) in a chart, its anchor, numbers -> momentum (n_twist,) of robot and load. Paper eq. (4)."""

        def build() -> ca.Function:
            x = ca.SX.sym("x", 2 * model.n)
            anchor = ca.SX.sym("anchor", model.space.n_anchor)
            numbers = ca.SX.sym("numbers", self.count(model))
            w, grasps, body = self._split(model, numbers)
            Q = model.space.charted_coordinates(x[: model.n], anchor)
            v = model.space.charted_velocity(x[: model.n], x[model.n :])
            momentum = model.dynamics.momentum(Q, v, w)
            if self.grippers:
                momentum += held_momentum(model, self.grippers)(Q, v, grasps, body)
            return ca.Function("momentum", [x, anchor, numbers], ca.cse([momentum]))

        return model.cached((LoadKind.momentum, self), build)

    def _split(self, model: RobotModel, numbers: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Return inertial parameters of the robot with the payload, grasps and object, those of nothing held empty."""
        own = model.nominal.vector
        loads = 2 * len(model.spec.arms) * self.carries
        of_body = (1 + model.space.n_principal) * bool(self.grippers)
        payload, body, grasps = ca.vertsplit(numbers, [0, loads, loads + of_body, self.count(model)])
        # masses and inertias in the grippers are the last of the inertial parameters
        return ca.vertcat(own[: own.size - loads], payload), grasps, body


@dataclass(frozen=True)
class OwnMotion:
    """A motion as the base sees it, on which force along its axes depends: not on where it is or how it is turned.

    Attributes:
        joints: Coordinates of the joints (joints,).
        v: Velocity (n,), that of the base along its own axes.
        vdot: Acceleration (n,), that of the base along its own axes.
    """

    joints: ca.SX
    v: ca.SX
    vdot: ca.SX

    @classmethod
    def in_chart(cls, space: ConfigurationSpace, Q: ca.SX, Qdot: ca.SX, u: ca.SX, anchor: ca.SX) -> "OwnMotion":
        """Return the motion at Q, Qdot and accelerations u (n,) in the chart about an anchor."""
        position = space.charted_coordinates(Q, anchor)
        v, vdot = (
            ca.vertcat(*space.along_base_axes(ca.vertsplit(position), ca.vertsplit(vector)))
            for vector in (space.charted_velocity(Q, Qdot), space.charted_acceleration(Q, Qdot, u))
        )
        return cls(position[space.joint_coordinates], v, vdot)


@dataclass(frozen=True)
class Load:
    """What the grippers are known to hold in a stage.

    Attributes:
        mass: Of the payload at each end-effector, (arms,) [kg].
        inertia: Of the payload about that point, (arms,) [kg m^2].
        held: The object with a mass, or None.
        driven: On which coordinates of the base something acts in the stage, see `LoadKind`.
    """

    mass: tuple[float, ...]
    inertia: tuple[float, ...]
    held: HeldObject | None = None
    driven: tuple[float, ...] | None = None

    @property
    def kind(self) -> LoadKind:
        """What of it decides expressions."""
        return LoadKind(any(self.mass), () if self.held is None else self.held.grippers, self.driven)

    @property
    def numbers(self) -> np.ndarray:
        """The numbers that expressions of its kind take."""
        payload = (*self.mass, *self.inertia) if self.kind.carries else ()
        of_object = () if self.held is None else (self.held.mass, *self.held.inertia, *np.ravel(self.held.grasps))
        return np.array([*payload, *of_object])

    def parameters(self, model: RobotModel) -> InertialParameters:
        """Return the inertial parameters of the robot with the payload."""
        return model.nominal.holding(np.array(self.mass), np.array(self.inertia))


def known_load(task: TaskSpec, model: RobotModel, stage: int) -> Load:
    """Return what the grippers are known to hold in a stage of a task."""
    payload = task.uncertainty.carried
    nothing = (0.0,) * len(model.spec.arms)
    moved_by = task.moved_by(stage, model.spec)
    driven = None if moved_by == model.spec.moved_by else model.driven(moved_by)
    if stage not in task.held_stages:
        return Load(nothing, nothing, driven=driven)
    if payload.known:
        share = np.array(payload.shares(tuple(model.spec.arms)))
        mass, inertia = (tuple((share * total).tolist()) for total in (payload.mass, payload.inertia))
        return Load(mass, inertia, driven=driven)
    held = HeldObject.of(task.body, model) if task.body.grasp.known else None
    return Load(nothing, nothing, held, driven)
