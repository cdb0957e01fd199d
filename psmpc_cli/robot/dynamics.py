"""Equations of motion of a tree of bodies by the recursive Newton-Euler algorithm. In space there is no gravity.

Every vector is in the frame of its body, so that the base's pose appears once, where its force and velocity are turned
into the inertial frame. Luh, Walker, Paul (1980); Featherstone: Rigid Body Dynamics Algorithms (2008), chapter 5.

The rotor that drives a joint, of inertia I_r about its own axis, turns G times as fast as the joint. With the armature
a = G^2 I_r the joint needs the further force a qdd and the kinetic energy has the further term a qd^2 / 2, so that the
mass matrix is H + diag(0, a). This is the armature of MuJoCo and of Pinocchio: the mass of the rotors belongs to the
links, and the spin momentum G I_r qd that a rotor adds to that of the body it sits on is neglected, being 1/G of what a
stands for. That is why neither the wrench on the base nor the momentum has a term of it. Featherstone (2008), chapter
9, on gears.

A reaction wheel i on the base, of inertia J_i about its axis a_i, stores h_i = J_i (Omega_i + a_i . omega): the
momentum of its spin and of the base's turn about its axis. Without J_i a_i a_i' the base has the inertia I*, and base
and wheels have the angular momentum I* omega + h_w with h_w = sum_i a_i h_i. Its motor changes h_i at the rate tau_i.
So the moment that the base needs from elsewhere is that of a body with the inertia I*, sum_i a_i tau_i, and
omega x h_w. The last is part of the bias here, with h_w, `stored`, as a parameter. Hughes: Spacecraft Attitude Dynamics
(1986), chapter 6.

In task space the same equations are those of the twists of base and end-effectors, paper eqs. (5) and (6); see
`TaskSpaceDynamics`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from psmpc_cli.errors import InputError
from psmpc_cli.robot.configuration import configuration_space
from psmpc_cli.robot.rotations import (
    add,
    cross,
    dot,
    exp,
    matrix,
    matrix_product,
    matrix_vector,
    scaled,
    transposed,
    turn_matrix,
)
from psmpc_cli.specs.robots.robot import Joint, RobotSpec, inertia_without_wheels

EXACT = 1e-15
"""Entries of a constant rotation matrix this near to 0 and 1 are meant to be: right angles cost no operations."""

NULL_SPACE_DAMPING = 1.0
"""Rate at which motion in the null space of the task decays under the task-space law [1/s]."""

LARGEST_CONDITION = 1e3
"""Condition number of J_C, lengths in metres, up to which the law in task space is used. There its forces are equal to
those in joint space to 1e-9; beyond, small accelerations of poses are large ones of joints."""

Vector = list[Any]
Matrix = list[list[Any]]


@dataclass(frozen=True, eq=False)
class InertialParameters:
    """Inertial parameters of a robot's bodies in their order, and of what its grippers hold.

    Attributes:
        mass: (bodies,) [kg].
        inertia: About the centres of mass, zz of a planar robot (bodies, 1), xx, yy, zz, xy, xz, yz of a spatial one
            (bodies, 6) [kg m^2]; the base's without what of wheels turns about their axes.
        offset: Of the centres of mass from the nominal ones, along the axes of the body (bodies, dimension) [m].
        held_mass: Of the load in each gripper, at the end-effector frame (arms,) [kg].
        held_inertia: Of the load about that point, the same about each axis (arms,) [kg m^2].
        stored: Angular momentum h_w that wheels store, along the base's own axes, (1,) or (3,) [N m s]; empty of a
            robot without wheels.
    """

    mass: np.ndarray
    inertia: np.ndarray
    offset: np.ndarray
    held_mass: np.ndarray
    held_inertia: np.ndarray
    stored: np.ndarray = field(default_factory=lambda: np.zeros(0))

    @classmethod
    def nominal(cls, spec: RobotSpec) -> "InertialParameters":
        """Return the parameters of the robot's description, with empty grippers and wheels that store nothing."""
        bodies = spec.bodies
        space = configuration_space(spec)
        inertias = [inertia_without_wheels(spec), *(body.inertia for body in bodies[1:])]
        return cls(
            mass=np.array([body.mass for body in bodies]),
            inertia=np.array([inertia[space.moments] for inertia in inertias]),
            offset=np.zeros((len(bodies), spec.dimension)),
            held_mass=np.zeros(len(spec.arms)),
            held_inertia=np.zeros(len(spec.arms)),
            stored=np.zeros(n_stored(spec)),
        )

    @cached_property
    def vector(self) -> np.ndarray:
        """All parameters in one vector w, the last argument of the functions of `Dynamics`."""
        return np.concatenate(
            [self.mass, self.inertia.T.ravel(), self.offset.T.ravel(), self.stored, self.held_mass, self.held_inertia]
        )

    def holding(self, mass: np.ndarray, inertia: np.ndarray) -> "InertialParameters":
        """Return the same robot with loads of mass (arms,) [kg] and inertia (arms,) [kg m^2] in its grippers."""
        return replace(self, held_mass=mass, held_inertia=inertia)

    def storing(self, stored: np.ndarray) -> "InertialParameters":
        """Return the same robot with wheels that store so much, (1,) or (3,) [N m s]."""
        return replace(self, stored=stored)


def n_stored(spec: RobotSpec) -> int:
    """Return the number of components of what wheels store; 0 of a robot without wheels."""
    space = configuration_space(spec)
    return (space.n_twist - space.dimension) * bool(spec.wheels)


def with_stored(spec: RobotSpec, w: Any, stored: Any) -> Any:
    """Return the vector of inertial parameters w as an expression, with what wheels store replaced."""
    rows = stored_in(spec, w)
    return ca.vertcat(w[: rows.start], stored, w[rows.stop :])


def stored_in(spec: RobotSpec, w: Any) -> slice:
    """Return where in the vector of inertial parameters w, an expression, that is what wheels store."""
    end = w.numel() - 2 * len(spec.arms)
    return slice(end - n_stored(spec), end)


@dataclass(frozen=True, eq=False)
class Dynamics:
    """Equations of motion as CasADi functions. They take and return columns and accept SX, MX and numbers.

    Q (nq,) and v (n,) are as `RobotModel` has them. The last argument is w, the vector of `InertialParameters`: a
    symbol where inertial parameters vary, numbers where they do not, which CasADi then folds into the expressions.

    Attributes:
        H: Q, w -> (n, n) [kg, kg m, kg m^2]. Paper eq. (3).
        inverse: Q, v, vdot, w -> F (n,) [N, N m]. Paper eq. (3). It is the computed torque, eq. (7), of a base that is
            moved at will; for others see `law_with_driven_coordinates`.
        forward: Q, v, F, w -> vdot (n,) [m/s^2, rad/s^2]. Paper eq. (3). A fixed base has none, whatever acts on it.
        momentum: Q, v, w -> linear [N s] and angular about the inertial origin [N m s], (3,) or (6,). Paper eq. (4).
            That of the bodies alone: the armature of joints has none, see above.
        kinetic_energy: Q, v, w -> scalar [J].
    """

    H: ca.Function
    inverse: ca.Function
    forward: ca.Function
    momentum: ca.Function
    kinetic_energy: ca.Function


def derive_dynamics(spec: RobotSpec) -> Dynamics:
    """Derive the equations of motion of a robot as CasADi functions.

    The recursive Newton-Euler algorithm gives the generalized force F of a motion, F = H vdot + C v. It is linear in
    vdot, so its Jacobian is the mass matrix H, and F at vdot = 0 is the bias C v. H v is F of the rates v at rest: its
    rows of the base are the momentum, and v' H v / 2 is the kinetic energy.
    """
    space = configuration_space(spec)
    n = space.n
    Q = ca.SX.sym("Q", space.nq)
    v, vdot, F = (ca.SX.sym(name, n) for name in ("v", "vdot", "F"))
    w = ca.SX.sym("w", InertialParameters.nominal(spec).vector.size)
    force = _Tree(spec, Q).force(v, vdot, w)
    inverse = ca.Function("inverse", [Q, v, vdot, w], [force])
    bias = inverse(Q, v, 0, w)
    Hv = inverse(Q, 0, v, w)
    H = ca.triu2symm(ca.triu(ca.jacobian(force, vdot)))  # symmetric to the last digit
    momentum = ca.vertcat(*space.external_wrench(ca.vertsplit(Q), ca.vertsplit(Hv)))  # about the inertial origin
    if spec.wheels:
        tree = _Tree(spec, Q)
        momentum += ca.vertcat(*space.twist([0.0] * 3, matrix_vector(tree.base_rotation, _stored_momentum(spec, w))))
    motion = {"Q": Q, "v": v}
    acceleration = _acceleration(spec, H, F - bias)
    return Dynamics(
        H=function("H", {"Q": Q, "w": w}, {"H": ca.densify(H)}),
        inverse=function("inverse", {**motion, "vdot": vdot, "w": w}, {"F": force}),
        forward=function("forward", {**motion, "F": F, "w": w}, {"vdot": acceleration}),
        momentum=function("momentum", {**motion, "w": w}, {"p": momentum}),
        kinetic_energy=function("kinetic_energy", {**motion, "w": w}, {"T": ca.dot(v, Hv) / 2}),
    )


def law_with_driven_coordinates(
    spec: RobotSpec, law: ca.Function, driven: ca.SX | ca.DM, base_force: ca.SX | None = None
) -> ca.Function:
    """Return a low-level law for a base of which not all coordinates accelerate as commanded.

    Without thrusters, for example, the base cannot be pushed: it reacts to the motion of the joints. The law that is
    given has the base accelerate as commanded; the one that is returned accounts for the reaction. With the rows of
    base and joints, and the bias c, paper eq. (3) is

        H_bb vdot_b + H_bj vdot_j + c_b = F_b,    H_jb vdot_b + H_jj vdot_j + c_j = F_j.

    Coordinates of the base that are driven accelerate as commanded; on the others, f, a given force w_f acts, by
    default none, and they react to it and to the joints:

        H_ff vdot_f = w_f - (H_fd u_d + H_fj u_j + c_f),    F_f = w_f.

    All are driven of a free-flying base, none of a free-floating one; where wheels turn the base, those of its turn. A
    fixed base does not accelerate, F_j = H_jj u_j + c_j, and the force of the mount is none of the robot's.
    Umetani, Yoshida: Resolved motion rate control of space manipulators with generalized Jacobian matrix (1989).

    Args:
        spec: The robot.
        law: Q, v, u, ... -> F (n,), the force under which the robot accelerates by u; linear in u.
        driven: 1 for each coordinate of the base that is driven, 0 for the others (n_twist,). If it is a symbol, the
            law that is returned has it as its last argument.
        base_force: w_f, a given force on the base (n_twist,), of which the rows count that are not driven; by default
            0. It is a symbol, and the very last argument of the law that is returned.

    Returns:
        Q, v, u, ... -> F (n,): the force under which joints and driven coordinates accelerate by u.
    """
    base = configuration_space(spec).base
    Q, v, u, *others = law.sx_in()
    driven = ca.SX(driven)
    reaction = ca.SX.sym("reaction", base.stop)  # accelerations of the coordinates that are not driven
    F = law(Q, v, ca.vertcat(driven * u[base] + (1 - driven) * reaction, u[base.stop :]), *others)
    solved_reaction = ca.SX.zeros(base.stop)
    if spec.moved_by.moves:
        # the matrix keeps its size whatever is driven: driven rows are those of the identity, with right side 0
        free = ca.diag(1 - driven)
        H_ff = free @ ca.jacobian(F[base], reaction) @ free + ca.diag(driven)
        missing_force = -ca.substitute(F[base], reaction, ca.SX.zeros(base.stop))
        if base_force is not None:
            missing_force += base_force
        solved_reaction = ca.solve(H_ff, free @ missing_force)
    F = ca.substitute(F, reaction, solved_reaction)
    of_base = driven * F[base]
    arguments = dict(zip(law.name_in(), (Q, v, u, *others), strict=True))
    if driven.is_valid_input():
        arguments["driven"] = driven
    if base_force is not None:
        of_base += (1 - driven) * base_force
        arguments["base_force"] = base_force
    return function("law", arguments, {"F": ca.densify(ca.vertcat(of_base, F[base.stop :]))})


def law_with_base_force(spec: RobotSpec, law: ca.Function) -> ca.Function:
    """Return a low-level law for a base on which a given force acts, such as that of thrusters that fire in pulses.

    This force differs from the one that the law asks for. The torques of the joints that are returned account for the
    difference: with them and the given force, the joints accelerate as commanded, and the base as it must. The rows of
    the base are unchanged: the force that would make the base accelerate as commanded, too.

    Args:
        spec: The robot.
        law: Q, v, u, ... -> F (n,), the force under which the robot accelerates by u; linear in u.

    Returns:
        Q, v, u, ..., force on the base (n_twist,) -> F (n,).
    """
    base = configuration_space(spec).base
    base_force = ca.SX.sym("base_force", base.stop)
    arguments = dict(zip(law.name_in(), law.sx_in(), strict=True))
    reacting = law_with_driven_coordinates(spec, law, ca.DM.zeros(base.stop), base_force)(
        *arguments.values(), base_force
    )
    F = ca.vertcat(law(*arguments.values())[base], reacting[base.stop :])
    return function("pushed_law", {**arguments, "base_force": base_force}, {"F": F})


def _acceleration(spec: RobotSpec, H: ca.SX, force: ca.SX) -> ca.SX:
    """Return the accelerations under a force less the bias (n,); a fixed base has none."""
    space = configuration_space(spec)
    joints = space.joint_rates
    if spec.moved_by.moves:
        return solve_spd(H, force)
    return ca.SX(ca.vertcat(ca.SX.zeros(space.n_twist), solve_spd(H[joints, joints], force[joints])))


@dataclass(frozen=True, eq=False)
class TaskSpaceDynamics:
    """Equations of motion of the twists of base and end-effectors, as CasADi functions. Paper eqs. (5) and (6).

    With `xidot = J v` and the derivative of that, `a = J vdot + Jdot v`, they are

        H_x a + C_x = F_m,    H_x = (J H^-1 J')^-1,    C_x = H_x (J H^-1 C v - Jdot v).

    Where J is square these are (6): `H_x = J^-T H J^-1` and `C_x = J^-T C v - H_x Jdot v`. Arms with more joints than
    their pose has coordinates have a null space, which the force F_0 moves. With `Jbar = H^-1 J' H_x` the law is

        F = J' F_m + (I - J' Jbar') F_0,    F_0 = C v - H v / T,

    which has the null space come to rest with the time constant T: under F the robot has the accelerations
    `Jbar (a - Jdot v) - (I - Jbar J) v / T`. Khatib: A unified approach for motion and force control of robot
    manipulators: the operational space formulation (1987).

    Q, v and w are as in `Dynamics`; a (k,) are accelerations of the rows of J. Where J loses rank, none of them is
    finite.

    Attributes:
        H_x: Q, w -> (k, k).
        C_x: Q, v, w -> (k,).
        law: Q, v, a, w -> F (n,) [N, N m].
        acceleration: Q, v, a, w -> vdot (n,), the rates of v under that force.
    """

    H_x: ca.Function
    C_x: ca.Function
    law: ca.Function
    acceleration: ca.Function


def derive_task_space_dynamics(dynamics: Dynamics, J_C: ca.Function, Jdot_v: ca.Function) -> TaskSpaceDynamics:
    """Derive the equations of motion of the velocities J v of base and end-effectors, as CasADi functions.

    `TaskSpaceDynamics` has the equations. Here they are computed from the Cholesky factor of `H = L L'` and the QR
    factors of `L^-1 J' = Y R`, where `Y'Y = I` and R is triangular: `H_x = R^-1 R^-T` and `Jbar = L^-T Y R^-T`. That
    avoids J H^-1 J', whose condition number is the square of that of J.

    Args:
        dynamics: Equations of motion in the coordinates Q and v.
        J_C: Q -> J (k, n), of full row rank.
        Jdot_v: Q, v -> Jdot v (k,).

    Raises:
        InputError: J has more rows than columns: not every acceleration of the poses is possible.
    """
    J_rows, n = J_C.size_out(0)
    if J_rows > n:
        raise InputError(
            f"task space: found {J_rows} coordinates of poses and {n} of base and joints, "
            "expected as many joints in every arm as its pose has coordinates, 3 in the plane and 6 in space"
        )
    Q = ca.SX.sym("Q", J_C.size1_in(0))
    v = ca.SX.sym("v", n)
    a = ca.SX.sym("a", J_rows)
    w = ca.SX.sym("w", dynamics.H.size1_in(1))
    J = ca.sparsify(J_C(Q))
    LT = ca.chol(dynamics.H(Q, w))
    L = LT.T
    Y, R = ca.qr(ca.solve(L, J.T))
    bias = dynamics.inverse(Q, v, 0, w)
    whitened_bias = ca.solve(L, bias)  # L^-1 C v
    drift = Jdot_v(Q, v)

    inverse_R = ca.solve(R, ca.SX.eye(J_rows))
    H_x = inverse_R @ inverse_R.T
    C_x = ca.solve(R, Y.T @ whitened_bias - ca.solve(R.T, drift))
    F_m = ca.solve(R, ca.solve(R.T, a - drift) + Y.T @ whitened_bias)

    F_0 = bias - NULL_SPACE_DAMPING * (L @ (LT @ v))
    if n == J_rows:  # no null space, and Jbar is J^-1, whatever the inertia
        F = J.T @ F_m
        acceleration = _solve_by_blocks(J, a - drift)
    else:
        null_rate = ca.solve(LT, _orthogonal_part(Y, LT @ v))
        F = J.T @ F_m + L @ _orthogonal_part(Y, ca.solve(L, F_0))
        acceleration = ca.solve(LT, Y @ ca.solve(R.T, a - drift)) - NULL_SPACE_DAMPING * null_rate
    motion = {"Q": Q, "v": v}
    return TaskSpaceDynamics(
        H_x=function("H_x", {"Q": Q, "w": w}, {"H_x": ca.densify(H_x)}),
        C_x=function("C_x", {**motion, "w": w}, {"C_x": ca.densify(C_x)}),
        law=function("task_law", {**motion, "a": a, "w": w}, {"F": ca.densify(F)}),
        acceleration=function("task_acceleration", {**motion, "a": a, "w": w}, {"vdot": ca.densify(acceleration)}),
    )


def _solve_by_blocks(A: ca.SX, b: ca.SX) -> ca.SX:
    """Solve A x = b (n,) for a sparse square matrix of symbols, block by block.

    Rows and columns are permuted so that A is block triangular. For the Jacobian of base and end-effectors this means:
    the base first, then each arm by itself. Blocks of up to three rows are inverted by their adjugates, whose
    derivatives have a tenth of the operations of those of a factorization. Duff, Reid: An implementation of Tarjan's
    algorithm for the block triangularization of a matrix (1978).
    """
    count, rows, columns, first_row, first_column, *_ = A.sparsity().btf()
    x = ca.SX.zeros(A.size2())
    for k in range(count):  # CasADi's form is lower triangular: a block needs the unknowns of those before it
        block_rows = rows[first_row[k] : first_row[k + 1]]
        block_columns = columns[first_column[k] : first_column[k + 1]]
        block = ca.densify(A[block_rows, block_columns])
        remaining = b[block_rows] - A[block_rows, :] @ x  # entries of x that are not solved for yet are 0
        is_small = len(block_rows) <= 3
        x[block_columns] = ca.inv_minor(block) @ remaining if is_small else ca.solve(block, remaining)
    return x


def _orthogonal_part(Y: ca.SX, b: ca.SX) -> ca.SX:
    """Return the part of b (n,) that is orthogonal to the orthonormal columns of Y (n, k)."""
    return b - Y @ (Y.T @ b)


def solve_spd(A: ca.SX, b: ca.SX) -> ca.SX:
    """Solve A x = b for symmetric positive definite A (n, n) by LDL', sparse: arms couple through the base alone."""
    D, LT, order = ca.ldl(A)
    return ca.ldl_solve(b, D, LT, order)


def function(name: str, inputs: Mapping[str, ca.SX], outputs: Mapping[str, ca.SX]) -> ca.Function:
    """Return a function with named inputs and outputs, common subexpressions computed once."""
    expressions = ca.cse(list(outputs.values()))
    return ca.Function(name, list(inputs.values()), expressions, list(inputs), list(outputs))


@dataclass(frozen=True)
class _RigidMass:
    """Mass fixed to a body: mass, centre and inertia matrix about the centre, in the frame of body number `body`."""

    body: int
    mass: Any
    centre: Vector
    inertia: Matrix


@dataclass(frozen=True)
class _Motion:
    """Motion of a body's frame: angular velocity and acceleration, acceleration of its origin."""

    omega: Vector
    alpha: Vector
    acceleration: Vector


@dataclass(frozen=True)
class ToolMotion:
    """Motion of an end-effector frame, in the inertial frame; its velocity has no part in the equations of motion.

    Attributes:
        rotation: Its rotation matrix, row by row (3, 3).
        omega: Angular velocity (3,) [rad/s].
        alpha: Angular acceleration (3,) [rad/s^2].
        acceleration: Of its origin (3,) [m/s^2].
    """

    rotation: Matrix
    omega: Vector
    alpha: Vector
    acceleration: Vector


def tool_motions(spec: RobotSpec, Q: ca.SX, v: ca.SX, vdot: ca.SX) -> dict[str, ToolMotion]:
    """Derive the motions of the end-effector frames, by arm, at Q (nq,), v (n,) and vdot (n,).

    A held object moves with them. Their expressions are those of the inverse dynamics, so that both share their
    derivatives.
    """
    tree = _Tree(spec, Q)
    motions = tree.motions(v, vdot)
    rotations = [tree.base_rotation]
    for joint, (E, _) in zip(tree.joints, tree.joint_frames, strict=True):
        rotations.append(matrix_product(rotations[joint.at.body], E))
    tools = {}
    for arm, tool in spec.tools.items():
        motion = motions[tool.body]
        R = rotations[tool.body]
        at_origin = add(motion.acceleration, point_acceleration(motion.omega, motion.alpha, list(tool.position)))
        tools[arm] = ToolMotion(
            rotation=matrix_product(R, matrix(exp(tool.rotation))),
            omega=matrix_vector(R, motion.omega),
            alpha=matrix_vector(R, motion.alpha),
            acceleration=matrix_vector(R, at_origin),
        )
    return tools


class _Tree:
    """The bodies of a robot at Q."""

    def __init__(self, spec: RobotSpec, Q: ca.SX) -> None:
        self.spec = spec
        self.space = configuration_space(spec)
        self.base_rotation = self.space.base_rotation(Q)
        joints = ca.vertsplit(Q)[self.space.joint_coordinates]
        self.joints = spec.joints
        self.joint_frames = list(map(_joint_frame, self.joints, joints))

    def motions(self, v: ca.SX, vdot: ca.SX) -> list[_Motion]:
        """Compute the motion of every body, each in its own frame."""
        base = self.space.base
        _, angular = self.space.twist_to_3d(ca.vertsplit(v[base]))
        pulled, twisted = self.space.twist_to_3d(ca.vertsplit(vdot[base]))
        motions = [_Motion(angular, twisted, matrix_vector(transposed(self.base_rotation), pulled))]
        rates = zip(*(ca.vertsplit(derivative)[base.stop :] for derivative in (v, vdot)), strict=True)
        for joint, place, rate in zip(self.joints, self.joint_frames, rates, strict=True):
            motions.append(_motion_of_link(motions[joint.at.body], joint, *place, *rate))
        return motions

    def force(self, v: ca.SX, vdot: ca.SX, w: ca.SX) -> ca.SX:
        """Compute the generalized force (n,) of a motion, by the recursive Newton-Euler algorithm.

        First the force and the moment that the motion of each mass needs are added up by body. Then, from the tips
        inward, the force along each joint is read off, and force and moment are handed on to the body that carries it.

        Args:
            v: Velocity (n,).
            vdot: Its rates (n,).
            w: Vector of inertial parameters, see `InertialParameters`.
        """
        motions = self.motions(v, vdot)
        joint_accelerations = ca.vertsplit(vdot)[self.space.base.stop :]
        # of each body, about its frame's origin and along its axes
        forces = [[0.0] * 3 for _ in motions]
        moments = [[0.0] * 3 for _ in motions]
        for rigid in _rigid_masses(self.spec, w):
            motion = motions[rigid.body]
            i = rigid.body
            at_centre = add(motion.acceleration, point_acceleration(motion.omega, motion.alpha, rigid.centre))
            f = scaled(at_centre, rigid.mass)
            spin = cross(motion.omega, matrix_vector(rigid.inertia, motion.omega))
            forces[i] = add(forces[i], f)
            moments[i] = add(moments[i], matrix_vector(rigid.inertia, motion.alpha), spin, cross(rigid.centre, f))
        if self.spec.wheels:  # the gyroscopic moment omega x h_w
            moments[0] = add(moments[0], cross(motions[0].omega, _stored_momentum(self.spec, w)))
        along: list[Any] = []  # forces along the joints, in their order
        for i in range(len(motions) - 1, 0, -1):
            joint = self.joints[i - 1]
            E, r = self.joint_frames[i - 1]
            on_link = dot(joint.axis, forces[i] if joint.prismatic else moments[i])
            along.insert(0, on_link + joint.armature * joint_accelerations[i - 1])
            f = matrix_vector(E, forces[i])
            carrier = joint.at.body
            forces[carrier] = add(forces[carrier], f)
            moments[carrier] = add(moments[carrier], matrix_vector(E, moments[i]), cross(r, f))
        return ca.SX(ca.vertcat(*self.space.twist(matrix_vector(self.base_rotation, forces[0]), moments[0]), *along))


def _joint_frame(joint: Joint, q: Any) -> tuple[Matrix, Vector]:
    """Compute the rotation of a body's frame into that of its carrier, and its origin there, at joint coordinate q."""
    position = list(joint.at.position)
    at = np.array(matrix(exp(joint.at.rotation)))
    at = np.where(np.abs(at - at.round()) < EXACT, at.round(), at).tolist()
    if joint.prismatic:
        return at, add(position, scaled(matrix_vector(at, joint.axis), q))
    columns = transposed(turn_matrix(joint.axis, q))
    return transposed([matrix_vector(at, column) for column in columns]), position


def _motion_of_link(before: _Motion, joint: Joint, E: Matrix, r: Vector, rate: Any, change: Any) -> _Motion:
    """Compute the motion of a body from that of its carrier; E and r are those of `_joint_frame`."""
    back = transposed(E)
    omega = matrix_vector(back, before.omega)
    alpha = matrix_vector(back, before.alpha)
    acceleration = matrix_vector(back, add(before.acceleration, point_acceleration(before.omega, before.alpha, r)))
    turning = cross(omega, scaled(joint.axis, rate))
    if joint.prismatic:
        return _Motion(omega, alpha, add(acceleration, scaled(joint.axis, change), scaled(turning, 2)))
    return _Motion(add(omega, scaled(joint.axis, rate)), add(alpha, scaled(joint.axis, change), turning), acceleration)


def _rigid_masses(spec: RobotSpec, w: ca.SX) -> list[_RigidMass]:
    """Return all rigid masses of a robot, with their parameters taken from the vector w: bodies, then held loads.

    The vector has the masses of all bodies, then each of their moments of inertia for all bodies, then the offsets of
    their centres likewise; what wheels store; masses, then inertias of the loads in the grippers. See
    `InertialParameters.vector`.
    """
    B = len(spec.bodies)
    A = len(spec.tools)
    space = configuration_space(spec)
    d = space.dimension
    k = space.n_moments
    sizes = [0, B, k * B, d * B, n_stored(spec), A, A]
    mass, moments, offsets, _, held_mass, held_inertia = ca.vertsplit(w, np.cumsum(sizes).tolist())
    moments = ca.reshape(moments, B, k)
    offsets = ca.reshape(offsets, B, d)
    rigid_masses = list[_RigidMass]()
    for i, body in enumerate(spec.bodies):
        moments_of_body = ca.horzsplit(moments[i, :])
        xx, yy, zz, xy, xz, yz = space.moments_to_3d(moments_of_body)
        centre = add(list(body.centre), [*ca.horzsplit(offsets[i, :]), 0.0][:3])
        rigid_masses.append(_RigidMass(i, mass[i], centre, [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
    for a, tool in enumerate(spec.tools.values()):  # a load counts as a point with the same inertia about every axis
        inertia = [[held_inertia[a] if i == j else 0.0 for j in range(3)] for i in range(3)]
        rigid_masses.append(_RigidMass(tool.body, held_mass[a], list(tool.position), inertia))
    return rigid_masses


def _stored_momentum(spec: RobotSpec, w: ca.SX) -> Vector:
    """Return what wheels store of inertial parameters w, (3,) along the base's axes."""
    space = configuration_space(spec)
    stored = ca.vertsplit(w[stored_in(spec, w)])
    return space.twist_to_3d([*[0.0] * space.dimension, *stored])[1]


def point_acceleration(omega: Vector, alpha: Vector, r: Vector) -> Vector:
    """Compute the acceleration of a point at r of a body relative to its origin."""
    return add(cross(alpha, r), cross(omega, cross(omega, r)))
