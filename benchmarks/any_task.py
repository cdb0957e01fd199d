"""Random valid tasks of any robot, controller and back-end, run by the command line and checked by code of its own.

    python benchmarks/any_task.py             1,000 tasks, some two hours; goes on where it was stopped
    python benchmarks/any_task.py 200         the first 200; 1100: 100 more, which get SIGTERM
    python benchmarks/any_task.py 0 17        task 17 alone, its files kept in any_task_17/, its result printed
    python benchmarks/any_task.py summary     what benchmarks/any_task.jsonl holds

Robots are planar or spatial, free-flying, free-floating or fixed, with masses from 1e-3 to 1e5 kg and lengths from 1e-3
to 1e2 m; windows have 2 to 400 intervals a stage. Every tenth run gets SIGTERM at a random moment, and so do all beyond
the first 1,000, since some runs are over before. Of each run:

- no traceback, no minute without a line, the end within 5 s of SIGTERM, a log that can be read;
- of a mission that succeeded, the error of the last end condition, from the logged true state by kinematics that share
  nothing with the program's: within the tolerance; of a noisy run within the tolerance and 2 sigma of what is measured;
- the positions of joints, and of planar bases, along every plan with hard limits, between its nodes too: by how much
  they leave their limits further than the measured state already does and the strongest braking leaves;
- rates along the plans, and of spatial robots hard cones, at 20 points an interval, which have no such bound: by how
  much they exceed their limits.

The plans of `htmpc` are not looked at: its log holds the windows of the first level.
"""

import json
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Thread
from typing import Any

import numpy as np
import yaml
from pages import PSMPC

import psmpc_cli as psmpc
from psmpc_cli.errors import LogError, PsmpcError
from psmpc_cli.ocp.feasibility.checks import load_task

RESULTS = Path(__file__).with_suffix(".jsonl")
COUNT = 1000
LONGEST = 120.0
"""A run that takes longer is ended by SIGTERM, too [s]."""

SILENCE = 60.0
OBEYED = 5.0
BEYOND = 1e-6
"""Longest time without a line, longest time from SIGTERM to the end [s], largest excess of a position [m, rad]."""

WITHIN = 1.001
"""Error of an end condition over its tolerance that counts as within it: the program's own slack is a thousandth."""

SPATIAL_ROBOTS = 16
"""Spatial robots are drawn from so many: each is compiled once."""

Array = np.ndarray
Row = dict[str, Any]


# Drawing


class Drawing:
    """Draws one task and its robot; all random numbers come from the seed."""

    def __init__(self, seed: int) -> None:
        self.random = np.random.default_rng(seed)
        self.is_spatial = self.chance(0.3)
        robot_seed = int(self.random.integers(SPATIAL_ROBOTS)) if self.is_spatial else seed
        self.of_robot = np.random.default_rng([robot_seed, 7])
        self.length = float(10 ** self.of_robot.uniform(-3, 2))
        self.mass = float(10 ** self.of_robot.uniform(-3, 5))
        self.mobility = str(self.random.choice(["free-flying", "free-floating", "fixed"], p=[0.5, 0.25, 0.25]))
        self.sample_time = float(10 ** self.random.uniform(-2, 0.5))
        self.rate = 0.6 / (8 * self.sample_time)  # rad/s with which a stage takes some 8 samples

    def chance(self, share: float) -> bool:
        """Return whether something happens that does so in a share of the draws."""
        return bool(self.random.random() < share)

    def between(self, low: float, high: float) -> float:
        """Draw a number, evenly."""
        return float(self.random.uniform(low, high))

    def log_between(self, low: float, high: float) -> float:
        """Draw a number whose decimal logarithm is even."""
        return float(10 ** self.random.uniform(low, high))

    def choice(self, options: list[Any], p: list[float] | None = None) -> Any:
        """Draw one of some options."""
        return options[int(self.random.choice(len(options), p=p))]

    # The robot

    def robot(self) -> Row:
        """Return a robot as its file has it."""
        arms = self._spatial_arms() if self.is_spatial else self._planar_arms()
        inertia = self.mass * self.length**2 * float(self.of_robot.uniform(0.05, 0.5))
        base: Row = (
            {"mass": self.mass, "inertia": [inertia, inertia * 1.2, inertia * 0.9]}
            if self.is_spatial
            else {
                "mass": self.mass,
                "inertia": inertia,
            }
        )
        robot: Row = {"name": "drawn", "base": base, "arms": arms, "limits": {}}
        if self.is_spatial:
            robot["space"] = "spatial"
        size = 6 if self.is_spatial else 3
        linear = self.rate * self.length
        rates = [linear] * (size // 2 + (size == 3)) + [self.rate] * (size // 2)
        of_base: Row = {"velocity": rates}
        if not self.is_spatial and self.chance(0.3):
            reach = 3 * self.length
            of_base["position"] = [[-reach, reach], [-reach, reach], [-3.0, 3.0]]
        robot["limits"]["base"] = of_base
        for name, arm in arms.items():
            count = len(arm["links"])
            limits: Row = {}
            if self.chance(0.7):
                limits["position"] = [[-self.between(0.4, 2.8), self.between(0.4, 2.8)] for _ in range(count)]
            if self.chance(0.8):
                limits["velocity"] = [self.rate] * count
            if self.chance(0.3):
                limits["acceleration"] = [self.rate / (self.sample_time * self.between(0.5, 3))] * count
            if limits:
                robot["limits"][name] = limits
        return robot

    def _planar_arms(self) -> Row:
        arms = {}
        for number in range(int(self.of_robot.integers(1, 4))):
            links = []
            for _ in range(int(self.of_robot.integers(1, 4))):
                a, b = self.length * self.of_robot.uniform(0.1, 0.6, 2)
                mass = self.mass * float(self.of_robot.uniform(0.02, 0.3))
                inertia = mass * self.length**2 * float(self.of_robot.uniform(0.02, 0.2))
                links.append({"mass": mass, "inertia": inertia, "a": float(a), "b": float(b)})
            x, y = self.length * self.of_robot.uniform(-0.4, 0.4, 2)
            mount = {"position": [float(x), float(y)], "angle": float(self.of_robot.uniform(-3, 3))}
            arm: Row = {"mount": mount, "links": links}
            if self.of_robot.random() < 0.5:
                arm["tool"] = {"angle": float(self.of_robot.uniform(-3, 3))}
            arms[f"a{number + 1}"] = arm
        return arms

    def _spatial_arms(self) -> Row:
        links = []
        for number in range(int(self.of_robot.integers(2, 5))):
            axis = np.eye(3)[[2, 1, 1, 0][number]]
            mass = self.mass * float(self.of_robot.uniform(0.02, 0.2))
            inertia = mass * self.length**2 * 0.05
            offset = self.length * float(self.of_robot.uniform(0.1, 0.5))
            links.append(
                {
                    "joint": {"axis": axis.tolist(), "position": [offset, 0.0, 0.0]},
                    "mass": mass,
                    "centre_of_mass": [self.length * 0.1, 0.0, 0.0],
                    "inertia": [inertia, inertia * 1.1, inertia * 0.9],
                }
            )
        return {"a1": {"links": links, "tool": {"position": [self.length * 0.2, 0.0, 0.0]}}}

    # The task

    def task(self, robot: Row) -> Row:
        """Return a task as its file has it."""
        nodes: Any = "auto" if self.chance(0.1) else round(self.log_between(np.log10(2), np.log10(400)))
        solver = self.choice(["sqp", "interpreted", "fatrop", "ipopt"], [0.5, 0.2, 0.15, 0.15])
        kind = self.choice(["psmpc", "smpc", "hard", "htmpc"], [0.4, 0.2, 0.2, 0.2])
        work = 60 if nodes == "auto" else nodes
        samples = int(np.clip((8000 if solver == "sqp" else 2500) / work, 15, 50))
        if kind == "htmpc" or self.is_spatial:
            samples = max(12, samples // 2)
        ticks = int(self.random.integers(4, 40))
        controller: Row = {
            "kind": kind,
            "nodes": nodes,
            "sample_time": self.sample_time,
            "horizon": self.sample_time * self.choice([2, 4, 8, 12, 20, 40]),
        }
        if kind in ("hard", "htmpc") and self.chance(0.5):
            controller["one_stage"] = "free_end"
        if kind in ("psmpc", "smpc") and self.chance(0.15):
            controller["multistart"] = int(self.random.integers(2, 4))
        if self.chance(0.1):
            controller["normalization"] = self.choice(["none", "range"])
        if self.chance(0.1):
            controller["discretization"] = "euler"
        plant = self.choice(["rk4", "ideal", "mujoco"], [0.6, 0.25, 0.15])
        joints = self._joints(robot, {})
        task: Row = {
            "robot": "robot.yaml",
            "mobility": self.mobility,
            "initial": self._configuration(joints),
            "controller": controller,
            "solver": {"kind": "sqp", "compiled": False} if solver == "interpreted" else {"kind": solver},
            "plant": {"kind": plant, "low_level_rate": ticks / self.sample_time},
            "time_limit": samples * self.sample_time,
            "skills": {},
            "stages": [],
            "seed": int(self.random.integers(100)),
            "log": {"shares": self.chance(0.3), "plans": True},
        }
        for number in range(min(int(self.random.integers(1, 5)), max(1, samples // 12))):
            joints = self._joints(robot, joints)
            self._add_stage(task, robot, joints, number)
        task["stages"][-1].pop("at", None)
        if self.chance(0.2):
            angle = self.log_between(-5, -3)
            task["uncertainty"] = {"noise": {"position": angle * self.length, "angle": angle}}
        if not self.is_spatial and self.chance(0.1):
            far = 20 * self.length
            task["obstacles"] = [{"name": "o", "shape": {"sphere": self.length}, "pose": [far, far, 0.0]}]
            task["clearance"] = {"margin": 0.02 * self.length, "hard": self.chance(0.5)}
        return task

    def _joints(self, robot: Row, before: Mapping[str, Any]) -> Row:
        """Draw a configuration within the limits, not far from the one before: joints by arm, and the base's pose."""
        found: Row = {}
        for name, arm in robot["arms"].items():
            count = len(arm["links"])
            low, high = np.array(robot["limits"].get(name, {}).get("position", [[-2.5, 2.5]] * count)).T
            near = np.array(before.get(name, self.random.uniform(0.8 * low, 0.8 * high)))
            far = 0.0 if not before else 0.6
            edge = self.chance(0.1)  # a target at the limits themselves
            wanted = np.clip(near + self.random.uniform(-far, far, count), low, high)
            found[name] = (np.where(wanted > 0, high, low) if edge and before else wanted).tolist()
        size = 3 if self.is_spatial else 2
        position = np.array(before.get("position", np.zeros(size)))
        turn = np.array(before.get("turn", np.zeros(3 if self.is_spatial else 1)))
        moves = self.mobility == "free-flying" and bool(before)
        found["position"] = (position + moves * self.length * self.random.uniform(-0.5, 0.5, size)).tolist()
        found["turn"] = (turn + moves * self.random.uniform(-0.3, 0.3, turn.shape)).tolist()
        return found

    def _configuration(self, joints: Mapping[str, Any]) -> Row:
        arms = {name: joints[name] for name in joints if name not in ("position", "turn")}
        return {"base": self._pose(joints["position"], quaternion_of(joints["turn"]), joints["turn"]), **arms}

    def _pose(self, position: Any, quaternion: Array, turn: Any) -> Any:
        if self.is_spatial:
            return {"position": list(position), "attitude": {"quaternion": quaternion.tolist()}}
        return [*position, float(turn[0])]

    def _add_stage(self, task: Row, robot: Row, joints: Mapping[str, Any], number: int) -> None:
        """Add a stage that leads to a configuration, and its skill."""
        space = self.choice(["joint", "task", "point"], [0.6, 0.25, 0.15])
        moved = self.mobility == "free-flying"
        arms = list(robot["arms"])
        sizes = {"joint": {arm: len(robot["arms"][arm]["links"]) for arm in arms}}
        per_pose = 6 if self.is_spatial else 3
        sizes["task"] = dict.fromkeys(arms, per_pose)
        sizes["point"] = dict.fromkeys(arms, 2 if self.is_spatial else 1)
        weights: Row = {arm: [self._weight()] * sizes[space][arm] for arm in arms}
        if moved:
            weights["base"] = [
                self._weight() / (self.length**2 if i < per_pose // 2 + (per_pose == 3) else 1) for i in range(per_pose)
            ]
        acceleration = self.rate / self.sample_time
        weights["control"] = 100 * 0.36 / acceleration**2 * self.log_between(-6, -2)
        skill = f"{space}_{number}"
        task["skills"][skill] = {"space": space, "weights": weights}
        kinematics = Kinematics(robot)
        Q = kinematics.coordinates(self._configuration(joints))
        poses = kinematics.poses(Q)
        target: Row = {}
        if moved:
            target["base"] = self._configuration(joints)["base"]
        for arm in arms:
            position, R, angle = poses[arm]
            if space == "joint":
                target[arm] = joints[arm]
            elif space == "task":
                target[arm] = self._pose(position.tolist(), quaternion_from(R), [angle])
            else:
                ahead = R @ np.eye(3)[0]
                target[arm] = (position + self.length * self.between(1, 3) * ahead[: len(position)]).tolist()
        part = self.choice([*arms, "all", *(["base"] if moved else [])])
        tolerance = self.choice([self.log_between(-4, -1), 1e-9, 1e3], [0.92, 0.05, 0.03])
        ends: Row = {"coordinates": [part], "tolerance": tolerance * min(1.0, self.length)}
        if self.chance(0.2):
            ends["velocity"] = self.rate * min(1.0, self.length) * self.log_between(-2, 0)
        if self.chance(0.15):
            ends["hold"] = self.sample_time * self.choice([0.5, 1, 3])
        stage: Row = {
            "name": f"s{number + 1}",
            "skill": skill,
            "priority": self.log_between(-2, 2) if self.chance(0.8) else self.log_between(-12, 12),
            "target": target,
            "ends_when": ends,
        }
        if self.chance(0.1):
            stage["dwell"] = self.sample_time * self.between(0, 4)
        if self.chance(0.1) and number == 0:
            stage["at"] = self.sample_time * self.choice([2, 3.5, 5])
            del stage["ends_when"]
        if self.chance(0.08):
            axis = [1.0, 0.0, 0.0] if self.is_spatial else [1.0, 0.0]
            direction = (poses[arms[0]][1] @ np.eye(3)[0])[: len(axis)]
            stage["cones"] = [
                {
                    "frame": arms[0],
                    "axis": axis,
                    "of": {"direction": direction.tolist()},
                    "within": self.between(0.5, 2.5),
                    "hard": self.chance(0.3),
                }
            ]
        task["stages"].append(stage)

    def _weight(self) -> float:
        return self.choice([self.log_between(0, 2), 0.0, 1e6, 1e-6], [0.88, 0.04, 0.04, 0.04])


def drawn(seed: int, folder: Path) -> tuple[Row, Row]:
    """Write a valid robot and task into a folder and return them; drawn anew while they are not valid."""
    for attempt in range(200):
        drawing = Drawing(seed + 1_000_003 * attempt)
        robot = drawing.robot()
        task = drawing.task(robot)
        if not robot["limits"]:
            del robot["limits"]
        (folder / "robot.yaml").write_text(yaml.safe_dump(robot, sort_keys=False))
        (folder / "task.yaml").write_text(yaml.safe_dump(task, sort_keys=False))
        try:
            load_task(str(folder / "task.yaml"))
        except PsmpcError:
            continue
        return robot, task
    raise SystemExit(f"seed {seed}: no valid task in 200 draws")


# Kinematics, on its own


def hat(a: Array) -> Array:
    """Return the matrix of the cross product with a vector."""
    x, y, z = a
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])


def rotation(vector: Array) -> Array:
    """Return the rotation matrix of a rotation vector, by Rodrigues' formula."""
    angle = float(np.linalg.norm(vector))
    if angle < 1e-12:
        return np.eye(3) + hat(vector)
    k = hat(vector / angle)
    return np.asarray(np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k)


def quaternion_of(vector: Any) -> Array:
    """Return the unit quaternion of a rotation vector, or of an angle about z."""
    v = np.zeros(3)
    v[-len(vector) :] = vector
    angle = float(np.linalg.norm(v))
    return np.append(np.cos(angle / 2), np.sinc(angle / 2 / np.pi) / 2 * v)


def matrix_of(q: Array) -> Array:
    """Return the rotation matrix of a quaternion."""
    w, v = q[0], q[1:] / np.linalg.norm(q)
    w = w / np.linalg.norm(q)
    return np.asarray((w * w - v @ v) * np.eye(3) + 2 * np.outer(v, v) + 2 * w * hat(v))


def vector_of(R: Array) -> Array:
    """Return the rotation vector of a rotation by less than half a turn."""
    s = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) / 2
    sine = float(np.linalg.norm(s))
    angle = float(np.arctan2(sine, (np.trace(R) - 1) / 2))
    return s if sine < 1e-12 else s / sine * angle


def quaternion_from(R: Array) -> Array:
    """Return the unit quaternion of a rotation matrix."""
    return quaternion_of(vector_of(R))


class Kinematics:
    """Poses of the frames of a drawn robot."""

    def __init__(self, robot: Row) -> None:
        self.robot = robot
        self.is_spatial = robot.get("space") == "spatial"
        self.sizes = {name: len(arm["links"]) for name, arm in robot["arms"].items()}
        self.base = 7 if self.is_spatial else 3

    def coordinates(self, configuration: Row) -> Array:
        """Return Q of a configuration as a task writes it."""
        base = configuration["base"]
        if self.is_spatial:
            base = [*base["position"], *base["attitude"]["quaternion"]]
        return np.concatenate([base, *(configuration[name] for name in self.sizes)]).astype(float)

    def joints(self, Q: Array) -> dict[str, Array]:
        """Return the joint coordinates by arm."""
        ends = np.cumsum([self.base, *self.sizes.values()])
        return {name: Q[first:end] for name, first, end in zip(self.sizes, ends, ends[1:], strict=False)}

    def moved(self, Q: Array, v: Array, time: float) -> Array:
        """Return the coordinates after a short time at velocities v, angular ones about the base's own axes."""
        if not self.is_spatial:
            return Q + time * v
        R = matrix_of(Q[3:7]) @ rotation(time * v[3:6])
        return np.concatenate([Q[:3] + time * v[:3], quaternion_from_any(R, Q[3:7]), Q[7:] + time * v[6:]])

    def poses(self, Q: Array) -> dict[str, tuple[Array, Array, float]]:
        """Return position, rotation matrix, and in the plane the angle, of base and end-effectors."""
        if self.is_spatial:
            found = {"base": (Q[:3], matrix_of(Q[3:7]), 0.0)}
        else:
            found = {"base": (Q[:2], rotation(np.array([0, 0, Q[2]])), float(Q[2]))}
        for name, q in self.joints(Q).items():
            arm = self.robot["arms"][name]
            found[name] = (
                self._spatial(found["base"], arm, q) if self.is_spatial else self._planar(found["base"], arm, q)
            )
        return found

    def _planar(self, base: tuple[Array, Array, float], arm: Row, q: Array) -> tuple[Array, Array, float]:
        position, R, angle = base
        position = position + R[:2, :2] @ arm["mount"]["position"]
        angle += arm["mount"]["angle"]
        for link, turned in zip(arm["links"], q, strict=True):
            angle += turned
            position = position + (link["a"] + link["b"]) * np.array([np.cos(angle), np.sin(angle)])
        angle += arm.get("tool", {}).get("angle", 0.0)
        return position, rotation(np.array([0, 0, angle])), float(angle)

    def _spatial(self, base: tuple[Array, Array, float], arm: Row, q: Array) -> tuple[Array, Array, float]:
        position, R, _ = base
        for link, turned in zip(arm["links"], q, strict=True):
            position = position + R @ link["joint"]["position"]
            R = R @ rotation(np.array(link["joint"]["axis"]) * turned)
        return position + R @ arm["tool"]["position"], R, 0.0

    def error(self, stage: Row, space: str, Q: Array) -> dict[str, Array]:
        """Return the rows of the error of a stage's target by part."""
        poses = self.poses(Q)
        joints = self.joints(Q)
        found = {}
        for part, wanted in stage["target"].items():
            if part == "base" or space == "task":
                found[part] = self._off_pose(poses[part], wanted)
            elif space == "joint":
                found[part] = joints[part] - np.array(wanted)
            else:
                position, R, _ = poses[part]
                line = np.zeros(3)
                line[: len(wanted)] = np.array(wanted) - position
                x, y, z = R.T @ line / np.linalg.norm(line)
                turn = np.arctan2(np.hypot(y, z), x) * np.array([-z, y]) / max(np.hypot(y, z), 1e-300)
                found[part] = turn if self.is_spatial else turn[1:]
        return found

    def _off_pose(self, pose: tuple[Array, Array, float], wanted: Any) -> Array:
        position, R, angle = pose
        if self.is_spatial:
            R_wanted = matrix_of(np.array(wanted["attitude"]["quaternion"]))
            return np.append(position - wanted["position"], vector_of(R_wanted.T @ R))
        off = angle - wanted[2]
        return np.append(position - wanted[:2], off - 2 * np.pi * np.round(off / (2 * np.pi)))


def quaternion_from_any(R: Array, near: Array) -> Array:
    """Return the unit quaternion of a rotation that is near another one."""
    turned = matrix_of(near).T @ R
    w, v = near[0], near[1:]
    b = quaternion_of(vector_of(turned))
    return np.append(w * b[0] - v @ b[1:], w * b[1:] + b[0] * v + np.cross(v, b[1:]))


def end_error(robot: Row, task: Row, run: psmpc.Run, sigmas: float) -> float:
    """Return the largest error of the last end condition over its tolerance and so many sigma of its measurement."""
    kinematics = Kinematics(robot)
    stage = task["stages"][-1]
    ends = stage["ends_when"]
    space = task["skills"][stage["skill"]]["space"]
    true = "_true" if "final/Q_true" in run else ""
    Q, v = run[f"final/Q{true}"], run[f"final/Qdot{true}"]
    noise = task.get("uncertainty", {}).get("noise", {})
    sigma = np.full(len(v), noise.get("angle", 0.0))
    sigma[: 3 if kinematics.is_spatial else 2] = noise.get("position", 0.0)
    (part,) = ends["coordinates"]
    parts = list(stage["target"]) if part == "all" else [part]

    def rows(Q: Array) -> Array:
        found = kinematics.error(stage, space, Q)
        return np.concatenate([found[each] for each in parts])

    step = 1e-6
    by = [
        (rows(kinematics.moved(Q, e, step)) - rows(kinematics.moved(Q, e, -step))) / (2 * step) for e in np.eye(len(v))
    ]
    allowance = np.sqrt(((np.array(by).T * sigma) ** 2).sum(axis=1))
    worst = float((np.abs(rows(Q)) / (ends["tolerance"] + sigmas * allowance)).max())
    if "velocity" in ends and not noise:
        worst = max(worst, float(np.abs(np.array(by).T @ v).max()) / ends["velocity"])
    return worst


# Plans


def plan(task: Row, run: psmpc.Run, sample: int) -> tuple[Array, Array, Array]:
    """Return the plan of a sample: lengths (K, 1) [s] of its intervals, states (K+1, 2n) and inputs (K, n)."""
    n = len(run["coordinate"])
    nodes = [int(each) for each in run["window/nodes"][sample] if np.isfinite(each) and each > 0]
    after = "window/nodes_after_end" in run and int(run["window/nodes_after_end"][sample])
    nodes += [after] if after else []
    K = sum(nodes)
    S = len(nodes) - 1
    switch_times, X, u = np.split(run.plan("solution", sample), [S, S + 2 * n * (K + 1)])
    ends = [run.time[sample], *switch_times, run.time[sample] + task["controller"]["horizon"]]
    return np.repeat(np.diff(ends) / nodes, nodes)[:, None], X.reshape(K + 1, 2 * n), u.reshape(K, n)


def plan_excess(robot: Row, task: Row, run: psmpc.Run) -> tuple[float, float]:
    """Return by how much plans leave limits of positions, and of rates, at worst: in their units."""
    kinematics = Kinematics(robot)
    n = len(run["coordinate"])
    size = 6 if kinematics.is_spatial else 3
    low, high = np.full((2, 3, n), np.inf)
    low *= -1
    at = 0
    for part, count in {"base": size, **kinematics.sizes}.items():
        for row, quantity in enumerate(("position", "velocity", "acceleration")):
            given = robot.get("limits", {}).get(part, {}).get(quantity)
            for i, pair in enumerate(given or []):
                low[row, at + i], high[row, at + i] = pair if isinstance(pair, list) else (-pair, pair)
        at += count
    if kinematics.is_spatial:
        low[0, 3:6], high[0, 3:6] = -np.inf, np.inf
    positions = rates = 0.0
    for sample in range(len(run.time)):
        if run["events/solve_failed"][sample] or run["events/braking"][sample]:
            continue
        h, X, u = plan(task, run, sample)
        q, v = X[:-1, :n], X[:-1, n:]
        turning = np.clip(np.divide(-v, u, out=np.zeros_like(v), where=u != 0), 0, h)
        reached = np.stack([q + t * v + t**2 / 2 * u for t in (0 * h, h, turning)])
        beyond = np.maximum(low[0] - reached, reached - high[0]).max(axis=0)
        own = np.maximum(low[0] - q[0], q[0] - high[0])
        outwards = np.where(low[0] - q[0] < q[0] - high[0], v[0], -v[0]).clip(0)
        braking = outwards**2 / (2 * high[2])
        beyond[0] -= np.maximum(own + np.where(own > 0, np.maximum(braking, h[0] * outwards / 2), braking), 0)
        positions = max(positions, float(beyond.max()))
        inside = np.linspace(0, 1, 21)[:, None, None] * h
        rate = v + inside * u
        if kinematics.is_spatial:
            phi = q[:, 3:6] + inside * v[:, 3:6] + inside**2 / 2 * u[:, 3:6]
            rate[..., 3:6] = body_rates(phi, rate[..., 3:6])
        of_rates = np.maximum(low[1] - rate, rate - high[1]) / np.where(np.isfinite(high[1]), high[1], 1.0)
        rates = max(rates, float((of_rates.max(axis=(0, 1)) - np.maximum(of_rates[0, 0], 0)).max()))
    return positions, rates


def cone_excess(robot: Row, task: Row, run: psmpc.Run) -> float:
    """Return by how much plans leave hard cones at worst, at 20 points of every interval of some samples [rad]."""
    kinematics = Kinematics(robot)
    n = len(run["coordinate"])
    worst = 0.0
    for sample in range(0, len(run.time), 4):
        index = int(run["window/first"][sample])
        cones = [cone for cone in task["stages"][index].get("cones", []) if cone["hard"]]
        if not cones or run["events/solve_failed"][sample] or run["events/braking"][sample]:
            continue
        count = int(run["window/nodes"][sample][index])
        h, X, u = plan(task, run, sample)
        Q0 = run["state/Q"][sample]
        found = []
        for k in range(count):
            for t in np.linspace(0, h[k, 0], 21):
                q = X[k, :n] + t * X[k, n:] + t**2 / 2 * u[k]
                turned = quaternion_from_any(matrix_of(Q0[3:7]) @ rotation(q[3:6]), Q0[3:7])
                poses = kinematics.poses(np.concatenate([q[:3], turned, q[6:]]))
                for cone in cones:
                    axis = poses[cone["frame"]][1] @ np.array(cone["axis"])
                    to = np.array(cone["of"]["direction"])
                    off = np.arctan2(np.linalg.norm(np.cross(axis, to)), axis @ to)
                    found.append(off - cone["within"])
        worst = max(worst, max(found) - max([*found[: len(cones)], 0.0]))
    return float(worst)


def body_rates(phi: Array, rate: Array) -> Array:
    """Return the angular velocity about a body's axes, of its rotation vector and that vector's rate."""
    angle = np.linalg.norm(phi, axis=-1, keepdims=True)
    small = angle < 1e-4
    safe = np.where(small, 1.0, angle)
    c1 = np.where(small, 0.5 - angle**2 / 24, (1 - np.cos(safe)) / safe**2)
    c2 = np.where(small, 1 / 6 - angle**2 / 120, (safe - np.sin(safe)) / safe**3)
    once = np.cross(phi, rate)
    return rate - c1 * once + c2 * np.cross(phi, once)


# Running


def run_task(seed: int, folder: Path) -> Row:
    """Draw a task, run it, and return what came of it; `faults` names what must not be."""
    robot, task = drawn(seed, folder)
    is_struck = seed % 10 == 0 or seed >= COUNT
    struck_after = float(np.random.default_rng([seed, 1]).uniform(0.2, 3)) if is_struck else None
    log = folder / "log.h5"
    command = [*PSMPC, "simulate", "task.yaml", "-o", "log.h5", "--no-figures"]
    began = time.monotonic()
    told = [began]
    lines: list[str] = []
    with subprocess.Popen(
        command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace"
    ) as child:

        def read() -> None:
            for line in child.stdout or ():
                lines.append(line)
                told.append(time.monotonic())

        reader = Thread(target=read)
        reader.start()
        took = None
        try:
            child.wait(LONGEST if struck_after is None else struck_after)
        except subprocess.TimeoutExpired:
            sent = time.monotonic()
            child.send_signal(signal.SIGTERM)
            try:
                child.wait(60)
            except subprocess.TimeoutExpired:
                child.kill()
            took = time.monotonic() - sent
        reader.join()
    told.append(time.monotonic())
    text = "".join(lines)
    row: Row = {
        "seed": seed,
        "what": " ".join(
            [
                "space" if robot.get("space") else "plane",
                task["mobility"],
                task["controller"]["kind"],
                task["solver"]["kind"] + ("" if task["solver"].get("compiled", True) else " interpreted"),
                task["plant"]["kind"],
                f"nodes {task['controller']['nodes']}",
            ]
        ),
        "noise": "uncertainty" in task,
        "code": child.returncode,
        "time": round(told[-1] - began, 1),
        "silence": round(float(np.diff(told).max()), 1),
    }
    faults = ["traceback"] if "Traceback" in text else []
    faults += ["silent"] if row["silence"] > SILENCE else []
    if struck_after is not None:
        row["ended_after_signal"] = None if took is None else round(took, 2)
        faults += ["signal not obeyed"] if took is not None and took > OBEYED else []
    elif took is not None:
        row["cut_off"] = True
        faults += ["signal not obeyed"] if took > OBEYED else []
    elif child.returncode not in (0, 3):
        faults.append("exit code")
        row["said"] = text[-500:]
    if log.exists():
        faults += check_log(robot, task, log, row)
    row["faults"] = faults
    return row


def not_checked(seed: int, error: BaseException) -> Row:
    """Return the row of a task that could not be drawn or checked."""
    about: Row = {"what": "", "noise": False, "code": None, "time": 0.0, "silence": 0.0}
    return {"seed": seed, **about, "said": repr(error)[:300], "faults": ["not checked"]}


def check_log(robot: Row, task: Row, log: Path, row: Row) -> list[str]:
    """Add to a row what a log says; return the faults."""
    try:
        run = psmpc.read_run(log)
    except LogError as error:
        row["said"] = str(error)
        return ["log cannot be read"]
    if not len(run.time):
        return []
    summary = run.summary()
    row |= {
        "samples": len(run.time),
        "succeeded": bool(summary.succeeded),
        "failed_solves": summary.failed_solves,
        "reason": summary.reason[:80],
    }
    faults = []
    if summary.succeeded:
        noise = "uncertainty" in task
        row["end_error"] = end_error(robot, task, run, 2.0 if noise else 0.0)
        faults += ["end error"] if row["end_error"] > WITHIN and not noise else []
    soft = "uncertainty" in task
    if not soft and task["controller"].get("discretization") != "euler" and task["controller"]["kind"] != "htmpc":
        row["beyond_position"], row["beyond_rate"] = plan_excess(robot, task, run)
        faults += ["position"] if row["beyond_position"] > BEYOND else []
        if robot.get("space"):
            row["beyond_cone"] = cone_excess(robot, task, run)
    return faults


def results() -> dict[int, Row]:
    """Return the rows of the results so far, by seed."""
    lines = RESULTS.read_text().splitlines() if RESULTS.exists() else []
    rows = [json.loads(line) for line in lines]
    return {row["seed"]: row for row in rows}


def summary() -> Iterator[str]:
    """Yield what the results come to."""
    rows = list(results().values())
    succeeded = [row for row in rows if row.get("succeeded")]
    noisy = [row for row in succeeded if row["noise"]]
    struck = [row["ended_after_signal"] for row in rows if row.get("ended_after_signal") is not None]
    quiet = [row["end_error"] for row in succeeded if not row["noise"]]
    yield f"{len(rows)} tasks, {len(succeeded)} missions succeeded, {sum(row['time'] for row in rows) / 3600:.1f} h"
    yield f"ended after {LONGEST:g} s: {sum('cut_off' in row for row in rows)}"
    yield f"defects: {dict(Counter(fault for row in rows for fault in row['faults'])) or 'none'}"
    yield f"longest time without a line: {max(row['silence'] for row in rows):.0f} s"
    yield f"ended by SIGTERM: {len(struck)}, the slowest in {max(struck, default=0):.1f} s"
    yield f"end error over tolerance, no noise: {len(quiet)}, at most {max(quiet, default=0):.6f}"
    within = sum(row["end_error"] <= 1 for row in noisy)
    yield f"end error over tolerance and 2 sigma, with noise: at most 1 in {within} of {len(noisy)}"
    positions = [row["beyond_position"] for row in rows if "beyond_position" in row]
    rates = [row["beyond_rate"] for row in rows if "beyond_rate" in row and "space" in row["what"]]
    yield f"plans beyond limits of positions: {len(positions)} runs, at most {max(positions, default=0):.1e}"
    most = max(rates, default=0)
    yield f"plans beyond limits of rates, spatial robots: {len(rates)} runs, at most {most:.1e} of the limit"
    cones = [row["beyond_cone"] for row in rows if row.get("beyond_cone")]
    yield f"plans beyond hard cones, spatial robots: in {len(cones)} runs, at most {max(cones, default=0):.1e} rad"


def main(words: list[str]) -> int:
    """Run the tasks that have no result yet; return 1 if there was a fault."""
    if words == ["summary"]:
        print("\n".join(summary()))
        return 0
    if len(words) == 2:
        folder = Path(f"any_task_{words[1]}")
        folder.mkdir(exist_ok=True)
        (folder / "log.h5").unlink(missing_ok=True)
        print(json.dumps(run_task(int(words[1]), folder)))
        return 0
    os.nice(5)
    done = results()
    missing = [seed for seed in range(int(words[0]) if words else COUNT) if seed not in done]

    def one(seed: int) -> Row:
        with TemporaryDirectory() as name:
            return run_task(seed, Path(name))

    with ThreadPoolExecutor(max_workers=2) as both, RESULTS.open("a") as file:
        made = {both.submit(one, seed): seed for seed in missing}
        for each in as_completed(made):
            error = each.exception()  # of the drawing or of the checks: a fault to look at, not an end of all
            row = each.result() if error is None else not_checked(made[each], error)
            file.write(json.dumps(row) + "\n")
            file.flush()
            if row["faults"]:
                print(json.dumps(row), flush=True)
    print("\n".join(summary()))
    return 1 if any(row["faults"] for row in results().values()) else 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
