"""Hands that hold one body keep their relative pose, in a soft band about the one in which they closed."""

from collections.abc import Iterator
from functools import partial
from typing import Any

import casadi as ca
import numpy as np

from psmpc_cli.ocp.constraints.base import ConstraintFunctions, NodeRows
from psmpc_cli.ocp.plan import Grid
from psmpc_cli.ocp.window import Parameters, Window, WindowShape
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.robot.rotations import add, conjugate, product, rotate, scaled


def HANDS(model: RobotModel, shape: WindowShape) -> Iterator[NodeRows]:
    """Yield the rows of every stage in which several grippers hold the object, at its nodes after the first.

    At its first node the grippers close, wherever the end condition of the stage before has them.
    """
    first_node = Grid(model.n, shape.nodes).first_node
    for s, stage in enumerate(shape.stages):
        if stage.hands:
            yield NodeRows(
                name="hands",
                nodes=range(int(first_node[s]) + 1, int(first_node[s + 1]) + 1),
                functions=model.owned(("hands", stage.hands), partial(_functions, model, stage.hands)),
                argument=partial(_relative, s),
                bounds=partial(_bounds, s),
                soft=True,
            )


def _functions(model: RobotModel, grippers: tuple[str, ...]) -> ConstraintFunctions:
    """Return x, [anchor; relative poses as closed] -> by how much the relative poses differ from them.

    With the poses (p_0, q_0) of the first gripper, (p, q) of another one, and (r, q_r) of that in the frame of the
    first as they closed, the rows are R_0' (p - p_0) - r, and twice the vector of the quaternion q_r* q_0* q: the
    rotation vector but for the third power of its angle, and smooth.
    """
    space = model.space
    others = len(grippers) - 1
    x = ca.SX.sym("x", 2 * model.n)
    argument = ca.SX.sym("argument", space.n_anchor + others * space.n_pose)
    xi = model.charted(x[: model.n], argument[: space.n_anchor])
    poses = [space.lifted(ca.vertsplit(xi[model.pose_rows[gripper]])) for gripper in grippers]
    (p_0, q_0), *_ = poses
    rows = list[ca.SX]()
    for i, (p, q) in enumerate(poses[1:]):
        first = space.n_anchor + i * space.n_pose
        r, q_r = space.lifted(ca.vertsplit(argument[first : first + space.n_pose]))
        moved = add(rotate(conjugate(q_0), add(p, scaled(p_0, -1))), scaled(r, -1))
        turned = product(conjugate(q_r), product(conjugate(q_0), q))
        rows += space.twist(moved, scaled(turned[1:], 2))
    return ConstraintFunctions(x, argument, ca.vertcat(*rows))


def _relative(s: int, p: Parameters[Any]) -> Any:
    return p.hands[s]


def _bounds(s: int, window: Window) -> tuple[np.ndarray, np.ndarray]:
    band = window.stages[s].hands.band
    return -band, band
