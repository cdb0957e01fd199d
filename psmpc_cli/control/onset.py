"""When a stage actually starts: first when it changes the control. See docs/formulation.md, actual start."""

import numpy as np

from psmpc_cli.control.controller import SwitchingController
from psmpc_cli.control.decision import Decision
from psmpc_cli.control.sequence import Sequence
from psmpc_cli.control.window_solver import SolvedWindow
from psmpc_cli.ocp.plan import Plan, shift


class OnsetObserver:
    """Compares the applied control with what the window without a pending stage would apply.

    For each stage that waits in the window the window up to the stage before it is solved as well, from the same
    measured state; the norm of the difference in the waiting stage's onset coordinates is its presence.
    """

    def __init__(self, controller: SwitchingController, largest: float) -> None:
        self.controller, self.largest = controller, largest
        self._without: dict[int, tuple[Plan, SolvedWindow | None]] = {}
        self._started: set[int] = set()

    def observe(self, decision: Decision, x: np.ndarray, edges: np.ndarray) -> dict[int, float]:
        """Return by stage index the norm [m/s^2, rad/s^2] of the control it adds in the first tick (edges (2,) [s]).

        Only stages that wait in the window are looked at, and only until their presence reaches the largest threshold.
        """
        sequence, presence = decision.sequence, {}
        for stage in range(sequence.first + 1, sequence.last + 1):
            if stage in self._started:
                continue
            shorter = Sequence(sequence.first, sequence.instants[: stage - sequence.first - 1], sequence.entered)
            plan = self._solve_without(stage, shorter, decision, x)
            added = (decision.plan.mean_control(edges) - plan.mean_control(edges))[0]
            rows = list(self.controller.stages[stage].onset_rows)
            presence[stage] = float(np.linalg.norm(added[rows]))
            if presence[stage] >= self.largest:
                self._started.add(stage)
        return presence

    def _solve_without(self, stage: int, sequence: Sequence, decision: Decision, x: np.ndarray) -> Plan:
        horizon, prediction, previous = self.controller.spec.horizon, decision.prediction, None
        if stage in self._without:
            plan, previous = self._without[stage]
            prediction = shift(plan, decision.prediction.start, horizon, x)
        window = self.controller.window(sequence, prediction, x)
        solved = self.controller.windows.solve(window, prediction, sequence.instants, previous)
        plan = solved.plan if solved.solution.outcome.usable else prediction
        self._without[stage] = plan, solved
        return plan
