"""A skill: the residual of the parts of a target, each wanted in a way of its own, and what a target's numbers mean.

The numbers of a spatial target are followed by those that every sample sets: the anchor (4,) of the chart, and the
posture (joints,) that redundant joints are drawn to. See `Stage.in_chart`.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.parts import BASE, Space, axes_of, part_kind


@dataclass(frozen=True, eq=False)
class Posture:
    """Where a sequence of stages leads to, stage by stage: Q (nq,) and poses xi (m,), as far as targets determine them.

    A target in one of the two leaves the joints of the other as they were, so that xi need not be g(Q).
    """

    Q: np.ndarray
    xi: np.ndarray


class PartKind(ABC):
    """How a part of a target is wanted. Its names of coordinates are those of `specs.parts`.

    Attributes:
        is_pose: The numbers are a pose of the part's frame.
        is_joints: They are the joint coordinates of an arm.
        is_point: They are a point that the part's frame points at.
        draws_joints: Joints that the part leaves free are drawn to where they are, in space.
        absent: Its numbers where the target leaves it out, whose weights are then 0; NaN where it is required.
    """

    is_pose = False
    is_joints = False
    is_point = False
    draws_joints = False
    absent = np.nan

    @abstractmethod
    def error(self, model: RobotModel, part: str, Q: ca.SX, xi: ca.SX, wanted: ca.SX) -> ca.SX:
        """Return the error of a part (rows,) at Q (n,) in the chart, where frames have the poses xi (m,)."""

    @abstractmethod
    def numbers_at(self, model: RobotModel, part: str, posture: Posture) -> np.ndarray:
        """Return the numbers of the part's target at a posture; those of `absent` where many would do."""

    @abstractmethod
    def aim(self, model: RobotModel, part: str, Q: np.ndarray, wanted: np.ndarray) -> np.ndarray:
        """Return the position (dimension,) [m] that the target is about; NaN without one.

        Args:
            model: The robot.
            part: The part.
            Q: Coordinates (nq,) with the base and the joints that the whole target wants.
            wanted: The numbers of the part.
        """


@dataclass(frozen=True, eq=False)
class TargetPart:
    """A part of a target.

    Attributes:
        kind: How it is wanted.
        rows: Its rows of the error.
        numbers: Its numbers of the target.
        coordinates, rates: The entries of Q and v that are the part's own: the base's, or the joints of an arm.
    """

    kind: PartKind
    rows: slice
    numbers: slice
    coordinates: slice
    rates: slice


class Skill:
    """A kind of skill: how each part of its targets is wanted, the base's pose first.

    Args:
        space: In which space each part is, which names its rows and numbers.
        kinds: How parts of such a space are wanted.
    """

    def __init__(self, space: Space, kinds: Mapping[str, PartKind]) -> None:
        self._space = space
        self._kinds = kinds

    def parts(self, model: RobotModel) -> Mapping[str, TargetPart]:
        """Return the parts of a target by their name; free arms are none."""
        return model.cached(("target parts", self._space), lambda: self._parts(model))

    def _parts(self, model: RobotModel) -> Mapping[str, TargetPart]:
        """Return the parts of a target, base and arms, by name: which entries of error, target, Q and v are theirs.

        Parts follow each other in error and target. A part may have more numbers than rows of the error: a spatial pose
        has 7, and its error 6.
        """
        row_names = axes_of(model.spec.parts, self._space)
        number_names = axes_of(model.spec.parts, self._space, of_error=False)
        parts = dict[str, TargetPart]()
        first_row = 0
        first_number = 0
        for part in row_names:
            end_row = first_row + len(row_names[part])
            end_number = first_number + len(number_names[part])
            parts[part] = TargetPart(
                kind=self._kinds[part_kind(self._space, part)],
                rows=slice(first_row, end_row),
                numbers=slice(first_number, end_number),
                coordinates=model.space.base_coordinates if part == BASE else joints_of(model, part),
                rates=model.parts.get(part, slice(model.n, model.n)),
            )
            first_row = end_row
            first_number = end_number
        return parts

    def draws_joints(self, model: RobotModel) -> bool:
        """Tell whether joints that poses leave free are drawn to where they are: rows behind those of the parts."""
        return any(part.kind.draws_joints for part in self.parts(model).values())

    def rows(self, model: RobotModel) -> int:
        """Return the number of rows of the error."""
        last = list(self.parts(model).values())[-1]
        return int(last.rows.stop) + model.space.n_posture * self.draws_joints(model)

    def numbers(self, model: RobotModel) -> int:
        """Return the number of numbers of a target in a task file."""
        return int(list(self.parts(model).values())[-1].numbers.stop)

    def error(self, model: RobotModel, Q: ca.SX, target: ca.SX) -> ca.SX:
        """Return the error (rows,) at Q (n,) in the chart against a target; units of the coordinates."""
        first = target.numel() - model.space.n_sample_numbers
        xi = model.charted(Q, target[first : first + model.space.n_anchor])
        parts = self.parts(model)
        errors = [part.kind.error(model, name, Q, xi, target[part.numbers]) for name, part in parts.items()]
        posture = model.space.n_posture * self.draws_joints(model)
        return ca.vertcat(*errors, Q[model.n - posture :] - target[target.numel() - posture :])

    def absent(self, model: RobotModel) -> np.ndarray:
        """Return the numbers of parts that a target leaves out (numbers,); NaN where none may be."""
        parts = self.parts(model).values()
        return np.concatenate([np.full(part.numbers.stop - part.numbers.start, part.kind.absent) for part in parts])

    def numbers_at(self, model: RobotModel, posture: Posture) -> np.ndarray:
        """Return the numbers of a target (numbers,) at a posture, of others than poses and joints `absent`."""
        parts = self.parts(model).items()
        return np.concatenate([part.kind.numbers_at(model, name, posture) for name, part in parts])

    def posture_after(self, model: RobotModel, posture: Posture, target: np.ndarray) -> Posture:
        """Return the robot's posture at a target that is reached from another one.

        What the target has as coordinates or poses is taken from it; other coordinates stay as they are. Coordinates of
        arms whose target is a pose are not computed: they stay, and only the pose is set.

        Args:
            model: The robot.
            posture: The posture before.
            target: Numbers of the target, (numbers,).
        """
        parts = self.parts(model)
        Q = posture.Q.copy()
        for name, part in parts.items():
            if name == BASE or part.kind.is_joints:
                Q[part.coordinates] = target[part.numbers]
        xi = np.asarray(model.g(Q)).ravel()
        for name, part in parts.items():
            if part.kind.is_pose:
                xi[model.pose_rows[name]] = target[part.numbers]
        return Posture(Q, xi)

    def aims(self, model: RobotModel, target: np.ndarray) -> np.ndarray:
        """Return the positions that a target is about, of base and end-effectors, for figures and records.

        That is where the target wants the frame, or the point that the frame is to point at.

        Args:
            model: The robot.
            target: Numbers of the target, (numbers,).

        Returns:
            (frames, dimension) [m]; NaN for arms that the target leaves free, and for points that it leaves out.
        """
        parts = self.parts(model)
        zero = Posture(np.zeros(model.nq), np.zeros(model.m))
        Q = self.posture_after(model, zero, target).Q  # 0 where the target says nothing
        positions = np.full((len(model.pose_rows), model.dimension), np.nan)
        for position, name in zip(positions, model.pose_rows, strict=True):
            if name in parts:
                position[:] = parts[name].kind.aim(model, name, Q, target[parts[name].numbers])
        return positions

    def angles(self, model: RobotModel) -> list[int]:
        """Return the numbers of a planar target that are angles of frames, of which the nearest equivalent is meant."""
        return [part.numbers.start + row for _, part in self._poses(model) for row in model.space.pose_angles]

    def attitudes(self, model: RobotModel) -> dict[str, int]:
        """Return the first numbers of the quaternions of a spatial target, by frame."""
        if not model.space.has_quaternion:
            return {}
        return {name: part.numbers.start + model.space.attitude.start for name, part in self._poses(model)}

    def _poses(self, model: RobotModel) -> Sequence[tuple[str, TargetPart]]:
        return [(name, part) for name, part in self.parts(model).items() if part.kind.is_pose]


def joints_of(model: RobotModel, arm: str) -> slice:
    """Return the entries of Q that are the joints of an arm; none of another part."""
    rates = model.parts.get(arm, slice(model.n, model.n))
    before = model.nq - model.n
    return slice(rates.start + before, rates.stop + before)
