"""Hands that hold one body keep their relative pose: soft rows keep their relative velocity near 0.

The rows are velocities, not displacements within a band: there plans may turn round at every node, and the closed
chain, which keeps the hands together at every tick, turns what they leave out into rates of joints. Where arms are
nearly stretched a millimetre per second of the hands is a tenth of a radian per second of a joint.
"""

from functools import partial

import casadi as ca
import numpy as np

from psmpc_cli.ocp.constraints.base import Constraint, ConstraintFunctions, rows_at_nodes
from psmpc_cli.ocp.stage import ConstraintNumbers, SampleContext
from psmpc_cli.robot.configuration import space_of_pose
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.robot.rotations import add, conjugate, product, rotate, scaled
from psmpc_cli.specs.task import TaskSpec


def hand_limits(task: TaskSpec, model: RobotModel, stage: int) -> ConstraintNumbers | None:
    """Return the constraint that hands which hold one object keep their relative pose; None if less than two hold it.

    Its rows are the velocities of each other hand relative to the first [m/s, rad/s]. Grasps give way a little, by
    `half_widths` (displacement [m], angle [rad]): a velocity at its bound takes a whole horizon for that. The argument
    is the pose of each other hand in the frame of the first, as the task has it, and from each sample on as measured.

    Args:
        task: The task.
        model: The robot.
        stage: Index of the stage.
    """
    grasp = task.body.grasp
    if stage not in task.held_stages or len(grasp.at) < 2:
        return None
    first, *others = grasp.at.values()
    space = space_of_pose(len(first))
    displacement, angle = grasp.half_widths
    most = np.full(space.n_twist, displacement)
    most[space.rotation] = angle
    largest_rates = np.tile(most / task.controller.horizon, len(others))
    grippers = tuple(grasp.at)
    return ConstraintNumbers(
        structure=grippers,
        argument=np.concatenate([space.relative(other, first) for other in others]),
        low=-largest_rates,
        high=largest_rates,
        at_sample=partial(_relative_poses, grippers),
    )


def _relative_poses(grippers: tuple[str, ...], model: RobotModel, sample: SampleContext) -> np.ndarray | None:
    """Return the poses of the others in the frame of the first gripper, one after the other, (others n_pose,)."""
    if not sample.is_current:
        return None
    xi = np.asarray(model.charted(sample.x[: model.n], sample.anchor)).ravel()
    first, *others = (xi[model.pose_rows[gripper]] for gripper in grippers)
    return np.concatenate([model.space.relative(other, first) for other in others])


def hand_rates(model: RobotModel, grippers: tuple[str, ...]) -> ConstraintFunctions:
    """Return x, [anchor; relative poses at the sample] -> the velocities of the other hands relative to the first.

    Let (p_0, q_0) be the pose of the first gripper, R_0 its rotation matrix, (p, q) the pose of another gripper, and
    (r, q_r) the pose of that one in the frame of the first at the sample. The rows are the rates of the displacement
    R_0' (p - p_0) - r and of twice the vector part of the quaternion q_r* q_0* q. The latter differs from the rotation
    vector only in the third power of its angle, and is smooth.

    Args:
        model: The robot.
        grippers: The arms that hold the object; velocities are relative to the hand of the first.

    Returns:
        Rows [m/s, rad/s], n_twist for each of the other grippers.
    """
    space = model.space
    others = len(grippers) - 1
    x = ca.SX.sym("x", 2 * model.n)
    argument = ca.SX.sym("argument", space.n_anchor + others * space.n_pose)
    xi = model.charted(x[: model.n], argument[: space.n_anchor])  # poses of all frames
    poses = [space.to_3d(ca.vertsplit(xi[model.pose_rows[gripper]])) for gripper in grippers]
    (p_0, q_0), *_ = poses
    displacements = list[ca.SX]()
    for i, (p, q) in enumerate(poses[1:]):
        first = space.n_anchor + i * space.n_pose
        r, q_r = space.to_3d(ca.vertsplit(argument[first : first + space.n_pose]))
        moved = add(rotate(conjugate(q_0), add(p, scaled(p_0, -1))), scaled(r, -1))
        turned = product(conjugate(q_r), product(conjugate(q_0), q))
        displacements += space.twist(moved, scaled(turned[1:], 2))
    rates = ca.jtimes(ca.vertcat(*displacements), x[: model.n], x[model.n :])  # d/dQ times Qdot
    return ConstraintFunctions(x, argument, rates, has_curvature=False)


CONSTRAINT = Constraint(rows_at_nodes("hands", hand_rates, soft=lambda grippers: True), hand_limits)
