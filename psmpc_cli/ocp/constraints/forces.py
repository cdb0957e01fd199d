"""What thrusters and motors can give: limits of the generalized force, at both ends of every interval.

The force of the low-level law, paper eq. (7), for an acceleration u that is held over an interval of length h is

    F(Q, v, u) = H(Q) vdot(u) + c(Q, v),    u = (Qdot+ - Qdot) / h.

Its rows are h F, which have no 1 / h where intervals become short. Both c and what the chart adds to vdot are squares
of the velocities, so h F is the force in a time that runs slower by sqrt(h):

    h F(Q, v, u) = F(Q, sqrt(h) v, h u) = F(Q, sqrt(h) v, Qdot+ - Qdot).

They are divided by the diagonal of H, so that they are changes of velocities like the others of a program: left in
N s those of a heavy robot ask the interior-point method for digits that it does not have. The force of the base is
along its own axes, as thrusters are.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np

from psmpc_cli.ocp.constraints.base import Constraint, IntervalFunctions, rows_over_intervals, sampled_load
from psmpc_cli.ocp.loads import LoadKind, OwnMotion, known_load
from psmpc_cli.ocp.stage import ConstraintNumbers
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.robot import resolve_limits
from psmpc_cli.specs.task import TaskSpec


@dataclass(frozen=True)
class ForceStructure:
    """What decides the rows of forces beside the robot.

    Attributes:
        coordinates: The limited ones.
        load: What kind of load the grippers are known to hold; its masses and grasps are the argument of the rows.
    """

    coordinates: tuple[int, ...]
    load: LoadKind


def numbers(task: TaskSpec, model: RobotModel, stage: int) -> ConstraintNumbers | None:
    """Return which forces are limited in a stage, and their limits; None where none is."""
    skill = task.skills[task.stages[stage].skill]
    limits = resolve_limits(model.spec, task.limits, skill.limits, moved_by=task.moved_by(stage, model.spec))
    limited = np.isfinite(limits.force_low) | np.isfinite(limits.force_high)
    if not limited.any():
        return None
    load = known_load(task, model, stage)
    return ConstraintNumbers(
        structure=ForceStructure(tuple(np.flatnonzero(limited).tolist()), load.kind),
        argument=load.numbers,
        at_sample=sampled_load(task, load),
        low=np.tile((limits.force_low / inertia(model))[limited], 2),
        high=np.tile((limits.force_high / inertia(model))[limited], 2),
    )


def inertia(model: RobotModel) -> np.ndarray:
    """Return the diagonal of H in the neutral posture, (n,) [kg, kg m^2]."""
    return np.diag(model.mass_matrix(model.neutral))


def functions(model: RobotModel, structure: ForceStructure) -> IntervalFunctions:
    """Return the rows h F / H_ii of the limited coordinates, at the beginning and at the end of an interval."""
    n = model.n
    x = ca.SX.sym("x", 2 * n)
    dv = ca.SX.sym("dv", n)
    h = ca.SX.sym("h")
    argument = ca.SX.sym("argument", model.space.n_anchor + structure.load.count(model))
    anchor, numbers = ca.vertsplit(argument, [0, model.space.n_anchor, argument.numel()])
    load = structure.load
    coordinates = list(structure.coordinates)
    scale = 1 / inertia(model)[coordinates]
    motion = OwnMotion.in_chart(model.space, x[:n], ca.sqrt(h) * x[n:], dv, anchor)
    rows = load.own_force(model, motion, numbers)[coordinates] * scale

    def jacobian() -> ca.SX:
        F_by = load.own_force_jacobian(model, motion, numbers, by=ca.vertcat(x, dv, h))
        return ca.SX(ca.diag(scale) @ F_by[coordinates, :])

    return IntervalFunctions(x, dv, h, argument, rows, ends=(0, 1), jacobian=jacobian)


CONSTRAINT = Constraint(rows_over_intervals("forces", functions), numbers)
