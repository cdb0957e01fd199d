"""The tables of docs/capture_results.md: runs of tasks with an object that has a mass, judged by what becomes of it.

    python benchmarks/capture.py held        the task as it is with 5, 20 and 60 kg, by controller
    python benchmarks/capture.py unknown     the same under PSMPC where the low-level law does not know of the load
    python benchmarks/capture.py ratio       the same by how much inertia the load has over the robot's
    python benchmarks/capture.py known       the load known, 5 to 200 kg
    python benchmarks/capture.py strength    at which strength a controller that plans for the robot alone loses 20 kg
    python benchmarks/capture.py drifting N  catch_drifting with N draws of drift and spin
    python benchmarks/capture.py plants N F  rk4 and mujoco on the same N draws, under two controllers, strength F [N]
    python benchmarks/capture.py built_in    the built-in tasks that deliver an object, rk4 and mujoco
    python benchmarks/capture.py speeds      by how much built-in tasks exceed limits of speed, by reserve

N_s = 25 in every run but those of the last, which are of tasks as shipped. Rows are printed in order as their runs end.
"""

import math
from collections.abc import Iterator, Mapping
from itertools import product
from typing import Any

import numpy as np
from pages import command_line, markdown
from scipy.stats import binomtest

import psmpc_cli as psmpc
from psmpc_cli.ocp.problem import build_problem
from psmpc_cli.paper.reproduce import BARE_ROBOT
from psmpc_cli.robot.configuration import space_of_pose
from psmpc_cli.robot.free_body import body_of
from psmpc_cli.robot.held_load import HeldLoad
from psmpc_cli.specs.load import Task
from psmpc_cli.specs.robots.robot import resolve_limits
from psmpc_cli.studies.measures import motion_between_hands

CARRY = {
    "skills.carry": {
        "space": "joint",
        "weights": {"base": [100, 100, 10], "arms": [100, 100, 10], "control": 4},
        "limits": {"base": {"acceleration": [0.1, 0.1, 0.1]}, "arms": {"velocity": [0.02, 0.02, 0.02]}},
    },
    "stages.transport.skill": "carry",
    "stages.transport.ends_when": {
        "coordinates": "all",
        "tolerance": {"base": 5e-3, "arms": 0.05},
        "velocity": 0.02,
        "object": {"position": 4e-3, "angle": "1 deg", "velocity": 0.02},
    },
    "object.grasp.known": True,
    "object.grasp.strength": None,
    "object.grasp.stiffness": [1e5, 1e3],
    "plant.step": 5e-4,
}
"""The load known, and Transport slow: no more than 0.1 m/s^2 of the base, arms that keep their posture."""

UNAWARE = {
    "object.grasp.known": False,
    "limits": {},
    "stages.transport.ends_when.object": None,
    "object.grasp.band": [1, 1],
    "object.grasp.stiffness": [1e4, 1e2],
}
"""The controller plans for the robot alone, and Transport ends by the robot alone; grasps that give way to it."""

PULL = "object.grasp.strength.pull"


def simulated(task: str, changes: Mapping[str, Any]) -> psmpc.Run:
    """Run a task; nothing but its outcome is looked at."""
    lean = {"controller.nodes": 25, "log.shares": False, "log.plans": False}
    return psmpc.simulate(psmpc.load_task(task, {**lean, **changes}))


def carried(mass: float, changes: Mapping[str, Any]) -> psmpc.Run:
    """Run transport_grasp with an object of a mass [kg] and the shape of its own."""
    return simulated("transport_grasp", {"object.mass": mass, "object.inertia": 2.67 / 20 * mass, **changes})


def number(value: float, digits: int) -> str:
    """Write a number; a dash where it came to nothing."""
    return f"{value:.{digits}f}" if math.isfinite(value) else "-"


def outcome(run: psmpc.Run) -> dict[str, str]:
    """Write what became of the object: pull, where and how fast it left, end of the run, drift of momentum."""
    summary = run.summary()
    found = summary.capture
    assert found is not None
    left = "held" if math.isfinite(found.left_at) else "not let go"
    taken = f"lost at {found.left_at:.2f} s" if found.lost else left
    return {
        "grasps": taken if math.isfinite(found.closed_at) else "not taken",
        "pull [N]": f"{found.loads['pull']:.1f}",
        "object off by [cm]": number(100 * found.distance, 1),
        "[deg]": number(math.degrees(found.angle), 1),
        "speed [mm/s]": number(1e3 * found.speed, 0),
        "delivered": "yes" if summary.monitors[-1].held else "no",
        "ends [s]": f"{summary.duration:.1f}" if summary.completed else summary.reason,
        "drift of momentum": f"{summary.momentum_error:.0e}",
    }


def held() -> Iterator[str]:
    """Yield the table of the task as it is under every controller."""
    cases = product(("psmpc", "smpc", "htmpc", "hard"), (5, 20, 60))
    return markdown(
        {"controller": kind, "mass [kg]": mass, **outcome(carried(mass, {"controller.kind": kind}))}
        for kind, mass in cases
    )


def unknown() -> Iterator[str]:
    """Yield the table of loads that the low-level law does not know of, with what the task says left out one by one."""
    limited = {"object.grasp.known": False}
    cases = {"load unknown": limited, "and no limits": {**limited, "limits": {}}, "and no wait": UNAWARE}
    return markdown(
        {"left out": name, "mass [kg]": mass, **outcome(carried(mass, changes))}
        for (name, changes), mass in product(cases.items(), (5, 20, 60))
    )


def ratio() -> Iterator[str]:
    """Yield the table of unknown loads by the ratio of their inertia to the robot's where the grippers close."""

    def row(mass: float) -> dict[str, object]:
        run = carried(mass, {"object.grasp.known": False})
        unlimited = carried(mass, {"object.grasp.known": False, "limits": {}})
        capture = run.task.spec.body
        load = HeldLoad(run.problem.model, body_of(capture), capture.grasp)
        Q = run.Q[np.argmax(run["grasp/closed"].all(axis=1))]
        return {
            "mass [kg]": mass,
            "load / robot": f"{load.largest_ratio(Q)[0]:.2f}",
            "samples without a solution": int(run["events/solve_failed"].sum()),
            "ends [s]": outcome(run)["ends [s]"],
            "without limits on acceleration [s]": outcome(unlimited)["ends [s]"],
        }

    return markdown(map(row, (5, 8, 12, 16, 20, 60, 120)))


def known() -> Iterator[str]:
    """Yield the table of known loads; the pull between the grasps is the smaller of the two."""

    def row(mass: float) -> dict[str, object]:
        run = carried(mass, CARRY)
        internal = np.min(run["grasp/pull"], axis=1).max(initial=0.0)
        return {"mass [kg]": mass, **outcome(run), "internal pull [N]": f"{internal:.1f}"}

    return markdown(map(row, (5, 20, 60, 120, 200)))


def bare_robot(kind: str, pull: float) -> psmpc.Run:
    """Run the task as `psmpc reproduce` does, under a controller that plans for the robot alone."""
    changes = [*BARE_ROBOT, f"controller.kind={kind}", f"{PULL}={pull}", "controller.nodes=25"]
    return psmpc.simulate(psmpc.load_task("transport_grasp", changes))


def strength() -> Iterator[str]:
    """Yield the table of losses of 20 kg as the strength falls."""
    return markdown(
        {"controller": kind, "strength [N]": pull, **outcome(bare_robot(kind, pull))}
        for kind, pull in product(("psmpc", "smpc"), (8, 4, 2))
    )


CAUGHT_BY = 25
"""When a run that asks only whether the object is taken ends [s]."""


def drifting(count: str) -> Iterator[str]:
    """Draw drift and spin up to the stated values, which the task's own motion does not know of."""
    drawn = {
        "object.motion": {"linear": [0, 0], "angular": 0},
        "uncertainty.object": {"linear": 0.02, "angular": "2 deg"},
        "time_limit": CAUGHT_BY,
    }
    captures = [simulated("catch_drifting", {**drawn, "seed": k}).summary().capture for k in range(int(count))]
    taken = sum(math.isfinite(each.closed_at) for each in captures)
    low, high = binomtest(taken, len(captures)).proportion_ci(method="wilson")
    position, angle, velocity, turn = np.max([each.missed_by for each in captures], axis=0)
    rows = {
        "taken": f"{taken} of {count}, 95 % interval {100 * low:.1f} to {100 * high:.1f} %",
        "farthest at closing": f"{1e3 * position:.2f} mm, {np.degrees(angle):.3f} deg",
        "fastest at closing": f"{1e3 * velocity:.1f} mm/s, {np.degrees(turn):.2f} deg/s",
    }
    return markdown(rows.items(), "", f"{count} draws")


def plants(count: str, strength: str) -> Iterator[str]:
    """Run both plants on the same draws: mass and motion of the object, bodies of the robot, noise."""
    drawn = {
        **UNAWARE,
        "uncertainty": {"mass": 0.1, "inertia": 0.1, "object": {"mass": 0.3, "linear": 1e-3, "angular": "0.1 deg"}},
        PULL: float(strength),
        "plant.step": 5e-4,
    }

    def row(kind: str) -> dict[str, object]:
        """Run a controller under both plants, draw by draw."""
        held, near, drifts, apart = [], 0, [], [0.0]
        for seed in range(int(count)):
            changes = {**drawn, "controller.kind": kind, "seed": seed}
            pair = [simulated("transport_grasp", {**changes, "plant": plant}) for plant in ("rk4", "mujoco")]
            summaries = [run.summary() for run in pair]
            held.append([not each.capture.lost for each in summaries])
            drifts += [each.momentum_error for each in summaries]
            if all(held[-1]):
                near += max(each.capture.loads["pull"] for each in summaries) > 0.99 * float(strength)
                apart.append(float(np.abs(pair[0]["final/object_pose"] - pair[1]["final/object_pose"]).max()))
        kept = sum(one for one, _ in held)
        return {
            "controller": kind,
            "draws": count,
            "held": kept,
            "lost": len(held) - kept,
            "pull within 1 % of the strength": near,
            "plants agree on it": sum(one == other for one, other in held),
            "object apart at the end, where held [m, rad]": f"{max(apart):.0e}",
            "largest drift of momentum": f"{max(drifts):.0e}",
        }

    return markdown(map(row, ("psmpc", "smpc")))


def built_in() -> Iterator[str]:
    """Run the built-in tasks that deliver an object, under both plants."""
    return markdown(
        row
        for task in ("transport_grasp", "catch_drifting", "catch_tumbling", "servicing")
        for row in under_both_plants(task)
    )


def under_both_plants(task: str) -> Iterator[dict[str, object]]:
    """Yield the rows of a task: how the object was taken, held and delivered, and how far the plants are apart."""
    runs = {plant: simulated(task, {"plant.kind": plant}) for plant in ("rk4", "mujoco")}
    one, other = (run["final/object_pose"] for run in runs.values())
    space = space_of_pose(len(one))
    apart = np.linalg.norm(space.pose_error(one, other)[: space.dimension])
    for plant, run in runs.items():
        position, angle, *_ = run.summary().capture.missed_by
        moved, turned = motion_between_hands(run)
        yield {
            "task": task,
            "plant": plant,
            "off at closing": f"{1e3 * position:.2f} mm, {math.degrees(angle):.3f} deg",
            "hands moved": f"{1e3 * moved:.2f} mm, {math.degrees(turned):.3f} deg",
            **outcome(run),
            "failed solves": run.summary().failed_solves,
            "plants apart [mm]": f"{1e3 * apart:.0e}",
        }


SPEED_TASKS = (
    "transport_grasp",
    "catch_drifting",
    "catch_tumbling",
    "servicing",
    "capture_floating",
    "capture_floating_servicer",
    "capture_and_detumble",
    "detumble_platform",
    "thrust_and_reach",
)
"""The built-in tasks with objects that have a mass, and with thrusters on and off."""

AFTER_CLOSING = 0.3
"""For how long after grippers close or open speeds are not judged [s]: the grasps stop them at once."""

LOWER = 0.95
"""What an engineer without a reserve would make of the limits of speed."""


def speeds() -> Iterator[str]:
    """Yield the table of speeds beyond their limits: without a reserve, with one, and with lower limits by hand."""
    return markdown(row for task in SPEED_TASKS for row in speeds_of(task))


def speeds_of(task: str) -> Iterator[dict[str, object]]:
    """Yield the rows of a task: the largest speed beyond a limit of the task as it is, and the end."""
    without = psmpc.load_task(task, {"log.shares": False, "log.plans": False, "controller.speed_reserve": 0})
    stages = build_problem(without).stages
    by_hand = {f"limits.{part}.velocity": lower for part, lower in lower_limits(without).items()}
    settings = {
        "no reserve": {"controller.speed_reserve": 0},
        "`speed_reserve: 3`": {"controller.speed_reserve": 3},
        f"limits {100 * (1 - LOWER):.0f} % lower": {"controller.speed_reserve": 0} | by_hand,
    }
    for name, changes in settings.items():
        run = psmpc.simulate(psmpc.load_task(task, {"log.shares": False, "log.plans": False, **changes}))
        limit = np.array([stages[stage].limits.velocity_high for stage in run["window/first"]])
        margin = run["margin/velocity"]
        if name.startswith("limits"):  # judged by the task's own limits
            stages_by_hand = run.problem.stages
            margin = margin + limit - [stages_by_hand[stage].limits.velocity_high for stage in run["window/first"]]
        excess = np.where(is_judged(run)[:, None], -margin / limit, 0.0)
        summary = run.summary()
        yield {
            "task": task,
            "setting": name,
            "largest speed beyond its limit [%]": f"{100 * max(np.nanmax(excess), 0.0):.1f}",
            "ends [s]": f"{summary.duration:.1f}" if summary.completed else summary.reason,
            "failed solves": summary.failed_solves,
        }


def lower_limits(task: Task) -> dict[str, list[float]]:
    """Return lower limits of the speeds of each part of a task's robot [m/s, rad/s], where all of them are limited."""
    high = resolve_limits(task.robot, task.spec.limits).velocity_high
    ends = np.cumsum(list(task.robot.parts.values()))
    of_parts = dict(zip(task.robot.parts, np.split(high, ends), strict=False))
    return {part: (LOWER * of_part).tolist() for part, of_part in of_parts.items() if np.isfinite(of_part).all()}


def is_judged(run: psmpc.Run) -> np.ndarray:
    """Tell of each sample (K,) whether no gripper has closed or opened soon before its end."""
    judged = np.ones(len(run.time), bool)
    if "grasp/closed_at" not in run:  # nothing is grasped
        return judged
    for name in ("grasp/closed_at", "grasp/opened_at"):
        for at in run[name]:
            end = run.time + run.task.spec.controller.sample_time
            judged &= ~((end > at) & (run.time <= at + AFTER_CLOSING))
    return judged


if __name__ == "__main__":
    command_line(held, unknown, ratio, known, strength, drifting, plants, built_in, speeds)
