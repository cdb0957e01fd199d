"""A tumbling satellite is taken and brought to rest: the tables of docs/tumbling.md.

    python benchmarks/tumbling.py budget                    what is asked, and what the means give
    python benchmarks/tumbling.py run 50 [CONTROLLER...]    complete benchmarks/tumbling.jsonl (a minute each)
    python benchmarks/tumbling.py table                     what became of the draws, by controller
    python benchmarks/tumbling.py draws                     the draws of PSMPC one by one

Draws of `capture_and_detumble`: any axis, 3 to 5 deg/s, 50 to 200 kg. Moments of inertia go with the mass. The motion
is that of a free body (Euler's equations). All controllers have the settings of the task, and a free end. Where inertia
is estimated the controller begins with the task's mass and moments, and the true ones are drawn about those.
"""

import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from pages import command_line, markdown

import psmpc_cli as psmpc

TASK = "capture_and_detumble"

RESULTS = Path(__file__).with_name("tumbling.jsonl")

BRIEF = {"log": {"shares": False, "plans": False}}

CONTROLLERS: dict[str, dict[str, Any]] = {
    "psmpc": {},
    "smpc": {"controller.kind": "smpc"},
    "hard, free end": {"controller.kind": "hard", "controller.one_stage": "free_end"},
    "psmpc, estimated inertia": {"object.grasp.known": "estimated", "uncertainty.object.mass": 0.5},
}

COMPARED = ("smpc", "hard, free end")
"""Controllers that are compared with PSMPC, on those draws alone on which no setting was chosen."""

AT_REST = 0.1
"""Rate below which the satellite is at rest [deg/s]."""

FORCE_EXCEEDED = 1.05
"""Commanded force over its limit above which a draw counts as one that exceeds it."""

DETUMBLE = 2
"""Index of the stage that brings it to rest."""

CHOSEN_ON = 6
"""Draws, the first ones, on which some settings of the task were chosen; the others were chosen on seeds 100 to 105."""

STOPS_WITHIN = 1.3
"""What the satellite takes to come to rest in the task as it stands [s]."""

WHEELS = 4
"""Momentum of each of four reaction wheels in a pyramid, as `thruster_servicer` has them [N m s]."""


def drawn(seed: int) -> dict[str, Any]:
    """Return the changes of the task in a draw."""
    rng = np.random.default_rng(seed)
    axis = rng.standard_normal(3)
    rate = rng.uniform(3, 5)
    mass = rng.uniform(50, 200)
    nominal = psmpc.load_task(TASK).spec.object
    return {
        "object.mass": round(mass, 1),
        "object.inertia": [round(moment * mass / nominal.mass, 2) for moment in nominal.inertia],
        "object.motion.angular": [f"{each:.3f} deg" for each in rate * axis / np.linalg.norm(axis)],
    }


def changes(controller: str, seed: int) -> dict[str, Any]:
    """Return the changes of the task in a draw under a controller; with an estimated inertia the true one is drawn."""
    settings = CONTROLLERS[controller]
    of_draw = drawn(seed)
    if "uncertainty.object.mass" in settings:
        return {"object.motion.angular": of_draw["object.motion.angular"], "seed": seed, **settings}
    return {**of_draw, **settings}


@contextmanager
def timed_decisions() -> Iterator[list[float]]:
    """Collect the processor time of every decision of the controllers within [s]."""
    step = psmpc.Controller.step
    times: list[float] = []

    def timed(*arguments: Any, **named: Any) -> Any:
        began = time.process_time()
        command = step(*arguments, **named)
        times.append(time.process_time() - began)
        return command

    with mock.patch.object(psmpc.Controller, "step", timed):
        yield times


def draw(controller: str, seed: int) -> dict[str, Any]:
    """Fly a draw and return what became of it."""
    task = psmpc.load_task(TASK, {**changes(controller, seed), **BRIEF})
    with timed_decisions() as decisions:
        run = psmpc.simulate(task)
    summary = run.summary()
    ends = run.stages["switch_time"]
    taken, at_rest = ends[DETUMBLE - 1 : DETUMBLE + 1]
    rates = np.degrees(np.linalg.norm(run["object/velocity"][:, 3:], axis=1))
    before_carrying = (run.time >= taken) & (run.time <= at_rest + 1e-6)  # none where it was not taken, or not at rest
    return {
        "controller": controller,
        "seed": seed,
        "mass": round(float(run["object/mass"]), 1),
        "rate": round(float(rates[0]), 2),
        "succeeded": bool(summary.succeeded),
        "why": summary.reason,
        "ends": [round(float(end), 2) if np.isfinite(end) else None for end in ends],
        "time": round(float(summary.duration), 1),
        "lowest_rate": round(float(rates[before_carrying].min()), 3) if before_carrying.any() else None,
        "last_rate": round(float(rates[-1]), 3),
        "pull": round(float(run["grasp/pull"].max()), 1),
        "force": round(float(run["force/utilization"].max()), 3),
        "failed_solves": summary.failed_solves,
        "late": int(np.sum(np.array(decisions) > task.spec.controller.sample_time)),
        "decisions": len(decisions),
        "slowest": round(max(decisions), 3),
    }


def results() -> dict[str, dict[int, dict[str, Any]]]:
    """Return the draws so far by controller and seed."""
    made: dict[str, dict[int, dict[str, Any]]] = {name: {} for name in CONTROLLERS}
    lines = RESULTS.read_text().splitlines() if RESULTS.exists() else []
    for row in map(json.loads, lines):
        made[row["controller"]][row["seed"]] = row
    return made


def run(count: str, *controllers: str) -> Iterator[str]:
    """Run the draws that are missing; controllers are compared on those alone on which no setting was chosen."""
    made = results()
    for seed in range(int(count)):
        for controller in controllers or CONTROLLERS:
            if seed not in made[controller] and (controller not in COMPARED or seed >= CHOSEN_ON):
                row = draw(controller, seed)
                with RESULTS.open("a") as file:
                    file.write(json.dumps(row) + "\n")
                yield json.dumps(row)


def is_at_rest(row: dict[str, Any]) -> bool:
    """Tell whether the satellite of a draw was brought to rest before it was carried."""
    return row["lowest_rate"] is not None and row["lowest_rate"] < AT_REST


def table() -> Iterator[str]:
    """Yield what became of the draws, by controller; differences are of the draws that both delivered."""
    made = results()
    rows = []
    for controller, of_one in made.items():
        delivered = {seed: row for seed, row in of_one.items() if row["succeeded"]}
        both = [seed for seed in delivered if made["psmpc"].get(seed, {}).get("succeeded")]
        later = [delivered[seed]["time"] - made["psmpc"][seed]["time"] for seed in both]
        is_compared = later and controller in COMPARED
        at_rest = [row["ends"][DETUMBLE] - row["ends"][DETUMBLE - 1] for row in delivered.values()]
        late = sum(row["late"] for row in of_one.values())
        exceeding = sum(row["force"] > FORCE_EXCEEDED for row in of_one.values())
        rows.append(
            {
                "controller": controller,
                f"below {AT_REST} deg/s": f"{sum(map(is_at_rest, of_one.values()))} of {len(of_one)}",
                "delivered": f"{len(delivered)} of {len(of_one)}",
                "end, median [s]": f"{np.median([row['time'] for row in delivered.values()]):.1f}" if delivered else "",
                "later than psmpc, median [s]": f"{np.median(later):+.1f}" if is_compared else "",
                "from taken to rest, median [s]": f"{np.median(at_rest):.1f}" if at_rest else "",
                "last rate, largest [deg/s]": f"{max((row['last_rate'] for row in delivered.values()), default=0):.2f}",
                "largest pull [N]": f"{max((row['pull'] for row in delivered.values()), default=0):.1f}",
                "force over its limit": f"{exceeding} of {len(of_one)}",
                "failed solves": sum(row["failed_solves"] for row in of_one.values()),
                "late decisions": f"{late} of {sum(row['decisions'] for row in of_one.values())}" if of_one else "",
            }
        )
    return markdown(rows)


def draws() -> Iterator[str]:
    """Yield the draws of PSMPC one by one."""
    return markdown(
        {
            "seed": seed,
            "mass [kg]": row["mass"],
            "rate [deg/s]": row["rate"],
            "taken at [s]": row["ends"][1] or "-",
            "at rest at [s]": row["ends"][2] or "-",
            "rate then [deg/s]": "-" if row["lowest_rate"] is None else row["lowest_rate"],
            "largest force over its limit": row["force"],
            "ends [s]": row["time"],
            "mission": row["why"],
        }
        for seed, row in sorted(results()["psmpc"].items())
    )


def budget() -> Iterator[str]:
    """Yield what the task as it stands asks of the servicer that has taken the satellite, and what its means give."""
    task = psmpc.load_task(TASK)
    body = task.spec.object
    robot = task.robot
    mass = sum(each.mass for each in robot.bodies)
    omega = np.array(body.motion.angular)
    rate = float(np.linalg.norm(omega))
    # the servicer turns with the satellite, at a place of the satellite's frame that is across to it at worst
    place = np.array(task.spec.stages[0].target["base"].object[:3])
    distance = float(np.linalg.norm(place))
    reduced = mass * body.mass / (mass + body.mass)
    spin = float(np.linalg.norm(np.array(body.inertia) * omega))  # both are about its principal axes
    own = float(max(robot.base.inertia[:3])) * rate
    limits = task.spec.limits["base"]
    force, torque = limits.force[0][1], limits.force[3][1]
    pyramid = 2 * WHEELS / np.sqrt(1.5)  # two of the four help
    both = reduced * distance**2 * rate
    turning_back = (spin + own + both) / torque
    impulse = mass * distance * rate
    pull = body.mass * distance * rate / STOPS_WITHIN
    rows = {
        "rate of the satellite": f"{np.degrees(rate):.1f} deg/s",
        "momentum of the satellite about its centre": f"{spin:.2f} N m s",
        "momentum of the servicer's own turn": f"{own:.2f} N m s",
        "momentum of both about their common centre of mass, by circling": f"{both:.1f} N m s",
        "momentum that four wheels of the servicer's class store about x or y": f"{pyramid:.1f} N m s",
        "largest torque of the thrusters": f"{torque:g} N m",
        "time in which this torque takes the sum of those three momenta away": f"{turning_back:.1f} s",
        "speed of the servicer beside the satellite": f"{distance * rate:.3f} m/s",
        "impulse to reach that speed, and again to stop with the satellite": f"{impulse:.0f} N s each",
        "largest force of the thrusters": f"{force:g} N",
        "time in which this force gives one of these impulses": f"{impulse / force:.1f} s",
        f"force at the hands if both stop within {STOPS_WITHIN} s, as in `{TASK}`": f"{pull:.1f} N",
        "pull that each of the two grasps bears": f"{body.grasp.strength.pull:g} N",
    }
    return markdown(rows.items(), "what", TASK)


if __name__ == "__main__":
    command_line(budget, run, table, draws)
