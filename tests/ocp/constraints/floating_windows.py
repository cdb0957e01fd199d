"""Shared by the tests of mobility and others."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from psmpc_cli.ocp.plan import Plan, resting_plan
from psmpc_cli.ocp.problem import Problem, build_problem, in_own_chart
from psmpc_cli.ocp.window import Window, on_mesh
from psmpc_cli.robot.model import load_robot
from psmpc_cli.solvers import Solution, build_solver
from psmpc_cli.specs.library import find
from psmpc_cli.specs.load import Task, load_task
from psmpc_cli.specs.robots.robot import stack

START = {"arm_1": [0.3, 0.3, 0.3], "arm_2": [-0.3, -0.3, -0.3]}


REACHED = np.array([0.02, 0.03, -0.3, 0.9, -0.5, 0.5, -0.2, 0.6, -0.4])
"""Coordinates whose hand poses are the target of the first stage."""


def fast_arms_in(folder: Path) -> Path:
    """Write the robot of Table I with joints of 0.6 rad/s and no other limits."""
    robot = yaml.safe_load(find("robot", "planar_dual_arm").read_text())
    robot["limits"] = {"arms": {"velocity": [0.6, 0.6, 0.6]}}
    path = folder / "fast_arms.yaml"
    path.write_text(yaml.safe_dump(robot))
    return path


def planar_task(robot: Path, changes: Mapping[str, Any] | None = None) -> Task:
    """Both hands to poses, then the joints home."""
    hands = load_robot(robot).poses(REACHED)
    arms = {"coordinates": ["arms"], "tolerance": 5e-3}
    task = {
        "robot": str(robot),
        "mobility": "free-floating",
        "initial": {"base": [0, 0, 0], **START},
        "controller": {"nodes": 25, "horizon": 6, "normalization": "none", "pending_cost": 5},
        "skills": {
            "reach": {"space": "task", "weights": {"arms": [100, 100, 10], "control": 0.3}},
            "home": {"space": "joint", "weights": {"arms": [30, 30, 30], "control": 0.3}},
        },
        "stages": [
            {
                "name": "reach",
                "skill": "reach",
                "priority": 0.05,
                "target": {"arm_1": hands[1].tolist(), "arm_2": hands[2].tolist()},
                "ends_when": arms,
            },
            {"name": "home", "skill": "home", "priority": 0.2, "target": START, "ends_when": arms},
        ],
    }
    return load_task(task, changes or {})


def spatial_task(changes: Mapping[str, Any] | None = None) -> Task:
    """The hand of a small arm to a place, then its joints home."""
    place = load_robot("free_flyer_arm").poses(np.r_[0, 0, 0, 1, 0, 0, 0, 0.3, 0.7, -0.9])[1]
    task = {
        "robot": "free_flyer_arm",
        "mobility": "free-floating",
        "initial": {"base": {"position": [0, 0, 0]}, "arm": [0, 0.5, -0.5]},
        "controller": {"nodes": 12},
        "skills": {
            "reach": {"space": "task", "weights": {"arm": [100, 100, 100, 0, 0, 0], "control": 0.1}},
            "home": {"space": "joint", "weights": {"arm": [10, 10, 10], "control": 0.1}},
        },
        "stages": [
            {
                "name": "reach",
                "skill": "reach",
                "target": {"arm": {"position": place[:3].tolist(), "attitude": {"quaternion": place[3:].tolist()}}},
                "ends_when": {"coordinates": ["arm.x", "arm.y", "arm.z"], "tolerance": 5e-3},
            },
            {
                "name": "home",
                "skill": "home",
                "target": {"arm": [0, 0.5, -0.5]},
                "ends_when": {"coordinates": ["arm"], "tolerance": 5e-3},
            },
        ],
        "time_limit": 20,
    }
    return load_task(task, changes or {})


def window_of(problem: Problem, Q: np.ndarray, v: np.ndarray) -> Window:
    """Both stages from a state."""
    model = problem.model
    placed = [in_own_chart(model, stage, Q, v) for stage in problem.stages]
    stages, states = zip(*placed, strict=True)
    controller = problem.spec.controller
    chart = model.space.chart_at(Q)
    return Window(
        stages=stages,
        start=0.0,
        elapsed=0.0,
        x0=states[0],
        omega=np.array([stage.priority for stage in problem.stages]),
        offset=np.zeros(2),
        scale=np.ones(2),
        horizon=controller.horizon,
        pending_cost=controller.pending_cost,
        terminal_cost=0.0,
        nodes=(controller.uniform_nodes,) * 2,
        chart=chart,
    )


def solved(problem: Problem, window: Window, kind: str, guess: Plan | None = None) -> Solution:
    """Solve a window to its optimum, by default from rest with the instant in the middle."""
    spec = problem.spec.solver.model_copy(update={"kind": kind, "iterations": 100})
    if guess is None:
        rest = resting_plan(0.0, window.horizon, problem.spec.controller.uniform_nodes, window.x0, window.chart)
        guess = on_mesh(replace(rest, switch_times=np.array([window.horizon / 2])), window)
    return build_solver(problem, spec).solve(window, guess)


def problem_of(mobility: str, robot: Path | None, then: str | None = None) -> Problem:
    """The problem of a planar robot that takes a known payload, or that in space.

    Thrusters need weights and targets of the base.

    Args:
        mobility: Of the first stage.
        robot: File of the planar robot.
        then: Mobility of the second stage, by default the same.
    """
    of_stages = {"reach": mobility, "home": then or mobility}
    changes: dict[str, Any] = {"mobility": mobility}
    if mobility != of_stages["home"]:
        changes["stages.home.mobility"] = then
    pose: object = [0.1, -0.1, 0.2] if robot else {"position": [0.1, 0, -0.1]}
    weights = [100, 100, 10] if robot else [100, 100, 100, 10, 10, 10]
    for name, of_stage in of_stages.items():
        if of_stage == "free-flying":
            changes[f"skills.{name}.weights.base"] = weights
            changes[f"stages.{name}.target.base"] = pose
    if robot is None:
        return build_problem(spatial_task({**changes, "controller.horizon": 6}))
    changes["object"] = {"shape": [0.2, 0.2], "pose": [0, 1, 0], "taken_by": "reach"}
    changes["uncertainty.payload"] = {"mass": 5, "inertia": 0.7, "known": True}
    return build_problem(planar_task(robot, changes))


def drawn(problem: Problem, seed: int) -> Window:
    """The window from a random state near the task's initial one."""
    model = problem.model
    random = np.random.default_rng(seed)
    start = stack(problem.spec.initial, model.spec, "joint")
    Q = model.space.path(start, 0.03 * random.standard_normal((1, model.n)))[-1]
    v = 0.01 * random.standard_normal(model.n)
    v[model.space.base] *= model.spec.moved_by.moves
    return window_of(problem, Q, v)
