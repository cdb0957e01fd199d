"""When a stage actually starts: first when it changes the control. See docs/formulation.md, actual start."""

import numpy as np

from psmpc_cli.control.aside import WindowsAside
from psmpc_cli.control.decision import Decision
from psmpc_cli.control.sequence import Sequence


class OnsetObserver:
    """Compares the applied control with what the window without a pending stage would apply.

    For each stage that waits in the window the window up to the stage before it is solved as well, from the same
    measured state; the norm of the difference in the waiting stage's onset coordinates is its presence.
    """

    def __init__(self, aside: WindowsAside, largest: float) -> None:
        self.aside, self.largest = aside, largest
        self._started: set[int] = set()

    def observe(self, decision: Decision, x: np.ndarray, edges: np.ndarray) -> dict[int, float]:
        """Return by stage index the norm [m/s^2, rad/s^2] of the control it adds in the first tick (edges (2,) [s]).

        Only stages that wait in the window are looked at, and only until their presence reaches the largest threshold.
        """
        sequence, presence = decision.sequence, {}
        for stage in range(sequence.first + 1, sequence.last + 1):
            if stage in self._started or decision.exhausted:
                continue
            shorter = Sequence(sequence.first, sequence.instants[: stage - sequence.first - 1], sequence.entered)
            plan, _ = self.aside.plan(shorter, decision, x)
            added = (decision.plan.mean_control(edges) - plan.mean_control(edges))[0]
            rows = list(self.aside.controller.stages[stage].onset_rows)
            presence[stage] = float(np.linalg.norm(added[rows]))
            if presence[stage] >= self.largest:
                self._started.add(stage)
        return presence
