"""The record of a window in a log: what the task and the measured state do not say of it, written and read."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from psmpc_cli.ocp.problem import Problem
from psmpc_cli.ocp.stage import PlacedStage, Stage, in_segments
from psmpc_cli.ocp.window import Window
from psmpc_cli.robot.configuration import Chart
from psmpc_cli.robot.free_body import body_of


@dataclass(frozen=True, eq=False)
class WindowFrame:
    """What a log has of a window besides its record.

    Attributes:
        segments: Indices of the stages between its switch times: one that continues after its own end comes again.
        nodes: N_s of each, (S + 1,).
        start: T0 [s].
        Q, v: Measured state, (nq,) and (n,).
    """

    segments: tuple[int, ...]
    nodes: tuple[int, ...]
    start: float
    Q: np.ndarray
    v: np.ndarray


@dataclass(frozen=True, eq=False)
class _Reading:
    """What the stages of a record are read with.

    Attributes:
        problem: The problem.
        frame: What the log has besides.
        chart: That about the measured attitude.
        elapsed: Time the current stage has run already [s].
    """

    problem: Problem
    frame: WindowFrame
    chart: Chart
    elapsed: float


@dataclass(frozen=True)
class _RecordedPart:
    """Numbers of a stage in a record.

    Attributes:
        numbers: What samples set of a stage.
        size: How many numbers that is, of a stage of a problem.
        read: A stage with these numbers.
    """

    numbers: Callable[[PlacedStage], np.ndarray]
    size: Callable[[Stage, Problem], int]
    read: Callable[[PlacedStage, np.ndarray, _Reading], PlacedStage]


def _arguments_of(stage: Stage) -> np.ndarray:
    """Return the arguments of a stage's constraints that samples set, one after the other."""
    return np.concatenate([np.zeros(0), *(sampled.argument for sampled in stage.sampled_constraints.values())])


def _with_arguments(stage: PlacedStage, numbers: np.ndarray, reading: _Reading) -> PlacedStage:
    sampled = stage.sampled_constraints
    ends = np.cumsum([len(constraint.argument) for constraint in sampled.values()])
    return stage.with_arguments(dict(zip(sampled, np.split(numbers, ends), strict=False)))


def _about_object(stage: PlacedStage, object_state: np.ndarray, reading: _Reading) -> PlacedStage:
    """Return a stage whose target is on the object, at a state of the object or following its free motion."""
    if not stage.on_object:
        return stage
    problem = reading.problem
    if stage.index == reading.frame.segments[0] and not stage.end.is_planned:
        horizon = problem.spec.controller.horizon
        return stage.following(body_of(problem.body), object_state, reading.elapsed, horizon)
    pose, velocity = np.split(object_state, [problem.model.space.n_pose])
    return stage.at_object(pose, velocity)


def _on_route(stage: PlacedStage, waypoint: np.ndarray, reading: _Reading) -> PlacedStage:
    if not len(waypoint):
        return stage
    return stage.with_waypoint(waypoint if np.isfinite(waypoint).all() else None)


def _with_speed_reserve(stage: PlacedStage, numbers: np.ndarray, reading: _Reading) -> PlacedStage:
    return stage.with_speed_reserve(numbers.reshape(2, -1)) if len(numbers) else stage


def _in_chart(stage: PlacedStage, signs: np.ndarray, reading: _Reading) -> PlacedStage:
    space = reading.problem.model.space
    posture = space.posture(reading.frame.Q[space.joint_coordinates])
    return stage.in_chart(reading.chart.anchor, posture, dict(zip(stage.attitudes, signs, strict=True)))


_SIGNS = _RecordedPart(
    numbers=lambda stage: np.array(stage.signs),
    size=lambda stage, problem: len(stage.attitudes),
    read=_in_chart,
)
_OTHERS = (
    _RecordedPart(
        numbers=lambda stage: stage.object_state,
        size=lambda stage, problem: bool(stage.on_object) * (problem.model.space.n_pose + problem.model.space.n_twist),
        read=_about_object,
    ),
    _RecordedPart(
        numbers=lambda stage: stage.end.record,
        size=lambda stage, problem: len(stage.end.record),
        read=lambda stage, numbers, reading: stage.with_end(stage.end.recorded(numbers)),
    ),
    _RecordedPart(
        numbers=_arguments_of,
        size=lambda stage, problem: len(_arguments_of(stage)),
        read=_with_arguments,
    ),
    _RecordedPart(
        numbers=lambda stage: stage.waypoint,
        size=lambda stage, problem: len(stage.target) * (problem.spec.routes is not None),
        read=_on_route,
    ),
    _RecordedPart(
        numbers=lambda stage: stage.speed_reserve.ravel(),
        size=lambda stage, problem: 2 * problem.model.n * (problem.spec.controller.speed_reserve > 0.0),
        read=_with_speed_reserve,
    ),
)
_RECORDED = (_SIGNS, *_OTHERS)
"""The parts in their order; each is of all stages of the window. Signs are read last: they put targets into the chart.

They are the signs of the quaternions in space, states of the object that targets are for, its poses in the gripper that
holds it, arguments of constraints that samples set, points of routes that costs follow, and reserves of speed.
"""


def record_of(window: Window) -> np.ndarray:
    """Return the record of a window: elapsed, hold, omega, offset and scale, (2 + 3 (S + 1),), then `_RECORDED`.

    Then the acceleration that was applied before (n,), where its changes count.
    """
    times = [window.elapsed, window.hold]
    numbers = [part.numbers(stage) for part in _RECORDED for stage in window.stages]
    return np.concatenate([times, window.omega, window.offset, window.scale, *numbers, window.applied])


def read_window(problem: Problem, frame: WindowFrame, record: np.ndarray) -> Window:
    """Rebuild a window from its record in a log, so that its solve can be repeated; the inverse of `record_of`.

    Args:
        problem: The problem of the logged task.
        frame: What the log has of the window besides: stages, nodes, start and measured state.
        record: Elapsed time and hold [s], priorities, offsets and scales, what samples set of the stages (`_RECORDED`),
            and the acceleration before, where changes of it count.

    Raises:
        ValueError: The record is not one of such a window.
    """
    spec = problem.spec
    space = problem.model.space
    count = len(frame.nodes)
    stages = [problem.stages[index] for index in frame.segments]
    part_sizes = [part.size(stage, problem) for part in _RECORDED for stage in stages]
    applied_size = problem.model.n * any(stage.has_rates for stage in problem.stages)
    ends = np.cumsum([2, count, count, count, *part_sizes, applied_size])
    (elapsed, hold), omega, offset, scale, *part_numbers, applied = np.split(record, ends)[:-1]
    chart = space.chart_at(frame.Q)
    reading = _Reading(problem, frame, chart, float(elapsed))
    placed = [stage.unplaced_copy() for stage in stages]
    # The record has the numbers part by part, of all stages each. Signs come first in it and are read last.
    signs, *others = (part_numbers[first : first + count] for first in range(0, len(part_numbers), count))
    # `part.read` returns a stage with the numbers that it is given.
    for part, numbers_of_stages in zip((*_OTHERS, _SIGNS), (*others, signs), strict=True):
        placed = [part.read(stage, numbers, reading) for stage, numbers in zip(placed, numbers_of_stages, strict=True)]
    return Window(
        stages=in_segments(placed),
        start=frame.start,
        elapsed=float(elapsed),
        hold=float(hold),
        x0=np.asarray(chart.to_chart(frame.Q[None], frame.v[None])[0]),
        omega=omega,
        offset=offset,
        scale=scale,
        horizon=spec.controller.horizon,
        pending_cost=spec.controller.pending_cost,
        terminal_cost=spec.controller.terminal_cost,
        nodes=frame.nodes,
        discretization=spec.controller.discretization,
        soft=problem.limits_are_soft,
        chart=chart,
        applied=applied,
        tick=1 / spec.plant.low_level_rate,
    )
