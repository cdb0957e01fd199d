"""The robot seen from its poses xi, as expressions: task-space inertia and nonlinear terms, and the damped inverse."""

import casadi as ca

from psmpc_cli.robot.dynamics import solve_spd


def task_dynamics(H: ca.SX, C_Qdot: ca.SX, J_C: ca.SX, Jdot_Qdot: ca.SX) -> tuple[ca.SX, ca.SX]:
    """H_x (m, m) and C_x (m,) for square J_C. Paper eq. (6), with the dot its C_x lacks.

    H_x = J_C^-T H J_C^-1, C_x = J_C^-T C Qdot - H_x Jdot_C Qdot.
    """
    inverse = ca.solve(J_C, ca.SX.eye(J_C.shape[0]))
    H_x = inverse.T @ H @ inverse
    return H_x, inverse.T @ C_Qdot - H_x @ Jdot_Qdot


def damped_acceleration(J_C: ca.SX, Jdot_Qdot: ca.SX, u: ca.SX, damping: float) -> ca.SX:
    """Qddot (n,) that makes the poses accelerate with u (m,), by the damped inverse of J_C (m, n).

    Solves (J_C' J_C + damping^2 I) Qddot = J_C' (u - Jdot_C Qdot), which is defined at singular J_C too.
    """
    normal = J_C.T @ J_C + damping**2 * ca.SX.eye(J_C.shape[1])
    return solve_spd(normal, J_C.T @ (u - Jdot_Qdot))
