"""A base that a mount holds in some stages and lets go in others.

While it is held the robot is the same one with a fixed base, with the equations of motion and the low-level law of
that. So a plant of each kind advances the ticks that are its own.

What velocity the base has left when the mount closes is lost in a blow, as that of a latch. With the rows of base and
joints of the mass matrix the velocities then change by

    dv_b = -v_b,    H_jb dv_b + H_jj dv_j = 0,

since the blow acts on the base alone. Its impulse and its work are among those of the sample.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from psmpc_cli.plant.base import Disturbance, Plant, Setpoints, Ticks
from psmpc_cli.plant.thrusters import ThrusterFiring
from psmpc_cli.robot.model import RobotModel


class MountedPlant:
    """A plant of a robot whose base a mount holds at some ticks.

    Args:
        model: The robot.
        moving: Its plant while the base moves.
        held: That of the same robot with a fixed base.
        firing: Its thrusters, which are off while the base is held; None without any.
    """

    def __init__(self, model: RobotModel, moving: Plant, held: Plant, firing: ThrusterFiring | None) -> None:
        self.model = model
        self.moving = moving
        self.held = held
        self.firing = firing

    def advance(
        self, start: float, state: np.ndarray, setpoints: Setpoints, disturbance: Disturbance | None = None
    ) -> Ticks:
        """Advance over one sample, up to each tick at which the mount closes or opens; see `Plant.advance`."""
        is_held = setpoints.base_is_held
        if not is_held.any():
            return self.moving.advance(start, state, setpoints, disturbance)
        changes = np.flatnonzero(np.diff(is_held)) + 1
        edges = [0, *changes.tolist(), len(is_held)]
        parts: list[Ticks] = []
        for first, last in pairwise(edges):
            ticks = slice(first, last)
            part = setpoints.part(ticks)
            of_part = None if disturbance is None else disturbance.part(ticks)
            begins = start if not parts else float(parts[-1].time[-1])
            state = state if not parts else parts[-1].states[-1]
            if is_held[first]:
                parts.append(self._hold(begins, state, part, of_part))
            else:
                parts.append(self.moving.advance(begins, state, part, of_part))
        return Ticks.joined(parts)

    def _hold(self, start: float, state: np.ndarray, setpoints: Setpoints, disturbance: Disturbance | None) -> Ticks:
        """Advance with the base held, which comes to rest at the beginning if it is not."""
        model = self.model
        robot = model.nominal if disturbance is None else disturbance.robot
        Q, v = np.split(state, [model.nq])
        base = model.space.base
        joints = model.space.joint_rates
        H = model.mass_matrix(Q, robot)
        after = v.copy()
        after[base] = 0.0
        after[joints] += np.linalg.solve(H[joints, joints], H[joints, base] @ v[base])
        blow = model.balance(Q, after, robot) - model.balance(Q, v, robot)
        of_joints = replace(setpoints, driven=None, shut=None)
        ticks = self.held.advance(start, np.concatenate([Q, after]), of_joints, disturbance)
        thrusters = None
        if self.firing is not None:
            self.firing.begin_sample(setpoints.shut)
            self.firing.pass_ticks(np.zeros((len(setpoints.u), model.space.n_twist)), is_pushed=False)
            thrusters = self.firing.end_sample()
        states = np.vstack([state, ticks.states[1:]])
        return replace(ticks, states=states, impulse_and_work=ticks.impulse_and_work + blow, thrusters=thrusters)
