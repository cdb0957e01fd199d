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
        """Advance over one sample, part by part: between ticks at which the mount closes or opens.

        Each part is advanced by the plant that is its own, that of the held base or that of the moving base.

        Args:
            start: When the sample begins [s].
            state: State [Q; v] when it begins (nq + n,).
            setpoints: What is commanded at its M ticks, and at which of them the mount holds the base.
            disturbance: What the controller does not know; None: nothing.

        Returns:
            What happened at each tick of the sample.
        """
        is_held = setpoints.base_is_held
        if not is_held.any():
            return self.moving.advance(start, state, setpoints, disturbance)
        changes = np.flatnonzero(np.diff(is_held)) + 1  # first ticks of the parts but the first
        edges = [0, *changes.tolist(), len(is_held)]
        parts: list[Ticks] = []
        for first, last in pairwise(edges):
            ticks = slice(first, last)
            part = setpoints.part(ticks)
            of_part = None if disturbance is None else disturbance.part(ticks)
            begins_at = start if not parts else float(parts[-1].time[-1])
            state = state if not parts else parts[-1].states[-1]
            if is_held[first]:
                parts.append(self._advance_held(begins_at, state, part, of_part))
            else:
                parts.append(self.moving.advance(begins_at, state, part, of_part))
        return Ticks.joined(parts)

    def _advance_held(
        self, start: float, state: np.ndarray, setpoints: Setpoints, disturbance: Disturbance | None
    ) -> Ticks:
        """Advance over ticks with the base held; a base that moves is first brought to rest by a blow.

        The blow acts on the base alone, so H_jb dv_b + H_jj dv_j = 0 with dv_b = -v_b, where H is the mass matrix and b
        and j are its rows of base and joints.

        Args:
            start: When the first tick begins [s].
            state: State [Q; v] then (nq + n,).
            setpoints: What is commanded at these ticks.
            disturbance: What the controller does not know; None: nothing.

        Returns:
            What happened; impulse and work include those of the blow. The first state is that before it.
        """
        model = self.model
        robot = model.nominal if disturbance is None else disturbance.robot
        Q, v = np.split(state, [model.nq])
        base = model.space.base
        joints = model.space.joint_rates
        H = model.mass_matrix(Q, robot)
        v_after = v.copy()
        v_after[base] = 0.0
        v_after[joints] += np.linalg.solve(H[joints, joints], H[joints, base] @ v[base])
        impulse_and_work_of_blow = model.balance(Q, v_after, robot) - model.balance(Q, v, robot)
        # nothing drives a held base, and its plant has no thrusters
        of_joints = replace(setpoints, driven=None, shut=None)
        ticks = self.held.advance(start, np.concatenate([Q, v_after]), of_joints, disturbance)
        thrusters = None
        if self.firing is not None:  # the log of the sample has them, too: they are off
            self.firing.begin_sample(setpoints.shut)
            self.firing.record_ticks(np.zeros((len(setpoints.u), model.space.n_twist)), is_pushed=False)
            thrusters = self.firing.end_sample()
        states = np.vstack([state, ticks.states[1:]])
        return replace(
            ticks,
            states=states,
            impulse_and_work=ticks.impulse_and_work + impulse_and_work_of_blow,
            thrusters=thrusters,
        )
