"""A base without thrusters moves as its momentum, or its mount, has it: equations at every node.

Free-floating: the momentum is that of the sample,

    h(Q, Qdot) = P_b(Q) Qdot_b + P_j(Q) Qdot_j = h,    so    Qdot_b = T Qdot_j + b,    T = -P_b^-1 P_j,  b = P_b^-1 h,

with the generalized Jacobian T of the base and its drift b. Umetani, Yoshida: Resolved motion rate control of space
manipulators with generalized Jacobian matrix (1989). Fixed: Qdot_b = 0.

The rows stand beside the double integrator of all coordinates, so windows, plans and meshes are those of every robot;
what u says of the base follows from them and costs nothing. The rows are linear in Qdot_b, and `sqp` solves them for it
after every step: left to the line search they do not hold, and it rejects steps (docs/decisions.md).
"""

from functools import partial

import casadi as ca
import numpy as np

from psmpc_cli.ocp.constraints.base import Constraint, ConstraintFunctions, rows_at_nodes
from psmpc_cli.ocp.loads import Load, LoadKind, known_load
from psmpc_cli.ocp.stage import ConstraintNumbers, SampleContext
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.task import TaskSpec


def numbers(task: TaskSpec, model: RobotModel, stage: int) -> ConstraintNumbers | None:
    """Return the bounds of the rows, and the momentum, which samples set; None for a base with thrusters."""
    moved_by = model.spec.moved_by
    if moved_by.actuated:
        return None
    none = np.zeros(model.space.n_twist)
    unknown = np.full(model.space.n_twist * moved_by.moves, np.nan)
    load = known_load(task, model, stage)
    return ConstraintNumbers(
        structure=load.kind,
        argument=unknown,
        low=none,
        high=none,
        at_sample=partial(_measured_momentum, load) if moved_by.moves else None,
        at_nodes=partial(_with_load, load.numbers) if moved_by.moves and load.kind.carries else None,
    )


def _measured_momentum(load: Load, model: RobotModel, sample: SampleContext) -> np.ndarray:
    """Return the momentum (n_twist,) of the robot and its load at a sample."""
    return np.asarray(load.kind.momentum(model)(sample.x, sample.anchor, load.numbers)).ravel()


def _with_load(load: np.ndarray, momentum: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Return the momentum, which stages share, with the numbers of a stage's load, at each time (N, numbers)."""
    return np.tile(np.concatenate([momentum, load]), (len(times), 1))


def functions(model: RobotModel, load: LoadKind) -> ConstraintFunctions:
    """Return x, [anchor; momentum; load] -> how much the momentum differs, or the rates of a base that stands still.

    A payload is at rest when it is taken and when it is let go, so the momentum of robot and payload stays throughout.
    """
    space = model.space
    x = ca.SX.sym("x", 2 * model.n)
    if not model.spec.moved_by.moves:
        anchor = ca.SX.sym("anchor", space.n_anchor)
        return ConstraintFunctions(x, anchor, x[model.n :][space.base], solved_for=space.base)
    sizes = np.cumsum([0, space.n_anchor, space.n_twist, load.count(model)]).tolist()
    argument = ca.SX.sym("argument", sizes[-1])
    anchor, h, numbers = ca.vertsplit(argument, sizes)
    rows = load.momentum(model)(x, anchor, numbers) - h
    return ConstraintFunctions(x, argument, rows, solved_for=space.base)


CONSTRAINT = Constraint(rows_at_nodes("mobility", functions), numbers)
