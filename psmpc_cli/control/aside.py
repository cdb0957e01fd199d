"""Windows solved aside: what other stages than those of the decision would make of the same sample."""

from dataclasses import dataclass, replace

import numpy as np

from psmpc_cli.control.controller import SwitchingController
from psmpc_cli.control.decision import Decision
from psmpc_cli.control.sequence import Sequence
from psmpc_cli.ocp.plan import Plan, shift
from psmpc_cli.ocp.window import Window
from psmpc_cli.solvers import Solution


@dataclass(frozen=True, eq=False)
class SolvedAside:
    """What came out at a sample: the plan in force, whether it is a solution, and the solve."""

    now: float
    plan: Plan
    solution: bool
    solved: Solution


class WindowsAside:
    """Solves windows for what is measured, never for what is applied; each starts from its own last plan."""

    def __init__(self, controller: SwitchingController) -> None:
        self.controller = controller
        self._last: dict[tuple[int, int], SolvedAside] = {}

    def plan(self, sequence: Sequence, decision: Decision, x: np.ndarray) -> tuple[Plan, bool]:
        """Return what a window over the sequence would plan from x (2n,), and whether it could be solved.

        Where it could not, its own last plan goes on.
        """
        key, now = (sequence.first, sequence.last), decision.prediction.start
        before = self._last.get(key)
        if before is None or before.now < now:
            self._last[key] = before = self._solve(sequence, decision, x, before)
        return before.plan, before.solution

    def _solve(self, sequence: Sequence, decision: Decision, x: np.ndarray, before: SolvedAside | None) -> SolvedAside:
        now, prediction = decision.prediction.start, decision.prediction
        if before is not None:
            prediction = shift(before.plan, now, self.controller.spec.horizon, x)
        solved_before = None if before is None else before.solved
        window = _on_mesh_of(
            decision.solved.window, self.controller.window(sequence, prediction, x, solved_before or decision.solved)
        )
        guess = replace(prediction, instants=sequence.instants)
        solved = self.controller.solver.solve(window, guess, solved_before)
        usable = solved.outcome.usable
        return SolvedAside(now, solved.plan if usable else prediction, usable, solved)


def _on_mesh_of(applied: Window, window: Window) -> Window:
    """Return a window with the nodes of the applied one in all stages that end in both.

    What a stage adds to a control is to be seen, not what a finer mesh does.
    """
    counts = {stage.index: N for stage, N in zip(applied.stages, applied.nodes, strict=True)}
    ending = zip(window.stages[:-1], window.nodes, strict=False)
    return replace(window, nodes=(*(counts.get(stage.index, N) for stage, N in ending), window.nodes[-1]))
