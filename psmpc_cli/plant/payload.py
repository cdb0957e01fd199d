"""What happens to a robot when its grippers close around an object at rest, and when they open again."""

from dataclasses import dataclass

import numpy as np

from psmpc_cli.robot.inertial import Inertials, WeighedRobot


@dataclass(frozen=True, eq=False)
class Contact:
    """What a take-up or a release does, all at once.

    Attributes:
        x: State after it (2n,).
        impulse: Momentum that the robot, with what it holds, gains by it (3,) [N s], [N m s].
        work: Kinetic energy that it gains by it [J].
    """

    x: np.ndarray
    impulse: np.ndarray
    work: float


def take_up(robot: WeighedRobot, x: np.ndarray, free: Inertials, holding: Inertials) -> Contact:
    """Return what comes of taking up an object at rest: H_holding Qdot+ = H_free Qdot-.

    The object brings no momentum, so generalized momentum stays. The energy lost is that of the velocities lost, by
    Carnot's theorem: 1/2 (Qdot- - Qdot+)' H_free (Qdot- - Qdot+) + 1/2 Qdot+' (H_holding - H_free) Qdot+.

    Args:
        robot: The equations of motion.
        x: State before (2n,).
        free: What the robot weighs with empty grippers.
        holding: What it weighs with the object in them.
    """
    n = len(x) // 2
    Q, before = x[:n], x[n:]
    H_free, H_holding = (np.asarray(robot.H(Q, weighed.vector)) for weighed in (free, holding))
    after = np.linalg.solve(H_holding, H_free @ before)
    lost = before - after
    loss = (lost @ H_free @ lost + after @ (H_holding - H_free) @ after) / 2
    return Contact(np.concatenate([Q, after]), np.zeros(3), -float(loss))


def let_go(robot: WeighedRobot, x: np.ndarray, free: Inertials, holding: Inertials) -> Contact:
    """Return what comes of letting go: velocities stay, and the object leaves with its momentum and energy."""
    (momentum, energy), (momentum_left, energy_left) = (
        (np.asarray(p).ravel(), float(T)) for p, T in (robot.kept(x, w.vector) for w in (holding, free))
    )
    return Contact(x, momentum_left - momentum, energy_left - energy)
