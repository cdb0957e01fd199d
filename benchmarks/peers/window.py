"""A window as the peers read it: numbers, and the cost of its stages in CasADi. Knows nothing of psmpc."""

import json
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
        arms: Geometry of the arms.
        x0: Measured state (2n,).
        horizon, pending_cost: T_h [s], delta.
        stages: Its stages.
        starts: Where to start, by N_s, then by name.
        repeats: How often a solve is timed.
    """

    arms: list[dict[str, Any]]
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
        at = Q if stage.space == "joint" else self.poses(Q)
        error = at - stage.target
        Lbar = ca.dot(stage.weights, error**2) + ca.dot(stage.control_weights, u**2)
        return stage.omega * (Lbar - stage.offset) / stage.scale

    def end_error(self, stage: Stage, Q: ca.MX) -> ca.MX:
        """Return the rows of a stage's end condition."""
        at = Q if stage.space == "joint" else self.poses(Q)
        return (at - stage.target)[stage.end_rows]

    def poses(self, Q: ca.MX) -> ca.MX:
        """Return the poses of base and end-effectors."""
        poses, first = [Q[:3]], 3
        for arm in self.arms:
            c, s = ca.cos(Q[2]), ca.sin(Q[2])
            x, y = arm["mount"]
            tip, angle = Q[:2] + ca.vertcat(c * x - s * y, s * x + c * y), Q[2] + arm["mount_angle"]
            for length in arm["lengths"]:
                angle += Q[first]
                tip += length * ca.vertcat(ca.cos(angle), ca.sin(angle))
                first += 1
            poses += [tip, angle + arm["tool_angle"]]
        return ca.vertcat(*poses)


def read_windows(path: Path) -> dict[str, Window]:
    """Return the windows of a file by name."""
    numbers = json.loads(path.read_text(encoding="utf-8"))
    return {name: _window(window, numbers) for name, window in numbers["windows"].items()}


def _window(window: dict[str, Any], numbers: dict[str, Any]) -> Window:
    starts = {
        int(nodes): {name: Start(**_arrays(start)) for name, start in by_name.items()}
        for nodes, by_name in window["starts"].items()
    }
    return Window(
        arms=numbers["arms"],
        x0=np.array(window["x0"]),
        horizon=window["horizon"],
        pending_cost=window["pending_cost"],
        stages=[Stage(**_arrays(stage)) for stage in window["stages"]],
        starts=starts,
        repeats=numbers["repeats"],
    )


def _arrays(values: dict[str, Any]) -> dict[str, Any]:
    """Return a mapping with its lists of numbers as arrays, but those of row numbers."""
    return {
        key: np.array(value) if isinstance(value, list) and key != "end_rows" else value
        for key, value in values.items()
    }


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


def write_results(
    directory: Path, name: str, programs: Mapping[str, Callable[[Window, int], Solve]], most_stages: int = 2
) -> None:
    """Solve every window of so many stages with every program, each built from a window and N_s; write the results."""
    results = []
    for of, window in read_windows(directory / "windows.json").items():
        for nodes, starts in window.starts.items() if len(window.stages) <= most_stages else ():
            for program, build in programs.items():
                print(f"{program}, {of}, N_s = {nodes}", file=sys.stderr)
                found = measured(partial(build, window, nodes), starts, window.repeats)
                results.append({"program": program, "window": of, "nodes": nodes, **found})
    (directory / f"{name}.json").write_text(json.dumps(results), encoding="utf-8")
