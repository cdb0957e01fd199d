"""A window as the peers read it: numbers, and the cost of its stages in CasADi. Knows nothing of psmpc."""

import pickle
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import process_time
from typing import Any

import casadi as ca
import numpy as np

Solve = Callable[[Any], dict[str, Any]]
"""Solves a window from a start: status, objective, instants, iterations, and time of a core [s]."""


@dataclass(frozen=True)
class Stage:
    """One stage; attributes as in docs/formulation.md, the rows of the limits those of x = [Q; Qdot]."""

    space: str
    omega: float
    offset: float
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
    """Where a solve starts: states (K + 1, 2n), controls (K, n) and the durations of all stages but the last."""

    X: np.ndarray
    u: np.ndarray
    durations: np.ndarray


@dataclass(frozen=True)
class Window:
    """A window to be solved.

    Attributes:
        arms: Position and angle of the mount, lengths of the links, and angle of the tool of each arm.
        x0: Measured state (2n,).
        horizon, pending_cost: T_h [s], delta.
        stages: Its stages.
        starts: Where to start, by N_s, then by name.
        repeats: How often a solve is timed.
    """

    arms: list[tuple[tuple[float, float], float, list[float], float]]
    x0: np.ndarray
    horizon: float
    pending_cost: float
    stages: list[Stage]
    starts: dict[int, dict[str, Start]]
    repeats: int

    @property
    def n(self) -> int:
        """Number of coordinates."""
        return len(self.x0) // 2

    def cost(self, stage: Stage, Q: ca.MX, u: ca.MX) -> ca.MX:
        """Return omega L of a stage, as a CasADi expression."""
        Lbar = ca.dot(stage.weights, self.error(stage, Q) ** 2) + ca.dot(stage.control_weights, u**2)
        return stage.omega * (Lbar - stage.offset) / stage.scale

    def error(self, stage: Stage, Q: ca.MX) -> ca.MX:
        """Return the error of a stage in its space, as a CasADi expression."""
        return (Q if stage.space == "joint" else self.poses(Q)) - stage.target

    def poses(self, Q: ca.MX) -> ca.MX:
        """Return the poses of base and end-effectors."""
        poses, first = [Q[:3]], 3
        for (x, y), mount_angle, lengths, tool_angle in self.arms:
            c, s = ca.cos(Q[2]), ca.sin(Q[2])
            tip, angle = Q[:2] + ca.vertcat(c * x - s * y, s * x + c * y), Q[2] + mount_angle
            for length in lengths:
                angle += Q[first]
                tip += length * ca.vertcat(ca.cos(angle), ca.sin(angle))
                first += 1
            poses += [tip, angle + tool_angle]
        return ca.vertcat(*poses)


def measured(build: Callable[[], Solve], starts: Mapping[str, Any], repeats: int) -> dict[str, Any]:
    """Return what a program makes of a window from each of its starts: times are medians, `build` that of building."""
    began = process_time()
    solve = build()
    found: dict[str, Any] = {"build": process_time() - began}
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
        for nodes, starts in window.starts.items() if len(window.stages) <= most_stages else ():
            for program, build in programs.items():
                print(f"{program}, {of}, N_s = {nodes}", file=sys.stderr)
                found = measured(partial(build, window, nodes), starts, window.repeats)
                results.append({"program": program, "window": of, "nodes": nodes, **found})
    (directory / name).write_bytes(pickle.dumps(results))
