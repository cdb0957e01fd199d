"""What thrusters and motors can give: limits of the generalized force, at both ends of every interval.

The force of the low-level law, paper eq. (7), for an acceleration u that is held over an interval of length h is

    F(Q, v, u) = H(Q) vdot(u) + c(Q, v),    u = (Qdot+ - Qdot) / h.

Its rows are h F, which have no 1 / h where intervals become short. Both c and what the chart adds to vdot are squares
of the velocities, so h F is the force in a time that runs slower by sqrt(h):

    h F(Q, v, u) = F(Q, sqrt(h) v, h u) = F(Q, sqrt(h) v, Qdot+ - Qdot).

They are divided by the diagonal of H, so that they are changes of velocities like the others of a program: left in
N s those of a heavy robot ask the interior-point method for digits that it does not have. The force of the base is
along its own axes, as thrusters and wheels are.

What thrusters can give is bounded by pairs of planes, low <= N F_base <= high (robot/actuators/thrusters.py). Each is
one more row, h N F_base, scaled so that the factors of F_i / H_ii are a unit vector. A limit of one component is the
case of a plane across one axis.

So are the torques of the motors of wheels that turn the base, -A^+ M, M the moment on the base
(robot/actuators/wheels.py). M has the gyroscopic moment omega x h_w of what wheels store in it, which is linear in h_w:
in the slower time it is that of sqrt(h) h_w.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from psmpc_cli.ocp.constraints.base import (
    Constraint,
    IntervalFunctions,
    named_for_stage,
    rows_over_intervals,
    sampled_load,
)
from psmpc_cli.ocp.constraints.plumes import PlumeForecast
from psmpc_cli.ocp.loads import Load, LoadKind, OwnMotion, known_load
from psmpc_cli.ocp.stage import ConstraintNumbers, SampleContext
from psmpc_cli.robot.actuators.thrusters import HalfSpaces, Thrusters, no_half_spaces
from psmpc_cli.robot.actuators.wheels import Wheels
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.parts import MobilityTraits
from psmpc_cli.specs.robots.robot import resolve_limits
from psmpc_cli.specs.task import TaskSpec


@dataclass(frozen=True)
class ForceStructure:
    """What decides the rows of forces beside the robot.

    Attributes:
        coordinates: The limited ones.
        load: What kind of load the grippers are known to hold; its masses and grasps are the argument of the rows.
        combinations: Factors of the base's components of further rows, those of thrusters or of wheels.
    """

    coordinates: tuple[int, ...]
    load: LoadKind
    combinations: tuple[tuple[float, ...], ...] = ()


def force_limits(
    task: TaskSpec, model: RobotModel, stage: int
) -> ConstraintNumbers | Mapping[str, ConstraintNumbers] | None:
    """Return the limits of what thrusters, wheels and motors give in a stage as a constraint; None if there are none.

    Its rows are generalized forces divided by inertias: first those of coordinates with a limit of their own, then the
    combinations of base forces that thrusters or wheels bound together. Each is limited at both ends of an interval.
    Unloading wheels means to take momentum out of them; thrusters balance the torque of that, so all limits of forces
    of the base are nearer to 0 by that much.

    Args:
        task: The task.
        model: The robot.
        stage: Index of the stage.

    Returns:
        The constraint, under its stage's own name where samples set what wheels store or which thrusters are shut.

    Raises:
        InputError: The robot's thrusters would take too many rows.
    """
    skill = task.skills[task.stages[stage].skill]
    moved_by = task.moved_by(stage, model.spec)
    limits = resolve_limits(model.spec, task.limits, skill.limits, moved_by=moved_by)
    is_limited = np.isfinite(limits.force_low) | np.isfinite(limits.force_high)
    actuator_bounds = _forces_of_actuators(model, moved_by)
    plumes = PlumeForecast.of(task, model, stage) if task.avoids_plumes(stage, model.spec) else None
    row_count = int(is_limited.sum()) + len(actuator_bounds.normals)
    if row_count == 0:
        return None
    load = known_load(task, model, stage)
    unloading = np.zeros(model.n)  # force that balances what unloads wheels, by coordinate
    if moved_by.is_pushed:
        unloading[model.space.base] = _largest_unloading(model, np.eye(model.space.n_twist))
    force_low = np.minimum(limits.force_low + unloading, 0.0) / inertia(model)
    force_high = np.maximum(limits.force_high - unloading, 0.0) / inertia(model)
    low = np.r_[force_low[is_limited], actuator_bounds.low]
    high = np.r_[force_high[is_limited], actuator_bounds.high]
    constraint = ConstraintNumbers(
        structure=ForceStructure(
            coordinates=tuple(np.flatnonzero(is_limited).tolist()),
            load=load.kind,
            combinations=tuple(map(tuple, actuator_bounds.normals.tolist())),
        ),
        argument=load.numbers,
        at_sample=sampled_load(load),
        low=np.tile(low, 2),  # at the beginning and at the end of an interval
        high=np.tile(high, 2),
    )
    if plumes is not None:
        constraint = _tighter_where_plumes_reach(plumes, model, load, constraint)
    return named_for_stage(stage, load, constraint)


def _tighter_where_plumes_reach(
    plumes: PlumeForecast, model: RobotModel, load: Load, constraint: ConstraintNumbers
) -> ConstraintNumbers:
    """Return the limits of forces of a stage, tighter where thrusters are shut because their plumes would reach a body.

    The set of forces that thrusters can give is bounded by pairs of planes. With some thrusters shut the planes keep
    their normals and come nearer to each other: the rows stay the same functions, and only their bounds change. Which
    thrusters are shut is forecast at every sample along the plan in force. The forecast is appended to the argument of
    the constraint, from which the bounds over each interval are computed; the functions of the rows do not take it.

    Args:
        plumes: How to forecast which thrusters are shut.
        model: The robot.
        load: What the grippers are known to hold; its numbers are the rest of the argument.
        constraint: The limits with all thrusters.

    Returns:
        `constraint` with a longer argument, set at each sample, and with bounds for each interval.
    """
    normals = _forces_of_thrusters(model).normals
    unloading = _largest_unloading(model, normals)
    # The rows come twice, for the force at the beginning and at the end of an interval.
    rows_at_begin, rows_at_end = np.split(np.arange(len(constraint.low)), 2)

    def at_sample(model: RobotModel, sample: SampleContext) -> np.ndarray | None:
        numbers = load.numbers if constraint.at_sample is None else constraint.at_sample(model, sample)
        return None if numbers is None else np.concatenate([numbers, plumes.numbers(model, sample)])

    def over_intervals(numbers: np.ndarray, since: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        interval_count = len(since) - 1
        low = np.tile(constraint.low, (interval_count, 1))
        high = np.tile(constraint.high, (interval_count, 1))
        low_of_thrusters, high_of_thrusters = plumes.bounds(normals, unloading, numbers, since)
        for rows in (rows_at_begin, rows_at_end):
            rows_of_thrusters = rows[len(rows) - len(normals) :]  # they follow those of single coordinates
            low[:, rows_of_thrusters] = low_of_thrusters
            high[:, rows_of_thrusters] = high_of_thrusters
        return low, high

    return replace(
        constraint,
        argument=np.full(len(load.numbers) + plumes.size, np.nan),
        at_sample=at_sample,
        for_bounds=plumes.size,
        over_intervals=over_intervals,
    )


def inertia(model: RobotModel) -> np.ndarray:
    """Return the diagonal of H in the neutral posture, (n,) [kg, kg m^2]."""
    return np.diag(model.mass_matrix(model.neutral))


def _forces_of_thrusters(model: RobotModel) -> HalfSpaces:
    """Return what thrusters can give as bounds of rows N F_base, scaled; without thrusters there are none."""

    def build() -> HalfSpaces:
        if not model.spec.thrusters:
            return no_half_spaces(model.space.n_twist)
        return _with_unit_normals(model, Thrusters.of(model.spec.thrusters).half_spaces)

    return model.cached(_forces_of_thrusters, build)


def _forces_of_actuators(model: RobotModel, moved_by: MobilityTraits) -> HalfSpaces:
    """Return the forces on the base that its actuators can give together in a stage, as half-spaces.

    They are low <= N F_base <= high with one row of N for each bound, scaled by the robot's inertia so that the rows
    are comparable to changes of velocity. Thrusters keep back the force that balances the unloading of wheels, which
    takes momentum out of them. Wheels bound moments alone: each gives its share of the moment, up to its motor's
    torque.

    Args:
        model: The robot.
        moved_by: What moves the base in the stage: thrusters, wheels, or nothing.

    Returns:
        Normals N (rows, n_twist), low and high (rows,); without rows where neither thrusters nor wheels act.
    """
    if moved_by.is_pushed:
        by_thrusters = _forces_of_thrusters(model)
        unloading = _largest_unloading(model, by_thrusters.normals)
        return HalfSpaces(
            by_thrusters.normals,
            low=np.minimum(by_thrusters.low + unloading, 0.0),  # no force at all stays possible
            high=np.maximum(by_thrusters.high - unloading, 0.0),
        )
    wheels = Wheels.of(model.spec)
    wheels_act = moved_by.is_turned and wheels.count > 0
    if not wheels_act:
        return no_half_spaces(model.space.n_twist)
    # The torques of the motors are -A^+ M, M the moment on the base and A^+ the allocation.
    normals = np.hstack([np.zeros((wheels.count, model.dimension)), -wheels.allocation])
    return _with_unit_normals(model, HalfSpaces(normals, low=-wheels.torque, high=wheels.torque))


def _with_unit_normals(model: RobotModel, wrenches: HalfSpaces) -> HalfSpaces:
    """Return the same half-spaces with normals whose factors of F_i / H_ii are a unit vector."""
    length = np.linalg.norm(wrenches.normals * inertia(model)[model.space.base], axis=1)
    return HalfSpaces(wrenches.normals / length[:, None], wrenches.low / length, wrenches.high / length)


def _largest_unloading(model: RobotModel, normals: np.ndarray) -> np.ndarray:
    """Return by how much the unloading of wheels may change combinations of the force on the base (K,), at most."""
    wheels = Wheels.of(model.spec)
    return np.asarray(np.abs(normals[:, model.space.rotation] @ wheels.axes) @ wheels.unloading)


def force_rows(model: RobotModel, structure: ForceStructure) -> IntervalFunctions:
    """Return the rows of limited forces, at the beginning and at the end of an interval.

    They are h F / H_ii of the limited coordinates, then h N F_base of the combinations N that thrusters or wheels
    bound. F is the computed torque of an acceleration u that is held over an interval of length h, paper eq. (7). With
    the factor h the rows have no 1 / h where intervals become short: F is linear in u and quadratic in v, so

        h F(Q, v, u) = F(Q, sqrt(h) v, h u),    h u = dv, the change of velocity over the interval.

    Args:
        model: The robot.
        structure: Which coordinates and combinations, and the kind of load that the grippers hold.

    Returns:
        Functions of x, dv, h and [anchor of the chart; numbers of the load]; twice the rows, for `ends` 0 and 1.
    """
    n = model.n
    x = ca.SX.sym("x", 2 * n)
    dv = ca.SX.sym("dv", n)
    h = ca.SX.sym("h")
    argument = ca.SX.sym("argument", model.space.n_anchor + structure.load.count(model))
    # The anchor is the attitude about which the window's coordinates are a chart; numbers are those of the load.
    anchor, numbers = ca.vertsplit(argument, [0, model.space.n_anchor, argument.numel()])
    load = structure.load
    coordinates = list(structure.coordinates)
    scale = 1 / inertia(model)[coordinates]
    normals = np.array(structure.combinations).reshape(-1, model.space.n_twist)
    combinations = ca.sparsify(ca.DM(normals))
    stored = ca.sqrt(h) * load.momentum_of_wheels(model)(x, anchor, numbers) if load.stores else None
    motion = OwnMotion.in_chart(model, x[:n], ca.sqrt(h) * x[n:], dv, anchor, stored)
    F = load.own_force(model, motion, numbers)
    rows = ca.vertcat(F[coordinates] * scale, combinations @ F[model.space.base])

    def jacobian() -> ca.SX:
        # shorter than what CasADi derives from the rows; `rows` again, with derivatives of F in the place of F
        F_by = load.own_force_jacobian(model, motion, numbers, by=ca.vertcat(x, dv, h))
        return ca.SX(ca.vertcat(ca.diag(scale) @ F_by[coordinates, :], combinations @ F_by[model.space.base, :]))

    return IntervalFunctions(x, dv, h, argument, rows, ends=(0, 1), jacobian=jacobian)


CONSTRAINT = Constraint(rows_over_intervals("forces", force_rows), force_limits)
