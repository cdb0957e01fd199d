"""The controller's memory: what lasts from one sample to the next."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from psmpc_cli.control.estimator import Estimate
from psmpc_cli.control.fallback import PlansInForce
from psmpc_cli.control.identification.inertia import NO_INERTIA, InertiaEstimate
from psmpc_cli.control.identification.load import NO_LOAD, LoadEstimate, RobotAlone
from psmpc_cli.control.identification.tracking import NO_OBJECT, ObjectEstimate
from psmpc_cli.control.identification.wheels import WheelEstimate
from psmpc_cli.control.interface import NewTarget
from psmpc_cli.control.placement import Signs
from psmpc_cli.control.routes.guidance import RouteProgress
from psmpc_cli.control.sequence import GraspProgress, MovingSequence
from psmpc_cli.solvers import Solution


@dataclass(frozen=True, eq=False)
class Memory:
    """What lasts from one sample to the next.

    Attributes:
        sequence: The stages in the window.
        time: Of the last measurement [s].
        plans: The plans in force.
        solution: The last solve.
        levels: The last solutions of the levels of HTMPC.
        unfinished: A solve that ran out of iterations or time.
        estimate: What is known of the robot; None before the first measurement.
        target_object: What is known of an object that moves.
        load: What is known of its mass and moments; `NO_LOAD` where they are not to be found out.
        inertia: What is known of masses and inertias of the robot; `NO_INERTIA` where they are not to be found out.
        motion: Robot, and object in its hands, at the last sample; None where they are not needed.
        signs: Of the quaternions in spatial targets.
        arguments: Those of constraints that samples of the current stage set, by name.
        route: How far the robot has come on its routes.
        grasp: What grippers have reported, and what came of earlier tries.
        new_targets: Targets of stages that have changed since the last sample.
        wheels: What wheels store; None of a robot without any, and before the first sample.
    """

    sequence: MovingSequence
    time: float = -np.inf
    plans: PlansInForce = field(default_factory=PlansInForce)
    solution: Solution | None = None
    levels: tuple[Solution, ...] = ()
    unfinished: Solution | None = None
    estimate: Estimate | None = None
    target_object: ObjectEstimate = NO_OBJECT
    load: LoadEstimate = NO_LOAD
    inertia: InertiaEstimate = NO_INERTIA
    motion: RobotAlone | None = None
    signs: Signs = field(default_factory=dict)
    arguments: Mapping[str, np.ndarray] = field(default_factory=dict)
    route: RouteProgress = field(default_factory=RouteProgress)
    grasp: GraspProgress = field(default_factory=GraspProgress)
    new_targets: tuple[NewTarget, ...] = ()
    wheels: WheelEstimate | None = None

    def __repr__(self) -> str:
        return f"<Memory of {self.time:g} s: stages {self.sequence.first} to {self.sequence.last} in the window>"
