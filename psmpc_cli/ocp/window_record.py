"""Windows from their records in a log."""

from dataclasses import dataclass, replace

import numpy as np

from psmpc_cli.ocp.problem import Problem
from psmpc_cli.ocp.stage import PlacedStage, Stage
from psmpc_cli.ocp.window import Window
from psmpc_cli.robot.free_body import body_of


@dataclass(frozen=True, eq=False)
class WindowFrame:
    """What a log has of a window besides its record.

    Attributes:
        first: Index of its first stage.
        nodes: N_s of its stages, (S + 1,); of one that continues before and after its planned end.
        start: T0 [s].
        Q, v: Measured state, (nq,) and (n,).
        end_is_planned: Whether the end of its first stage is ever planned; if not, the stage follows the object.
        continues: The first stage itself follows upon its planned end.
    """

    first: int
    nodes: tuple[int, ...]
    start: float
    Q: np.ndarray
    v: np.ndarray
    end_is_planned: bool
    continues: bool = False


def read_window(problem: Problem, frame: WindowFrame, record: np.ndarray) -> Window:
    """Return the window of a record, the inverse of `Window.record`.

    Raises:
        ValueError: The record is not one of such a window.
    """
    spec = problem.spec
    space = problem.model.space
    count = len(frame.nodes)
    stages = problem.stages[frame.first : frame.first + count]
    if frame.continues:
        stages = (problem.stages[frame.first],) * count
    signs_sizes = [len(stage.attitudes) for stage in stages]
    object_sizes = [(space.n_pose + space.n_twist) * bool(stage.on_object) for stage in stages]
    inside_sizes = [len(stage.object_end.inside) for stage in stages]
    argument_sizes = [sum(len(each.argument) for each in stage.sampled_constraints.values()) for stage in stages]
    via_sizes = [len(stage.target) * (spec.routes is not None) for stage in stages]
    sizes = (*signs_sizes, *object_sizes, *inside_sizes, *argument_sizes, *via_sizes)
    ends = np.cumsum([2, count, count, count, *sizes])
    (elapsed, hold), omega, offset, scale, *parts = np.split(record, ends)[:-1]
    chart = space.chart_at(frame.Q)
    posture = space.posture(frame.Q[space.joint_coordinates])
    placed = list[PlacedStage]()
    by_kind = (parts[first : first + count] for first in range(0, len(parts), count))
    for stage, signs, object_state, inside, arguments, via in zip(stages, *by_kind, strict=True):
        at_sample = replace(stage.placed(), object_end=replace(stage.object_end, inside=inside))
        at_sample = at_sample.with_arguments(_arguments(stage, arguments))
        if stage.on_object:
            follows = stage.index == frame.first and not frame.end_is_planned
            at_sample = _about_object(problem, at_sample, object_state, float(elapsed), follows)
        at_sample = at_sample.heading_for(via)
        placed.append(at_sample.in_chart(chart.anchor, posture, dict(zip(stage.attitudes, signs, strict=True))))
    if frame.continues:
        placed[-1] = placed[-1].continued
    return Window(
        stages=tuple(placed),
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
    rows = problem.model.pose_rows
    capture = problem.capture
    if follows and capture:
        return stage.following(rows, body_of(capture), object_state, elapsed, problem.spec.controller.horizon)
    pose, velocity = np.split(object_state, [problem.model.space.n_pose])
    return stage.at_object(rows, pose, velocity)
