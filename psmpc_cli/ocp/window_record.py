"""Windows from their records in a log."""

from dataclasses import dataclass, replace

import numpy as np

from psmpc_cli.ocp.problem import Problem
from psmpc_cli.ocp.stage import PlacedStage, Stage, in_segments
from psmpc_cli.ocp.window import Window
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


def read_window(problem: Problem, frame: WindowFrame, record: np.ndarray) -> Window:
    """Return the window of a record, the inverse of `Window.record`.

    Raises:
        ValueError: The record is not one of such a window.
    """
    spec = problem.spec
    space = problem.model.space
    count = len(frame.nodes)
    stages = [problem.stages[index] for index in frame.segments]
    signs_sizes = [len(stage.attitudes) for stage in stages]
    object_sizes = [(space.n_pose + space.n_twist) * bool(stage.on_object) for stage in stages]
    end_sizes = [len(stage.end.record) for stage in stages]
    argument_sizes = [sum(len(each.argument) for each in stage.sampled_constraints.values()) for stage in stages]
    waypoint_sizes = [len(stage.target) * (spec.routes is not None) for stage in stages]
    sizes = (*signs_sizes, *object_sizes, *end_sizes, *argument_sizes, *waypoint_sizes)
    ends = np.cumsum([2, count, count, count, *sizes])
    (elapsed, hold), omega, offset, scale, *parts = np.split(record, ends)[:-1]
    chart = space.chart_at(frame.Q)
    posture = space.posture(frame.Q[space.joint_coordinates])
    placed = list[PlacedStage]()
    by_kind = (parts[first : first + count] for first in range(0, len(parts), count))
    for stage, signs, object_state, of_end, arguments, waypoint in zip(stages, *by_kind, strict=True):
        at_sample = replace(stage.placed(), end=stage.end.recorded(of_end))
        at_sample = at_sample.with_arguments(_arguments(stage, arguments))
        if stage.on_object:
            follows = stage.index == frame.segments[0] and not stage.end.is_planned
            at_sample = _about_object(problem, at_sample, object_state, float(elapsed), follows)
        if len(waypoint):
            at_sample = at_sample.with_waypoint(waypoint if np.isfinite(waypoint).all() else None)
        placed.append(at_sample.in_chart(chart.anchor, posture, dict(zip(stage.attitudes, signs, strict=True))))
    return Window(
        stages=in_segments(placed),
        start=frame.start,
        elapsed=float(elapsed),
        hold=float(hold),
        x0=np.asarray(chart.enter(frame.Q[None], frame.v[None])[0]),
        omega=omega,
        offset=offset,
        scale=scale,
        horizon=spec.controller.horizon,
        pending_cost=spec.controller.pending_cost,
        terminal_cost=spec.controller.terminal_cost,
        nodes=frame.nodes,
        discretization=spec.controller.discretization,
        soft=spec.limits_are_soft,
        chart=chart,
    )


def _arguments(stage: Stage, numbers: np.ndarray) -> dict[str, np.ndarray]:
    """Return the arguments of a stage's constraints that samples set, by name, of their numbers one after the other."""
    sampled = stage.sampled_constraints
    ends = np.cumsum([len(each.argument) for each in sampled.values()])
    return dict(zip(sampled, np.split(numbers, ends), strict=False))


def _about_object(
    problem: Problem, stage: PlacedStage, object_state: np.ndarray, elapsed: float, follows: bool
) -> PlacedStage:
    """Return a stage whose target is relative to the object, at a state of the object or following its free motion."""
    if follows:
        return stage.following(body_of(problem.body), object_state, elapsed, problem.spec.controller.horizon)
    pose, velocity = np.split(object_state, [problem.model.space.n_pose])
    return stage.at_object(pose, velocity)
