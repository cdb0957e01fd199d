"""Equations of motion from the kinetic energy alone, by algorithmic differentiation. In space there is no gravity."""

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca

from psmpc_cli.robot.bodies import Body


@dataclass(frozen=True)
class Dynamics:
    """Expressions of Q, Qdot, Qddot, F (n,): the terms of (3) and what is conserved. Shapes as in `RobotModel`."""

    kinetic_energy: ca.SX
    momentum: ca.SX
    H: ca.SX
    C_Qdot: ca.SX
    inverse: ca.SX
    forward: ca.SX


def derive(bodies: Sequence[Body], Q: ca.SX, Qdot: ca.SX, Qddot: ca.SX, F: ca.SX) -> Dynamics:
    """Derive the equations of motion of connected bodies. Paper eqs. (3), (4)."""
    T, H = kinetic_energy(bodies, Q, Qdot), inertia(bodies, Q, Qdot)
    C_Qdot = coriolis(T, Q, Qdot)
    inverse = C_Qdot + ca.jtimes(ca.gradient(T, Qdot), Qdot, Qddot)
    return Dynamics(T, momentum(bodies, Q, Qdot), H, C_Qdot, inverse, solve_spd(H, F - C_Qdot))


def kinetic_energy(bodies: Sequence[Body], Q: ca.SX, Qdot: ca.SX) -> ca.SX:
    """T of all bodies, scalar [J]."""
    T = ca.SX(0)
    for body in bodies:
        v, spin = body.velocity(Q, Qdot), body.frame.angular_velocity(Q, Qdot)
        T += (body.mass * ca.dot(v, v) + ca.dot(spin, body.inertia @ spin)) / 2
    return T


def inertia(bodies: Sequence[Body], Q: ca.SX, Qdot: ca.SX) -> ca.SX:
    """H = d2T/dQdot2, (n, n).

    Velocities being linear in Qdot, it is the sum of their Jacobians' squares: fewer operations than to differentiate
    T twice.
    """
    H = ca.SX(Q.numel(), Q.numel())
    for body in bodies:
        J_v, J_w = ca.jacobian(body.frame.position, Q), ca.jacobian(body.frame.angular_velocity(Q, Qdot), Qdot)
        H += body.mass * J_v.T @ J_v + J_w.T @ body.inertia @ J_w
    return ca.triu2symm(ca.triu(H))


def coriolis(T: ca.SX, Q: ca.SX, Qdot: ca.SX) -> ca.SX:
    """C Qdot = Hdot Qdot - 1/2 d(Qdot' H Qdot)/dQ, (n,) [N, N m]; H Qdot = dT/dQdot. Below paper eq. (3)."""
    return ca.jtimes(ca.gradient(T, Qdot), Q, Qdot) - ca.gradient(T, Q)


def momentum(bodies: Sequence[Body], Q: ca.SX, Qdot: ca.SX) -> ca.SX:
    """Linear [N s], then angular momentum about the inertial origin [N m s]; planar (3,), spatial (6,)."""
    linear, angular = ca.SX(0), ca.SX(0)
    for body in bodies:
        mv, spin = body.mass * body.velocity(Q, Qdot), body.inertia @ body.frame.angular_velocity(Q, Qdot)
        linear, angular = linear + mv, angular + body.frame.angular_momentum(spin, mv)
    return ca.vertcat(linear, angular)


def solve_spd(A: ca.SX, b: ca.SX) -> ca.SX:
    """Solve A x = b for symmetric positive definite A (n, n) by LDL', sparse: arms couple through the base alone."""
    D, LT, order = ca.ldl(A)
    return ca.ldl_solve(b, D, LT, order)
