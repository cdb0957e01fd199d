"""Equations of motion from the kinetic energy alone, by algorithmic differentiation. In space there is no gravity."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca

from psmpc_cli.robot.bodies import Body, Placement, bodies_at


@dataclass(frozen=True, eq=False)
class Dynamics:
    """Equations of motion as CasADi functions. They take and return columns and accept SX, MX and numbers.

    Their last argument is w, the vector of `InertialParameters`: a symbol where inertial parameters vary, numbers where
    they do not, which CasADi then folds into the expressions.

    Attributes:
        H: Q, w -> (n, n) [kg, kg m, kg m^2]. Paper eq. (3).
        inverse: Q, Qdot, Qddot, w -> F (n,) [N, N m], also the computed-torque law. Paper eqs. (3), (7).
        forward: Q, Qdot, F, w -> Qddot (n,) [m/s^2, rad/s^2]. Paper eq. (3).
        momentum: Q, Qdot, w -> linear (x, y) [N s] and angular about the inertial origin [N m s], (3,). Paper eq. (4).
        kinetic_energy: Q, Qdot, w -> scalar [J].
    """

    H: ca.Function
    inverse: ca.Function
    forward: ca.Function
    momentum: ca.Function
    kinetic_energy: ca.Function


def derive_dynamics(placed: Placement, Q: ca.SX, w_size: int) -> Dynamics:
    """Derive the equations of motion of a robot placed at the symbols Q (n,), its bodies given by w (w_size,)."""
    n, w = Q.numel(), ca.SX.sym("w", w_size)
    Qdot, Qddot, F = (ca.SX.sym(name, n) for name in ("Qdot", "Qddot", "F"))
    bodies = bodies_at(placed, w)
    T, H = _kinetic_energy(bodies, Q, Qdot), _inertia(bodies, Q)
    bias = _coriolis(T, Q, Qdot)
    inverse = bias + ca.jtimes(ca.gradient(T, Qdot), Qdot, Qddot)
    motion = {"Q": Q, "Qdot": Qdot}
    return Dynamics(
        H=function("H", {"Q": Q, "w": w}, {"H": ca.densify(H)}),
        inverse=function("inverse", {**motion, "Qddot": Qddot, "w": w}, {"F": inverse}),
        forward=function("forward", {**motion, "F": F, "w": w}, {"Qddot": solve_spd(H, F - bias)}),
        momentum=function("momentum", {**motion, "w": w}, {"p": _momentum(bodies, Q, Qdot)}),
        kinetic_energy=function("kinetic_energy", {**motion, "w": w}, {"T": T}),
    )


def solve_spd(A: ca.SX, b: ca.SX) -> ca.SX:
    """Solve A x = b for symmetric positive definite A (n, n) by LDL', sparse: arms couple through the base alone."""
    D, LT, order = ca.ldl(A)
    return ca.ldl_solve(b, D, LT, order)


def function(name: str, inputs: Mapping[str, ca.SX], outputs: Mapping[str, ca.SX]) -> ca.Function:
    """Return a function with named inputs and outputs, common subexpressions computed once."""
    expressions = ca.cse(list(outputs.values()))
    return ca.Function(name, list(inputs.values()), expressions, list(inputs), list(outputs))


def _kinetic_energy(bodies: Sequence[Body], Q: ca.SX, Qdot: ca.SX) -> ca.SX:
    """Return T of all bodies, scalar [J]."""
    T = ca.SX(0)
    for body in bodies:
        v, omega = ca.jtimes(body.frame.position, Q, Qdot), ca.jtimes(body.frame.angle, Q, Qdot)
        T += (body.mass * ca.dot(v, v) + body.inertia * omega**2) / 2
    return T


def _inertia(bodies: Sequence[Body], Q: ca.SX) -> ca.SX:
    """Return H = d2T/dQdot2, (n, n).

    Velocities are linear in Qdot, so it is the sum of their squared Jacobians: fewer operations than to differentiate
    T twice.
    """
    H = ca.SX(Q.numel(), Q.numel())
    for body in bodies:
        J_v, J_w = ca.jacobian(body.frame.position, Q), ca.jacobian(body.frame.angle, Q)
        H += body.mass * J_v.T @ J_v + body.inertia * J_w.T @ J_w
    return ca.triu2symm(ca.triu(H))


def _coriolis(T: ca.SX, Q: ca.SX, Qdot: ca.SX) -> ca.SX:
    """Return C Qdot = Hdot Qdot - 1/2 d(Qdot' H Qdot)/dQ, (n,) [N, N m]; H Qdot = dT/dQdot. Below paper eq. (3)."""
    return ca.jtimes(ca.gradient(T, Qdot), Q, Qdot) - ca.gradient(T, Q)


def _momentum(bodies: Sequence[Body], Q: ca.SX, Qdot: ca.SX) -> ca.SX:
    """Return linear (x, y) [N s] and angular momentum about the inertial origin [N m s], (3,)."""
    linear, angular = ca.SX(0), ca.SX(0)
    for body in bodies:
        position, p = body.frame.position, body.mass * ca.jtimes(body.frame.position, Q, Qdot)
        linear += p
        angular += body.inertia * ca.jtimes(body.frame.angle, Q, Qdot) + position[0] * p[1] - position[1] * p[0]
    return ca.vertcat(linear, angular)
