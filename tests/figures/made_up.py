"""Logs of made-up runs: rest-to-rest motions between given points, without any controller or solver."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from psmpc_cli.logs.record import Record, SolveRecord, TickRecord
from psmpc_cli.logs.write import Header, LogWriter, StageTimes
from psmpc_cli.robot.model import RobotModel, build_model
from psmpc_cli.specs.coordinates import labels
from psmpc_cli.specs.library import find
from psmpc_cli.specs.load import Task, parse_task

HORIZON = 4.0

Q_CAPTURE = np.array([-2, 2, np.pi / 6, np.pi / 4, np.pi / 6, np.pi / 3, -np.pi / 4, -np.pi / 6, -np.pi / 3])
Q_THERE = np.array([0, 0, 0, np.pi / 4, np.pi / 4, np.pi / 3, -np.pi / 4, -np.pi / 4, -np.pi / 3])
Q_APPROACHED = np.r_[Q_CAPTURE[:3], np.zeros(6)]


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
    attributes: Mapping[str, Any] = field(default_factory=dict)


def write_story(path: Path, story: Story) -> Path:
    """Write the log of a story."""
    loaded = parse_task(story.task, story.robot, "made up")
    model = build_model(loaded.robot)
    with LogWriter(path, _header(loaded, story)) as log:
        for time in np.arange(0.0, min(story.ends[-1] - 1e-9, story.last), story.sample):
            log.append(_record(model, float(time), story))
        log.update_stages(_stage_times(story))
        if story.last == np.inf:
            Q, Qdot, _ = _motion(story.ends[-1], story)
            true = np.r_[Q, Qdot]
            log.finish(True, "done", story.ends[-1], true + story.blur, _poses(model, Q), true)
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
    }
    return Header(
        attributes={**usual, **story.attributes},
        coordinates=labels(loaded.robot, "joint"),
        pose_coordinates=labels(loaded.robot, "task"),
        stages=tuple(stage.name for stage in loaded.spec.stages),
        priorities=tuple(stage.priority for stage in loaded.spec.stages),
        epsilons=(0.1, 0.01),
        ticks=story.ticks,
        plans=False,
        noisy=story.blur > 0,
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


def _stage_times(story: Story) -> StageTimes:
    ends = np.array([end if end <= story.last else np.nan for end in story.ends])
    starts, premature = np.r_[0.0, ends[:-1]], np.zeros(len(ends), bool)
    for stage, time in story.early.items():
        if time <= story.last:
            starts[stage], premature[stage] = time, True
    return StageTimes(ends, starts, premature, np.tile(starts[:, None], (1, 2)))


def _record(model: RobotModel, time: float, story: Story) -> Record:
    Q, Qdot, u = _motion(time, story)
    first = int(np.searchsorted(story.ends, time, side="right"))
    instants = np.array([end + 0.02 * (end - time) for end in story.ends[first:-1] if end < time + HORIZON])
    empty, blur = np.zeros(0), story.blur * (-1) ** round(time / story.sample)
    return Record(
        time=time,
        Q=Q + blur,
        Qdot=Qdot + blur,
        u=u,
        F=model.inverse_dynamics(Q, Qdot, u),
        xi=_poses(model, Q),
        window_first=first,
        instants=instants,
        nadir=np.ones(len(instants) + 1),
        nodes=np.full(len(instants) + 1, 25.0),
        flags=frozenset({"fallback"} if abs(time - 20.0) < 1e-6 else ()),
        switches=(),
        presence={},
        solve=SolveRecord(
            "solved", 9 + 5 * len(instants), 0.012 * (1 + len(instants)), 1.0, empty, False, empty, empty, empty
        ),
        stage_cost=1.0,
        position_margin=np.ones(model.n),
        velocity_margin=np.ones(model.n),
        control_effort=1.0,
        thruster_effort=np.ones(2),
        momentum_error=np.zeros(3),
        energy_error=0.0,
        ticks=_ticks(model, time, story) if story.ticks else None,
        window_cost=2.0 ** -np.arange(len(instants) + 1),
        true=np.r_[Q, Qdot] if story.blur else None,
        shares=_shares(first, time, instants),
    )


def _shares(first: int, time: float, instants: np.ndarray) -> dict[int, float]:
    """The stages of the window take over one after another, each over a horizon."""
    handed = [1.0, *np.clip(1.0 - (instants - time) / HORIZON, 0.0, 1.0), 0.0]
    return {first + k: float(handed[k] - handed[k + 1]) for k in range(len(handed) - 1)}


def _ticks(model: RobotModel, time: float, story: Story) -> TickRecord:
    times = time + np.array([0.0, story.sample / 2])
    motions = [_motion(float(tick), story) for tick in times]
    F = np.array([model.inverse_dynamics(*motion) for motion in motions])
    return TickRecord(times, np.array([m[0] for m in motions]), np.array([m[1] for m in motions]), F)
