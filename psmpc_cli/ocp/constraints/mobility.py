"""A base that is not moved at will moves as momentum, or its mount, has it: equations in the stages in which it does.

Nothing pushes a free-floating base, and nothing turns it: the momentum of robot and load stays over every interval,

    h(Q, Qdot) = P_b(Q) Qdot_b + P_j(Q) Qdot_j,    h(Q+, Qdot+) = h(Q, Qdot),

so that Qdot_b = T Qdot_j + b, with the generalized Jacobian T = -P_b^-1 P_j of the base and its drift b = P_b^-1 h.
Umetani, Yoshida: Resolved motion rate control of space manipulators with generalized Jacobian matrix (1989). What
wheels store stays in a base that nothing turns, h_w, and h has R h_w besides, R the base's attitude. Of a base that
wheels turn the linear momentum stays. Fixed: Qdot_b = 0 at every node.

A stage begins with the velocities that the one before leaves, and so with its momentum: in the first node of a window,
that of the sample. What the grippers take at the beginning of a stage is as if it moved with them there.

The rows stand beside the double integrator of all coordinates, so windows, plans and meshes are those of every robot;
what u says of the base follows from them and costs nothing. The rows are linear in Qdot_b, and `sqp` solves them for it
after every step: left to the line search they do not hold, and it rejects steps (docs/decisions.md).
"""

from collections.abc import Iterator, Mapping

import casadi as ca
import numpy as np

from psmpc_cli.ocp.constraints.base import (
    Constraint,
    ConstraintFunctions,
    IntervalRows,
    NodeRows,
    named_for_stage,
    rows_at_nodes,
    rows_over_intervals,
    sampled_load,
)
from psmpc_cli.ocp.loads import LoadKind, known_load
from psmpc_cli.ocp.objective import ChangeFunctions
from psmpc_cli.ocp.stage import ConstraintNumbers
from psmpc_cli.ocp.window import WindowShape
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.task import TaskSpec


def base_equations(
    task: TaskSpec, model: RobotModel, stage: int
) -> ConstraintNumbers | Mapping[str, ConstraintNumbers] | None:
    """Return the equations for the velocities of a base that is not moved at will; None for one that thrusters move.

    A base on a mount stands still in every node. Of a free-floating one momentum is conserved over every interval: all
    of it, or, where wheels turn the base, the linear one. Nothing more than that decides how the base moves.

    Args:
        task: The task.
        model: The robot.
        stage: Index of the stage.
    """
    moved_by = task.moved_by(stage, model.spec)
    if moved_by.actuated:
        return None
    if not moved_by.moves:
        at_rest = np.zeros(model.space.n_twist)
        return ConstraintNumbers(structure="fixed", argument=np.zeros(0), low=at_rest, high=at_rest)
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


def _at_rest(model: RobotModel, structure: str) -> ConstraintFunctions:
    """Return x, anchor -> the rates of a base that stands still."""
    space = model.space
    x = ca.SX.sym("x", 2 * model.n)
    anchor = ca.SX.sym("anchor", space.n_anchor)
    return ConstraintFunctions(x, anchor, x[model.n :][space.base], solved_for=space.base)


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


_rows_of_mount = rows_at_nodes("mobility", _at_rest)
_rows_of_momentum = rows_over_intervals("mobility", momentum_changes, permanent=True, over_time=False)


def _rows(model: RobotModel, shape: WindowShape) -> Iterator[NodeRows | IntervalRows]:
    yield from (_rows_of_momentum if model.spec.moved_by.moves else _rows_of_mount)(model, shape)


CONSTRAINT = Constraint(_rows, base_equations)
