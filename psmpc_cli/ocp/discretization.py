"""One interval of the dynamics: exact for the double integrator (8), Euler as printed, RK4 for task-space input."""

import casadi as ca

from psmpc_cli.robot.model import RobotModel


def exact(model: RobotModel, x: ca.SX, u: ca.SX, dt: ca.SX) -> ca.SX:
    """Return x after dt under constant Qddot = u: Q + dt Qdot + dt^2/2 u, Qdot + dt u."""
    Q, Qdot = x[: model.n], x[model.n :]
    return ca.vertcat(Q + dt * Qdot + dt**2 / 2 * u, Qdot + dt * u)


def euler(model: RobotModel, x: ca.SX, u: ca.SX, dt: ca.SX) -> ca.SX:
    """Return x + f_1(x, u) dt. Paper eq. (20)."""
    return x + dt * model.f_1(x, u)


def rk4_task_input(model: RobotModel, x: ca.SX, u: ca.SX, dt: ca.SX) -> ca.SX:
    """Return x after one classical Runge-Kutta step of f_2, u the acceleration of xi."""
    k1 = model.f_2(x, u)
    k2 = model.f_2(x + dt / 2 * k1, u)
    k3 = model.f_2(x + dt / 2 * k2, u)
    k4 = model.f_2(x + dt * k3, u)
    return x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def step_function(model: RobotModel, stage_input: str, discretization: str) -> ca.Function:
    """Return F: x (2n,), u, dt -> x_next (2n,)."""
    x, dt = ca.SX.sym("x", 2 * model.n), ca.SX.sym("dt")
    u = ca.SX.sym("u", model.n if stage_input == "joint" else model.m)
    if stage_input == "task":
        after = x + dt * model.f_2(x, u) if discretization == "euler" else rk4_task_input(model, x, u, dt)
    else:
        after = (euler if discretization == "euler" else exact)(model, x, u, dt)
    return ca.Function("F", [x, u, dt], [after], ["x", "u", "dt"], ["x_next"])
