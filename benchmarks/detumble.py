"""A published optimal control problem in one window: a tumbling pair of spacecraft brought to rest.

Facts: S. Vyas, L. Maywald, S. Kumar, M. Jankovic, A. Mueller, F. Kirchner: Post-capture detumble trajectory
stabilization for robotic active debris removal (2022), Advances in Space Research, doi 10.1016/j.asr.2022.09.033, and
its repository vyas-shubham/asr-trajopt-trajstab. A chaser of 100 kg with an arm of three joints holds a target of 50 kg
that turns at 5 deg/s; thrust, torque and joint torques are limited and paid for, the duration is free. Motion is in the
plane of the chaser's z and x axes, our x and y.

    python benchmarks/detumble.py table        the first table of docs/detumble.md
    python benchmarks/detumble.py thrusters    the second: with eight thrusters that give less than the optimum takes
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import casadi as ca
import numpy as np
import yaml
from pages import command_line, markdown

from psmpc_cli.ocp.plan import Plan, resting_plan
from psmpc_cli.ocp.problem import Problem, build_problem, in_own_chart
from psmpc_cli.ocp.window import Window, on_mesh
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.solvers import Solution, build_solver
from psmpc_cli.specs.load import load_task

ROBOT = {
    "name": "chaser with a held target",
    "base": {"mass": 100, "inertia": 66.66},
    "arms": {
        "arm": {
            "mount": {"position": [1.05, 0], "angle": 0},
            "links": [
                {"mass": 10, "inertia": 0.5396, "a": 0.45, "b": 0.45},
                {"mass": 8, "inertia": 0.245, "a": 0.35, "b": 0.35},
                {"mass": 54.1, "inertia": 3.951532403, "a": 0.6123844732, "b": 0.0376155268},
            ],
            "tool": {"angle": 0},
        }
    },
    "limits": {"base": {"force": [2, 2, 2.5]}, "arm": {"force": [0.5, 0.5, 0.5]}},
}
"""The third link is the arm's last one and the target in its grip."""

POSTURE = [-0.72, 1.2, 0.72]
BASE_RATES = [-0.005233123297, -0.012447128002, 0.004207290408]
JOINT_RATES = [0.063457865147, -0.13529433722, 0.166854874375]

WEIGHTS = {"base": [10, 10, 1], "arm": [1, 1, 1]}
"""Of the squares of force and torque in the cost."""

AT_REST = {"base": 1e-6, "arm": 1e-3}
"""Velocities at the end [m/s, rad/s]. Published: 1e-3 for all, and a cost of 4e8 for squares of those of the base."""

END_COST = np.array([4e8] * 3 + [4e4] * 3)
"""Of the squares of the velocities at the end."""

THRUSTERS = [
    {"position": position, "direction": direction, "force": 0.15}
    for position, direction in (
        ([-1, 1], [1, 0]),
        ([-1, -1], [1, 0]),
        ([1, 1], [-1, 0]),
        ([1, -1], [-1, 0]),
        ([1, -1], [0, 1]),
        ([-1, -1], [0, 1]),
        ([1, 1], [0, -1]),
        ([-1, 1], [0, -1]),
    )
]
"""Two in each direction at the corners of the chaser: 0.3 N and 0.6 N m at most, and less of both together. Without
limits that bind, the optimum has up to 0.85 N m."""

STEPS = 100
"""Of the published discretization."""

OPTIMUM = {"J": 8.50682, "duration": 4.0891, "base torque": 2.85977, "base force": 0.19044, "joint torques": 1.24684}
"""By IPOPT, with the published discretization: backward Euler, 100 steps, forces at the ends of the steps."""


def task_of(robot: str, nodes: int) -> dict[str, object]:
    """Return the problem as a task: to rest wherever that is; a second stage that costs nothing frees the duration."""
    nothing = {"base": [0, 0, 0], "arm": [0, 0, 0]}
    return {
        "robot": robot,
        "initial": {"base": [0, 0, 0], "arm": POSTURE},
        "initial_velocity": {"base": BASE_RATES, "arm": JOINT_RATES},
        "controller": {"nodes": nodes, "horizon": 8, "normalization": "none", "pending_cost": 1},
        "solver": {"iterations": 200},
        "skills": {
            "stop": {"space": "joint", "weights": {**nothing, "control": 0, "force": WEIGHTS}},
            "rest": {"space": "joint", "weights": {**nothing, "control": 1e-6}},
        },
        "stages": [
            {
                "name": "stop",
                "skill": "stop",
                "target": {"base": [0, 0, 0], "arm": POSTURE},
                "ends_when": {"coordinates": "all", "tolerance": 6, "velocity": AT_REST},
            },
            {
                "name": "rest",
                "skill": "rest",
                "target": {"base": [0, 0, 0], "arm": POSTURE},
                "ends_when": {"coordinates": "all", "tolerance": 6},
            },
        ],
    }


def solve(problem: Problem, nodes: int) -> Solution:
    """Solve the window of both stages from the start, guessed to end after half of the horizon."""
    model = problem.model
    Q = np.r_[0, 0, 0, POSTURE]
    v = np.r_[BASE_RATES, JOINT_RATES]
    placed = [in_own_chart(model, stage, Q, v) for stage in problem.stages]
    stages, states = zip(*placed, strict=True)
    controller = problem.spec.controller
    window = Window(
        stages=stages,
        start=0.0,
        elapsed=0.0,
        x0=states[0],
        omega=np.array([stage.priority for stage in stages]),
        offset=np.zeros(2),
        scale=np.ones(2),
        horizon=controller.horizon,
        pending_cost=controller.pending_cost,
        terminal_cost=0.0,
        nodes=(nodes, nodes),
        chart=model.space.chart_at(Q),
    )
    rest = resting_plan(0.0, window.horizon, nodes, window.x0, window.chart)
    guess = on_mesh(replace(rest, switch_times=np.array([window.horizon / 2])), window)
    solution = build_solver(problem, problem.spec.solver).solve(window, guess)
    if not solution.outcome.usable:
        raise RuntimeError(f"{nodes} intervals: {solution.outcome.value}")
    return solution


def costs(model: RobotModel, plan: Plan, nodes: int, end: int) -> dict[str, float]:
    """Return the published cost and its parts, with the forces at the beginning, 0, or the end, 1, of the intervals."""
    duration = float(plan.switch_times[0])
    Q, v = plan.chart.from_chart(plan.X[: nodes + 1])
    F = np.array([model.inverse_dynamics(Q[k + end], v[k + end], plan.u[k]) for k in range(nodes)])
    weights = np.concatenate([WEIGHTS["base"], WEIGHTS["arm"]])
    force_x, force_y, torque, *joints = duration / nodes * (F**2).sum(axis=0) * weights
    at_end = float(v[-1] ** 2 @ END_COST)
    parts = {"base torque": torque, "base force": force_x + force_y, "joint torques": sum(joints)}
    return {"J": duration + sum(parts.values()) + at_end, "duration": duration, **parts}


def table() -> Iterator[str]:
    """Yield the rows: of psmpc with several numbers of intervals, and of the independent optimum."""
    rows = [{"": "independent optimum, backward Euler, 100 steps"} | {name: f"{x:.3f}" for name, x in OPTIMUM.items()}]
    with TemporaryDirectory() as folder:
        robot = Path(folder) / "chaser.yaml"
        robot.write_text(yaml.safe_dump(ROBOT))
        for nodes in (25, 50, 100, 200):
            problem = build_problem(load_task(task_of(str(robot), nodes)))
            solution = solve(problem, nodes)
            for end, where in enumerate(("beginnings", "ends")):
                found = costs(problem.model, solution.plan, nodes, end)
                name = f"psmpc, {nodes} intervals, forces at their {where}"
                rows.append({"": name} | {name: f"{x:.3f}" for name, x in found.items()})
    yield from markdown(rows)


def thrusters() -> Iterator[str]:
    """Yield the rows of the problem with thrusters instead of limits of force and torque on the base."""
    optimum = independent_optimum()
    rows = [{"": "independent optimum, thrusts as inputs"} | {name: f"{x:.3f}" for name, x in optimum.items()}]
    of_arm = {part: limits for part, limits in ROBOT["limits"].items() if part != "base"}
    with TemporaryDirectory() as folder:
        robot = Path(folder) / "chaser.yaml"
        robot.write_text(yaml.safe_dump({**ROBOT, "limits": of_arm, "thrusters": THRUSTERS}))
        for nodes in (50, 100):
            problem = build_problem(load_task(task_of(str(robot), nodes)))
            solution = solve(problem, nodes)
            for end, where in enumerate(("beginnings", "ends")):
                found = costs(problem.model, solution.plan, nodes, end)
                name = f"psmpc, {nodes} intervals, forces at their {where}"
                rows.append({"": name} | {name: f"{x:.3f}" for name, x in found.items()})
    yield from markdown(rows)


def independent_optimum() -> dict[str, float]:
    """Return the optimum with thrusts as inputs, by IPOPT, from equations of motion and wrenches of its own.

    The published discretization: backward Euler, M(q+) (v+ - v) / h + c(q+, v+) = forces, equal steps h of 0.01 to 0.2
    s. At the end the base is at rest, the joints are within 1e-3 rad/s, and the squares of their velocities cost. The
    published problem also has no acceleration in its first step, for which these thrusters are too weak.
    """
    inertial_force = _equations_of_motion()
    q, v = (ca.SX.sym(name, 6, STEPS + 1) for name in "qv")
    thrust, torque, h = ca.SX.sym("thrust", len(THRUSTERS), STEPS), ca.SX.sym("torque", 3, STEPS), ca.SX.sym("h")
    equations = [q[:, 0] - np.r_[0, 0, 0, POSTURE], v[:, 0] - np.r_[BASE_RATES, JOINT_RATES]]
    parts = [ca.SX(0), ca.SX(0), ca.SX(0)]
    for k in range(STEPS):
        push = ca.SX.zeros(3)  # along the axes of the base, torque last
        for number, thruster in enumerate(THRUSTERS):
            (x, y), (to_x, to_y) = thruster["position"], thruster["direction"]
            push += thrust[number, k] * ca.vertcat(to_x, to_y, x * to_y - y * to_x)
        cos, sin = ca.cos(q[2, k + 1]), ca.sin(q[2, k + 1])
        on_base = ca.vertcat(cos * push[0] - sin * push[1], sin * push[0] + cos * push[1], push[2])
        change = (v[:, k + 1] - v[:, k]) / h
        equations += [
            q[:, k + 1] - q[:, k] - h * v[:, k + 1],
            h * (inertial_force(q[:, k + 1], v[:, k + 1], change) - ca.vertcat(on_base, torque[:, k])),
        ]
        weighed = h * push[2] ** 2, h * 10 * ca.sumsqr(push[:2]), h * ca.sumsqr(torque[:, k])
        parts = [part + of_step for part, of_step in zip(parts, weighed, strict=True)]
    at_end = ca.dot(v[3:, -1] ** 2, END_COST[3:])
    J = STEPS * h + sum(parts) + at_end
    unknowns = ca.vertcat(ca.vec(q), ca.vec(v), ca.vec(thrust), ca.vec(torque), h)
    free, within = np.full(6 * (STEPS + 1), np.inf), np.full(6 * (STEPS + 1), np.inf)
    within[-6:] = np.r_[np.zeros(3), np.full(3, 1e-3)]
    strongest = np.tile([thruster["force"] for thruster in THRUSTERS], STEPS)
    upper = np.concatenate([free, within, strongest, np.full(3 * STEPS, 0.5), [0.2]])
    lower = np.concatenate([-free, -within, 0 * strongest, np.full(3 * STEPS, -0.5), [0.01]])
    slowing = np.outer(1 - np.arange(STEPS + 1) / STEPS, np.r_[BASE_RATES, JOINT_RATES])
    moving = np.r_[0, 0, 0, POSTURE] + 0.08 * (np.cumsum(slowing, axis=0) - slowing[0])
    guess = np.concatenate([moving.ravel(), slowing.ravel(), strongest / 2, np.zeros(3 * STEPS), [0.08]])
    quiet = {"ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-8, "max_iter": 1000}, "print_time": False}
    solver = ca.nlpsol("optimum", "ipopt", {"x": unknowns, "f": J, "g": ca.vertcat(*equations)}, quiet)
    solution = solver(x0=guess, lbx=lower, ubx=upper, lbg=0, ubg=0)
    if not solver.stats()["success"]:
        raise RuntimeError(f"IPOPT: {solver.stats()['return_status']}")
    values = ca.Function("values", [unknowns], [J, STEPS * h, *parts])(solution["x"])
    return dict(zip(OPTIMUM, map(float, values), strict=True))


def _equations_of_motion() -> ca.Function:
    """Return q, v, rate of v -> the force (6,) that they take: Lagrange's equations of the kinetic energy."""
    q, v, rate = (ca.SX.sym(name, 6) for name in ("q", "v", "rate"))
    bodies = [(ROBOT["base"]["mass"], ROBOT["base"]["inertia"], q[:2], q[2])]
    (arm,) = ROBOT["arms"].values()
    angle = q[2]
    at = q[:2] + arm["mount"]["position"][0] * ca.vertcat(ca.cos(angle), ca.sin(angle))
    for number, link in enumerate(arm["links"]):
        angle += q[3 + number]
        along = ca.vertcat(ca.cos(angle), ca.sin(angle))
        bodies.append((link["mass"], link["inertia"], at + link["a"] * along, angle))
        at += (link["a"] + link["b"]) * along
    energy = ca.SX(0)
    for mass, inertia, centre, turn in bodies:
        energy += (mass * ca.sumsqr(ca.jtimes(centre, q, v)) + inertia * ca.jtimes(turn, q, v) ** 2) / 2
    momentum = ca.gradient(energy, v)
    force = ca.jtimes(momentum, v, rate) + ca.jtimes(momentum, q, v) - ca.gradient(energy, q)
    return ca.Function("inertial_force", [q, v, rate], [force])


if __name__ == "__main__":
    command_line(table, thrusters)
