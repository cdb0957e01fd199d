"""What reaction wheels may store, at the nodes of the stages in which they turn the base.

While nothing thrusts the angular momentum L of everything about the inertial origin stays, so what wheels store
follows from the state at a node (ocp/loads.py). Each of them has its share, least in norm, and what it has of the part
that adds up to nothing, which motors leave (robot/actuators/wheels.py):

    h = A^+ h_w(x, L) + (I - A^+ A) h_now.

Its rows are h_i over the robot's moment of inertia about the axis of the wheel: turns of the whole robot that it makes
up for.
"""

from collections.abc import Mapping
from functools import partial

import casadi as ca
import numpy as np

from psmpc_cli.ocp.constraints.base import (
    Constraint,
    ConstraintFunctions,
    load_at_sample,
    named_for_stage,
    rows_at_nodes,
)
from psmpc_cli.ocp.constraints.forces import inertia
from psmpc_cli.ocp.loads import FOLLOWS, Load, LoadKind, known_load
from psmpc_cli.ocp.stage import ConstraintNumbers, SampleContext
from psmpc_cli.robot.actuators.wheels import Wheels
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.task import TaskSpec


def wheel_limits(
    task: TaskSpec, model: RobotModel, stage: int
) -> ConstraintNumbers | Mapping[str, ConstraintNumbers] | None:
    """Return the limits of what reaction wheels store in a stage as a constraint; None if they do not turn the base.

    Rows are the momenta of the wheels, each divided by the robot's moment of inertia about the axis of the wheel: rates
    of rotation [rad/s]. The argument is the numbers of the load, then a part of the momenta of the wheels that adds up
    to nothing on the base: more than three wheels have such a part, and motors leave it as it is.

    Args:
        task: The task.
        model: The robot.
        stage: Index of the stage.
    """
    load = known_load(task, model, stage)
    if load.stores != FOLLOWS:  # what wheels store does not follow from the motion: they do not turn the base
        return None
    wheels = Wheels.of(model.spec)
    largest = wheels.momentum * _scale(model, wheels)
    constraint = ConstraintNumbers(
        structure=load.kind,
        argument=np.concatenate([load.numbers, wheels.unseen @ wheels.initial]),
        low=-largest,
        high=largest,
        at_sample=partial(_argument, load),
    )
    return named_for_stage(stage, load, constraint)


def _argument(load: Load, model: RobotModel, sample: SampleContext) -> np.ndarray | None:
    """Return the numbers of the load at a sample, then the part of the momenta that motors leave."""
    if sample.unseen is None:
        return None
    return np.concatenate([load_at_sample(load, model, sample), sample.unseen])


def _scale(model: RobotModel, wheels: Wheels) -> np.ndarray:
    """Return 1 over the robot's moment of inertia about the axis of each wheel (W,), in the neutral posture."""
    about_base = inertia(model)[model.space.rotation]
    return np.asarray(1 / (about_base @ wheels.axes**2))


def wheel_momenta(model: RobotModel, load: LoadKind) -> ConstraintFunctions:
    """Return the scaled momenta of wheels (W,)."""
    wheels = Wheels.of(model.spec)
    x = ca.SX.sym("x", 2 * model.n)
    argument = ca.SX.sym("argument", model.space.n_anchor + load.count(model) + wheels.count)
    ends = [0, model.space.n_anchor, model.space.n_anchor + load.count(model), argument.numel()]
    anchor, of_load, unseen = ca.vertsplit(argument, ends)
    stored = load.momentum_of_wheels(model)(x, anchor, of_load)
    momenta = ca.DM(wheels.allocation) @ stored + unseen
    return ConstraintFunctions(x, argument, ca.DM(_scale(model, wheels)) * momenta, at_nodes=True)


CONSTRAINT = Constraint(rows_at_nodes("wheels", wheel_momenta), wheel_limits)
