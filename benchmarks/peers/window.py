"""A window as the peers read it: numbers, and the cost of its stages in CasADi. Knows nothing of psmpc."""

import os
import pickle
import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

Solve = Callable[[Any], dict[str, Any]]
"""Solves a window from a start: status, objective (None where it fails), instants, iterations, time of a core [s]."""


class Robot(ABC):
    """What the costs need of a robot: the errors of its two skills."""

    def error(self, space: str, Q: Any, x0: np.ndarray, target: np.ndarray) -> Any:
        """Return the error of a skill (rows,) at Q (n,) as an expression; x0 (2n,) is the measured state."""
        return self.joint_error(Q, target) if space == "joint" else self.task_error(Q, x0, target)

    @abstractmethod
    def joint_error(self, Q: Any, target: np.ndarray) -> Any:
        """Return the error of base and joints (n,)."""

    @abstractmethod
    def task_error(self, Q: Any, x0: np.ndarray, target: np.ndarray) -> Any:
        """Return the error of the poses of base and end-effectors (rows,)."""


@dataclass(frozen=True)
class PlanarRobot(Robot):
    """A base in the plane with arms.

    Attributes:
        arms: Position and angle of the mount, lengths of the links, and angle of the tool of each arm.
    """

    arms: list[tuple[tuple[float, float], float, list[float], float]]

    def joint_error(self, Q: Any, target: np.ndarray) -> Any:
        """Return Q - Q_d."""
        return Q - target

    def task_error(self, Q: Any, x0: np.ndarray, target: np.ndarray) -> Any:
        """Return xi - xi_d."""
        poses, first = [Q[:3]], 3
        for (x, y), mount_angle, lengths, tool_angle in self.arms:
            c, s = ca.cos(Q[2]), ca.sin(Q[2])
            tip, angle = Q[:2] + ca.vertcat(c * x - s * y, s * x + c * y), Q[2] + mount_angle
            for length in lengths:
                angle += Q[first]
                tip += length * ca.vertcat(ca.cos(angle), ca.sin(angle))
                first += 1
            poses += [tip, angle + tool_angle]
        return ca.vertcat(*poses) - target


@dataclass(frozen=True)
class Frame:
    """A frame that is fixed to a body: position (3,) [m] and unit quaternion (w, x, y, z) in that of the body."""

    body: int
    position: np.ndarray
    quaternion: np.ndarray


@dataclass(frozen=True)
class SpatialRobot(Robot):
    """A base in space with revolute joints, its attitude A Exp(phi) with the three coordinates phi.

    Attributes:
        anchor: A, a unit quaternion.
        joints: Frame of each joint on the body that carries it, and its axis; joint i carries body i + 1.
        tools: Frame of each end-effector.
    """

    anchor: np.ndarray
    joints: list[tuple[Frame, np.ndarray]]
    tools: list[Frame]

    def joint_error(self, Q: Any, target: np.ndarray) -> Any:
        """Return the errors of the base's pose and of the joints."""
        return ca.vertcat(_pose_error(*self._base(Q), target[:7]), Q[6:] - target[7:])

    def task_error(self, Q: Any, x0: np.ndarray, target: np.ndarray) -> Any:
        """Return the errors of the poses, then those of the joints against the measured ones."""
        bodies = [self._base(Q)]
        for number, (frame, axis) in enumerate(self.joints):
            position, quaternion = _carried(bodies, frame)
            half = Q[6 + number] / 2
            bodies.append((position, _product(quaternion, ca.vertcat(ca.cos(half), axis * ca.sin(half)))))
        poses = [bodies[0], *(_carried(bodies, tool) for tool in self.tools)]
        errors = [_pose_error(*pose, target[7 * i : 7 * i + 7]) for i, pose in enumerate(poses)]
        return ca.vertcat(*errors, Q[6:] - x0[6 : 6 + len(self.joints)])

    def _base(self, Q: Any) -> tuple[Any, Any]:
        """Return position and quaternion; Exp(phi) = (cos(|phi| / 2), sin(|phi| / 2) phi / |phi|)."""
        angle = _norm(Q[3:6])
        turn = ca.vertcat(ca.cos(angle / 2), ca.sin(angle / 2) / angle * Q[3:6])
        return Q[:3], _product(ca.DM(self.anchor), turn)


def _norm(v: Any) -> Any:
    """Return |v|, with derivatives at 0: what is divided by it is off by less than 1e-12."""
    return ca.sqrt(ca.dot(v, v) + 1e-12)


def _product(a: Any, b: Any) -> Any:
    """Return the quaternion of the rotation b followed by a."""
    return ca.vertcat(a[0] * b[0] - ca.dot(a[1:], b[1:]), a[0] * b[1:] + b[0] * a[1:] + ca.cross(a[1:], b[1:]))


def _carried(bodies: list[tuple[Any, Any]], frame: Frame) -> tuple[Any, Any]:
    """Return position and quaternion of a frame on one of the bodies."""
    position, quaternion = bodies[frame.body]
    turned = 2 * ca.cross(quaternion[1:], ca.DM(frame.position))
    apart = frame.position + quaternion[0] * turned + ca.cross(quaternion[1:], turned)
    return position + apart, _product(quaternion, ca.DM(frame.quaternion))


def _pose_error(position: Any, quaternion: Any, target: np.ndarray) -> Any:
    """Return the difference of the positions, and the rotation vector from the wanted attitude."""
    wanted = ca.DM(target[3:] * [1, -1, -1, -1])
    turned = _product(wanted, quaternion)
    length = _norm(turned[1:])
    return ca.vertcat(position - target[:3], 2 * ca.atan2(length, turned[0]) / length * turned[1:])


@dataclass(frozen=True)
class Stage:
    """One stage; attributes as in docs/formulation.md, `low` and `high` those of the control (n,)."""

    space: str
    omega: float
    scale: float
    weights: np.ndarray
    control_weights: np.ndarray
    target: np.ndarray
    end_rows: list[int]
    tolerance: np.ndarray
    shortest: float
    low: np.ndarray
    high: np.ndarray


@dataclass(frozen=True)
class Start:
    """Where a solve starts.

    Attributes:
        X: States (K + 1, 2n).
        u: Controls (K, n).
        durations: Of all stages but the last [s].
        is_warm: It is the optimum of the sample before, moved on.
    """

    X: np.ndarray
    u: np.ndarray
    durations: np.ndarray
    is_warm: bool


@dataclass(frozen=True)
class Mesh:
    """N_s intervals in every stage: limits of the states at the nodes (K + 1, 2n), and where to start, by name."""

    low: np.ndarray
    high: np.ndarray
    starts: dict[str, Start]


@dataclass(frozen=True)
class Window:
    """A window to be solved.

    Attributes:
        robot: The errors of its skills.
        x0: Measured state (2n,).
        horizon, pending_cost: T_h [s], delta.
        stages: Its stages.
        meshes: By N_s.
        repeats: How often a solve is timed.
    """

    robot: Robot
    x0: np.ndarray
    horizon: float
    pending_cost: float
    stages: list[Stage]
    meshes: dict[int, Mesh]
    repeats: int

    @property
    def n(self) -> int:
        """Number of coordinates."""
        return len(self.x0) // 2

    def cost(self, stage: Stage, Q: Any, u: Any) -> Any:
        """Return omega L of a stage, as a CasADi expression."""
        Lbar = ca.dot(stage.weights, self.error(stage, Q) ** 2) + ca.dot(stage.control_weights, u**2)
        return stage.omega * Lbar / stage.scale

    def error(self, stage: Stage, Q: Any) -> Any:
        """Return the error of a stage in its space, as a CasADi expression."""
        return self.robot.error(stage.space, Q, self.x0, stage.target)

    def durations(self, free: np.ndarray) -> np.ndarray:
        """Return the durations of all stages from those of all but the last [s]."""
        return np.append(free, self.horizon - free.sum())

    def objective(self, X: np.ndarray, u: np.ndarray, durations: np.ndarray) -> float:
        """Return J of states (K + 1, 2n), controls (K, n) and the durations of all stages [s]."""
        N = len(u) // len(self.stages)
        J = self.pending_cost * float(np.cumsum(durations)[:-1].sum())
        Q, control = ca.SX.sym("Q", self.n), ca.SX.sym("u", self.n)
        for s, (stage, duration) in enumerate(zip(self.stages, durations, strict=True)):
            cost = ca.Function("cost", [Q, control], [self.cost(stage, Q, control)])
            at = slice(s * N, (s + 1) * N)
            J += duration / N * float(ca.sum2(cost(X[:-1][at, : self.n].T, u[at].T)))
        return J


def measured(build: Callable[[], Solve], starts: Mapping[str, Any], repeats: int) -> dict[str, Any]:
    """Return what a program makes of a window from each of its starts: times are medians, `build` that of building."""
    began = sum(os.times()[:4])  # with that of compilers
    solve = build()
    found: dict[str, Any] = {"build": sum(os.times()[:4]) - began}
    for number, (name, start) in enumerate(starts.items()):
        first, *again = (solve(start) for _ in range(repeats + 1))
        time = float(np.median([each["time"] for each in again]))
        if number == 0:
            found["build"] += max(first["time"] - time, 0.0)  # the first solve builds the solver
        found[name] = first | {"time": time}
    return found


def write_results(name: str, programs: Mapping[str, Callable[[Window, int], Solve]], most_stages: int = 2) -> None:
    """Solve every window of so many stages with every program, each built from a window and N_s; write the results."""
    directory, results = Path(sys.argv[1]), []
    for of, window in pickle.loads((directory / "windows").read_bytes()).items():
        for nodes, mesh in window.meshes.items() if len(window.stages) <= most_stages else ():
            for program, build in programs.items():
                print(f"{program}, {of}, N_s = {nodes}", file=sys.stderr, flush=True)
                found = measured(partial(build, window, nodes), mesh.starts, window.repeats)
                results.append({"program": program, "window": of, "nodes": nodes, **found})
                (directory / name).write_bytes(pickle.dumps(results))
