"""The computed torque of a robot that knows its load: an object held by all grippers. docs/grasp_model.md."""

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np
from scipy.linalg import eigh, null_space

from psmpc_cli.native.functions import ArrayFunction
from psmpc_cli.robot.configuration import ConfigurationSpace
from psmpc_cli.robot.dynamics import InertialParameters, solve_spd
from psmpc_cli.robot.free_body import FreeBody
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.robot.rotations import add, conjugate, cross, product, rotate, scaled
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
        self._body = body.vector
        self._force = ArrayFunction(held_force(model, grippers))
        self._grippers = grippers
        self._followed: dict[int, ArrayFunction] = {}
        self._terms = ArrayFunction(_chain_terms(model, body, grippers))

    def force(
        self,
        Q: np.ndarray,
        v: np.ndarray,
        u: np.ndarray,
        law: InertialParameters | None = None,
        grasps: np.ndarray | None = None,
        body: np.ndarray | None = None,
    ) -> np.ndarray:
        """Compute the generalized force (n,) [N, N m] for an acceleration u (n,).

        Args:
            Q: Position of the robot (nq,).
            v: Velocity (n,).
            u: Commanded acceleration (n,).
            law: Inertial parameters that the law has for the robot's; by default its own.
            grasps: Of each gripper its pose in the object's frame and both stiffnesses, (A, 5) or (A, 9); by default
                as the task has them.
            body: Mass and principal moments of the object; by default as the task has them.
        """
        grasps = self.grasps if grasps is None else grasps
        body = self._body if body is None else body
        parameters = (law or self._model.nominal).vector
        return np.asarray(self._force(Q, v, u, grasps.ravel(), parameters, body)[0][0])

    def followed(self, Q: np.ndarray, v: np.ndarray, u: np.ndarray, closed: np.ndarray, tick: float) -> np.ndarray:
        """Return the accelerations (M, n) that the robot has under commanded ones: u' while grippers are closed.

        Args:
            Q: Position of the robot at the first tick (nq,).
            v: Velocity then (n,).
            u: Commanded accelerations over the ticks (M, n).
            closed: Whether the grippers are closed at each of them (M,).
            tick: Length of a tick [s].
        """
        if len(u) not in self._followed:
            self._followed[len(u)] = ArrayFunction(_followed_tick(self._model, self._grippers).mapaccum(len(u)))
        _, followed = self._followed[len(u)](np.concatenate([Q, v]), u, closed[:, None], self.grasps.ravel(), tick)
        return followed

    def largest_ratio(self, Q: np.ndarray) -> tuple[float, np.ndarray]:
        """Compute the largest ratio of the load's inertia to the robot's, over all motions that keep the closed chain.

        It says what a law that does not know of the load makes of a commanded acceleration u. At rest its force is
        H u, and the robot with the load does (H + S'WS) vdot = H u. With u along the motion v that fulfils

            S'WS v = rho H v,    S_i v the same for all i,

        that is vdot = u / (1 + rho). Armatures are part of H.

        Args:
            Q: Position of the robot (nq,).

        Returns:
            The largest rho, and its motion v (n,), of kinetic energy 1/2 without the load.
        """
        n = self._model.n
        S, W = self._terms(Q, self.grasps.ravel())
        S = S.T.reshape(len(self.grasps), -1, n)
        N = null_space((S[1:] - S[:1]).reshape(-1, n), rcond=SINGULAR)
        H = self._model.mass_matrix(Q)
        SN = S.mean(axis=0) @ N
        ratios, motions = eigh(SN.T @ W @ SN, N.T @ H @ N)
        return float(ratios[-1]), N @ motions[:, -1]


def described_grasps(grippers: Sequence[str], grasp: GraspSpec) -> np.ndarray:
    """Return of each gripper its pose in the object's frame and both stiffnesses, (A, 5) or (A, 9)."""
    return np.array([[*grasp.at[gripper], *grasp.stiffness] for gripper in grippers])


def held_force(model: RobotModel, grippers: Sequence[str]) -> ca.Function:
    """Return Q, v, u, grasps, inertial parameters of the robot, object -> the force of the low-level law (n,).

    With G and g the differences S_i - S_1 and s_i - s_1 of the other grippers to the first, one below the other,

        u' = u - G' (G G')^-1 (G u + g),
        F = H u' + c + sum_i S_i' C_i (sum C)^-1 (M (S u' + s) + bias),

    where S u' + s, the object's acceleration, is that of any gripper. `HeldLoad` says why.

    Args:
        model: The robot.
        grippers: Those that hold the object, which is given as `FreeBody.vector`.
    """
    return model.derived((held_force, tuple(grippers)), lambda: _held_force(model, grippers))


def _held_force(model: RobotModel, grippers: Sequence[str]) -> ca.Function:
    """Derive what `held_force` returns."""
    body, numbers = FreeBody.symbolic(model.space.n_principal)
    size = body.space.n_twist
    Q = ca.SX.sym("Q", model.nq)
    v = ca.SX.sym("v", model.n)
    u = ca.SX.sym("u", model.n)
    p = ca.SX.sym("p", (body.space.n_pose + 2) * len(grippers))
    w = ca.SX.sym("w", model.nominal.vector.size)
    moving, stiffness, attitude = _chain(model, body, grippers, Q, v, p)
    rate = ca.vertcat(*model.space.rate(ca.vertsplit(Q), ca.vertsplit(v)))
    u_shared = _shared_acceleration(moving, size, v, u, ca.jtimes(moving, Q, rate))
    acceleration = ca.jtimes(moving[:size], v, u_shared) + ca.jtimes(moving[:size], Q, rate)
    M, bias = _load(body, attitude, ca.vertsplit(moving[:size]))
    wrench = M @ acceleration + bias
    wrenches = [wrench]
    if len(grippers) > 1:
        share = solve_spd(sum(stiffness, ca.SX.zeros(size, size)), wrench)
        wrenches = [C @ share for C in stiffness]
    of_load = ca.jtimes(moving, v, ca.vertcat(*wrenches), True)
    force = model.dynamics.law(Q, v, u_shared, w) + of_load
    return ca.Function("held", [Q, v, u, p, w, numbers], [ca.cse(ca.densify(force))])


def _followed_tick(model: RobotModel, grippers: Sequence[str]) -> ca.Function:
    """Return state [Q; v], u, closed, grasps, tick -> the state after the tick, u' of `held_force` (n,).

    Where the grippers are not closed u' is u. The state only says where the chain is: the turn's change of direction
    within a tick does not count.
    """

    def derive() -> ca.Function:
        shared = _shared(model, grippers)
        n = model.n
        state = ca.SX.sym("state", model.nq + n)
        closed = ca.SX.sym("closed")
        tick = ca.SX.sym("tick")
        _, _, u, grasps = shared.sx_in()
        Q = state[: model.nq]
        v = state[model.nq :]
        followed = ca.if_else(closed, shared(Q, v, u, grasps), u)
        step = tick * v + tick**2 / 2 * followed
        after = ca.vertcat(*model.space.integrate(ca.vertsplit(Q), ca.vertsplit(step)), v + tick * followed)
        return ca.Function("followed", [state, u, closed, grasps, tick], ca.cse([after, followed]))

    return model.derived((_followed_tick, tuple(grippers)), derive)


def _shared(model: RobotModel, grippers: Sequence[str]) -> ca.Function:
    """Return Q, v, u, grasps -> u' of `held_force` (n,)."""
    body, _ = FreeBody.symbolic(model.space.n_principal)
    Q = ca.SX.sym("Q", model.nq)
    v = ca.SX.sym("v", model.n)
    u = ca.SX.sym("u", model.n)
    p = ca.SX.sym("p", (body.space.n_pose + 2) * len(grippers))
    moving, _, _ = _chain(model, body, grippers, Q, v, p)
    rate = ca.vertcat(*model.space.rate(ca.vertsplit(Q), ca.vertsplit(v)))
    u_shared = _shared_acceleration(moving, body.space.n_twist, v, u, ca.jtimes(moving, Q, rate))
    return ca.Function("shared", [Q, v, u, p], [ca.cse(ca.densify(u_shared))])


def _shared_acceleration(moving: ca.SX, size: int, v: ca.SX, u: ca.SX, bias: ca.SX) -> ca.SX:
    """Return the accelerations u' (n,) nearest to u with which all grippers move the object alike.

    Gripper i would accelerate the object by S_i u + s_i. With G = S_i - S_1 and g = s_i - s_1 of all grippers but the
    first, one below the other, u' is the projection u - G' (G G')^-1 (G u + g). G G' is regularized, because in space
    it loses rank where arms are stretched. A single gripper leaves u as it is.

    Args:
        moving: Velocities S_i v that grippers give the object, one below the other (A size,).
        size: Components of one: 3 in the plane, 6 in space.
        v: The robot's velocity, a symbol (n,).
        u: Wanted accelerations (n,).
        bias: s_i, one below the other (A size,).
    """
    others = moving.numel() // size - 1
    if not others:
        return u
    apart = moving[size:] - ca.repmat(moving[:size], others, 1)
    G = ca.jacobian(apart, v)
    away = G @ u + bias[size:] - ca.repmat(bias[:size], others, 1)
    regular = G @ G.T + REGULARIZATION * ca.SX.eye(apart.numel())
    return u - G.T @ solve_spd(regular, away)


REGULARIZATION = 1e-9
"""Added to the squares of singular values of the constraints, which where both arms are stretched are 0."""

SINGULAR = 1e-9
"""Singular values of the constraints, over the largest, below which they say the same twice."""


def _chain_terms(model: RobotModel, body: FreeBody, grippers: list[str]) -> ca.Function:
    """Return Q, grasps -> S of all grippers (A size, n), inertia of the object."""
    Q = ca.SX.sym("Q", model.nq)
    v = ca.SX.sym("v", model.n)
    p = ca.SX.sym("p", (body.space.n_pose + 2) * len(grippers))
    moving, _, attitude = _chain(model, body, grippers, Q, v, p)
    inertia, _ = _load(body, attitude, ca.vertsplit(moving[: body.space.n_twist]))
    terms = ca.jacobian(moving, v), inertia
    return ca.Function("chain", [Q, p], ca.cse([ca.densify(term) for term in terms]))


def _chain(
    model: RobotModel, body: FreeBody, grippers: Sequence[str], Q: ca.SX, v: ca.SX, p: ca.SX
) -> tuple[ca.SX, list[ca.SX], Vector]:
    """Return S_i v of all grippers (A size,), the stiffnesses C_i about the object's centre, and its attitude.

    S_i v is the velocity of the object's centre of mass and its angular velocity, both in the inertial frame, if it is
    fixed to gripper i at its pose in the object's frame.
    """
    space = body.space
    size = space.n_twist
    size_of_grasp = space.n_pose + 2
    xi = model.g(Q)
    xidot = model.J_C(Q) @ v
    velocities = list[ca.SX]()
    stiffness = list[ca.SX]()
    attitude: Vector = ()
    for i, gripper in enumerate(grippers):
        frame = list(model.pose_rows).index(gripper)
        grasp = ca.vertsplit(p)[size_of_grasp * i : size_of_grasp * (i + 1)]
        inside, turned = space.to_3d(grasp[:-2])
        _, at = space.to_3d(ca.vertsplit(xi[model.pose_rows[gripper]]))
        attitude = product(at, conjugate(turned))
        linear, angular = space.twist_to_3d(ca.vertsplit(xidot[size * frame : size * (frame + 1)]))
        lever = scaled(rotate(attitude, inside), -1)
        stiffness.append(_at_centre(space, scaled(lever, -1), *grasp[-2:]))
        velocities += space.twist(add(linear, cross(angular, lever)), angular)
    return ca.vertcat(*velocities), stiffness, attitude


def _at_centre(space: ConfigurationSpace, lever: Vector, k: ca.SX, kappa: ca.SX) -> ca.SX:
    """Return the stiffness of a bushing at a lever from the object's centre as the wrench about it, by displacement."""
    displacement = ca.SX.sym("d", space.n_twist)
    moved, turned = space.twist_to_3d(ca.vertsplit(displacement))
    force = scaled(add(moved, cross(turned, lever)), k)
    wrench = space.twist(force, add(scaled(turned, kappa), cross(lever, force)))
    return ca.SX(ca.jacobian(ca.vertcat(*wrench), displacement))


def _load(body: FreeBody, attitude: Vector, velocity: Vector) -> tuple[ca.SX, ca.SX]:
    """Return the object's inertia M by its velocity in the inertial frame, and its bias omega x I omega as a wrench.

    With attitude R and principal moments I_0: M = diag(m, m, m, R I_0 R'), of which the components that count are left.
    """
    space = body.space

    def spin(angular: Vector) -> list[Any]:
        turned = rotate(conjugate(attitude), angular)
        return rotate(attitude, [moment * rate for moment, rate in zip(body.moments, turned, strict=True)])

    twist = ca.SX.sym("twist", space.n_twist)
    linear, angular = space.twist_to_3d(ca.vertsplit(twist))
    momentum = ca.vertcat(*space.twist(scaled(linear, body.mass), spin(angular)))
    _, omega = space.twist_to_3d(velocity)
    bias = ca.vertcat(*space.twist([0.0, 0.0, 0.0], cross(omega, spin(omega))))
    return ca.SX(ca.jacobian(momentum, twist)), bias
