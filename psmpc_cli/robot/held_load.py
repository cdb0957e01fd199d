"""The computed torque of a robot that knows its load: an object held by all grippers. docs/grasp_model.md."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from scipy.linalg import eigh, null_space

from psmpc_cli.native.functions import ArrayFunction
from psmpc_cli.robot.configuration import ConfigurationSpace
from psmpc_cli.robot.dynamics import (
    InertialParameters,
    law_with_base_force,
    law_with_driven_coordinates,
    point_acceleration,
    solve_spd,
    stored_in,
    tool_motions,
)
from psmpc_cli.robot.free_body import FreeBody
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.robot.rotations import add, cross, dot, matrix, matrix_product, matrix_vector, scaled, transposed
from psmpc_cli.specs.object import GraspSpec

Vector = Sequence[Any]


class HeldLoad:
    """The low-level law of a robot that knows its load: the object, held by all grippers, as part of the robot.

    Each gripper i makes the object move by S_i(Q) v. Where these differ the commanded acceleration u would strain the
    object: it is replaced by the nearest one u' with S_i u' + s_i the same for all i, nearest without regard to mass,
    since a metric of masses has the light wrists make up for all of it, and a controller that brings them back within
    their limits at once then overcompensates. The force is that of the robot under u' and the object's, of which
    gripper i bears C_i (sum C)^-1, C_i its bushing's stiffness about the object's centre, so that all grasps deflect
    equally and the grippers stay consistent. Equal shares would twist them against each other. With one gripper nothing
    can differ, u' = u, and it bears everything: the object is part of the last body.

    Attributes:
        grasps: Of each gripper its pose in the object's frame and both stiffnesses, (A, 5) or (A, 9), as described.
    """

    def __init__(self, model: RobotModel, body: FreeBody, grasp: GraspSpec) -> None:
        grippers = [arm for arm in model.spec.arms if arm in grasp.at]
        self._model = model
        self.grasps = described_grasps(grippers, grasp)
        self._forces: dict[tuple[float, ...] | None, ArrayFunction] = {}
        self._grippers = grippers
        self._attainable: dict[int, ArrayFunction] = {}
        self._object = body

    @cached_property
    def _chain_terms_at(self) -> ArrayFunction:
        """See `_chain_terms`."""
        return ArrayFunction(_chain_terms(self._model, self._object, self._grippers))

    def prepare(self) -> None:
        """Derive what `attainable_accelerations` needs, so that no sample waits for it."""
        _attainable_tick(self._model, self._grippers)

    def force(
        self,
        Q: np.ndarray,
        v: np.ndarray,
        u: np.ndarray,
        parameters: InertialParameters,
        grasps: np.ndarray,
        body: np.ndarray,
        driven: tuple[float, ...] | None = None,
        base_force: np.ndarray | None = None,
    ) -> np.ndarray:
        """Compute the generalized force (n,) [N, N m] by which the robot, with its load, accelerates by u.

        The force is evaluated by a function that is derived once for each set of driven coordinates.

        Args:
            Q: Position of the robot (nq,).
            v: Velocity (n,).
            u: Commanded acceleration (n,).
            parameters: Inertial parameters that the law assumes for the robot.
            grasps: Of each gripper its pose in the object's frame and both stiffnesses, (A, 5) or (A, 9).
            body: Mass and principal moments of the object.
            driven: On which coordinates of the base something acts, see `RobotModel.driven`; by default as the robot's
                description says.
            base_force: Force that acts on the base, whatever is commanded, and its mean over a period of pulses
                (2, n_twist), see `LowLevelLaw.force`; by default the base gets the force that is returned.
        """
        is_pushed = base_force is not None
        key = None if is_pushed else driven or self._model.driven()  # a given force acts whatever is driven
        if key not in self._forces:
            self._forces[key] = ArrayFunction(
                pushed_held_force(self._model, self._grippers)
                if is_pushed
                else held_force(self._model, self._grippers, key)
            )
        of_base = () if base_force is None else tuple(base_force)
        return np.asarray(self._forces[key](Q, v, u, grasps.ravel(), parameters.vector, body, *of_base)[0][0])

    def attainable_accelerations(
        self, Q: np.ndarray, v: np.ndarray, u: np.ndarray, closed: np.ndarray, tick: float
    ) -> np.ndarray:
        """Return the accelerations that the robot has under commanded ones, over the ticks of a sample.

        While grippers are closed on the object, robot and object are a closed chain, which cannot follow commands that
        would move the grippers differently. The accelerations are then the nearest ones that the chain allows, u' of
        `held_force`; else they are the commanded ones.

        Args:
            Q: Position of the robot at the first tick (nq,).
            v: Velocity then (n,).
            u: Commanded accelerations over the ticks (M, n).
            closed: Whether the grippers are closed at each of them (M,).
            tick: Length of a tick [s].

        Returns:
            The accelerations (M, n) [m/s^2, rad/s^2].
        """
        if len(u) not in self._attainable:
            self._attainable[len(u)] = ArrayFunction(_attainable_tick(self._model, self._grippers).mapaccum(len(u)))
        _, attainable = self._attainable[len(u)](np.concatenate([Q, v]), u, closed[:, None], self.grasps.ravel(), tick)
        return attainable

    def largest_ratio(self, Q: np.ndarray) -> tuple[float, np.ndarray]:
        """Compute the largest ratio of the load's inertia to the robot's, over all motions that keep the closed chain.

        It says how wrong a low-level law is that does not know of the load. At rest the force of such a law is H u for
        a commanded acceleration u, and robot and load together do (H + S'WS) vdot = H u: H is the mass matrix of the
        robot, armatures included, W the inertia of the object, and S v its velocity. With u along a motion v with

            S'WS v = rho H v,    S_i v the same for all grippers i,

        the robot accelerates by u / (1 + rho) alone. The largest rho and its v are a generalized eigenvalue and its
        vector, in the space N of motions that move all grippers alike.

        Args:
            Q: Position of the robot (nq,).

        Returns:
            The largest rho, and its motion v (n,), of kinetic energy 1/2 without the load.
        """
        n = self._model.n
        S, W = self._chain_terms_at(Q, self.grasps.ravel())
        S = S.T.reshape(len(self.grasps), -1, n)
        N = null_space((S[1:] - S[:1]).reshape(-1, n), rcond=SINGULAR)
        H = self._model.mass_matrix(Q)
        SN = S.mean(axis=0) @ N  # all S_i N are the same
        ratios, motions = eigh(SN.T @ W @ SN, N.T @ H @ N)
        return float(ratios[-1]), N @ motions[:, -1]


def described_grasps(grippers: Sequence[str], grasp: GraspSpec) -> np.ndarray:
    """Return of each gripper its pose in the object's frame and both stiffnesses, (A, 5) or (A, 9)."""
    return np.array([[*grasp.at[gripper], *grasp.stiffness] for gripper in grippers])


def held_force(model: RobotModel, grippers: Sequence[str], driven: tuple[float, ...] | None = None) -> ca.Function:
    """Return the low-level law of a robot that holds an object with all grippers, as a CasADi function.

    It is a function of Q, v, u, grasps, inertial parameters of the robot and of the object; its value is the force
    (n,). The acceleration of the object by gripper i is S_i u + s_i. With G and g the differences S_i - S_1 and
    s_i - s_1 of the other grippers to the first, one below the other, and C_i the stiffness of grasp i,

        u' = u - G' lambda,    lambda = (G G')^-1 (G u + g),
        F = H u' + c + sum_i S_i' f_i,    f_i = C_i (sum C)^-1 (M (S u' + s) + bias),

    where u' is the acceleration nearest to u that the closed chain of robot and object allows, f_i what gripper i bears
    of the force on the object, and S u' + s the object's acceleration, the same by any gripper. `HeldLoad` says why. F
    depends on u linearly: coordinates of the base that are not driven react, see `law_with_driven_coordinates`.

    Args:
        model: The robot.
        grippers: Those that hold the object, which is given as `FreeBody.vector`.
        driven: 1 for each coordinate of the base on which something acts, else 0, see `RobotModel.driven`; by default
            something acts on all.
    """
    all_driven = (1.0,) * model.space.n_twist
    driven = driven or all_driven

    def derive() -> ca.Function:
        if driven == all_driven:
            return _held_force(model, grippers)
        return law_with_driven_coordinates(model.spec, held_force(model, grippers), ca.DM(driven))

    return model.derived((held_force, tuple(grippers), driven), derive)


def pushed_held_force(model: RobotModel, grippers: Sequence[str]) -> ca.Function:
    """Return `held_force` for a base on which a given force acts, such as that of thrusters that fire in pulses.

    The function has two further arguments: the force on the base now, w, and its mean over a period of pulses, w_m,
    (n_twist,) each. The torques of the joints account for what these differ by from the force that the law asks for,
    so that the joints accelerate as commanded, whatever the base does.

    Robot and object together react to the mean. Grasps are elastic: changes that are shorter than they take to deflect
    do not reach the object, so that the robot alone reacts to the difference,

        F_j = F_j of robot and object under w_m + H_jb H_bb^-1 (w - w_m).

    Torques for all of w at once would throw the hands against the grasps at both ends of every pulse.

    Args:
        model: The robot.
        grippers: Those that hold the object.
    """

    def derive() -> ca.Function:
        held = held_force(model, grippers)
        base = model.space.base
        joints = model.space.joint_rates
        Q, v, u, grasps, w, body = held.sx_in()
        now, mean = (ca.SX.sym(name, base.stop) for name in ("now", "mean"))
        F = law_with_base_force(model.spec, held)(Q, v, u, grasps, w, body, mean)
        # what the torques of the robot alone differ by where now - mean acts on its base besides
        alone = model.law((1.0,) * base.stop)(Q, v, u, w)
        pushed = model.pushed_law(Q, v, u, w, alone[base] + now - mean)
        F[joints] += pushed[joints] - alone[joints]
        return ca.Function("pushed_held", [Q, v, u, grasps, w, body, now, mean], [ca.cse(F)])

    return model.derived((pushed_held_force, tuple(grippers)), derive)


def held_momentum(model: RobotModel, grippers: Sequence[str]) -> ca.Function:
    """Return the momentum of a held object as a CasADi function of Q, v, grasps and the object's inertial parameters.

    The momentum is linear, then angular about the inertial origin (n_twist,) [N s, N m s]. The object is taken to move
    as if it were fixed to the first of the grippers.

    Args:
        model: The robot.
        grippers: Those that hold the object, which is given as `FreeBody.vector`.
    """

    def derive() -> ca.Function:
        space = model.space
        body, numbers = FreeBody.symbolic(space.n_principal)
        Q = ca.SX.sym("Q", model.nq)
        v = ca.SX.sym("v", model.n)
        p = ca.SX.sym("p", (space.n_pose + 2) * len(grippers))
        # with velocity 0 and v in place of vdot the accelerations are S v: velocities without terms of v^2
        hold = _object_motions(model, grippers[:1], Q, ca.SX.zeros(model.n), v, p[: space.n_pose + 2])
        gripper, _ = space.to_3d(ca.vertsplit(model.g(Q)[model.pose_rows[grippers[0]]]))
        centre = add(gripper, scaled(ca.vertsplit(hold.levers), -1))
        linear, angular = space.twist_to_3d(ca.vertsplit(_object_wrench(body, hold, hold.accelerations)))
        momentum = space.twist(linear, add(angular, cross(centre, linear)))
        return ca.Function("held_momentum", [Q, v, p, numbers], [ca.cse(ca.vertcat(*momentum))])

    return model.derived((held_momentum, tuple(grippers)), derive)


def held_force_jacobian(model: RobotModel, grippers: Sequence[str]) -> ca.Function:
    """Return the Jacobian of `held_force`, as a CasADi function of joints, v, u, grasps and inertial parameters.

    It has the derivatives by [joints; v; u] (n, joints + 2n), and then those by what wheels store, with the base at its
    neutral pose, as `RobotModel.law_jacobian` has them of the robot alone. Optimizations that limit forces need them.

    Args:
        model: The robot.
        grippers: Those that hold the object, which is given as `FreeBody.vector`.
    """
    return model.derived((held_force_jacobian, tuple(grippers)), lambda: _held_force_jacobian(model, grippers))


def _held_force(model: RobotModel, grippers: Sequence[str]) -> ca.Function:
    """Derive what `held_force` returns."""
    body, numbers = FreeBody.symbolic(model.space.n_principal)
    Q = ca.SX.sym("Q", model.nq)
    v = ca.SX.sym("v", model.n)
    u = ca.SX.sym("u", model.n)
    p = ca.SX.sym("p", (body.space.n_pose + 2) * len(grippers))
    w = ca.SX.sym("w", model.nominal.vector.size)
    hold = _object_motions(model, grippers, Q, v, u, p)
    closed = _closed_chain(hold, u)
    borne = _shared_wrenches(body.space, hold.levers, p, _object_wrench(body, hold, closed.acceleration))
    force = model.dynamics.inverse(Q, v, closed.attainable, w) + closed.S.T @ borne
    return ca.Function("held", [Q, v, u, p, w, numbers], [ca.cse(ca.densify(force))])


def _held_force_jacobian(model: RobotModel, grippers: Sequence[str]) -> ca.Function:
    """Derive what `held_force_jacobian` returns.

    The closed chain is differentiated as the system of equations that it solves, not as its solution. In the symbols of
    `held_force`, let the force be F = phi(z, u') with z = [joints; v]. With lambda and u' held, z alone causes the
    differentials

        dphi, dP of G' lambda, dE of G u' + g.

    The system u' + G' lambda = u, G u' + g = 0 then gives du' = du - dP - G' dlambda and

        dF = dphi + Y (du - dP) - X dE,    X = phi_u' G' (G G')^-1,    Y = phi_u' - X G,

    where Y are the derivatives of F by u. Griewank, Walther: Evaluating Derivatives (2008), section 15.1. The forward
    mode through the solution would carry each of the directions through both factorizations, and takes twice the
    operations.

    In the code names that end in `_by` are derivatives by the columns [joints; v; u]. `strain` is lambda as wrenches of
    all grippers, `projector` is (G G')^-1 G, and `borne` are the wrenches f_i by which grippers move the object.
    """
    space = model.space
    n = model.n
    size = space.n_twist
    body, numbers = FreeBody.symbolic(space.n_principal)
    joints = ca.SX.sym("joints", space.joints)
    v = ca.SX.sym("v", n)
    u = ca.SX.sym("u", n)
    p = ca.SX.sym("p", (space.n_pose + 2) * len(grippers))  # grasps
    w = ca.SX.sym("w", model.nominal.vector.size)
    Q = space.at_neutral_base(joints)
    acceleration = ca.SX.sym("acceleration", size)

    # explicit derivatives by [z; u'] with the object's acceleration held; as one Jacobian, so that rows share terms
    hold = _object_motions(model, grippers, Q, v, u, p)
    wrench = _object_wrench(body, hold, acceleration)
    law = model.dynamics.inverse(Q, v, u, w)
    rows = ca.cse([law, hold.accelerations, wrench, hold.levers])
    explicit = ca.Function(
        "explicit",
        [joints, v, u, acceleration, p, w, numbers],
        [
            ca.jacobian(ca.vertcat(*rows), ca.vertcat(joints, v, u)),
            ca.jacobian(wrench, acceleration),
            wrench,
            hold.levers,
        ],
    )
    closed = _closed_chain(hold, u)
    by_motion, M, wrench, levers = explicit(joints, v, closed.attainable, closed.acceleration, p, w, numbers)
    first_rows = np.cumsum([0, *(each.numel() for each in rows)]).tolist()
    law_by, accelerations_by, wrench_by, levers_by = ca.vertsplit(ca.sparsify(by_motion), first_rows)
    accelerations_by = ca.horzcat(accelerations_by[:, :-n], closed.S)  # S is known: its derivation is shared

    borne, borne_by_levers, borne_by_wrench = _shared_wrenches_with_jacobians(space, len(grippers))(levers, wrench, p)
    # the law, and what grippers bear: by the wrench on the object, by its acceleration, by the levers
    S = closed.S
    by_wrench = S.T @ borne_by_wrench
    by_acceleration = by_wrench @ M
    X = law_by[:, -n:] @ closed.projector.T + by_acceleration @ (S[:size, :] @ closed.projector.T)
    by_first = by_acceleration + sum(ca.horzsplit(X, size), ca.SX.zeros(n, size))
    F_by = (
        law_by
        + by_wrench @ wrench_by
        + (S.T @ borne_by_levers) @ levers_by
        + ca.horzcat(by_first, -X) @ accelerations_by
    )
    # S' lambda and S' borne also change with S, where joints turn
    Y = F_by[:, -n:]
    P_by = _geometric_stiffness(space, S, closed.strain)
    F_by[:, : space.joints] += _geometric_stiffness(space, S, borne) - Y @ P_by
    if model.spec.wheels:
        F_by = ca.horzcat(F_by, ca.jacobian(law, w)[:, stored_in(model.spec, w)])
    return ca.Function("held_by", [joints, v, u, p, w, numbers], [F_by])


def _geometric_stiffness(space: ConfigurationSpace, S: ca.SX, wrenches: ca.SX) -> ca.SX:
    """Return the derivatives of the generalized force S'f by the joints, with wrenches f fixed in the inertial frame.

    With the columns of S as linear and angular velocity (l; w), and those of a gripper in their order from the base
    outward, joint k turns the axes that come after it, and moves the point that those before it turn:

        dS_c / dq_k = (w_k x l_c; w_k x w_c) for k before c,    (w_c x l_k; 0) otherwise.

    Bruyninckx, De Schutter: Symbolic differentiation of the velocity mapping for a serial kinematic chain (1996).

    Args:
        space: That of the robot.
        S: Velocities of the object's centre by v, of one gripper below the other (A size, n).
        wrenches: One below the other (A size,).

    Returns:
        The derivatives (n, joints).
    """
    size = space.n_twist
    stiffness = ca.SX(space.n, space.joints)
    for of_gripper, wrench in zip(ca.vertsplit(S, size), ca.vertsplit(wrenches, size), strict=True):
        force, moment = space.twist_to_3d(ca.vertsplit(wrench))
        columns = [c for c in range(space.n) if of_gripper[:, c].nnz()]
        twists = {c: space.twist_to_3d(ca.vertsplit(ca.densify(of_gripper[:, c]))) for c in columns}
        for c, (linear, angular) in twists.items():
            turned = add(cross(linear, force), cross(angular, moment))
            moved = cross(force, angular)
            for k, (linear_k, angular_k) in twists.items():
                if k >= size:  # a joint; the first columns are those of the base
                    stiffness[c, k - size] += dot(angular_k, turned) if k < c else dot(linear_k, moved)
    return ca.sparsify(stiffness)


def _attainable_tick(model: RobotModel, grippers: Sequence[str]) -> ca.Function:
    """Return one tick of `HeldLoad.attainable_accelerations`, as a CasADi function.

    It is a function of the state [Q; v], the commanded acceleration u, whether the grippers are closed, the grasps and
    the length of the tick. Its values are the state after the tick, and the acceleration u' of `held_force` (n,), which
    is u while the grippers are open. The state is only needed to know where the chain is: that the axis of a rotation
    turns within a tick does not count.
    """

    def derive() -> ca.Function:
        """Derive state after a tick and attainable acceleration, of state, u, closed, grasps, tick."""
        n = model.n
        state = ca.SX.sym("state", model.nq + n)
        u = ca.SX.sym("u", n)
        closed = ca.SX.sym("closed")
        tick = ca.SX.sym("tick")
        grasps = ca.SX.sym("grasps", (model.space.n_pose + 2) * len(grippers))
        Q = state[: model.nq]
        v = state[model.nq :]
        nearest = _closed_chain(_object_motions(model, grippers, Q, v, u, grasps), u).attainable
        attainable = ca.if_else(closed, nearest, u)
        step = tick * v + tick**2 / 2 * attainable
        after = ca.vertcat(*model.space.integrate(ca.vertsplit(Q), ca.vertsplit(step)), v + tick * attainable)
        return ca.Function("attainable", [state, u, closed, grasps, tick], ca.cse([after, attainable]))

    return model.derived((_attainable_tick, tuple(grippers)), derive)


@dataclass(frozen=True)
class _ObjectMotions:
    """The object as each gripper would move it if it were fixed to it; vectors are in the inertial frame.

    Attributes:
        accelerations: S_i vdot + s_i, of the object's centre of mass and of its turn, one below the other (A size,).
        levers: From that centre to the grippers, one below the other (3 A,).
        attitude: Rotation matrix of the object, by the last gripper (3, 3).
        omega: Its angular velocity, by the first gripper (3,).
    """

    accelerations: ca.SX
    levers: ca.SX
    attitude: list[list[Any]]
    omega: Vector


def _object_motions(
    model: RobotModel, grippers: Sequence[str], Q: ca.SX, v: ca.SX, vdot: ca.SX, p: ca.SX
) -> _ObjectMotions:
    """Derive how each gripper would move the object if it were fixed to it.

    Args:
        model: The robot.
        grippers: Those that hold the object, by arm.
        Q: Position of the robot (nq,).
        v: Velocity (n,).
        vdot: Rates of v (n,).
        p: Grasps, of each gripper its pose in the object's frame and both stiffnesses.
    """
    space = model.space
    tools = tool_motions(model.spec, Q, v, vdot)
    accelerations = list[Any]()
    levers = list[Any]()
    attitude: list[list[Any]] = []
    for gripper, grasp in zip(grippers, ca.vertsplit(p, space.n_pose + 2), strict=True):
        tool = tools[gripper]
        inside, turned = space.to_3d(ca.vertsplit(grasp)[:-2])
        attitude = matrix_product(tool.rotation, transposed(matrix(turned)))
        lever = matrix_vector(attitude, inside)
        at_centre = add(tool.acceleration, point_acceleration(tool.omega, tool.alpha, scaled(lever, -1)))
        accelerations += space.twist(at_centre, tool.alpha)
        levers += lever
    return _ObjectMotions(ca.vertcat(*accelerations), ca.vertcat(*levers), attitude, tools[grippers[0]].omega)


@dataclass(frozen=True)
class _ClosedChain:
    """How the robot accelerates with the chain closed, see `held_force`.

    Attributes:
        S: Velocities of the object by v, of one gripper below the other (A size, n).
        attainable: u' = u - S'strain (n,).
        acceleration: Of the object, by the first gripper, S_1 u' + s_1 (size,).
        strain: The multipliers lambda as wrenches of the grippers that add up to 0, one below the other (A size,).
        projector: (G G')^-1 G ((A - 1) size, n).
    """

    S: ca.SX
    attainable: ca.SX
    acceleration: ca.SX
    strain: ca.SX
    projector: ca.SX


def _closed_chain(hold: _ObjectMotions, u: ca.SX) -> _ClosedChain:
    """Return the accelerations nearest to commanded ones with which all grippers move the object alike.

    `held_force` has the equations. G G' is regularized, because in space it loses rank where arms are stretched. With a
    single gripper nothing can differ, and the commanded accelerations stay.

    Args:
        hold: How each gripper moves the object under the commanded accelerations.
        u: These accelerations, a symbol (n,).
    """
    S = ca.jacobian(hold.accelerations, u)
    grippers = hold.levers.numel() // 3
    size = hold.accelerations.numel() // grippers
    # the differences to the first gripper, [G, G u + g], and (G G')^-1 times both: the projector and lambda
    first, *others = ca.vertsplit(ca.horzcat(S, hold.accelerations), size)
    differences = ca.vertcat(ca.SX(0, u.numel() + 1), *(other - first for other in others))
    G = ca.sparsify(differences[:, :-1])
    solved = differences
    if others:
        solved = solve_spd(G @ G.T + REGULARIZATION * ca.SX.eye(differences.size1()), differences)
    of_others = ca.vertsplit(solved[:, -1], size) if others else []
    strain = ca.vertcat(-sum(of_others, ca.SX.zeros(size)), *of_others)
    shift = S.T @ strain
    return _ClosedChain(
        S=S,
        attainable=u - shift,
        acceleration=hold.accelerations[:size] - S[:size, :] @ shift,
        strain=strain,
        projector=solved[:, :-1],
    )


REGULARIZATION = 1e-9
"""Added to the squares of singular values of the constraints, which where both arms are stretched are 0."""

SINGULAR = 1e-9
"""Singular values of the constraints, over the largest, below which they say the same twice."""


def _chain_terms(model: RobotModel, body: FreeBody, grippers: list[str]) -> ca.Function:
    """Return Q, grasps -> S of all grippers (A size, n), inertia of the object."""
    Q = ca.SX.sym("Q", model.nq)
    vdot = ca.SX.sym("vdot", model.n)
    p = ca.SX.sym("p", (body.space.n_pose + 2) * len(grippers))
    acceleration = ca.SX.sym("acceleration", body.space.n_twist)
    hold = _object_motions(model, grippers, Q, ca.SX.zeros(model.n), vdot, p)
    inertia = ca.jacobian(_object_wrench(body, hold, acceleration), acceleration)
    terms = ca.jacobian(hold.accelerations, vdot), inertia
    return ca.Function("chain", [Q, p], ca.cse([ca.densify(term) for term in terms]))


def _object_wrench(body: FreeBody, hold: _ObjectMotions, acceleration: ca.SX) -> ca.SX:
    """Return the wrench that an acceleration of the object needs, about its centre of mass, along inertial axes.

    With the attitude R and principal moments I_0 it is (m a, I alpha + omega x I omega), I = R I_0 R'. In the plane the
    components that do not count are left out.

    Args:
        body: The object.
        hold: Has its attitude and angular velocity.
        acceleration: Of its centre and of its rotation, (3,) or (6,) [m/s^2, rad/s^2].

    Returns:
        Force and moment, (3,) or (6,) [N, N m].
    """
    space = body.space

    def spin(angular: Vector) -> list[Any]:
        turned = matrix_vector(transposed(hold.attitude), angular)
        return matrix_vector(hold.attitude, [I_0 * rate for I_0, rate in zip(body.moments, turned, strict=True)])

    linear, alpha = space.twist_to_3d(ca.vertsplit(acceleration))
    moment = add(spin(alpha), cross(hold.omega, spin(hold.omega)))
    return ca.SX(ca.vertcat(*space.twist(scaled(linear, body.mass), moment)))


def _shared_wrenches(space: ConfigurationSpace, levers: ca.SX, p: ca.SX, wrench: ca.SX) -> ca.SX:
    """Divide the wrench that moves an object among A grippers, so that all grasps deflect equally.

    Gripper i bears f_i = C_i (sum C)^-1 wrench, with C_i the stiffness of its grasp about the object's centre: then
    (sum C)^-1 wrench is the deflection of each. One gripper bears all of it.

    Args:
        space: Of the object's poses.
        levers: From the object's centre to the grippers (3 A,).
        p: Grasps, with the stiffnesses k and kappa of each last.
        wrench: Of force and moment that the object needs, about its centre (n_twist,).

    Returns:
        The wrenches f_i about the object's centre, one after the other (A n_twist,).
    """
    stiffness = [
        _stiffness_about_centre(space, ca.vertsplit(lever), *ca.vertsplit(grasp)[-2:])
        for lever, grasp in zip(ca.vertsplit(levers, 3), ca.vertsplit(p, space.n_pose + 2), strict=True)
    ]
    if len(stiffness) == 1:
        return wrench
    deflection = solve_spd(sum(stiffness, ca.SX.zeros(space.n_twist, space.n_twist)), wrench)
    return ca.SX(ca.vertcat(*(C @ deflection for C in stiffness)))


def _shared_wrenches_with_jacobians(space: ConfigurationSpace, grippers: int) -> ca.Function:
    """Return levers, wrench, grasps -> `_shared_wrenches`, its derivatives by levers and by the wrench."""
    levers = ca.SX.sym("levers", 3 * grippers)
    wrench = ca.SX.sym("wrench", space.n_twist)
    p = ca.SX.sym("p", (space.n_pose + 2) * grippers)
    borne = _shared_wrenches(space, levers, p, wrench)
    jacobians = ca.jacobian(borne, levers), ca.jacobian(borne, wrench)
    return ca.Function("borne", [levers, wrench, p], [borne, *jacobians])


def _stiffness_about_centre(space: ConfigurationSpace, lever: Vector, k: ca.SX, kappa: ca.SX) -> ca.SX:
    """Return the stiffness matrix of an elastic grasp about the object's centre: wrench by displacement of the object.

    Args:
        space: Of the object's poses.
        lever: From the object's centre to the grasp (3,) [m].
        k: Stiffness against translation [N/m].
        kappa: Stiffness against rotation [N m/rad].
    """
    displacement = ca.SX.sym("d", space.n_twist)
    moved, turned = space.twist_to_3d(ca.vertsplit(displacement))
    force = scaled(add(moved, cross(turned, lever)), k)
    wrench = space.twist(force, add(scaled(turned, kappa), cross(lever, force)))
    return ca.SX(ca.jacobian(ca.vertcat(*wrench), displacement))
