"""A base that a mount holds does not move: Qdot_b = 0 at every node of the stage.

The mount may hold it in all stages, or close at the end of a stage that leaves it at rest. Where it closes the rows of
the stage before count, and with them its end condition: the base then is as much at rest as that asks for.

Beside the double integrator of all coordinates the rows are equations, as those in `mobility`. `sqp` solves them for
the rates of the base after every step.
"""

import casadi as ca
import numpy as np

from psmpc_cli.ocp.constraints.base import Constraint, ConstraintFunctions, rows_at_nodes
from psmpc_cli.ocp.stage import ConstraintNumbers
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.task import TaskSpec


def numbers(task: TaskSpec, model: RobotModel, stage: int) -> ConstraintNumbers | None:
    """Return the rates of a base that a mount holds in a stage, all 0; None for a base that moves."""
    if task.moved_by(stage, model.spec).moves:
        return None
    none = np.zeros(model.space.n_twist)
    return ConstraintNumbers(structure="fixed", argument=np.zeros(0), low=none, high=none)


def functions(model: RobotModel, structure: str) -> ConstraintFunctions:
    """Return x, anchor -> the rates of the base."""
    space = model.space
    x = ca.SX.sym("x", 2 * model.n)
    anchor = ca.SX.sym("anchor", space.n_anchor)
    return ConstraintFunctions(x, anchor, x[model.n :][space.base], solved_for=space.base)


CONSTRAINT = Constraint(rows_at_nodes("mount", functions), numbers)
