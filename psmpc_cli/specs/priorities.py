"""The priorities that a task's paired comparisons stand for, in place of numbers at its stages."""

import numpy as np

from psmpc_cli.specs.comparisons import Weighing, weigh
from psmpc_cli.specs.task import PrioritiesSpec, TaskSpec

DIGITS = 12
"""Significant digits of a resolved priority: [a, b, 100] gives 100."""


def weigh_stages(priorities: PrioritiesSpec, stages: list[str]) -> Weighing:
    """Return what comparisons of stages, all known and connected, amount to; the weights in the order of `stages`."""
    pairs = [(stages.index(a), stages.index(b)) for a, b, _ in priorities.compare]
    return weigh(len(stages), pairs, [ratio for _, _, ratio in priorities.compare])


def prioritize(task: TaskSpec) -> TaskSpec:
    """Return a valid task with every stage's priority from its comparisons, or as it is if it has none."""
    if task.priorities is None:
        return task
    omega = np.exp(weigh_stages(task.priorities, [stage.name for stage in task.stages]).logarithms)
    stages = tuple(
        stage.model_copy(update={"priority": float(f"{weight:.{DIGITS}g}")})
        for stage, weight in zip(task.stages, omega, strict=True)
    )
    return task.model_copy(update={"stages": stages})
