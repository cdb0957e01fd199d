"""When a stage actually starts: first when it makes itself felt in the control. See docs/formulation.md, section 8."""

import numpy as np

from psmpc_cli.control.aside import WindowsAside
from psmpc_cli.control.decision import Decision
from psmpc_cli.control.sequence import Sequence
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.specs.task import OnsetSpec

DISTINCT = 1e-3
"""Controls with and without a stage nearer to each other than this say nothing of it [m/s^2, rad/s^2]."""


class OnsetObserver:
    """Compares the control with what the window without a waiting stage would apply, and with the stage's own optimum.

    For each stage that waits in the window the window up to the stage before it is solved aside from the same measured
    state; for the closeness form the window over the waiting stage alone as well.
    """

    def __init__(self, aside: WindowsAside, onset: OnsetSpec) -> None:
        self.aside, self.onset = aside, onset
        self.started: frozenset[int] = frozenset()

    def observe(self, decision: Decision, x: np.ndarray, edges: np.ndarray) -> dict[int, float]:
        """Return by stage index how much of it is in the mean control from x (2n,) on over the sample, edges (2,) [s].

        With `kind: control` the norm of what it adds [m/s^2, rad/s^2], with `kind: closeness` the `closeness` to its
        own optimum [1], each in the stage's onset coordinates. Only stages that wait in the window are looked at, and
        only until they reach the largest threshold.
        """
        sequence, presence = decision.sequence, {}
        for stage in range(sequence.first + 1, sequence.last + 1):
            if stage in self.started or decision.exhausted:
                continue
            shorter = Sequence(sequence.first, sequence.instants[: stage - sequence.first - 1], sequence.entered)
            without, _ = self.aside.plan(shorter, decision, x)
            found = self._presence(stage, decision, without, x, edges)
            if found is None:
                continue
            presence[stage] = found
            if found >= max(self.onset.epsilon, *self.onset.series):
                self.started |= {stage}
        return presence

    def _presence(
        self, stage: int, decision: Decision, without: Plan, x: np.ndarray, edges: np.ndarray
    ) -> float | None:
        """Return how much of a stage there is in the control; None where its own optimum is not known."""
        rows = list(self.aside.controller.stages[stage].onset_rows)
        applied, other = (plan.mean_control(edges)[0, rows] for plan in (decision.plan, without))
        if self.onset.kind == "control":
            return float(np.linalg.norm(applied - other))
        alone, solved = self.aside.plan(Sequence(stage, np.zeros(0), decision.prediction.start), decision, x)
        return closeness(applied, other, alone.mean_control(edges)[0, rows]) if solved else None


def closeness(applied: np.ndarray, without: np.ndarray, own: np.ndarray) -> float:
    """Return how far the applied control has come from the one without a stage towards the stage's own optimum.

    0 where it is as far from the own optimum as without the stage, 1 where it is the own optimum, negative where it
    is farther away than without the stage; never more than what the stage adds over the distance of the two. Paper
    section III-E, made a number.

    Args:
        applied: Control of the window's solution in the onset coordinates [m/s^2, rad/s^2].
        without: Control of the window without the stage.
        own: Control of the window over the stage alone.
    """
    distance = float(np.linalg.norm(without - own))
    return (distance - float(np.linalg.norm(applied - own))) / max(distance, DISTINCT)
