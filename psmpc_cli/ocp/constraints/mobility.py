"""A base that is not moved at will moves as momentum has it: equations in the stages in which it does.

Nothing pushes a free-floating base, and nothing turns it: the momentum of robot and load stays over every interval,

    h(Q, Qdot) = P_b(Q) Qdot_b + P_j(Q) Qdot_j,    h(Q+, Qdot+) = h(Q, Qdot),

so that Qdot_b = T Qdot_j + b, with the generalized Jacobian T = -P_b^-1 P_j of the base and its drift b = P_b^-1 h.
Umetani, Yoshida: Resolved motion rate control of space manipulators with generalized Jacobian matrix (1989). What
wheels store stays in a base that nothing turns, h_w, and h has R h_w besides, R the base's attitude. Of a base that
wheels turn the linear momentum stays. A base that is fixed is that of `mount`.

A stage begins with the velocities that the one before leaves, and so with its momentum: in the first node of a window,
that of the sample. What the grippers take at the beginning of a stage is as if it moved with them there.

The rows stand beside the double integrator of all coordinates, so windows, plans and meshes are those of every robot;
what u says of the base follows from them and costs nothing. The rows are linear in Qdot_b, and `sqp` solves them for it
after every step: left to the line search they do not hold, and it rejects steps (docs/decisions.md).
"""

from collections.abc import Mapping

import casadi as ca
import numpy as np

from psmpc_cli.ocp.constraints.base import (
    Constraint,
    ConstraintFunctions,
    named_for_stage,
    rows_over_intervals,
    sampled_load,
)
from psmpc_cli.ocp.loads import LoadKind, known_load
from psmpc_cli.ocp.objective import ChangeFunctions
from psmpc_cli.ocp.stage import ConstraintNumbers
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.task import TaskSpec


def conserved_momentum(
    task: TaskSpec, model: RobotModel, stage: int
) -> ConstraintNumbers | Mapping[str, ConstraintNumbers] | None:
    """Return the constraint that momentum is conserved in a stage; None if thrusters push the base or a mount holds it.

    It decides how a free-floating base moves when the arms do. Its rows are changes of the momentum of robot and load
    over an interval, all of them 0: of linear and angular momentum, or, where wheels turn the base, of the linear
    momentum alone.

    Args:
        task: The task.
        model: The robot.
        stage: Index of the stage.

    Returns:
        The constraint; its argument is the numbers of the load that grippers are known to hold.
    """
    moved_by = task.moved_by(stage, model.spec)
    if not moved_by.reacts:
        return None
    load = known_load(task, model, stage)
    if moved_by.is_turned:
        load = load.without_wheels  # what they store has no part in the linear momentum
    no_change = np.zeros(len(_conserved(model, load.kind)))
    constraint = ConstraintNumbers(
        structure=load.kind,
        argument=load.numbers,
        low=no_change,
        high=no_change,
        at_sample=sampled_load(load),
    )
    return named_for_stage(stage, load, constraint)


def _conserved(model: RobotModel, load: LoadKind) -> list[int]:
    """Return which components of the momentum are conserved: those along which nothing acts on the base."""
    return np.flatnonzero(np.equal(load.driven or model.driven(), 0)).tolist()


def momentum_changes(model: RobotModel, load: LoadKind) -> ChangeFunctions:
    """Return by how much the momentum of robot and load changes over an interval.

    A payload is at rest when it is taken and when it is let go, so the momentum of robot and payload stays throughout.
    """
    space = model.space
    conserved = _conserved(model, load)
    x = ca.SX.sym("x", 2 * model.n)
    argument = ca.SX.sym("argument", space.n_anchor + load.count(model))
    anchor, of_load = ca.vertsplit(argument, [0, space.n_anchor, argument.numel()])
    rows = load.momentum(model)(x, anchor, of_load)[conserved]
    return ChangeFunctions(ConstraintFunctions(x, argument, rows, solved_for=slice(conserved[0], conserved[-1] + 1)))


CONSTRAINT = Constraint(
    rows_over_intervals("mobility", momentum_changes, permanent=True, over_time=False), conserved_momentum
)
