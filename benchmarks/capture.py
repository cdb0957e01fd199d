"""The tables of docs/capture.md: runs of tasks with an object that has a mass, judged by what becomes of it.

    python benchmarks/capture.py held        strength 12 N, 5, 20 and 60 kg, unknown to the controller, by controller
    python benchmarks/capture.py known       the load known, 5 to 200 kg
    python benchmarks/capture.py strength    the strength below which each controller loses 20 kg
    python benchmarks/capture.py drifting N  catch_drifting with N draws of drift and spin
    python benchmarks/capture.py plants N F  rk4 and mujoco on the same N draws, under two controllers, strength F [N]
    python benchmarks/capture.py tumbling    catch_tumbling, rk4 and mujoco

N_s = 25 in every run. Rows are printed in order as their runs end.
"""

import math
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np
from pages import markdown
from scipy.stats import binomtest

import psmpc_cli as psmpc
from psmpc_cli.logs.run import Run
from psmpc_cli.robot.free_body import pose_error

INERTIA = 2.67 / 20
"""Inertia over mass of the object of transport_grasp [m^2]."""

LEAN = {"controller.nodes": 25, "log.shares": False, "log.plans": False}
CARRY = {
    "skills.carry": {
        "space": "joint",
        "weights": {"base": [100, 100, 10], "arms": [100, 100, 10], "control": 4},
        "limits": {"base": {"acceleration": [0.1, 0.1, 0.1]}, "arms": {"velocity": [0.02, 0.02, 0.02]}},
    },
    "stages.transport.skill": "carry",
    "stages.transport.ends_when": {"coordinates": "all", "tolerance": {"base": 5e-3, "arms": 0.05}, "velocity": 0.02},
    "object.grasp.known": True,
    "object.grasp.strength": None,
    "object.grasp.stiffness": [1e5, 1e3],
    "plant.step": 5e-4,
}
"""The load known, and Transport slow: no more than 0.1 m/s^2 of the base, arms that keep their posture."""

CONTROLLERS = ("psmpc", "smpc", "htmpc", "hard")


def simulated(task: str, set: Mapping[str, Any]) -> Run:
    """Run a task; nothing but its outcome is looked at."""
    return psmpc.simulate(psmpc.load_task(task, {**LEAN, **set}))


def massive(mass: float, **set: Any) -> dict[str, Any]:
    """Return the keys of transport_grasp with an object of a mass [kg]."""
    return {"object.mass": mass, "object.inertia": INERTIA * mass, **set}


def outcome(run: Run) -> list[str]:
    """Write what became of the object: pull, where and how fast it left, end of the run, drift of momentum."""
    summary = run.summary()
    found = summary.capture
    assert found is not None
    held = f"lost at {found.left_at:.2f} s" if found.lost else "held" if math.isfinite(found.left_at) else "not let go"
    held = held if math.isfinite(found.closed_at) else "not taken"
    return [
        held,
        f"{found.pull:.1f}",
        f"{100 * found.distance:.1f}",
        f"{math.degrees(found.angle):.1f}",
        f"{1e3 * found.speed:.0f}",
        "yes" if summary.monitors[-1].held else "no",
        f"{summary.duration:.1f}" if summary.completed else summary.reason,
        f"{summary.momentum_error:.0e}",
    ]


OUTCOME = (
    "grasps", "pull [N]", "object off by [cm]", "[deg]", "speed [mm/s]", "delivered", "ends [s]", "drift of momentum"
)  # fmt: skip


def held() -> Iterator[str]:
    """Unknown loads under every controller."""
    rows = (
        (kind, mass, *outcome(simulated("transport_grasp", massive(mass, **{"controller.kind": kind}))))
        for kind, mass in product(CONTROLLERS, (5, 20, 60))
    )
    return markdown(("controller", "mass [kg]", *OUTCOME), rows)


def known() -> Iterator[str]:
    """Known loads; the pull between the grasps is the smaller of the two."""

    def row(mass: float) -> tuple[object, ...]:
        run = simulated("transport_grasp", massive(mass, **CARRY))
        internal = np.min(run["grasp/pull"], axis=1).max(initial=0.0)
        return mass, *outcome(run), f"{internal:.1f}"

    return markdown(("mass [kg]", *OUTCOME, "internal pull [N]"), map(row, (5, 20, 60, 120, 200)))


def strength() -> Iterator[str]:
    """Look for losses of 20 kg as the strength falls."""
    rows = (
        (
            kind,
            pull,
            *outcome(simulated("transport_grasp", {"controller.kind": kind, "object.grasp.strength.pull": pull})),
        )
        for kind, pull in product(("psmpc", "smpc"), (8, 4, 2))
    )
    return markdown(("controller", "strength [N]", *OUTCOME), rows)


def drifting(count: str) -> Iterator[str]:
    """Draw drift and spin up to the stated values, which the task's own motion does not know of."""
    still = {
        "object.motion": {"linear": [0, 0], "angular": 0},
        "uncertainty.object": {"linear": 0.02, "angular": "2 deg"},
    }
    found = [simulated("catch_drifting", {**still, "seed": seed}) for seed in range(int(count))]
    captures = [each for each in (run.summary().capture for run in found) if each is not None]
    missed = np.array([each.missed_by for each in captures])
    taken = sum(math.isfinite(each.closed_at) for each in captures)
    low, high = binomtest(taken, len(found)).proportion_ci(method="wilson")
    rows = [
        ("taken", f"{taken} of {len(found)}, 95 % interval {100 * low:.1f} to {100 * high:.1f} %"),
        ("farthest at closing", f"{1e3 * missed[:, 0].max():.2f} mm, {np.degrees(missed[:, 1].max()):.3f} deg"),
        ("fastest at closing", f"{1e3 * missed[:, 2].max():.1f} mm/s, {np.degrees(missed[:, 3].max()):.2f} deg/s"),
    ]
    return markdown(("", f"{count} draws"), rows)


def plants(count: str, strength: str) -> Iterator[str]:
    """Run both plants on the same draws: mass and motion of the object, bodies of the robot, noise."""
    drawn = {
        "uncertainty": {"mass": 0.1, "inertia": 0.1, "object": {"mass": 0.3, "linear": 1e-3, "angular": "0.1 deg"}},
        "object.grasp.strength.pull": float(strength),
        "plant.step": 5e-4,
    }

    def row(kind: str) -> Sequence[object]:
        """Run a controller under both plants, draw by draw."""
        held, near, drifts, apart = [], 0, [], [0.0]
        for seed in range(int(count)):
            pair = [
                simulated("transport_grasp", {**drawn, "controller.kind": kind, "seed": seed, "plant": plant})
                for plant in ("rk4", "mujoco")
            ]
            summaries = [run.summary() for run in pair]
            captures = [summary.capture for summary in summaries if summary.capture is not None]
            held.append([not each.lost for each in captures])
            near += all(held[-1]) and max(each.pull for each in captures) > 0.99 * float(strength)
            drifts += [summary.momentum_error for summary in summaries]
            if all(held[-1]):
                apart.append(float(np.abs(pair[0]["final/object_pose"] - pair[1]["final/object_pose"]).max()))
        number, agree = sum(one for one, _ in held), sum(one == other for one, other in held)
        return kind, count, number, len(held) - number, near, agree, f"{max(apart):.0e}", f"{max(drifts):.0e}"

    headings = (
        "controller",
        "draws",
        "held",
        "lost",
        "held at more than 99 % of the strength",
        "plants agree on it",
        "object apart at the end, where held [m, rad]",
        "largest drift of momentum",
    )
    return markdown(headings, map(row, ("psmpc", "smpc")))


def tumbling() -> Iterator[str]:
    """Run catch_tumbling under both plants."""
    runs = {plant: simulated("catch_tumbling", {"plant.kind": plant}) for plant in ("rk4", "mujoco")}
    apart = pose_error(*(run["final/object_pose"] for run in runs.values()))

    def row(plant: str, run: Run) -> tuple[object, ...]:
        summary = run.summary()
        assert summary.capture is not None
        position, angle = summary.capture.missed_by[:2]
        missed = f"{1e3 * position:.2f} mm, {math.degrees(angle):.3f} deg"
        return plant, missed, *outcome(run), summary.failed_solves

    yield from markdown(("plant", "off at closing", *OUTCOME, "failed solves"), (row(*each) for each in runs.items()))
    yield ""
    yield (
        f"Final poses of the object apart by {1e3 * np.linalg.norm(apart[:3]):.1e} mm and "
        f"{math.degrees(float(np.linalg.norm(apart[3:]))):.1e} deg."
    )


COMMANDS: dict[str, Callable[..., Iterator[str]]] = {
    each.__name__: each for each in (held, known, strength, drifting, plants, tumbling)
}

if __name__ == "__main__":
    for line in COMMANDS[sys.argv[1]](*sys.argv[2:]):
        print(line, flush=True)
