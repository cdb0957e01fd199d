"""Hand-made runs of the transport task: the log of a made-up one with other times, monitors and waiting stages."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import cast

import numpy as np

from psmpc_cli.logs.run import Run, read_run
from psmpc_cli.logs.schema import SCHEMA
from psmpc_cli.ocp.problem import Problem, build_problem
from psmpc_cli.paper.judge import Reproduction
from psmpc_cli.paper.reproduce import load_grasps
from psmpc_cli.studies.sweep import SweepCells

from ..synthetic_logs import Story, write_story

STAGES = ("approach", "capture", "transport", "release")

VERSIONS = {"casadi_version": "3.8", "numpy_version": "2.0"}

TIMES = np.round(np.arange(0.0, 30.0, 0.1), 1)


@cache
def _made_up() -> Run:
    with TemporaryDirectory() as folder:
        run = read_run(write_story(Path(folder) / "run.h5", Story(attributes=VERSIONS)))
    assert run.problem is not None  # built once, before the file is gone
    return run


def hand_made(
    ends: Sequence[float] = (10.0, 14.0, 24.0, 30.0),
    early: Mapping[str, float] | None = None,
    lost: float | None = None,
    presence: Mapping[str, Mapping[float, float]] | None = None,
    starts: Mapping[float, float] | None = None,
    method: str = "psmpc",
) -> Run:
    """A run with a sample every 0.1 s to 30 s.

    Args:
        ends: When its stages end; NaN if never.
        early: Actual starts before their time, by stage.
        lost: When the grippers move apart; during transport that violates the monitor.
        presence: What a waiting stage adds at each time, by stage.
        starts: Actual starts of every stage by threshold.
        method: The controller.
    """
    base, early = _made_up(), early or {}
    sampled = [column.path for column in SCHEMA if column.value is not None and column.dims[0] == "time"]
    rows = np.resize(np.arange(len(base.time)), len(TIMES))
    arrays = {path: values[rows] if path in sampled else values for path, values in base.arrays.items()}
    begins = np.r_[0.0, ends[:-1]]
    first = np.minimum(np.searchsorted(ends, TIMES, side="right"), 3)
    xi = np.tile(base["pose/xi"][:1], (len(TIMES), 1))
    xi[(np.inf if lost is None else lost) <= TIMES, base["pose_coordinate"].tolist().index("arm_1.y")] += 1.0
    added = np.full((len(TIMES), 4), np.nan)
    for stage, values in (presence or {}).items():
        added[np.searchsorted(TIMES, np.array(list(values)) - 1e-6), STAGES.index(stage)] = list(values.values())
    thresholds = np.array(list(starts or {0.1: np.nan}))
    arrays |= {
        "time": TIMES,
        "window/first": first,
        "window/count": np.ones_like(first),
        "window/presence": added,
        "pose/xi": xi,
        "events/postponed": np.zeros_like(first),
        "stages/switch_time": np.array(ends),
        "stages/actual_start": np.array([early.get(name, begin) for name, begin in zip(STAGES, begins, strict=True)]),
        "stages/early": np.array([name in early for name in STAGES]),
        "stages/epsilon": thresholds,
        "stages/actual_start_by_epsilon": np.tile(list((starts or {0.1: np.nan}).values()), (4, 1)),
        "final/end_time": np.nanmax([1.0, *ends]),
    }
    completed = bool(np.isfinite(ends[-1]))
    reason = "release met its end condition" if completed else "time limit of 60 s reached"
    attributes = {**base.attributes, "controller": method, "finished": completed, "end_reason": reason}
    made = replace(base, arrays=arrays, attributes=attributes)
    vars(made).update(task=base.task, problem=base.problem)  # the same for all: made once
    return made


def grasped(off: float = 0.0, lost: float | None = None, taken: bool = True, opened: bool = True) -> Run:
    """A run in which an object with a mass leaves grippers that closed at 14 s.

    Args:
        off: Its distance from its destination when they open, at 24 s [m].
        lost: When the first grasp is pulled open.
        taken: Whether the second gripper closed.
        opened: Whether they open; else the run ends with the object held.
    """
    base, task = hand_made(), load_grasps()["psmpc"]
    left_at = np.nan if not opened else 24.0 if lost is None else lost
    thing, closed = task.spec.object, np.array([14.0, 14.0 if taken else np.nan])
    assert thing is not None and thing.destination is not None
    inside = (closed <= TIMES[:, None]) & ~(left_at <= TIMES[:, None])
    arrays = {
        "gripper": np.array(["arm_1", "arm_2"]),
        "object_axis": np.array(["x", "y", "angle"]),
        "grasp/measure": np.array(["position", "angle", "velocity", "angular_velocity"]),
        "grasp/missed_by": np.full((2, 4), 1e-3),
        "grasp/closed_at": closed,
        "grasp/opened_at": np.full(2, left_at),
        "grasp/lost": np.array([lost is not None, False]).astype(int),
        "grasp/closed": inside.astype(int),
        "grasp/pull": 2.0 * inside,
        "grasp/shear": 1.0 * inside,
        "grasp/moment": 0.1 * inside,
        "object/left_at": np.float64(left_at),
        "object/left_pose": np.add(thing.destination.pose, [off, 0, 0]),
        "object/left_velocity": np.array([0.2, 0.0, 0.0]),
    }
    if not opened:
        arrays |= {"object/left_pose": np.full(3, np.nan), "object/left_velocity": np.full(3, np.nan)}
    made = replace(base, arrays=base.arrays | arrays)
    vars(made).update(task=task, problem=_grasp_problem())
    return made


@cache
def _grasp_problem() -> Problem:
    return build_problem(load_grasps()["psmpc"])


def reproduced(**runs: Run) -> Reproduction:
    """What there is for the claims on runs, which look at no sweep and no fronts."""
    return Reproduction(runs, cast(SweepCells, None), None)
