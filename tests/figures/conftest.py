"""A log of a made-up run: the shape of a transport run, without any controller or solver."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from psmpc_cli.figures.run import Run, load_run
from psmpc_cli.logs.read import Log, read_log
from psmpc_cli.logs.record import Record, SolveRecord
from psmpc_cli.logs.write import Header, LogWriter, StageTimes
from psmpc_cli.robot.model import RobotModel, build_model
from psmpc_cli.specs.library import find
from psmpc_cli.specs.load import LoadedTask, parse_task

STAGES = ("approach", "capture", "transport", "release")
ENDS = (10.0, 13.0, 23.0, 29.6)
EARLY = 6.4
SAMPLE = 0.4
HORIZON = 4.0

Q_START = np.zeros(9)
Q_CAPTURE = np.array([-2, 2, np.pi / 6, np.pi / 4, np.pi / 6, np.pi / 3, -np.pi / 4, -np.pi / 6, -np.pi / 3])
Q_THERE = np.array([0, 0, 0, np.pi / 4, np.pi / 4, np.pi / 3, -np.pi / 4, -np.pi / 4, -np.pi / 3])


@dataclass(frozen=True)
class Story:
    """What happens in a made-up run.

    Attributes:
        last: Time of the last sample [s].
        finished: Whether the log was closed in order.
        premature: Whether Capture starts before Approach is over.
    """

    last: float = ENDS[-1] - SAMPLE / 2
    finished: bool = True
    premature: bool = True
    task: str = "transport"


WriteLog = Callable[..., Path]


@pytest.fixture(scope="session")
def loaded() -> LoadedTask:
    task, robot = find("task", "transport"), find("robot", "planar_dual_arm")
    return parse_task(task.read_text(), robot.read_text(), "transport")


@pytest.fixture(scope="session")
def model(loaded: LoadedTask) -> RobotModel:
    return build_model(loaded.robot)


@pytest.fixture(scope="session")
def write_log(loaded: LoadedTask, model: RobotModel) -> WriteLog:
    """Write the log of a story: (path, **story) -> path."""

    def write(path: Path, **changes: object) -> Path:
        story = replace(Story(), **changes)  # type: ignore[arg-type]
        times = np.arange(0.0, story.last + 1e-9, SAMPLE)
        with LogWriter(path, _header()) as log:
            for time in times:
                log.append(_record(model, float(time), story))
            log.update_stages(_stage_times(story))
            if story.finished:
                Q, Qdot, _ = _motion(ENDS[-1], story)
                log.finish(True, "release met its end condition", ENDS[-1], np.r_[Q, Qdot], _poses(model, Q))
        return path

    return write


@pytest.fixture(scope="session")
def log_path(tmp_path_factory: pytest.TempPathFactory, write_log: WriteLog) -> Path:
    return write_log(tmp_path_factory.mktemp("logs") / "transport.h5")


@pytest.fixture(scope="session")
def log(log_path: Path) -> Log:
    return read_log(log_path)


@pytest.fixture(scope="session")
def run(log: Log) -> Run:
    return load_run(log)


def _header() -> Header:
    task, robot = find("task", "transport"), find("robot", "planar_dual_arm")
    coordinates = [f"{part}.{row}" for part, rows in _ROWS.items() for row in rows]
    poses = [f"{part}.{row}" for part in _ROWS for row in ("x", "y", "angle")]
    return Header(
        attributes={
            "psmpc_version": "0.1.0",
            "controller": "psmpc",
            "plant": "rk4",
            "sample_time": SAMPLE,
            "horizon": HORIZON,
            "task_name": "transport",
            "task_yaml": task.read_text(),
            "robot_yaml": robot.read_text(),
        },
        coordinates=tuple(coordinates),
        pose_coordinates=tuple(poses),
        stages=STAGES,
        priorities=(1.0, 100.0, 1.0, 0.01),
        epsilons=(0.1, 0.01),
        ticks=False,
        plans=False,
    )


_ROWS = {"base": ("x", "y", "angle"), "arm_1": ("1", "2", "3"), "arm_2": ("1", "2", "3")}


def _motion(time: float, story: Story) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Q, Qdot and Qddot of rest-to-rest motions between the stages' targets."""
    start = EARLY if story.premature else ENDS[0]
    base = _between(time, (0.0, ENDS[0], ENDS[1], ENDS[2], ENDS[3]), (Q_START, Q_CAPTURE, Q_CAPTURE, Q_THERE, Q_START))
    arms = _between(time, (0.0, start, ENDS[1], ENDS[2], ENDS[3]), (Q_START, Q_START, Q_CAPTURE, Q_THERE, Q_START))
    return tuple(np.r_[b[:3], a[3:]] for b, a in zip(base, arms, strict=True))  # type: ignore[return-value]


def _between(time: float, times: tuple[float, ...], points: tuple[np.ndarray, ...]) -> list[np.ndarray]:
    """Position, velocity and acceleration along quintics from point to point."""
    k = min(int(np.searchsorted(times, time, side="right")) - 1, len(times) - 2)
    tau = times[k + 1] - times[k]
    s = min((time - times[k]) / tau, 1.0)
    shape = (s**3 * (10 - 15 * s + 6 * s**2), 30 * s**2 * (1 - s) ** 2 / tau, 60 * s * (1 - s) * (1 - 2 * s) / tau**2)
    step = points[k + 1] - points[k]
    return [points[k] + shape[0] * step, shape[1] * step, shape[2] * step]


def _poses(model: RobotModel, Q: np.ndarray) -> np.ndarray:
    return np.asarray(model.g(Q)).ravel()


def _stage_times(story: Story) -> StageTimes:
    known = story.last if not story.finished else np.inf
    ends = np.array([end if end <= known else np.nan for end in ENDS])
    starts = np.r_[0.0, ends[:-1]]
    premature = np.zeros(4, bool)
    if story.premature and known >= EARLY:
        starts[1], premature[1] = EARLY, True
    return StageTimes(ends, starts, premature, np.tile(starts[:, None], (1, 2)))


def _record(model: RobotModel, time: float, story: Story) -> Record:
    Q, Qdot, u = _motion(time, story)
    first = int(np.searchsorted(ENDS, time, side="right"))
    instants = np.array([end + 0.02 * (end - time) for end in ENDS[first:-1] if end < time + HORIZON])
    empty = np.zeros(0)
    return Record(
        time=time,
        Q=Q,
        Qdot=Qdot,
        u=u,
        F=np.asarray(model.low_level(Q, Qdot, u)).ravel(),
        xi=_poses(model, Q),
        window_first=first,
        instants=instants,
        nadir=np.ones(len(instants) + 1),
        flags=frozenset({"fallback"} if abs(time - 20.0) < 1e-6 else ()),
        switches=(),
        presence={},
        solve=SolveRecord(
            "solved", 9 + 5 * len(instants), 0.012 * (1 + len(instants)), 1.0, empty, empty, empty, empty
        ),
        stage_cost=1.0,
        position_margin=np.ones(9),
        velocity_margin=np.ones(9),
        control_effort=1.0,
        thruster_effort=np.ones(2),
        momentum_error=np.zeros(3),
        energy_error=0.0,
    )
