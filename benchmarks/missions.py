"""Runs random missions under every controller with one setting: prints the tables of docs/missions.md.

    python benchmarks/missions.py STUDY [MISSIONS]     runs what is missing of a study, prints its tables
    python benchmarks/missions.py figure               draws the study `effort`: end of missions over their effort
    python benchmarks/missions.py optimum              solves windows over whole missions of `reach` by IPOPT as well
    python benchmarks/missions.py headline             the short tables of the page, from the results: what is gained
    python benchmarks/missions.py by_hand              with arms as drawn and held ready, by controller and by hand,
    python benchmarks/missions.py gains [STUDY...]     in larger studies, or in these,
    python benchmarks/missions.py equal_effort         with at most some efforts,
    python benchmarks/missions.py deliveries           and how often by what the controller does not know
    python benchmarks/missions.py lateness             and with late commands,
    python benchmarks/missions.py late_masses          also with estimated masses,
    python benchmarks/missions.py late_others          under each controller
    python benchmarks/missions.py loads_found          and with loads that are estimated
    python benchmarks/missions.py files                writes the long tables to benchmarks/results/missions-*.csv

    plane       an object that drifts and spins is caught and brought to its destination: 100 missions
    space       the same with two arms of seven joints: 20 missions
    reach       hands reach poses from a base without thrusters: 30 missions
    posed       missions of `plane` with the arms as drawn, and held ready for the stage that needs them: 30 missions
    tour        tours of a planar robot with two unequal arms (tours.py), as drawn and held ready: 20 missions
    tour_space  tours of a spatial robot with two arms of seven joints, the same: 10 missions
    htmpc_plane  missions of `plane` also under HTMPC: 20 missions
    htmpc_tour  tours of the planar robot also under HTMPC with a free end: 20 tours
    effort      missions of `plane` by control weight: 10 missions
    best        each controller with its best control weight: 30 missions of `plane`
    noise       missions of `plane` by the noise of the measurements: 5 missions
    masses, load, drift  the same by what else the controller does not know
    loads       missions of `plane` with an object of 5 to 60 kg whose mass is estimated, or known: 100 missions
    delay       missions of `plane` by a delay that the controller is not told, with noise and wrong masses: 50 missions
    delay_tour  tours of the planar robot, the same: 50 tours
    delay_others  missions of `plane` by some of these delays under every controller: 10 missions
    timed       missions of `plane` that switch when hard switching did, at given times: 5 missions
    priorities  the task `transport` by the priority of each stage, and by horizon and the priority of Release

Mission k of a family is drawn with seed k. Stages, skills, weights, priorities, tolerances and limits are those of the
family's task, the same for every controller. Each run adds one line to benchmarks/missions.jsonl; a run that has its
line is not repeated, and studies share their runs. `PSMPC_DASK=ADDRESS` computes them on a Dask cluster.
"""

import json
import logging
import os
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pages import as_csv, markdown, write_long_tables
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.stats import binomtest, bootstrap
from tours import ahead, as_target, draw_tour, tour

import psmpc_cli as psmpc
from psmpc_cli.figures.style import in_style, line_look, mark_look, new_figure
from psmpc_cli.logs.summary import Summary
from psmpc_cli.ocp.feasibility.checks import load_task
from psmpc_cli.ocp.feasibility.forecast import forecast_configurations, forecast_stages
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.robot.reach import reach_of
from psmpc_cli.simulation.replay import replay
from psmpc_cli.simulation.run import build_experiment
from psmpc_cli.solvers import Outcome
from psmpc_cli.specs.load import Task, load_robot
from psmpc_cli.specs.stages import StageSpec
from psmpc_cli.studies.runner import compute

RESULTS = Path(__file__).with_suffix(".jsonl")
FIGURE = Path(__file__).parents[1] / "docs" / "figures" / "effort_front.png"

Row = dict[str, Any]
Changes = dict[str, Any]
Made = dict[str, dict[int, Row]]
"""Lines of the results by case, then by seed."""

CONTROLLERS: Mapping[str, Changes] = {
    "psmpc": {"controller.kind": "psmpc"},
    "smpc": {"controller.kind": "smpc"},
    "hard, free end": {"controller.kind": "hard", "controller.one_stage": "free_end"},
    "hard": {"controller.kind": "hard"},
    "htmpc": {"controller.kind": "htmpc"},
    "htmpc, free end": {"controller.kind": "htmpc", "controller.one_stage": "free_end"},
    "psmpc, whole mission": {
        "controller.kind": "psmpc",
        "controller.horizon": 20,
        "controller.nodes": 100,
        "solver.iterations": 20,
    },
    "psmpc, timed": {"controller.kind": "psmpc"},
    "hard, timed": {"controller.kind": "hard"},
}
"""What each mission is run under; `hard` and `htmpc` have windows as published.

The windows of `psmpc, whole mission` are longer than missions of `reach`, and iterated to the optimum. What is `timed`
switches when `TIMED_BY` did in the same mission.
"""

TIMED_BY = "hard"
"""Whose switch times in the same mission are given to what is `timed`."""

TITLES = {"psmpc": "PSMPC", "smpc": "SMPC", "hard, free end": "hard switching, free end", "hard": "hard switching"}
"""Names in the figure."""

PLANNED = ("psmpc", "smpc", "hard, free end")
"""Controllers whose windows have the end of the current stage."""

BY_STATE = ("psmpc", "smpc", "hard, free end", "hard", "htmpc")
"""Controllers that switch by the state."""

FEWER = {("plane", "hard"): 30, ("plane", "htmpc"): 5}
"""Missions of controllers whose missions are long."""

AGAINST = "hard, free end"
"""What the others are compared with, mission by mission."""

LEAN: Changes = {"controller.nodes": 25, "log.plans": False, "log.shares": False, "by_controller": {}}
"""What every run has: one mesh and one setting for all controllers; what is not read here is not logged."""

SIDEWAYS = 1.5
"""How far to either side of the base the grippers go when they have let go [m]."""

OTHERS = 100
"""Seed of the first mission that settings are compared on; results with the chosen one are from missions before it."""


# ------------------------------------------------------------------------------------------------ missions


def draw_plane(rng: np.random.Generator) -> Changes | None:
    """Draw what differs from `catch_drifting`; None where the arms cannot hold the object so."""
    model = RobotModel(load_robot("planar_dual_arm"))
    taken = pose(rng, (1.5, 3.5), 90)
    left = pose(rng, (0.0, 2.0), 60)
    drift = rng.uniform(0.0, 0.02)
    heading = rng.uniform(-np.pi, np.pi)
    spin = rng.uniform(-2.0, 2.0)
    mass = np.exp(rng.uniform(np.log(5.0), np.log(60.0)))
    half_width = rng.uniform(0.60, 0.68)
    turn = rng.uniform(125.0, 145.0)
    stand_off = rng.uniform(0.90, 1.02)
    arms = np.radians(rng.uniform([-45, -60, -30], [45, 60, 30], (2, 3)))
    grip = np.array([half_width, stand_off, np.radians(turn)])
    holding = reach_of(model, "arm_1", np.zeros(3), grip).configuration
    mirrored = reach_of(model, "arm_2", np.zeros(3), grip * [-1, 1, -1]).configuration
    if holding is None or mirrored is None:
        return None
    return {
        "initial": {"base": [0, 0, 0], "arm_1": arms[0].tolist(), "arm_2": arms[1].tolist()},
        "object.pose": at(taken),
        "object.motion": {"linear": [drift * np.cos(heading), drift * np.sin(heading)], "angular": f"{spin:.3f} deg"},
        "object.mass": float(mass),
        "object.inertia": float(2.67 / 20 * mass),
        "object.grasp.at": {
            "arm_1": [float(half_width), 0, f"{turn:.3f} deg"],
            "arm_2": [float(-half_width), 0, f"{-turn:.3f} deg"],
        },
        "object.destination.pose": at(left, [0.0, stand_off]),
        "stages.approach.target.base": {"object": [0, float(-stand_off), "0 deg"]},
        "stages.capture.target.base": {"object": [0, float(-stand_off), "0 deg"]},
        "stages.transport.target": {"base": at(left), "arm_1": list(holding), "arm_2": list(mirrored)},
        "stages.release.target": {
            "base": at(left),
            "arm_1": at(left, [SIDEWAYS, 0.0]),
            "arm_2": at(left, [-SIDEWAYS, 0.0]),
        },
    }


def pose(rng: np.random.Generator, distances: tuple[float, float], angle: float) -> np.ndarray:
    """Return a pose [x, y, angle] [m, deg] at a random distance and bearing from the origin."""
    distance = rng.uniform(*distances)
    bearing = rng.uniform(-np.pi, np.pi)
    return np.array([distance * np.cos(bearing), distance * np.sin(bearing), rng.uniform(-angle, angle)])


def at(frame: np.ndarray, offset: ArrayLike = (0.0, 0.0)) -> list[Any]:
    """Return the pose at an offset in a frame [x, y, angle] [m, deg], as a task has it."""
    c = np.cos(np.radians(frame[2]))
    s = np.sin(np.radians(frame[2]))
    x, y = frame[:2] + np.array([[c, -s], [s, c]]) @ offset
    return [float(x), float(y), f"{frame[2]:.4f} deg"]


def draw_space(rng: np.random.Generator) -> Changes:
    """Draw what differs from `catch_tumbling`: the object's pose, motion and mass, where it goes, and postures."""
    taken = rng.uniform(2.0, 3.0) * direction(rng)
    attitude = Rotation.from_rotvec(rng.uniform(0.0, np.radians(45)) * direction(rng))
    drift = rng.uniform(0.0, 0.01) * direction(rng)
    spin = np.radians(rng.uniform(0.0, 2.0)) * direction(rng)
    mass = np.exp(rng.uniform(np.log(5.0), np.log(30.0)))
    home = rng.uniform(0.0, 0.8) * direction(rng)
    x, y, z, w = attitude.as_quat()
    base = {"position": home.tolist()}
    left = np.array([1.02, 0.21, -0.77, 1.11, 0.9, -1.56, -0.42])
    start = left + rng.uniform(-0.2, 0.2, 7)
    mirror = np.array([-1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
    return {
        "initial.left": start.tolist(),
        "initial.right": (mirror * start).tolist(),
        "object.pose": {
            "position": taken.tolist(),
            "attitude": {"quaternion": [float(w), float(x), float(y), float(z)]},
        },
        "object.motion": {"linear": drift.tolist(), "angular": spin.tolist()},
        "object.mass": float(mass),
        "object.inertia": (mass / 15 * np.array([0.6, 0.4, 0.5])).tolist(),
        "object.destination.pose": {"position": (home + np.array([1.5, 0.0, -0.4])).tolist()},
        "stages.carry.target.base": base,
        "stages.let_go.target.base": base,
    }


def direction(rng: np.random.Generator) -> np.ndarray:
    """Return a random unit vector."""
    vector = rng.normal(size=3)
    return vector / np.linalg.norm(vector)


def draw_reach(rng: np.random.Generator) -> Changes | None:
    """Draw what differs from `float_and_reach`: postures before and after, and the poses that the hands reach.

    They are those to which a straight motion of the joints leads, so that there is a way; None where it leaves limits.
    """
    model = RobotModel(load_robot("planar_dual_arm"))
    folded = np.array([0.3, 0.3, 0.3, -0.3, -0.3, -0.3])
    start = folded + rng.uniform(-0.5, 0.5, 6)
    end = folded + rng.uniform(-0.5, 0.5, 6)
    way = rng.uniform(-1.0, 1.0, 6)
    Q = floated(model, np.concatenate([np.zeros(3), start]), way)
    poses = model.poses(Q)
    low, high = np.transpose(model.spec.limits["arms"].position * len(model.spec.arms))
    if ((start + way < low) | (start + way > high)).any():
        return None
    return {
        "initial.arm_1": start[:3].tolist(),
        "initial.arm_2": start[3:].tolist(),
        "stages.reach.target": {"arm_1": poses[1].tolist(), "arm_2": poses[2].tolist()},
        "stages.fold.target": {"arm_1": end[:3].tolist(), "arm_2": end[3:].tolist()},
    }


def floated(model: RobotModel, Q: np.ndarray, way: np.ndarray, steps: int = 200) -> np.ndarray:
    """Return the configuration (9,) after a motion of the joints (6,) [rad] from rest that nothing pushes."""
    for _ in range(steps):
        H = model.mass_matrix(Q)
        base = -np.linalg.solve(H[:3, :3], H[:3, 3:] @ way)  # no momentum: H_bb v_b + H_bq qdot = 0
        Q = Q + np.concatenate([base, way]) / steps
    return Q


FAMILIES: Mapping[str, tuple[str | Changes, Callable[[np.random.Generator], Changes | None]]] = {
    "plane": ("catch_drifting", draw_plane),
    "space": ("catch_tumbling", draw_space),
    "reach": ("float_and_reach", draw_reach),
    "tour": (tour("plane"), partial(draw_tour, space="plane")),
    "tour_space": (tour("space"), partial(draw_tour, space="space")),
    "transport": ("transport", lambda rng: {}),
}
"""Task of each family of missions, and what draws a mission's changes of it."""


def draw_mission(family: str, seed: int, changes: Changes) -> Task:
    """Return a mission with some changes; draws that `psmpc check` rejects without them are repeated."""
    task, draw = FAMILIES[family]
    rng = np.random.default_rng(seed)
    while True:
        drawn = draw(rng)
        if drawn is None:
            continue
        mission = {**LEAN, "time_limit": 120, **drawn}
        try:
            load_task(task, mission)
        except psmpc.SpecError:
            continue
        return load_task(task, {**mission, **changes, "seed": seed})


def held_ready(task: Task) -> Changes:
    """Return the changes by which arms that the end of a stage does not ask for are wanted where they work next.

    They work in the next stage whose end asks for them, in the posture to which the motion leads by inverse kinematics.
    An arm that holds an object, or that points at nothing, stays as it is.
    """
    forecasts = forecast_stages(task)
    stops = forecast_configurations(task, forecasts)
    model = forecasts[0].model
    joints_of = {arm: slice(rows.start, rows.stop) for arm, rows in model.parts.items() if arm != "base"}
    before = model.nq - model.n
    changes: Changes = {}
    for index, stage in enumerate(task.spec.stages):
        for number, arm in enumerate(model.spec.arms, start=1):
            working = [j for j, each in enumerate(task.spec.stages) if j >= index and asks_for(each, arm)]
            if index in task.spec.held_stages or not working or working[0] == index:
                continue
            work = task.spec.stages[working[0]]
            where = slice(before + joints_of[arm].start, before + joints_of[arm].stop)
            joints = stops[working[0] + 1][where]
            if forecasts[working[0]].stage.space == "point":
                joints = pointing(model, stops[working[0] + 1], where, number, work.target[arm])
            space = forecasts[index].stage.space
            if space == "joint":
                changes[f"stages.{stage.name}.target.{arm}"] = joints.tolist()
            elif space == "task":
                Q = stops[index + 1].copy()
                Q[where] = joints
                changes[f"stages.{stage.name}.target.{arm}"] = as_target(model.poses(Q)[number])
    return changes


def pointing(model: RobotModel, Q: np.ndarray, where: slice, number: int, point: ArrayLike) -> np.ndarray:
    """Return the joints, among `where` of Q, with which an arm points at a point and that are nearest to those of Q."""
    begin = Q[where]

    def error(joints: np.ndarray) -> np.ndarray:
        pose = model.poses(np.concatenate([Q[: where.start], joints, Q[where.stop :]]))[number]
        there = np.asarray(point, float) - pose[: len(np.asarray(point))]
        return np.concatenate([np.subtract(ahead(pose, float(np.linalg.norm(there))), point), 1e-3 * (joints - begin)])

    low, high = np.transpose(model.spec.limits["arms"].position)
    return np.asarray(least_squares(error, np.clip(begin, low, high), bounds=(low, high)).x)


def asks_for(stage: StageSpec, arm: str) -> bool:
    """Tell whether the end of a stage asks for an arm."""
    return stage.ends_when is not None and not {arm, "arms", "all"}.isdisjoint(stage.ends_when.coordinates)


# ------------------------------------------------------------------------------------------------ studies


@dataclass(frozen=True)
class Case:
    """What missions are run with, beside what is drawn.

    Attributes:
        controller: The controller, by the row of the tables.
        level: What differs from the family's task, in words; "" if nothing does.
        changes: The keys that say so.
    """

    controller: str
    level: str
    changes: Changes

    @property
    def name(self) -> str:
        """The name under which the results have it."""
        return f"{self.controller}; {self.level}" if self.level else self.controller


def cases(levels: Mapping[str, Changes], controllers: Sequence[str]) -> list[Case]:
    """Return each level under each controller."""
    return [
        Case(controller, level, {**CONTROLLERS[controller], **changes})
        for level, changes in levels.items()
        for controller in controllers
    ]


def weight(value: float) -> tuple[str, Changes]:
    """Return a control weight of all skills of `catch_drifting`."""
    return f"W_r = {value:g}", {f"skills.{skill}.weights.control": value for skill in ("move", "reach")}


def noise(sigma: float) -> tuple[str, Changes]:
    """Return noise of every measured position [m] and angle [rad], of the object as of the robot."""
    quantities = ("position", "angle", "object_position", "object_angle")
    return f"{1e3 * sigma:g} mm", {"uncertainty.noise": dict.fromkeys(quantities, sigma)}


def drift(linear: float, angular: float) -> tuple[str, Changes]:
    """Return an error of the object's velocity [m/s, deg/s], along and about each axis."""
    changes = {"uncertainty.object.linear": linear, "uncertainty.object.angular": f"{angular:g} deg"}
    return f"{linear:g} m/s, {angular:g} deg/s", changes


IMPRECISE = {
    "uncertainty.noise": dict.fromkeys(
        ("position", "angle", "velocity", "angular_velocity", "object_position", "object_angle"), 1e-3
    ),
    "uncertainty.mass": 0.1,
    "uncertainty.inertia": 0.1,
}
"""Noise of a measurement, 1 mm, 1 mrad and as much in a second, and masses and inertias wrong by up to 10 %."""

IMPRECISE_WITHOUT_OBJECT = {
    **IMPRECISE,
    "uncertainty.noise": dict.fromkeys(("position", "angle", "velocity", "angular_velocity"), 1e-3),
}


DELAYS = (0.05, 0.1, 0.2, 0.3)
"""Delays of commands [s]."""

JITTER = 0.03
"""Standard deviation of the delay of a command [s]."""


def late(seconds: float, jitter: float = 0.0, imprecise: Changes = IMPRECISE) -> tuple[str, Changes]:
    """Return a delay that the controller is not told and its jitter [s], beside what else it does not know."""
    name = f"{seconds:g} s, jitter" if jitter else f"{seconds:g} s"
    return name, {**imprecise, "uncertainty.delay": f"{seconds:g} s", "uncertainty.jitter": jitter}


MASSES = "masses estimated"
"""What is added to the name of a level at which the controller estimates the masses of the robot."""


DECLARED, OFF_BY = 32.5, 27.5
"""Mass of the object that the task states, and how far the true one is from it at most [kg]."""


def loads() -> dict[str, Changes]:
    """Return objects of `plane` whose mass the controller estimates, knows, or estimates with a robot that is off too.

    The true mass is drawn; in `KNOWN_LOAD` it is that of the same mission where it is estimated. Inertias go with it.
    """
    drawn = {"object.grasp.known": "estimated", **with_mass(DECLARED), "uncertainty.object.mass": OFF_BY / DECLARED}
    noise = {"uncertainty.noise": IMPRECISE["uncertainty.noise"]}
    return {"load estimated": drawn | noise, KNOWN_LOAD: noise, "load estimated, robot off": drawn | IMPRECISE}


def with_mass(mass: float) -> Changes:
    """Return an object of a mass [kg] in a mission of `plane`, with its inertia in proportion."""
    return {"object.mass": mass, "object.inertia": 2.67 / 20 * mass}


KNOWN_LOAD = "load known"
"""Level at which the controller knows the true mass."""


def delays(imprecise: Changes) -> dict[str, Changes]:
    """Return no delay, and each delay without jitter and with it, beside what else the controller does not know.

    At some of them the controller also estimates the masses of the robot.
    """
    levels = {"none": imprecise, **dict(late(each, jitter, imprecise) for jitter in (0.0, JITTER) for each in DELAYS)}
    estimated = {
        f"{level}, {MASSES}": {**levels[level], "controller.masses": "estimated"}
        for level in ("none", "0.1 s", "0.3 s")
    }
    return levels | estimated


NOT_ESTIMATED = "0.1 s, `controller.delay: 0`"
"""Level at which the controller counts with no delay."""

PRIORITIES = (1e-3, 1e-2, 1e-1, 1.0, 1e1, 1e2, 1e3)
STAGES = ("approach", "capture", "transport", "release")
HORIZONS = (2.0, 3.0, 4.0, 6.0, 8.0, 12.0)
"""What the study of priorities goes through [1, s]."""

DRAWN = 30
"""How many priorities of all stages it draws."""

LAST_PRIORITIES = (1e-3, 1e-2, 3e-2, 1e-1, 1.0)
"""Priorities of Release that it goes through with each horizon."""


def priority(stage: str, value: float) -> tuple[str, Changes]:
    """Return a priority of one stage of `transport`."""
    return f"{stage} {value:g}", {f"stages.{stage}.priority": value}


def drawn(number: int) -> tuple[str, Changes]:
    """Return priorities of all stages drawn at random, uniform in their logarithm over the range of the study."""
    rng = np.random.default_rng(number)
    values = np.exp(rng.uniform(np.log(PRIORITIES[0]), np.log(PRIORITIES[-1]), len(STAGES)))
    changes = {f"stages.{stage}.priority": float(f"{value:.3g}") for stage, value in zip(STAGES, values, strict=True)}
    return f"drawn {number}", changes


def horizon(length: float, value: float) -> tuple[str, Changes]:
    """Return a horizon [s] and a priority of Release."""
    return f"{length:g} s, release {value:g}", {"controller.horizon": length, "stages.release.priority": value}


READY = "held ready"
"""Level at which arms are held ready."""

LEVELS: Mapping[str, Mapping[str, Changes]] = {
    **{name: {"": {}, READY: {}} for name in ("posed", "tour", "tour_space")},
    **{name: {"": {}} for name in ("plane", "space", "reach", "htmpc_plane", "htmpc_tour")},
    "effort": dict(map(weight, (0.02, 0.05, 0.1, 0.25, 0.5, 1, 2, 4, 8, 16))),
    "noise": dict(map(noise, (1e-4, 3e-4, 1e-3, 3e-3, 1e-2))),
    "masses": {
        f"{100 * error:g} %": {
            "uncertainty.mass": error,
            "uncertainty.inertia": error,
            "uncertainty.object.mass": error,
        }
        for error in (0.1, 0.3)
    },
    "load": {
        "not known": {"object.grasp.known": False},
        **{
            f"by up to 85 % other, {name}": {"uncertainty.object.mass": 0.85, "object.grasp.known": known}
            for name, known in {"as declared": True, "`estimated`": "estimated"}.items()
        },
    },
    "drift": dict([drift(0.01, 1.0), drift(0.03, 3.0)]),
    "delay": delays(IMPRECISE),
    "delay_tour": delays(IMPRECISE_WITHOUT_OBJECT),
    "delay_others": {
        "none": IMPRECISE,
        **dict(late(seconds) for seconds in (0.1, 0.3)),
        **dict([late(0.3, JITTER)]),
        "0.3 s, jitter, `if_missed`": {
            **late(0.3, JITTER)[1],
            "stages.capture.if_missed": {"back_to": "approach", "times": 2},
        },
        NOT_ESTIMATED: {**IMPRECISE, "uncertainty.delay": "0.1 s", "controller.delay": 0},
    },
    "loads": loads(),
    "timed": {"": {}},
    "priorities": {
        **dict(priority(stage, value) for stage in STAGES for value in PRIORITIES),
        **dict(horizon(length, value) for length in HORIZONS for value in LAST_PRIORITIES),
        **dict(map(drawn, range(DRAWN))),
    },
}
"""Levels of each study."""

STUDIES: Mapping[str, tuple[str, Sequence[str], range]] = {
    "plane": ("plane", BY_STATE, range(100)),
    "space": ("space", PLANNED, range(20)),
    "reach": ("reach", ("psmpc", "smpc", "hard, free end", "hard", "psmpc, whole mission"), range(30)),
    "posed": ("plane", PLANNED, range(30)),
    "tour": ("tour", PLANNED, range(20)),
    "tour_space": ("tour_space", PLANNED, range(10)),
    "htmpc_plane": ("plane", ("psmpc", "hard, free end", "htmpc, free end", "hard", "htmpc"), range(20)),
    "htmpc_tour": ("tour", ("psmpc", "hard, free end", "htmpc, free end"), range(20)),
    "effort": ("plane", ("psmpc", "smpc", "hard, free end", "hard"), range(OTHERS, OTHERS + 10)),
    "best": ("plane", ("psmpc", "smpc", "hard, free end", "hard"), range(30)),
    "noise": ("plane", PLANNED, range(5)),
    "masses": ("plane", PLANNED, range(5)),
    "load": ("plane", PLANNED, range(5)),
    "drift": ("plane", PLANNED, range(5)),
    "delay": ("plane", ("psmpc",), range(50)),
    "delay_tour": ("tour", ("psmpc",), range(50)),
    "delay_others": ("plane", PLANNED, range(10)),
    "loads": ("plane", ("psmpc",), range(OTHERS, OTHERS + 100)),
    "timed": ("plane", ("psmpc, timed", "hard, timed"), range(5)),
    "priorities": ("transport", ("psmpc",), range(1)),
}
"""Family, controllers and seeds of each study."""


def measure(item: tuple[str, Case, int]) -> Row:
    """Run a mission and return its line of the results."""
    logging.disable(logging.CRITICAL)
    family, case, seed = item
    line = {"family": family, "case": case.name, "seed": seed}
    times = given_times(family, seed) if case.controller.endswith("timed") else {}
    ready = held_ready(draw_mission(family, seed, {})) if case.level == READY else {}
    true_load = with_mass(drawn_mass(family, seed)) if case.level == KNOWN_LOAD else {}
    run = psmpc.simulate(draw_mission(family, seed, {**case.changes, **times, **ready, **true_load}))
    summary = run.summary()
    ends = np.array([float(stage.switch_time) for stage in summary.stages])
    starts = np.array([float(stage.actual_start) for stage in summary.stages])
    margins = [each.margin for each in summary.monitors]
    return {
        **line,
        "succeeded": bool(summary.succeeded),
        "why": "; ".join(each.name for each in summary.monitors if not each.held) or summary.reason,
        "time": round(float(summary.duration), 3),
        "ends": ends.round(3).tolist(),
        "starts": starts.round(3).tolist(),
        "effort": round(float(summary.control_effort), 4),
        "force": round(float(np.nanmax(run["peak/base_force"])), 3),
        "impulse": round(float(run["effort/base_force"].sum()), 2),
        "margin": round(float(min(margins)), 4) if margins else None,
        "speed": speed_excess(summary),
        "delay_off": delay_off(run),
        **load_found(run),
        "failed_solves": int(summary.failed_solves),
        **({"levels": level_counts(run)} if run.task.spec.controller.traits.has_levels else {}),
    }


def speed_excess(summary: Summary) -> float | None:
    """Return by what share of a speed limit the robot exceeded it most at any tick; negative if it kept all of them."""
    return next((round(-float(each.relative), 4) for each in summary.limits if each.kind == "velocity"), None)


KNOWN_AFTER = 1.0
"""Time of motion after which the estimated delay is looked at [s]."""


def delay_off(run: psmpc.Run) -> float | None:
    """Return the error of the estimated delay after a second of motion [s]; None where it is not estimated.

    The robot moves from when the first command arrives.
    """
    if "delay/expected" not in run.arrays:
        return None
    true = float(run.task.spec.uncertainty.delay)
    sample = int(np.searchsorted(run.time, true + KNOWN_AFTER - 1e-9))
    return round(float(run["delay/expected"][sample]) - true, 4) if sample < len(run.time) else None


CARRIED = 3.0
"""Time of carrying after which the estimated load is looked at [s]."""


def drawn_mass(family: str, seed: int) -> float:
    """Return the true mass of the object in a mission where the controller estimates it [kg]."""
    capture = build_experiment(draw_mission(family, seed, loads()["load estimated"])).capture
    if capture is None:
        raise RuntimeError("the mission has no object")
    return float(capture.body.mass)


def load_found(run: psmpc.Run) -> Row:
    """Return the object's true mass [kg], and the estimate's error and deviation as shares of it; nothing without."""
    if "load/mass" not in run.arrays:
        return {}
    mass = float(run["object/mass"])
    sample = int(np.searchsorted(run.time, float(np.max(run["grasp/closed_at"])) + CARRIED))
    if not sample < len(run.time):
        return {"mass": mass}
    off = float(run["load/mass"][sample]) / mass - 1
    return {
        "mass": mass,
        "load_off": round(off, 4),
        "load_sigma": round(float(run["load/mass_deviation"][sample]) / mass, 4),
    }


def level_counts(run: psmpc.Run) -> dict[str, int]:
    """Return how many levels of HTMPC were solved or not, and how many bounds on earlier costs the last ones kept.

    A sample has a bound for each level that converged but the last one, whose plan is applied.
    """
    summary = run.summary()
    is_solved = run["levels/solved"] == 1
    bounds = int(is_solved.sum() - is_solved.any(axis=1).sum())
    return {
        "solved": int(is_solved.sum()),
        "unsolved": int(summary.unsolved_levels or 0),
        "bounds": bounds,
        "kept": bounds - int(summary.raised_levels or 0),
    }


def given_times(family: str, seed: int) -> Changes:
    """Return the changes by which all stages but the last end when they did in the run of `TIMED_BY`."""
    changes: Changes = {}
    ends = results(family)[TIMED_BY][seed]["ends"]
    for stage, end in zip(STAGES[:-1], ends[:-1], strict=True):
        changes[f"stages.{stage}.at"] = end
        changes[f"stages.{stage}.ends_when"] = None
    return changes


def results(family: str) -> Made:
    """Return the lines of a family of missions."""
    made: Made = {}
    lines = RESULTS.read_text(encoding="utf-8").splitlines() if RESULTS.exists() else []
    for row in map(json.loads, lines):
        if row["family"] == family:
            made.setdefault(row["case"], {})[row["seed"]] = row
    return made


def run_missing(family: str, wanted: Sequence[Case], seeds: Sequence[int]) -> Made:
    """Run the missions of some cases that the results lack; return the lines of these cases, in their order."""
    chosen = {case.name: seeds[: FEWER.get((family, case.controller))] for case in wanted}
    made = results(family)
    missing = [
        (family, case, seed)
        for seed in seeds
        for case in wanted
        if seed in chosen[case.name] and seed not in made.get(case.name, {})
    ]
    with RESULTS.open("a", encoding="utf-8") as file:
        for _, row in compute(measure, dict(enumerate(missing)), 2, os.environ.get("PSMPC_DASK")):
            file.write(json.dumps(row) + "\n")
            file.flush()
    made = results(family)
    return {name: {seed: made[name][seed] for seed in each} for name, each in chosen.items()}


COMPARED_ON = range(OTHERS, OTHERS + 20)
"""Missions on which the settings of a controller are compared; those of `effort` are the first ten."""


def best_cases() -> list[Case]:
    """Return each controller with its best setting of those of `effort`."""
    family, controllers, _ = STUDIES["effort"]
    made = run_missing(family, cases(LEVELS["effort"], controllers), COMPARED_ON)
    return [
        min(cases(LEVELS["effort"], [controller]), key=lambda case: rank(made[case.name])) for controller in controllers
    ]


def rank(rows: Mapping[int, Row]) -> tuple[int, float]:
    """Return what settings are compared by: how many missions fail, then the median time of those that succeed [s]."""
    times = [row["time"] for row in rows.values() if row["succeeded"]]
    return len(rows) - len(times), float(np.median(times)) if times else np.inf


# ------------------------------------------------------------------------------------------------ tables


def successes(made: Made) -> Iterator[Row]:
    """Yield how often each case succeeds, and what its missions take."""
    for name, rows in made.items():
        succeeded = [row for row in rows.values() if row["succeeded"]]
        rate = binomtest(len(succeeded), len(rows)).proportion_ci(method="wilson")
        line: Row = {
            "controller": f"`{name}`",
            "succeeded": f"{len(succeeded)} of {len(rows)} ({100 * rate.low:.0f} to {100 * rate.high:.0f} %)",
            "end [s]": spread([row["time"] for row in succeeded]),
            "effort": spread([row["effort"] for row in succeeded]),
            "impulse on the base [N s]": spread([row.get("impulse", np.nan) for row in succeeded]),
            "largest force on the base [N]": spread([row["force"] for row in succeeded]),
            "second stage early by [s]": spread([row["ends"][0] - row["starts"][1] for row in succeeded]),
        }
        if any(row["margin"] is not None for row in succeeded):
            line["smallest margin of a verdict [%]"] = spread([100 * row["margin"] for row in succeeded])
        line["failed solves a run"] = f"{np.mean([row['failed_solves'] for row in rows.values()]):.2f}"
        yield line


def differences(made: Made) -> Iterator[Row]:
    """Yield what each case needs more or less than hard switching with a free end, where both succeed.

    That is at the same level or, if there is none, at the first. What PSMPC needs against SMPC follows.
    """
    for name, rows in made.items():
        controller, _, level = name.partition("; ")
        for against in (AGAINST, "smpc"):
            others = {each: found for each, found in made.items() if each.partition("; ")[0] == against}
            if controller == against or not others or (against == "smpc" and controller != "psmpc"):
                continue
            same = f"{against}; {level}" if level else against
            other = others[same if same in others else next(iter(others))]
            yield {"controller": f"`{name}`", "against": f"`{against}`", **compared(rows, other)}


def compared(rows: Mapping[int, Row], other: Mapping[int, Row]) -> Row:
    """Return what missions under one controller need more or less than under another one, where both succeed."""
    pairs = [
        (row, other[seed])
        for seed, row in rows.items()
        if seed in other and row["succeeded"] and other[seed]["succeeded"]
    ]

    def ratio(name: str) -> str:
        return median([row[name] / base[name] for row, base in pairs if row.get(name) and base.get(name)])

    return {
        "both succeed": len(pairs),
        "end, difference [s]": median([row["time"] - base["time"] for row, base in pairs]),
        "end, ratio": ratio("time"),
        "effort, ratio": ratio("effort"),
        "impulse, ratio": ratio("impulse"),
        "largest force, ratio": ratio("force"),
    }


ALLOWED_EFFORTS = (2.0, 2.25, 2.5, 3.0)
"""Efforts at which the study `effort` compares controllers."""


def at_equal_effort(made: Made) -> Iterator[Row]:
    """Yield how early missions end with at most some efforts, and what that is less than with two other controllers."""
    seeds = next(iter(made.values())).keys()
    controllers = dict.fromkeys(name.partition("; ")[0] for name in made)
    ends = {
        controller: np.array([earliest_ends(made, controller, seed) for seed in seeds]) for controller in controllers
    }
    for controller, own in ends.items():
        for effort, found, hard, smpc in zip(ALLOWED_EFFORTS, own.T, ends[AGAINST].T, ends["smpc"].T, strict=True):
            both = np.isfinite(found - hard)
            yield {
                "controller": f"`{controller}`",
                "effort": f"at most {effort:g}",
                "missions": int(both.sum()),
                "end [s]": spread(found[both]),
                f"less the end of `{AGAINST}` [s]": median((found - hard)[both]),
                "less the end of `smpc` [s]": median((found - smpc)[np.isfinite(found - smpc)]),
            }


def earliest_ends(made: Made, controller: str, seed: int) -> np.ndarray:
    """Return when a mission ends at the earliest with at most each of the efforts [s], over control weights.

    Between the runs it is interpolated along the effort; NaN where every run takes more.
    """
    runs = [
        rows[seed] for name, rows in made.items() if name.partition("; ")[0] == controller and rows[seed]["succeeded"]
    ]
    efforts, times = np.array(sorted((row["effort"], row["time"]) for row in runs)).T
    return np.interp(ALLOWED_EFFORTS, efforts, np.minimum.accumulate(times), left=np.nan)


def failures(made: Made) -> Iterator[str]:
    """Yield why missions failed, and their numbers."""
    for name, rows in made.items():
        reasons: dict[str, list[int]] = {}
        for seed, row in rows.items():
            if not row["succeeded"]:
                reasons.setdefault(row["why"], []).append(seed)
        for reason, seeds in reasons.items():
            shown = ", ".join(map(str, sorted(seeds)[:8])) + (", ..." if len(seeds) > 8 else "")
            yield f"- `{name}`: {len(seeds)} failed: {reason} (missions {shown})"


def priorities(made: Made) -> Iterator[str]:
    """Yield when `transport` ends by the priority of each stage, by horizon and the priority of Release, and drawn."""

    def row_of(level: str) -> Row:
        (row,) = made[f"psmpc; {level}"].values()
        return row

    def outcome(level: str) -> str:
        row = row_of(level)
        early = row["ends"][2] - row["starts"][3]
        return f"{row['time']:.1f} ({early:.1f})" if row["succeeded"] else f"lost ({early:.1f})"

    by_stage = []
    for stage in STAGES:
        outcomes = {f"{value:g}": outcome(priority(stage, value)[0]) for value in PRIORITIES}
        by_stage.append({"priority of": stage, **outcomes})
    by_horizon = []
    for length in HORIZONS:
        outcomes = {f"{value:g}": outcome(horizon(length, value)[0]) for value in LAST_PRIORITIES}
        by_horizon.append({"horizon [s]": f"{length:g}", **outcomes})
    yield from ("End of the mission [s] with one priority changed:", "")
    yield from markdown(by_stage)
    yield from ("", "End of the mission [s] by horizon and priority of Release:", "")
    yield from markdown(by_horizon)
    yield from ("", "Draws of all four priorities that keep the object:", "")
    ratios = []
    for level, changes in map(drawn, range(DRAWN)):
        ratio = changes["stages.release.priority"] / changes["stages.transport.priority"]
        ratios.append((ratio, row_of(level)["succeeded"]))
    edges = (0.0, 0.01, 0.03, 0.1, 1.0, np.inf)
    by_ratio = []
    for low, high in pairwise(edges):
        within = [succeeded for ratio, succeeded in ratios if low <= ratio < high]
        of = f"{low:g} to {high:g}" if np.isfinite(high) else f"{low:g} or more"
        by_ratio.append({"release over transport": of, "drawn": len(within), "kept": sum(within)})
    yield from markdown(by_ratio)


OF_TIMED = ("controller", "succeeded", "end [s]", "effort", "failed solves a run")
"""Columns of the study `timed`, in which one of the controllers never succeeds."""


def spread(values: Sequence[float]) -> str:
    """Return the 5, 50 and 95 % quantiles of a sample."""
    known = np.array(values, float)
    known = known[np.isfinite(known)]
    return " / ".join(f"{value:.1f}" for value in np.quantile(known, (0.05, 0.5, 0.95))) if len(known) else "-"


def median(values: Sequence[float]) -> str:
    """Return the median of a sample, with its bootstrap 95 % interval."""
    if len(values) < 2:
        return "-"
    sample = np.asarray(values)
    found = bootstrap((sample,), np.median, method="percentile", rng=np.random.default_rng(0)).confidence_interval
    return f"{np.median(sample):.2f} ({found.low:.2f} to {found.high:.2f})"


def study(name: str, count: str = "") -> Iterator[str]:
    """Run what is missing of a study and yield the lines of its tables."""
    family, controllers, seeds = STUDIES[name]
    wanted = best_cases() if name == "best" else cases(LEVELS[name], controllers)
    if name == "timed":
        run_missing(family, cases(LEVELS[name], [TIMED_BY]), seeds)
    made = run_missing(family, wanted, seeds[: int(count)] if count else seeds)
    if name == "priorities":
        yield from priorities(made)
        return
    if name == "timed":
        yield from markdown({heading: row[heading] for heading in OF_TIMED} for row in successes(made))
    else:
        yield from markdown(successes(made))
    if name == "effort":
        yield ""
        yield from markdown(at_equal_effort(made))
    elif name != "timed":
        yield ""
        yield from markdown(differences(made))
    failed = list(failures(made))
    if failed:
        yield ""
        yield from failed


# ------------------------------------------------------------------------------------------------ short and long tables


def made_of(name: str) -> Made:
    """Return the lines of a study that has been run."""
    family, controllers, seeds = STUDIES[name]
    return run_missing(family, best_cases() if name == "best" else cases(LEVELS[name], controllers), seeds)


IN_WORDS = {
    "plane": "captures in the plane",
    "space": "captures in space",
    "tour": "tours in the plane",
    "tour_space": "tours in space",
    "reach": "same hands",
}
"""How tables call the missions of a family."""

BESIDE = ("smpc", "htmpc, free end")
"""Controllers whose ends PSMPC's are compared with besides, in studies that have them."""


def gains(*names: str) -> Iterator[str]:
    """Yield what controllers gain against hard switching with a free end: all of named studies, or the planned ones."""
    rows = []
    studies = names or ("plane", "space", "reach")
    beside = [each for each in BESIDE if any(each in STUDIES[name][1] for name in studies)]
    for name in studies:
        family, controllers, _ = STUDIES[name]
        made = made_of(name)
        for controller in controllers if names else PLANNED:
            against = compared(made[controller], made[AGAINST]) if controller != AGAINST else {}
            succeeded = [row for row in made[controller].values() if row["succeeded"]]
            row = {
                "missions": IN_WORDS[family],
                "controller": f"`{controller}`",
                "succeeded": f"{len(succeeded)} of {len(made[controller])}",
                "end [s]": f"{np.median([row['time'] for row in succeeded]):.1f}",
                "end, difference [s]": against.get("end, difference [s]", ""),
                "end, ratio": _without_interval(against.get("end, ratio", "")),
                "effort, ratio": _without_interval(against.get("effort, ratio", "")),
            }
            for other in beside:
                over = compared(made[controller], made[other]) if controller == "psmpc" else {}
                row[f"end less that of `{other}` [s]"] = over.get("end, difference [s]", "")
            if "htmpc, free end" in beside:
                row["levels solved"], row["bounds kept"] = _levels(made[controller])
            rows.append(row)
    yield from markdown(rows)


def _levels(rows: Mapping[int, Row]) -> tuple[str, str]:
    """Return the share of levels that converged, and of bounds on the costs of earlier levels that were kept."""
    counts = [row["levels"] for row in rows.values() if "levels" in row]
    if not counts:
        return "", ""
    total = {name: sum(each[name] for each in counts) for name in counts[0]}
    tried = total["solved"] + total["unsolved"]
    return (
        f"{100 * total['solved'] / tried:.1f} %",
        f"{100 * total['kept'] / total['bounds']:.1f} % of {total['bounds']}",
    )


POSED = {"posed": IN_WORDS["plane"], "tour": IN_WORDS["tour"], "tour_space": IN_WORDS["tour_space"]}
"""Studies of missions with the arms as drawn and held ready, and how their missions are called."""


def headline() -> Iterator[str]:
    """Yield what is gained with the arms as drawn and held ready, each against hard switching with the same arms."""
    rows = []
    for name, missions in POSED.items():
        made = made_of(name)
        for level in LEVELS[name]:
            for controller in ("psmpc", "smpc"):
                own, hard, smpc = (made[Case(each, level, {}).name] for each in (controller, AGAINST, "smpc"))
                against = compared(own, hard)
                succeeded = [row for row in own.values() if row["succeeded"]]
                rows.append(
                    {
                        "missions": missions,
                        "arms": level or "as drawn",
                        "controller": f"`{controller}`",
                        "succeeded": f"{len(succeeded)} of {len(own)}",
                        "end [s]": f"{np.median([row['time'] for row in succeeded]):.1f}",
                        "end, difference [s]": against["end, difference [s]"],
                        "end, ratio": _without_interval(against["end, ratio"]),
                        "effort, ratio": against["effort, ratio"],
                        "end less that of `smpc` [s]": compared(own, smpc)["end, difference [s]"]
                        if controller == "psmpc"
                        else "",
                    }
                )
    yield from markdown(rows)


def by_hand() -> Iterator[str]:
    """Yield what holding the arms ready gains under each controller, and PSMPC without it against hard with it."""
    rows = []
    for name, missions in POSED.items():
        made = made_of(name)
        pairs = {f"`{each}`, held ready against as drawn": (f"{each}; {READY}", each) for each in PLANNED}
        pairs[f"`psmpc` as drawn against `{AGAINST}` held ready"] = ("psmpc", f"{AGAINST}; {READY}")
        for what, (own, other) in pairs.items():
            against = compared(made[own], made[other])
            columns = ("both succeed", "end, difference [s]", "end, ratio", "effort, ratio")
            rows.append({"missions": missions, "what": what, **{column: against[column] for column in columns}})
    yield from markdown(rows)


def _without_interval(cell: str) -> str:
    """Return the median of a cell that has its interval behind it."""
    return cell.partition(" (")[0]


def equal_effort() -> Iterator[str]:
    """Yield how early missions end with at most some efforts, under the controllers that plan the next stage."""
    rows = at_equal_effort(made_of("effort"))
    yield from markdown(row for row in rows if row["controller"] in ("`psmpc`", "`smpc`"))


def differences_of(name: str) -> Iterator[str]:
    """Yield the differences between the controllers of a study."""
    yield from markdown(differences(made_of(name)))


NOT_KNOWN = {
    "noise": "noise",
    "masses": "masses wrong by up to",
    "load": "mass of the object",
    "drift": "motion of the object",
}
"""Studies of what the controller does not know, and what that is."""


def deliveries() -> Iterator[str]:
    """Yield how often each planned controller succeeds, by what it does not know."""
    rows = []
    for name, title in NOT_KNOWN.items():
        made = made_of(name)
        for level in LEVELS[name]:
            cells = {}
            for controller in PLANNED:
                runs = made[f"{controller}; {level}"].values()
                cells[f"`{controller}`"] = f"{sum(row['succeeded'] for row in runs)} of {len(runs)}"
            rows.append({"not known": f"{title}: {level}", **cells})
    yield from markdown(rows)


LATE = {
    "delay": "captures",
    "delay_tour": "tours",
}
"""Studies of late commands under PSMPC, and what they fly."""


def later(runs: Mapping[int, Row], prompt: Mapping[int, Row]) -> str:
    """Count the runs that succeeded, and say how much later they end in the median than the same without delay."""
    differences = [row["time"] - prompt[seed]["time"] for seed, row in runs.items() if row["succeeded"]]
    median = f", {np.median(differences):+.1f}" if differences and runs is not prompt else ""
    return f"{len(differences)} of {len(runs)}{median}"


def lateness() -> Iterator[str]:
    """Yield how often missions with late commands succeed under PSMPC, and what becomes of limits and estimates."""
    made = {name: made_of(name) for name in LATE}
    rows = []
    for level in LEVELS["delay"]:
        if level.endswith(MASSES):
            continue
        of_level = {name: made[name][f"psmpc; {level}"] for name in LATE}
        every = [row for runs in of_level.values() for row in runs.values()]
        succeeded = sum(row["succeeded"] for row in every)
        interval = binomtest(succeeded, len(every)).proportion_ci(method="wilson")
        off = 1e3 * np.array([row["delay_off"] for row in every if row["delay_off"] is not None])
        speeds = 100 * np.array([row["speed"] for row in every])
        rows.append(
            {
                "delay": level,
                **{title: later(of_level[name], made[name]["psmpc; none"]) for name, title in LATE.items()},
                "all": f"{succeeded} of {len(every)} ({100 * interval.low:.0f} to {100 * interval.high:.0f} %)",
                "over a speed limit [%]": f"{np.median(speeds):.0f} / {np.quantile(speeds, 0.95):.0f}",
                "estimate off [ms]": f"{np.median(np.abs(off)):.0f} / {np.quantile(np.abs(off), 0.95):.0f}",
                "within 10 ms": f"{np.sum(np.abs(off) <= 10)} of {len(off)}",
            }
        )
    yield from markdown(rows)


def late_masses() -> Iterator[str]:
    """Yield what estimated masses change under delays: the same missions, masses taken as described and estimated."""
    made = {name: made_of(name) for name in LATE}
    rows = []
    for level in LEVELS["delay"]:
        delay, comma, _ = level.partition(f", {MASSES}")
        if not comma:
            continue
        pairs = [
            (made[name][f"psmpc; {delay}"][seed], row)
            for name in LATE
            for seed, row in made[name][f"psmpc; {level}"].items()
        ]
        sooner = [one["time"] - other["time"] for one, other in pairs if one["succeeded"] and other["succeeded"]]
        speeds = 100 * np.array([[row["speed"] for row in pair] for pair in pairs])
        rows.append(
            {
                "delay": delay,
                "succeeded, as described": f"{sum(one['succeeded'] for one, _ in pairs)} of {len(pairs)}",
                "succeeded, estimated": f"{sum(other['succeeded'] for _, other in pairs)} of {len(pairs)}",
                "estimated ends sooner by [s]": " / ".join(
                    f"{each:.1f}" for each in np.quantile(sooner, [0.05, 0.5, 0.95])
                ),
                **{
                    f"over a speed limit, {name} [%]": f"{np.median(each):.0f} / {np.quantile(each, 0.95):.0f}"
                    for name, each in zip(("as described", "estimated"), speeds.T, strict=True)
                },
            }
        )
    yield from markdown(rows)


def loads_found() -> Iterator[str]:
    """Yield how missions go whose load is estimated, and how far the estimate is off after some seconds of carrying."""
    made = made_of("loads")
    known = made[f"psmpc; {KNOWN_LOAD}"]
    names = {"load estimated": "as described", "load estimated, robot off": "wrong by up to 10 %"}
    rows = []
    for level, title in names.items():
        runs = made[f"psmpc; {level}"]
        found = [row for row in runs.values() if "load_off" in row]
        off = np.abs([row["load_off"] for row in found])
        is_inside = off <= 1.96 * np.array([row["load_sigma"] for row in found])
        delivered = [seed for seed, row in runs.items() if row["succeeded"] and known[seed]["succeeded"]]
        differences = [runs[seed]["time"] - known[seed]["time"] for seed in delivered]
        rows.append(
            {
                "masses of the robot": title,
                "delivered": f"{sum(row['succeeded'] for row in runs.values())} of {len(runs)}",
                "with a known load": f"{sum(row['succeeded'] for row in known.values())} of {len(known)}",
                "ends later than with a known load [s]": spread(differences),
                "mass off after 3 s [%]": spread(100 * off),
                "within 5 %": f"{np.sum(off <= 0.05)} of {len(off)}",
                "in the interval of 95 %": f"{is_inside.sum()} of {len(off)}",
            }
        )
    yield from markdown(rows)


def late_others() -> Iterator[str]:
    """Yield how often captures with late commands succeed, by controller, and how much later they end."""
    made = made_of("delay_others")
    yield from markdown(
        {
            "delay": level,
            **{f"`{each}`": later(made[f"{each}; {level}"], made[f"{each}; none"]) for each in PLANNED},
        }
        for level in LEVELS["delay_others"]
    )


def long_tables() -> dict[str, str]:
    """Return the long tables of all studies but `priorities` as CSV, by file name."""
    rows: dict[str, list[Row]] = {"runs": [], "differences": [], "equal-effort": []}
    for name in STUDIES:
        if name == "priorities":
            continue
        made = made_of(name)
        rows["runs"] += [{"study": name, **row} for row in successes(made)]
        rows["differences"] += [{"study": name, **row} for row in differences(made)]
        if name == "effort":
            rows["equal-effort"] += at_equal_effort(made)
    return {f"missions-{kind}.csv": as_csv([_split(row) for row in each]) for kind, each in rows.items()}


def _split(row: Row) -> dict[str, str]:
    """Return the cells of a row with quantiles, and medians with their intervals, in columns of their own."""
    cells: dict[str, str] = {}
    for name, value in row.items():
        text = str(value).replace("`", "")
        numbers = re.findall(r"-?\d+(?:\.\d+)?", text)
        if " / " in text:
            cells |= {f"{name}, {share} %": number for share, number in zip((5, 50, 95), numbers, strict=True)}
        elif re.fullmatch(r"-?[\d.]+ \(.* to .*\)", text):
            cells |= dict(zip((name, f"{name}, low", f"{name}, high"), numbers, strict=True))
        elif text != "-":
            cells[name] = text
    return cells


def files() -> Iterator[str]:
    """Write the long tables and yield the table of their files."""
    yield from write_long_tables(long_tables())


WHOLE_SAMPLE = 5
"""The sample whose window IPOPT solves as well: by then it has both stages."""


def optimum(count: str = "10") -> Iterator[str]:
    """Solve a window over the whole of some missions of `reach` by IPOPT as well and yield by how much they differ."""
    logging.disable(logging.CRITICAL)
    changes = {**CONTROLLERS["psmpc, whole mission"], "log.plans": True, "time_limit": (WHOLE_SAMPLE + 1) * 0.1}
    compared = []
    for seed in range(int(count)):
        run = psmpc.simulate(draw_mission("reach", seed, changes))
        found = replay(run, WHOLE_SAMPLE, "ipopt")
        if found.solution.outcome is Outcome.OPTIMAL:
            of_objectives = found.solution.objective / found.logged.objective - 1
            of_instants = found.solution.plan.switch_times[0] - found.logged.plan.switch_times[0]
            compared.append((of_objectives, of_instants))
    of_objective, of_instant = np.abs(compared).max(axis=0)
    row = {
        "windows": count,
        "solved by IPOPT": len(compared),
        "J differs by at most": f"{of_objective:.0e}",
        "switch differs by at most [s]": f"{of_instant:.0e}",
    }
    yield from markdown([row])


# ------------------------------------------------------------------------------------------------ figure


def figure() -> Iterator[str]:
    """Draw the median end of missions over their median effort, a line for each controller along its control weight."""
    family, controllers, seeds = STUDIES["effort"]
    made = results(family)
    with in_style():
        drawn = new_figure()
        drawn.set_figheight(2.4)
        axes = drawn.subplots()
        for index, controller in enumerate(controllers):
            rows = [[made[case.name][seed] for seed in seeds] for case in cases(LEVELS["effort"], [controller])]
            whole = [each for each in rows if all(row["succeeded"] for row in each)]
            efforts = [np.median([row["effort"] for row in each]) for each in whole]
            times = [np.median([row["time"] for row in each]) for each in whole]
            axes.plot(
                efforts, times, label=TITLES[controller], **{**line_look(index), **mark_look(index), "linestyle": "-"}
            )
        axes.set(xlabel="Control effort (m²/s³, rad²/s³)", ylabel="End of the mission (s)")
        axes.legend(title="Control weights from large (left) to small (right)")
        drawn.savefig(FIGURE, bbox_inches="tight")
    yield f"{FIGURE}"


def main(words: Sequence[str]) -> None:
    """Print the lines of what the command line names."""
    others = (
        figure,
        optimum,
        headline,
        by_hand,
        gains,
        equal_effort,
        differences_of,
        deliveries,
        lateness,
        late_masses,
        late_others,
        loads_found,
        files,
    )
    other = {function.__name__: function for function in others}.get(words[0])
    for line in study(*words) if other is None else other(*words[1:]):
        print(line, flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
