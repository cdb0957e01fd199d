"""Logs of made-up runs: rest-to-rest motions between given points, without any controller or solver."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from psmpc_cli.logs.conditions import ALWAYS, CLEARANCE, TICKS, TRUE_STATE
from psmpc_cli.logs.schema import MOMENTUM, PEAKS
from psmpc_cli.logs.write import Header, LogWriter
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.library import find
from psmpc_cli.specs.load import Task, parse_task
from psmpc_cli.specs.robots.robot import labels

HORIZON = 4.0

Q_CAPTURE = np.array([-2, 2, np.pi / 6, np.pi / 4, np.pi / 6, np.pi / 3, -np.pi / 4, -np.pi / 6, -np.pi / 3])
Q_THERE = np.array([0, 0, 0, np.pi / 4, np.pi / 4, np.pi / 3, -np.pi / 4, -np.pi / 4, -np.pi / 3])
Q_APPROACHED = np.r_[Q_CAPTURE[:3], np.zeros(6)]

LIMITED = ("position", "velocity", "planned_position", "planned_velocity")
"""Quantities that have limits, of the robot and of its plans."""

POINTS = tuple(f"{side}.{axis}" for side in ("first", "second") for axis in "xyz")


@dataclass(frozen=True)
class Story:
    """A made-up run.

    Attributes:
        task, robot: The texts of its specifications.
        ends: When the stages end [s].
        points: Q at the start and at the end of each stage (S + 1, n).
        early: By stage, when its arms start to move although the stage before is still on [s].
        last: When the log breaks off [s].
        sample: Sample time [s].
        ticks: Whether the log holds ticks, two a sample.
        blur: How far off the true state, up and down, the controller sees every coordinate and velocity [SI].
        distances: By pair of parts, such as "arm_1.2 - post", their distance at times evenly apart over the run [m].
        attributes: Further attributes of the log, in place of the usual ones.
    """

    task: str = field(default_factory=lambda: find("task", "transport").read_text())
    robot: str = field(default_factory=lambda: find("robot", "planar_dual_arm").read_text())
    ends: tuple[float, ...] = (10.0, 13.0, 23.0, 29.6)
    points: tuple[np.ndarray, ...] = (np.zeros(9), Q_APPROACHED, Q_CAPTURE, Q_THERE, np.zeros(9))
    early: Mapping[int, float] = field(default_factory=lambda: {1: 6.4})
    last: float = np.inf
    sample: float = 0.4
    ticks: bool = False
    blur: float = 0.0
    distances: Mapping[str, Sequence[float]] = field(default_factory=dict)
    attributes: Mapping[str, Any] = field(default_factory=dict)


def story_among_obstacles() -> dict[str, Any]:
    """A run past a moving ball, through a wall and before a beam: nine pairs, one of them overlaps from 10 to 20 s."""
    clear = """
obstacles:
  - {name: ball, shape: {sphere: 0.2}, pose: [-1, 1.2, 0], velocity: [0.05, 0]}
  - {name: beam, shape: {capsule: [0.1, 0.6]}, pose: [-1.5, 3, 30 deg]}
  - {name: crate, shape: {box: [0.5, 0.3]}, pose: [0.8, -0.5, 20 deg]}
  - {name: wall, shape: {half_space: [1, 0]}, pose: [-3.2, 0, 0]}
clearance: {margin: 0.03}
"""
    distances = {
        **{f"arm_1.{k} - {name}": (0.5, 0.1 + k / 20, 0.9) for name in ("ball", "beam") for k in (1, 2, 3)},
        "arm_1.3 - object": (0.4, 0.2, np.nan, np.nan),
        "object - arm_1.3": (np.nan, np.nan, 0.1, 0.05),
        "base - wall": (0.1, -0.05, -0.05, 0.1),
        "base - object": (np.nan, np.nan, np.nan, np.nan),
    }
    return {"task": find("task", "transport").read_text() + clear, "distances": distances}


def write_story(path: Path, story: Story) -> Path:
    """Write the log of a story."""
    loaded = parse_task(story.task, story.robot, "transport")
    model = RobotModel(loaded.robot)
    with LogWriter(path, _header(loaded, story)) as log:
        for time in np.arange(0.0, min(story.ends[-1] - 1e-9, story.last), story.sample):
            log.write(_row(model, float(time), story))
        log.update(_stage_times(story))
        if story.last == np.inf:
            Q, Qdot, _ = _motion(story.ends[-1], story)
            final = {"end_time": story.ends[-1], "Q": Q + story.blur, "Qdot": Qdot + story.blur, "xi": _poses(model, Q)}
            final |= {"Q_true": Q, "Qdot_true": Qdot} if story.blur else {}
            log.finish(True, "done", {f"final/{name}": value for name, value in final.items()})
    return path


def _header(loaded: Task, story: Story) -> Header:
    usual: dict[str, str | int | float] = {
        "psmpc_version": "0.1.0",
        "controller": "psmpc",
        "plant": "rk4",
        "sample_time": story.sample,
        "horizon": HORIZON,
        "task_name": "transport",
        "task_yaml": story.task,
        "robot_yaml": story.robot,
        "digest": loaded.digest,
    }
    names = tuple(stage.name for stage in loaded.spec.stages)
    return Header(
        attributes={**usual, **story.attributes},
        values={
            "coordinate": labels(loaded.robot, "joint"),
            "pose_coordinate": labels(loaded.robot, "task"),
            "stage": names,
            "momentum": MOMENTUM[2],
            "stages/epsilon": (0.1, 0.01),
            "stages/name": names,
            "stages/priority": [stage.priority for stage in loaded.spec.stages],
            "monitors/name": (),
            **({"clearance/pair": tuple(story.distances), "clearance/point": POINTS} if story.distances else {}),
        },
        has=frozenset(
            {
                ALWAYS,
                *({TICKS} if story.ticks else ()),
                *({TRUE_STATE} if story.blur else ()),
                *({CLEARANCE} if story.distances else ()),
            }
        ),
    )


def _motion(time: float, story: Story) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Q, Qdot and Qddot: base and arms go from point to point, the arms earlier where a stage is early."""
    starts = (0.0, *story.ends)
    early = tuple(story.early.get(k, start) for k, start in enumerate(starts))
    base, arms = _between(time, starts, story.points), _between(time, early, story.points)
    Q, Qdot, u = (np.r_[b[:3], a[3:]] for b, a in zip(base, arms, strict=True))
    return Q, Qdot, u


def _between(time: float, times: tuple[float, ...], points: tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
    """Position, velocity and acceleration along quintics from point to point."""
    k = min(int(np.searchsorted(times, time, side="right")) - 1, len(times) - 2)
    tau, step = times[k + 1] - times[k], points[k + 1] - points[k]
    s = min((time - times[k]) / tau, 1.0)
    return (
        points[k] + (s**3 * (10 - 15 * s + 6 * s**2)) * step,
        30 * s**2 * (1 - s) ** 2 / tau * step,
        60 * s * (1 - s) * (1 - 2 * s) / tau**2 * step,
    )


def _poses(model: RobotModel, Q: np.ndarray) -> np.ndarray:
    return np.asarray(model.g(Q)).ravel()


def _stage_times(story: Story) -> dict[str, np.ndarray]:
    ends = np.array([end if end <= story.last else np.nan for end in story.ends])
    starts, early = np.r_[0.0, ends[:-1]], np.zeros(len(ends), bool)
    for stage, time in story.early.items():
        if time <= story.last:
            starts[stage], early[stage] = time, True
    return {
        "stages/switch_time": ends,
        "stages/actual_start": starts,
        "stages/early": early,
        "stages/actual_start_by_epsilon": np.tile(starts[:, None], (1, 2)),
    }


def _row(model: RobotModel, time: float, story: Story) -> dict[str, Any]:
    Q, Qdot, u = _motion(time, story)
    first = int(np.searchsorted(story.ends, time, side="right"))
    switch_times = np.array([end + 0.02 * (end - time) for end in story.ends[first:-1] if end < time + HORIZON])
    count, stages, blur = len(switch_times) + 1, len(story.ends), story.blur * (-1) ** round(time / story.sample)

    def placed(values: np.ndarray) -> np.ndarray:
        return np.r_[np.full(first, np.nan), values, np.full(stages - first - len(values), np.nan)]

    return {
        "time": time,
        "state/Q": Q + blur,
        "state/Qdot": Qdot + blur,
        "control/u": u,
        "force/F": model.inverse_dynamics(Q, Qdot, u),
        "force/own_axes": np.array(model.space.along_base_axes(Q, model.inverse_dynamics(Q, Qdot, u)), dtype=float),
        "pose/xi": _poses(model, Q),
        "window/first": first,
        "window/count": count,
        "window/instants": placed(switch_times),
        "window/cost": placed(2.0 ** -np.arange(count)),
        "window/basin": -1,
        "window/nodes": placed(np.full(count, 25.0)),
        "window/presence": np.full(stages, np.nan),
        "window/share": placed(_shares(time, switch_times)),
        **{f"events/{name}": 0 for name in ("appended", "postponed", "braking", "unmeasured")},
        "events/solve_failed": abs(time - 20.0) < 1e-6,
        "solver/status": "solved",
        "solver/warm": 0,
        "solver/iterations": 9 + 5 * len(switch_times),
        "solver/wall_time": 0.012 * count,
        "solver/objective": 1.0,
        "normalization/nadir": placed(np.ones(count)),
        "cost/current_stage": 1.0,
        **{f"margin/{name}": np.ones(model.n) for name in LIMITED},
        **{f"effort/{name}": 1.0 for name in ("control", "squared_acceleration", "base_force", "base_torque")},
        **{f"peak/{name}": 1.0 for name in PEAKS},
        **{f"deviation/{name}": np.full(model.n, np.nan) for name in ("Q", "Qdot")},
        "deviation/end": np.full(stages, np.nan),
        "deviation/end_noise": np.full(stages, np.nan),
        "balance/momentum": np.zeros(3),
        "balance/energy": 0.0,
        "state/Q_true": Q,
        "state/Qdot_true": Qdot,
        **(_ticks(model, time, story) if story.ticks else {}),
        **(_clearance(time, story) if story.distances else {}),
    }


def _clearance(time: float, story: Story) -> dict[str, np.ndarray]:
    """Distances as the story has them; the nearest points of every pair are beside each other at x = 1 m."""
    apart = np.array(
        [np.interp(time, np.linspace(0, story.ends[-1], len(each)), each) for each in story.distances.values()]
    )
    points = np.tile([1.0, 1.0, 0.0, 1.0, 1.0, 0.0], (len(apart), 1))
    points[:, 3] += apart
    return {"clearance/distance": apart, "clearance/margin": apart - 0.02, "clearance/points": points}


def _shares(time: float, switch_times: np.ndarray) -> np.ndarray:
    """The stages of the window take over one after another, each over a horizon."""
    begun = np.array([1.0, *np.clip(1.0 - (switch_times - time) / HORIZON, 0.0, 1.0), 0.0])
    return begun[:-1] - begun[1:]


def _ticks(model: RobotModel, time: float, story: Story) -> dict[str, np.ndarray]:
    times = time + np.array([0.0, story.sample / 2])
    Q, Qdot, u = (np.array(each) for each in zip(*(_motion(float(tick), story) for tick in times), strict=True))
    F = np.array([model.inverse_dynamics(*each) for each in zip(Q, Qdot, u, strict=True)])
    number = 2 * round(time / story.sample) + np.arange(2)
    return {"ticks/tick": number, "ticks/time": times, "ticks/Q": Q, "ticks/Qdot": Qdot, "ticks/F": F}
