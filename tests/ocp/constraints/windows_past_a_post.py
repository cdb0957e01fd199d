"""Shared by the tests of clearance and others."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from psmpc_cli.ocp.constraints import node_rows
from psmpc_cli.ocp.plan import Plan, resting_plan
from psmpc_cli.ocp.problem import Problem, build_problem, in_own_chart
from psmpc_cli.ocp.stage import SampleContext
from psmpc_cli.ocp.window import Window, on_mesh, window_numbers, window_shape
from psmpc_cli.solvers import Solution, build_solver
from psmpc_cli.specs.load import Task, load_task

BENT = {"arm_1": ["60 deg", "60 deg", 0], "arm_2": ["-60 deg", "-60 deg", 0]}


REACHING = {"arm_1": ["10 deg", "30 deg", 0], "arm_2": ["-10 deg", "-30 deg", 0]}


POST = {"name": "post", "shape": {"sphere": 0.1}, "pose": [1.1, 1.2, 0]}


def passing(changes: Mapping[str, Any] | None = None) -> Task:
    """A planar robot flies past a post that its upper arm would hit, then stretches its arms."""
    ends = {"coordinates": ["all"], "tolerance": 5e-3}
    task = {
        "robot": "planar_dual_arm",
        "initial": {"base": [0, 0, 0], **BENT},
        "controller": {"nodes": 25},
        "skills": {
            "move": {
                "space": "joint",
                "weights": {"base": [100, 100, 10], "arms": [10, 10, 1], "control": 0.1},
            }
        },
        "limits": {"base": {"acceleration": [0.2, 0.2, 0.5]}, "arms": {"acceleration": [1, 1, 1]}},
        "obstacles": [POST],
        "clearance": {"margin": 0.02},
        "stages": [
            {"name": "fly", "skill": "move", "target": {"base": [2, 0, 0], **BENT}, "ends_when": ends},
            {"name": "reach", "skill": "move", "target": {"base": [2, 0, 0], **REACHING}, "ends_when": ends},
        ],
        "time_limit": 25,
        "log": {"shares": False},
    }
    return load_task(task, changes or {})


def sampled(problem: Problem, stage: int, Q: np.ndarray, time: float = 0.0, **more: Any) -> dict[str, np.ndarray]:
    """Arguments of the groups of a stage at a sample at rest."""
    model = problem.model
    chart = model.space.chart_at(Q)
    x = np.asarray(chart.to_chart(Q[None], np.zeros((1, model.n)))[0])
    view = SampleContext(time, x, chart.anchor, **more)
    found = problem.stages[stage].sampled_constraints
    arguments = {name: each.at_sample(model, view) for name, each in found.items() if each.at_sample is not None}
    return {name: argument for name, argument in arguments.items() if argument is not None}


def window_of(problem: Problem, Q: np.ndarray, v: np.ndarray, stages: int = 2) -> Window:
    """The first stages of a task from a state, all groups of pairs in them."""
    placed = [in_own_chart(problem.model, stage, Q, v) for stage in problem.stages[:stages]]
    arguments = sampled(problem, 0, Q)
    controller = problem.spec.controller
    return Window(
        stages=tuple(stage.with_arguments(arguments) for stage, _ in placed),
        start=0.0,
        elapsed=0.0,
        x0=placed[0][1],
        omega=np.ones(stages),
        offset=np.zeros(stages),
        scale=np.full(stages, 10.0),
        horizon=controller.horizon,
        pending_cost=controller.pending_cost,
        terminal_cost=0.0,
        nodes=(controller.uniform_nodes,) * stages,
        chart=problem.model.space.chart_at(Q),
    )


def solved(
    problem: Problem, window: Window, kind: str, guess: Plan | None = None, max_iterations: int = 200
) -> Solution:
    """Solve a window to its optimum, by default from a plan without accelerations, with instants evenly apart."""
    to_optimum = {"kind": kind, "iterations": max_iterations, "max_iterations": max_iterations, "tolerance": 1e-9}
    spec = problem.spec.solver.model_copy(update=to_optimum)
    if guess is None:
        guess = resting_plan(0.0, window.horizon, window.K, window.x0, window.chart)
        guess = replace(guess, switch_times=np.linspace(0, window.horizon, len(window.nodes) + 1)[1:-1])
    return build_solver(problem, spec).solve(window, on_mesh(guess, window))


def active_rows(problem: Problem, window: Window, plan: Plan) -> int:
    """Number of distances that a plan has at their margin."""
    p = window_numbers(window, plan.switch_times)
    count = 0
    for rows in node_rows(problem.model, window_shape(window)):
        if rows.name.startswith("clearance"):
            values = rows.functions.value(plan.X[list(rows.nodes)], rows.argument(p), rows=len(rows.nodes))[0]
            count += int((values < rows.bounds(window)[0] + 1e-6).sum())
    return count


def near_post(seed: int) -> tuple[Problem, Window]:
    """A window of one stage or two in which the robot is about to pass a post, from a random state."""
    rng = np.random.default_rng(seed)
    post = {**POST, "pose": [rng.uniform(0.5, 0.7), rng.uniform(1.1, 1.2), 0]}
    problem = build_problem(passing({"obstacles": [post], "stages.fly.target.base": [0.3, 0, 0]}))
    Q = np.r_[np.zeros(3), np.radians([60, 60, 0, -60, -60, 0])] + rng.uniform(-0.1, 0.1, 9)
    v = np.r_[0.1, rng.uniform(-0.05, 0.05, 8)]
    return problem, window_of(problem, Q, v, stages=1 + seed % 2)
