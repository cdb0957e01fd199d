"""What a stage is made of, as CasADi functions: step, cost and end condition."""

from dataclasses import dataclass

import casadi as ca

from psmpc_cli.ocp.discretization import step_function
from psmpc_cli.ocp.layout import StageShape
from psmpc_cli.ocp.skills import SKILLS
from psmpc_cli.ocp.skills.base import quadratic_cost
from psmpc_cli.robot.model import RobotModel


@dataclass(frozen=True, eq=False)
class StageFunctions:
    """A stage's step, cost and end condition as CasADi functions."""

    step: ca.Function  # x, u, dt -> x_next
    cost: ca.Function  # x, u, target, weights, control_weights -> Lbar
    end: ca.Function  # x, target -> end rows of the error, then of its rate


def stage_functions(model: RobotModel, shape: StageShape, discretization: str) -> StageFunctions:
    """Return the functions a stage of this shape is made of."""
    skill = SKILLS[shape.space]
    x, target = ca.SX.sym("x", 2 * model.n), ca.SX.sym("target", skill.rows(model))
    u = ca.SX.sym("u", model.n if shape.input == "joint" else model.m)
    W, W_r = ca.SX.sym("W", target.shape[0]), ca.SX.sym("W_r", u.shape[0])
    Q, Qdot = x[: model.n], x[model.n :]
    error = skill.error(model, Q, target)
    rows = list(shape.end_rows)
    end = error[rows] if rows else ca.SX(0, 1)
    if shape.end_velocity:
        end = ca.vertcat(end, skill.rate(model, Q, Qdot)[rows])
    return StageFunctions(
        step=step_function(model, shape.input, discretization),
        cost=ca.Function("Lbar", [x, u, target, W, W_r], [quadratic_cost(error, u, W, W_r)]),
        end=ca.Function("h", [x, target], [end]),
    )
