"""The loads that the low-level law, and the plan with it, know the grippers to hold in a stage.

A payload is lumped into the last links. An object with a mass, in grasps that are `known`, is held by the grippers as
the task describes them.

With it goes what reaction wheels store, a moment of momentum that the base carries. While motors are off it stays in
the base, h_w. While they turn the base and nothing thrusts, the angular momentum of everything about the inertial
origin, L, stays, and what wheels store follows from the state by

    L = l(Q, v) + R h_w,

with l that of robot and load, R the base's attitude.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca
import numpy as np

from psmpc_cli.robot.actuators.wheels import Wheels
from psmpc_cli.robot.dynamics import InertialParameters, n_stored, with_stored
from psmpc_cli.robot.held_load import described_grasps, held_force, held_force_jacobian, held_momentum
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.robot.rotations import matrix_vector, transposed
from psmpc_cli.specs.controller import LoadPriorSpec
from psmpc_cli.specs.object import ObjectBody
from psmpc_cli.specs.parts import MobilityTraits
from psmpc_cli.specs.task import TaskSpec

NOTHING = ""
"""Nothing is known of wheels, or they have no effect."""

STAYS = "stays in the base"
"""Motors of wheels are off, or change little."""

FOLLOWS = "follows from the angular momentum"
"""Wheels turn the base, and nothing thrusts."""


@dataclass(frozen=True)
class HeldObject:
    """An object with a mass in known grasps; `EMPTY_HANDS` hold none.

    Attributes:
        mass: [kg].
        inertia: Principal moments, (1,) or (3,) [kg m^2].
        grippers: That hold it.
        grasps: Of each gripper its pose in the object's frame and both stiffnesses.
        is_estimated: Its mass and moments are those that are found out by a sample.
    """

    mass: float
    inertia: tuple[float, ...]
    grippers: tuple[str, ...]
    grasps: tuple[tuple[float, ...], ...]
    is_estimated: bool = False

    @classmethod
    def of(cls, body: ObjectBody, model: RobotModel) -> "HeldObject":
        """Return the object of a task as its grippers hold it."""
        grasps = described_grasps(body.grippers, body.grasp)
        return cls(body.mass, body.inertia, body.grippers, tuple(map(tuple, grasps.tolist())), body.grasp.is_estimated)

    @property
    def numbers(self) -> np.ndarray:
        """Mass, principal moments and grasps, as expressions take them."""
        return np.array([self.mass, *self.inertia, *np.ravel(self.grasps)])


class _EmptyHands(HeldObject):
    """No object with a mass, or none that is known."""

    @property
    def numbers(self) -> np.ndarray:
        """None."""
        return np.zeros(0)


EMPTY_HANDS = _EmptyHands(mass=0.0, inertia=(), grippers=(), grasps=())


@dataclass(frozen=True)
class LoadKind:
    """What of a load, and of what moves it, decides expressions.

    How heavy it is, and where it is held, are numbers that they take; how much wheels store is the last of them.

    Attributes:
        carries: Whether there is a payload.
        grippers: That hold an object with a mass; none without one.
        driven: On which coordinates of the base something acts, see `RobotModel.driven`; None: as the robot's
            description says.
        stores: What the last numbers say of wheels: `STAYS`, h_w; `FOLLOWS`, L; `NOTHING`: they count as empty.
    """

    carries: bool
    grippers: tuple[str, ...]
    driven: tuple[float, ...] | None = None
    stores: str = NOTHING

    @property
    def weighs_force(self) -> bool:
        """Whether a stage's cost weighs the force of the low-level law with this load; `UNWEIGHED` says that not."""
        return True

    def weighed_rows(self, model: RobotModel) -> int:
        """Return the number of coordinates of the force that cost."""
        return model.n

    def weighed_force(self, model: RobotModel, Q: ca.SX, Qdot: ca.SX, u: ca.SX, anchor: ca.SX, numbers: ca.SX) -> ca.SX:
        """Return the force that costs (rows,), along the base's own axes, of a motion in the chart about an anchor."""
        return self.own_force(model, OwnMotion.in_chart(model, Q, Qdot, u, anchor), numbers)

    def count(self, model: RobotModel) -> int:
        """Return the number of numbers."""
        space = model.space
        of_object = 1 + space.n_principal + (space.n_pose + 2) * len(self.grippers) if self.grippers else 0
        of_wheels = n_stored(model.spec) if self.stores else 0
        return 2 * len(model.spec.arms) * self.carries + of_object + of_wheels

    def momentum_of_wheels(self, model: RobotModel) -> ca.Function:
        """Return the function that says what reaction wheels store at a state, as a load of this kind knows it.

        Either that is one of the load's numbers (it stays in the base), or it follows from the angular momentum L of
        everything about the inertial origin, which is one of them: L = l(Q, v) + R h_w, with l that of robot and load
        and R the attitude of the base, so that h_w = R' (L - l).

        Returns:
            x (2n,) in a chart, anchor of the chart, numbers of the load -> h_w along the base's axes, (1,) or (3,) [N m
            s].
        """

        def build() -> ca.Function:
            space = model.space
            x = ca.SX.sym("x", 2 * model.n)
            anchor = ca.SX.sym("anchor", space.n_anchor)  # attitude about which the coordinates in x are a chart
            numbers = ca.SX.sym("numbers", self.count(model))
            wheel_numbers = numbers[numbers.numel() - n_stored(model.spec) :]  # the last: h_w, or L
            stored = wheel_numbers
            if self.stores == FOLLOWS:
                rest = wheel_numbers - self.momentum(model)(x, anchor, numbers)[space.rotation]
                R = space.base_rotation(space.charted_coordinates(x[: model.n], anchor))
                _, rest_3d = space.twist_to_3d([*[0.0] * space.dimension, *ca.vertsplit(rest)])
                along_base = space.twist([0.0] * 3, matrix_vector(transposed(R), rest_3d))
                stored = ca.vertcat(*along_base[space.rotation])
            return ca.Function("stored", [x, anchor, numbers], ca.cse([stored]))

        return model.cached((LoadKind.momentum_of_wheels, self), build)

    def force(self, model: RobotModel, Q: ca.SX, v: ca.SX, u: ca.SX, numbers: ca.SX) -> ca.SX:
        """Return the generalized force (n,) of the low-level law for accelerations u (n,). Paper eq. (7).

        A base that is not driven reacts. With an object in the grippers it accelerates as u says, which a plan has from
        the momentum at its nodes.
        """
        return self._force(model, Q, v, u, numbers, ca.SX.zeros(n_stored(model.spec)))

    def _force(self, model: RobotModel, Q: ca.SX, v: ca.SX, u: ca.SX, numbers: ca.SX, stored: ca.SX) -> ca.SX:
        """Return that force (n,) with wheels that store so much."""
        w, grasps, body = self._split_numbers(model, numbers, stored)
        if not self.grippers:
            return ca.SX(model.law(self.driven)(Q, v, u, w))
        return ca.SX(held_force(model, self.grippers)(Q, v, u, grasps, w, body))

    def own_force(self, model: RobotModel, motion: "OwnMotion", numbers: ca.SX) -> ca.SX:
        """Return that force (n,), the base's along its own axes, with the gyroscopic moment of wheels in it."""
        Q = model.space.at_neutral_base(motion.joints)
        return self._force(model, Q, motion.v, motion.vdot, numbers, motion.stored)

    def own_force_jacobian(self, model: RobotModel, motion: "OwnMotion", numbers: ca.SX, by: ca.SX) -> ca.SX:
        """Return the derivatives of that force by symbols that the motion is an expression of, (n, symbols).

        They are equal to those that CasADi derives, and shorter: see `held_force_jacobian` and
        `RobotModel.law_jacobian`.
        """
        w, grasps, body = self._split_numbers(model, numbers, motion.stored)
        arguments = [motion.joints, motion.v, motion.vdot]
        if self.grippers:
            F_by = held_force_jacobian(model, self.grippers)(*arguments, grasps, w, body)
        else:
            F_by = model.law_jacobian(self.driven)(*arguments, w)
        return ca.SX(ca.sparsify(F_by) @ ca.cse(ca.jacobian(ca.vertcat(*arguments, motion.stored), by)))

    def momentum(self, model: RobotModel) -> ca.Function:
        """Return the momentum of robot and load as a function, which a base without thrusters keeps. Paper eq. (4).

        The momentum that reaction wheels store is in it where their motors leave it in the base.

        Returns:
            x (2n,) in a chart, anchor of the chart, numbers of the load -> momentum (n_twist,) [N s, N m s].
        """
        return model.cached((LoadKind.momentum, self), lambda: self._momentum(model))

    def _momentum(self, model: RobotModel) -> ca.Function:
        """Build the function that `momentum` returns: of state, anchor of the chart and numbers of the load.

        The last of the load's numbers say what reaction wheels store. Where that stays in the base (`STAYS`) it is
        added as a momentum that the base carries.
        """
        x = ca.SX.sym("x", 2 * model.n)
        anchor = ca.SX.sym("anchor", model.space.n_anchor)  # attitude about which the coordinates in x are a chart
        numbers = ca.SX.sym("numbers", self.count(model))
        stored_count = n_stored(model.spec)
        stored = ca.SX.zeros(stored_count)
        if self.stores == STAYS:
            stored = numbers[numbers.numel() - stored_count :]
        inertial_parameters, grasps, body = self._split_numbers(model, numbers, stored)
        Q = model.space.charted_coordinates(x[: model.n], anchor)
        v = model.space.charted_velocity(x[: model.n], x[model.n :])
        momentum = model.dynamics.momentum(Q, v, inertial_parameters)
        if self.grippers:
            momentum += held_momentum(model, self.grippers)(Q, v, grasps, body)
        return ca.Function("momentum", [x, anchor, numbers], ca.cse([momentum]))

    def momentum_about_centre(self, model: RobotModel) -> ca.Function:
        """Return x (2n,) in a chart, its anchor, numbers -> linear momentum, and angular about the centre of mass.

        Both (n_twist,) are of robot and load. A translation of everything at the velocity of the common centre of mass
        has the same linear momentum and, about that centre, no angular momentum. So the angular momentum about it is
        what stays about the inertial origin once that translation is taken from the base's velocity.
        """

        def build() -> ca.Function:
            space = model.space
            x = ca.SX.sym("x", 2 * model.n)
            anchor = ca.SX.sym("anchor", space.n_anchor)
            numbers = ca.SX.sym("numbers", self.count(model))
            momentum = self.momentum(model)

            def at_velocity(velocity: ca.SX) -> ca.SX:
                return momentum(ca.vertcat(x[: model.n], velocity), anchor, numbers)

            linear = at_velocity(x[model.n :])[: space.dimension]
            along_x = ca.SX(ca.DM([1.0, *np.zeros(model.n - 1)]))
            mass = at_velocity(along_x)[0]
            translation = ca.vertcat(linear / mass, ca.SX.zeros(model.n - space.dimension))
            about_centre = at_velocity(x[model.n :] - translation)[space.dimension :]
            momenta = ca.vertcat(linear, about_centre)
            return ca.Function("momentum_about_centre", [x, anchor, numbers], ca.cse([momenta]))

        return model.cached((LoadKind.momentum_about_centre, self), build)

    def _split_numbers(self, model: RobotModel, numbers: ca.SX, stored: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Return inertial parameters of the robot with the payload, grasps and object, those of nothing held empty.

        Wheels of the robot store so much, (0,) without any.
        """
        own = model.nominal.vector
        loads = 2 * len(model.spec.arms) * self.carries
        of_body = (1 + model.space.n_principal) * bool(self.grippers)
        count = self.count(model)
        ends = [0, loads, loads + of_body, count - (n_stored(model.spec) if self.stores else 0), count]
        payload, body, grasps, _ = ca.vertsplit(numbers, ends)
        # masses and inertias in the grippers are the last of the inertial parameters
        w = ca.vertcat(own[: own.size - loads], payload)
        return with_stored(model.spec, w, stored) if model.spec.wheels else w, grasps, body


class _Unweighed(LoadKind):
    """Of a stage in which force costs nothing, whatever the load: a force without coordinates."""

    @property
    def weighs_force(self) -> bool:
        """Whether force costs: it does not."""
        return False

    def weighed_rows(self, model: RobotModel) -> int:
        """Return the number of coordinates of the force that cost: none."""
        return 0

    def weighed_force(self, model: RobotModel, Q: ca.SX, Qdot: ca.SX, u: ca.SX, anchor: ca.SX, numbers: ca.SX) -> ca.SX:
        """Return a force without coordinates (0,)."""
        return ca.SX(0, 1)


UNWEIGHED = _Unweighed(carries=False, grippers=())


@dataclass(frozen=True)
class OwnMotion:
    """A motion as the base sees it, on which force along its axes depends: not on where it is or how it is turned.

    Attributes:
        joints: Coordinates of the joints (joints,).
        v: Velocity (n,), that of the base along its own axes.
        vdot: Acceleration (n,), that of the base along its own axes.
        stored: What wheels store, along the same axes (1,) or (3,); (0,) without any.
    """

    joints: ca.SX
    v: ca.SX
    vdot: ca.SX
    stored: ca.SX

    @classmethod
    def in_chart(
        cls,
        model: RobotModel,
        Q: ca.SX,
        Qdot: ca.SX,
        u: ca.SX,
        anchor: ca.SX,
        stored: ca.SX | None = None,
    ) -> "OwnMotion":
        """Return a motion in a chart as the base sees it: velocity and acceleration along the base's own axes.

        Args:
            model: The robot.
            Q: Coordinates in the chart, (n,).
            Qdot: Their rates, (n,).
            u: Their accelerations, (n,).
            anchor: Attitude about which the chart is.
            stored: What wheels store along the base's axes; by default nothing.
        """
        space = model.space
        position = space.charted_coordinates(Q, anchor)

        def along_base_axes(vector: ca.SX) -> ca.SX:
            return ca.SX(ca.vertcat(*space.along_base_axes(ca.vertsplit(position), ca.vertsplit(vector))))

        v = along_base_axes(space.charted_velocity(Q, Qdot))
        vdot = along_base_axes(space.charted_acceleration(Q, Qdot, u))
        if stored is None:
            stored = ca.SX.zeros(n_stored(model.spec))
        return cls(position[space.joint_coordinates], v, vdot, stored)


@dataclass(frozen=True)
class Load:
    """What the grippers are known to hold in a stage.

    Attributes:
        mass: Of the payload at each end-effector, (arms,) [kg].
        inertia: Of the payload about that point, (arms,) [kg m^2].
        finds_payload: The payload is what was found out by a sample; its mass and inertia here are the prior's.
        held: The object with a mass, or `EMPTY_HANDS`.
        driven: On which coordinates of the base something acts in the stage, see `LoadKind`.
        stores: What is known of wheels in the stage, see `LoadKind`.
        stored: How much that is, (1,) or (3,) [N m s]; empty where nothing is.
    """

    mass: tuple[float, ...]
    inertia: tuple[float, ...]
    finds_payload: bool = False
    held: HeldObject = EMPTY_HANDS
    driven: tuple[float, ...] | None = None
    stores: str = NOTHING
    stored: tuple[float, ...] = ()

    @cached_property
    def kind(self) -> LoadKind:
        """What of it decides expressions."""
        return LoadKind(any(self.mass), self.held.grippers, self.driven, self.stores)

    @cached_property
    def numbers(self) -> np.ndarray:
        """The numbers that expressions of its kind take."""
        payload = (*self.mass, *self.inertia) if self.kind.carries else ()
        return np.array([*payload, *self.held.numbers, *self.stored])

    @property
    def is_estimated(self) -> bool:
        """Whether the controller finds out what the grippers hold."""
        return self.finds_payload or self.held.is_estimated

    @property
    def without_wheels(self) -> "Load":
        """The load with wheels that count as empty."""
        return replace(self, stores=NOTHING, stored=())

    @property
    def sampled_numbers(self) -> np.ndarray:
        """What samples set of the load where it is found out, mass [kg] and moments of inertia [kg m^2]; else empty.

        Those of an object are its principal moments, of a payload the one of all that grippers hold together.
        """
        if self.finds_payload:
            return np.array([sum(self.mass), sum(self.inertia)])
        return np.array([self.held.mass, *self.held.inertia]) if self.held.is_estimated else np.zeros(0)

    def sampled(self, numbers: np.ndarray) -> "Load":
        """Return the load with these as `sampled_numbers`; itself where samples set none."""
        if self.finds_payload:
            shares = np.array(self.mass) / sum(self.mass)
            masses, inertias = np.outer(numbers, shares).tolist()
            return replace(self, mass=tuple(masses), inertia=tuple(inertias))
        if not self.held.is_estimated:
            return self
        mass, *inertia = numbers.tolist()
        return replace(self, held=replace(self.held, mass=mass, inertia=tuple(inertia)))

    def parameters(self, model: RobotModel) -> InertialParameters:
        """Return the inertial parameters of the robot with the payload."""
        return model.nominal.holding(np.array(self.mass), np.array(self.inertia))


NO_KNOWN_LOAD = Load(mass=(), inertia=())
"""Of a stage whose end asks nothing of the momentum, and so of no load."""


class _UnweighedLoad(Load):
    """Of a stage in which force costs nothing, whatever the load."""

    @cached_property
    def kind(self) -> LoadKind:
        """That of no force."""
        return UNWEIGHED


UNWEIGHED_LOAD = _UnweighedLoad(mass=(), inertia=())


def known_load(task: TaskSpec, model: RobotModel, stage: int) -> Load:
    """Return what the controller knows of the load in a stage: what grippers hold, and what reaction wheels store.

    Constraints on forces and momentum, and the cost of force, count with it. Outside the stages that hold something
    grippers hold nothing. In these stages it is a payload at the ends of the arms, or the object as its grippers hold
    it, if the task lets the controller know of it.

    Args:
        task: The task.
        model: The robot.
        stage: Index of the stage.
    """
    payload = task.uncertainty.carried
    nothing = (0.0,) * len(model.spec.arms)
    moved_by = task.moved_by(stage, model.spec)
    # coordinates of the base on which something acts
    driven = None if moved_by == model.spec.moved_by else _driven_in_stage(model, moved_by)
    stores = _stores(model, moved_by)  # what is known of the momentum in wheels: it stays in the base, or follows
    stored = tuple(Wheels.of(model.spec).at_first) if stores else ()
    no_load = Load(nothing, nothing, driven=driven, stores=stores, stored=stored)
    if stage not in task.held_stages:
        return no_load
    if payload.known:
        totals = prior_of_load(task).mean if payload.is_estimated else np.array([payload.mass, payload.inertia])
        masses, inertias = np.outer(totals, payload.shares(tuple(model.spec.arms))).tolist()
        return replace(no_load, mass=tuple(masses), inertia=tuple(inertias), finds_payload=payload.is_estimated)
    held = HeldObject.of(task.body, model) if task.body.grasp.known else EMPTY_HANDS
    return replace(no_load, held=held)


@dataclass(frozen=True, eq=False)
class LoadPrior:
    """What is known of the load before it is held.

    Attributes:
        mean: Mass [kg] and moments of inertia [kg m^2]: principal ones of an object, one of a payload.
        deviation: Their standard deviations.
    """

    mean: np.ndarray
    deviation: np.ndarray


def prior_of_load(task: TaskSpec) -> LoadPrior:
    """Return what the controller takes for a load that is to be found out before it has found out anything."""
    spec = task.controller.load_prior or LoadPriorSpec()
    payload = task.uncertainty.carried
    if payload.is_estimated:
        inertia = [float(np.mean(spec.inertia))] if spec.inertia else [payload.inertia]
        mean = np.array([spec.mass or payload.mass, *inertia])
    else:
        mean = np.array([spec.mass or task.body.mass, *(spec.inertia or task.body.inertia)])
    return LoadPrior(mean, spec.deviation * mean)


def _driven_in_stage(model: RobotModel, moved_by: MobilityTraits) -> tuple[float, ...]:
    """Return on which coordinates of the base something acts in a stage: a mount on all, which it keeps at rest."""
    return model.driven(moved_by) if moved_by.moves else (1.0,) * model.space.n_twist


def _stores(model: RobotModel, moved_by: MobilityTraits) -> str:
    """Return what is known of a robot's wheels in a stage; in the plane what stays in the base has no effect."""
    if not model.spec.wheels:
        return NOTHING
    if moved_by.is_turned and not moved_by.is_pushed:
        return FOLLOWS
    return STAYS if n_stored(model.spec) > 1 else NOTHING
