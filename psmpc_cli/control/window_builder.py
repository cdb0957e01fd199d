"""Builds windows: the numbers that a sequence of placed stages, a prediction and the task give an optimization."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from psmpc_cli.control.sequence import MovingSequence
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.ocp.problem import Problem
from psmpc_cli.ocp.stage import PlacedStage, Stage, in_segments
from psmpc_cli.ocp.window import Window, first_counts, node_counts, normalization
from psmpc_cli.solvers import Solution
from psmpc_cli.specs.controller import ControllerSpec


class WindowBuilder:
    """Builds the windows of one problem."""

    def __init__(self, problem: Problem) -> None:
        self._spec = problem.spec.controller
        self._costs = problem.costs
        self._soft = problem.limits_are_soft
        self._tick = 1 / problem.spec.plant.low_level_rate
        self._uniform_nodes = self._spec.uniform_nodes
        # strict priorities do not depend on the scale; "range", eq. (12) as printed, divides by 0 for a robot at rest
        self._normalization = "nadir" if self._spec.traits.has_levels else self._spec.normalization
        self._normalization_step = self._spec.normalization_step
        self._priorities = priorities_in_force(self._spec, problem.stages)

    def build(
        self,
        sequence: MovingSequence,
        stages: Sequence[PlacedStage],
        prediction: Plan,
        before: Solution | None = None,
        applied: np.ndarray | None = None,
    ) -> Window:
        """Build the window over the stages of a sequence from the first state of a prediction on.

        Costs are normalized by their values along the prediction, as `controller.normalization` says; `range` is paper
        eq. (12) as printed. With `nodes: auto` each stage has as many nodes as the quadrature of its cost along the
        prediction needs. It keeps the number that it had in the last solve as long as that is enough, and at most
        twice what is needed. Without a last solve the prediction says little of costs to come: the mesh then assumes
        that they fall from their largest value to 0 over the window.

        Args:
            sequence: The stages in the window, when the first was entered, and the planned switch times between them.
            stages: All stages of the task, placed at this sample.
            prediction: The last solved plan, shifted to begin now, at the measured state.
            before: The previous solve, for the numbers of nodes it had; None without one.
            applied: Acceleration that was commanded last (n,), where its changes count; None before the first command.
        """
        spec = self._spec
        begun = stages[sequence.first : sequence.last + 1]
        # a stage's cost L is normalized to (L - offset) / scale; zeta keeps scale from being 0
        offset, scale = normalization(
            self._normalization, spec.zeta, begun, sequence.begins, self._costs, prediction, self._normalization_step
        )
        segments = list(sequence.segments)
        of_segments = np.array(segments) - sequence.first  # a stage that continues has one scale
        window = Window(
            stages=in_segments([stages[index] for index in segments]),
            start=prediction.start,
            elapsed=prediction.start - sequence.progress.entered,
            hold=begun[0].end.time_left(sequence.progress, prediction.start, spec.sample_time),
            x0=prediction.X[0],
            omega=self._priorities[segments],
            offset=offset[of_segments],
            scale=scale[of_segments],
            horizon=spec.horizon,
            pending_cost=spec.pending_cost,
            terminal_cost=spec.terminal_cost,
            nodes=(self._uniform_nodes,) * len(segments),
            discretization=spec.discretization,
            soft=self._soft,
            chart=prediction.chart,
            applied=np.zeros(0) if applied is None else applied,
            tick=self._tick,
        )
        if spec.nodes != "auto":
            return window
        if before is None:
            return replace(
                window, nodes=first_counts(window, sequence.switch_times, spec.mesh_tolerance, spec.sample_time)
            )
        before_nodes = dict(zip(_parts(before.window), before.window.nodes, strict=True))
        had = [before_nodes.get(part) for part in _parts(window)]
        counts = node_counts(
            window, sequence.guess(prediction), self._costs, spec.sample_time, spec.mesh_tolerance, had
        )
        return replace(window, nodes=counts)


def _parts(window: Window) -> list[tuple[int, bool]]:
    """Return by what the parts of a window are the same in the next one: index of the stage, and if it continues."""
    return [(index, index in window.indices[:number]) for number, index in enumerate(window.indices)]


def priorities_in_force(spec: ControllerSpec, stages: Sequence[Stage]) -> np.ndarray:
    """Return omega of each stage (stages,); SMPC knows none but 1."""
    return np.array([stage.priority if spec.traits.has_priorities else 1.0 for stage in stages])
