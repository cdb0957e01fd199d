"""The functions of a stage that need a robot, with their derivatives; the rest of a window is arithmetic."""

from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np

from psmpc_cli.native.functions import compiled
from psmpc_cli.ocp.layout import StageShape
from psmpc_cli.ocp.skills import SKILLS
from psmpc_cli.robot.model import RobotModel


@dataclass(frozen=True, eq=False)
class StageTerms:
    """The functions of one stage, of SX and without state: they can be mapped over the nodes, saved and compiled.

    Attributes:
        cost: Q, W, reference, slope -> e'We, e'We_tau, e_tau'We_tau, E'We (n,), E'We_tau (n,) and the nonzeros of the
            upper triangle of E'WE; E is the derivative of the error e by Q, e_tau that by the stage's duration.
        error: Q, W, reference -> e'We alone.
        end: x, target -> rows h of the end condition, then the nonzeros of their derivative by x.
        end_rows: Number of those rows.
        hessian: Rows and columns of the triangle's nonzeros.
        end_derivatives: Rows and columns of the nonzeros of the derivative of h.
    """

    cost: ca.Function
    error: ca.Function
    end: ca.Function
    end_rows: int
    hessian: tuple[np.ndarray, np.ndarray]
    end_derivatives: tuple[np.ndarray, np.ndarray]


@lru_cache(maxsize=64)
def stage_terms(model: RobotModel, shape: StageShape, native: bool = False) -> StageTerms:
    """Return the functions of a stage of this shape, `native` ones as compiled C. Paper eqs. (10), (18)."""
    skill, n = SKILLS[shape.space], model.n
    rows = skill.rows(model)
    Q, Qdot, target = ca.SX.sym("Q", n), ca.SX.sym("Qdot", n), ca.SX.sym("target", rows)
    slope, W = ca.SX.sym("slope", rows), ca.SX.sym("W", rows)
    e = skill.error(model, Q, target)
    E, e_tau = ca.jacobian(e, Q), ca.jtimes(e, target, slope)
    L, H = ca.dot(W * e, e), ca.triu(E.T @ (ca.diag(W) @ E))
    by_duration = [ca.dot(W * e, e_tau), ca.dot(W * e_tau, e_tau)]
    by_position = [ca.densify(E.T @ (W * e)), ca.densify(E.T @ (W * e_tau)), _nonzeros(H)]
    end = _end_condition(model, shape, Q, Qdot, target)
    x = ca.vertcat(Q, Qdot)
    by_x = ca.jacobian(end, x)
    cost = ca.Function("cost", [Q, W, target, slope], ca.cse([L, *by_duration, *by_position]))
    error = ca.Function("error", [Q, W, target], ca.cse([L]))
    return StageTerms(
        cost=compiled(cost) if native else cost,
        error=compiled(error) if native else error,
        end=ca.Function("end", [x, target], ca.cse([ca.densify(end), _nonzeros(by_x)])),
        end_rows=end.shape[0],
        hessian=_places(H),
        end_derivatives=_places(by_x),
    )


def _end_condition(model: RobotModel, shape: StageShape, Q: ca.SX, Qdot: ca.SX, target: ca.SX) -> ca.SX:
    """Return the rows of the error the stage ends by, then of its rate where that counts."""
    skill, rows = SKILLS[shape.space], list(shape.end_rows)
    if not rows:
        return ca.SX(0, 1)
    end = skill.error(model, Q, target)[rows]
    return ca.vertcat(end, skill.rate(model, Q, Qdot)[rows]) if shape.end_velocity else end


def _nonzeros(matrix: ca.SX) -> ca.SX:
    """Return the nonzeros of a matrix as a column."""
    return matrix.nz[:] if matrix.nnz() else ca.SX(0, 1)


def _places(matrix: ca.SX) -> tuple[np.ndarray, np.ndarray]:
    """Return rows and columns of the nonzeros."""
    rows, columns = matrix.sparsity().get_triplet()
    return np.array(rows, int), np.array(columns, int)
