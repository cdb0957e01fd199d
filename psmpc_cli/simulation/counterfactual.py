"""Counterfactual solves: windows over other stages than the applied one, to measure what a stage does to the control.

They give the presence of a waiting stage in the control, whose actual start is when it first reaches a threshold
(docs/formulation.md, section 8), and the shares of the stages in the applied control (paper Fig. 1).
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import nnls

from psmpc_cli.control.controller import Command, Controller
from psmpc_cli.control.sequence import MovingSequence
from psmpc_cli.ocp.plan import Plan, shift
from psmpc_cli.ocp.window import Window
from psmpc_cli.solvers import Solution

DISTINCT = 1e-3
"""Controls nearer to each other than this are the same [m/s^2, rad/s^2]."""


@dataclass(frozen=True, eq=False)
class Counterfactual:
    """What was found last for some stages: when [s], the plan, whether it is a solution, and the solve."""

    time: float
    plan: Plan
    usable: bool
    solution: Solution


class Counterfactuals:
    """Solves windows for what is measured, never for what is applied; each starts from its own last plan."""

    def __init__(self, controller: Controller) -> None:
        self.controller, self.onset = controller, controller.problem.spec.onset
        self._last: dict[tuple[int, int], Counterfactual] = {}
        self._started: set[int] = set()

    def presence(self, command: Command, edges: np.ndarray) -> dict[int, float]:
        """Measure how much of each waiting stage is in the mean control between edges (2,) [s], by stage index.

        With `onset: control` that is the norm of what the stage adds [m/s^2, rad/s^2]: the difference to the window
        up to the stage before it. With `closeness` it is the `closeness` to the stage's own optimum [1]. Both are in
        the stage's onset coordinates. A stage is measured until it reaches the largest threshold.
        """
        sequence, presence = command.sequence, {}
        for stage in range(sequence.first + 1, sequence.last + 1):
            if stage in self._started or "braking" in command.events:
                continue
            shorter = MovingSequence(sequence.first, sequence.instants[: stage - sequence.first - 1], sequence.entered)
            without, _ = self._plan(shorter, command)
            rows = list(self.controller.stages[stage].onset_rows)
            applied, other = (plan.mean_control(edges)[0, rows] for plan in (command.plan, without))
            if self.onset.kind == "control":
                presence[stage] = float(np.linalg.norm(applied - other))
            else:
                own, usable = self._plan(_alone(stage, command.time), command)
                if not usable:
                    continue
                presence[stage] = closeness(applied, other, own.mean_control(edges)[0, rows])
            if presence[stage] >= max(self.onset.epsilon, *self.onset.series):
                self._started.add(stage)
        return presence

    def shares(self, command: Command, edges: np.ndarray) -> dict[int, float]:
        """Compute the share of each stage in the control of the first tick, edges (2,) [s], by stage index.

        Every stage in the window, or every level, is solved for alone. The shares are the weights of the convex
        combination of their controls that is nearest to the applied one. There are none where the stages agree, where
        one has no solution, or where the robot brakes without a plan.
        """
        first, count = command.sequence.first, max(command.sequence.count, len(command.levels))
        if "braking" in command.events:
            return {}
        if count == 1:
            return {first: 1.0}
        controls = []
        for stage in range(first, first + count):
            entered = command.sequence.entered if stage == first else command.time
            plan, usable = self._plan(_alone(stage, entered), command)
            if not usable:
                return {}
            controls.append(plan.mean_control(edges)[0])
        u = np.array(controls)
        if np.ptp(u, axis=0).max() < DISTINCT:
            return {}
        weights = nearest_combination(u, command.plan.mean_control(edges)[0])
        return dict(enumerate(map(float, weights), start=first))

    def _plan(self, sequence: MovingSequence, command: Command) -> tuple[Plan, bool]:
        """Return the plan of the window over a sequence, and whether it is a solution or its last plan, shifted."""
        key = (sequence.first, sequence.last)
        before = self._last.get(key)
        if before is None or before.time < command.time:
            self._last[key] = before = self._solve(sequence, command, before)
        return before.plan, before.usable

    def _solve(self, sequence: MovingSequence, command: Command, before: Counterfactual | None) -> Counterfactual:
        controller, x, prediction = self.controller, command.x, command.prediction
        if before is not None:
            prediction = shift(before.plan, command.time, controller.spec.horizon, x)
        previous = None if before is None else before.solution
        window = controller.window(sequence, prediction, x, previous or command.solution)
        guess = replace(prediction, instants=sequence.instants)
        solution = controller.solver.solve(_on_mesh_of(command.solution.window, window), guess, previous)
        usable = solution.outcome.usable
        return Counterfactual(command.time, solution.plan if usable else prediction, usable, solution)


def _alone(stage: int, entered: float) -> MovingSequence:
    return MovingSequence(stage, np.zeros(0), entered)


def _on_mesh_of(applied: Window, window: Window) -> Window:
    """Return a window with the nodes of the applied one in all stages that end in both.

    What a stage adds to a control is to be seen, not what a finer mesh does.
    """
    counts = {stage.index: N for stage, N in zip(applied.stages, applied.nodes, strict=True)}
    ending = zip(window.stages[:-1], window.nodes, strict=False)
    return replace(window, nodes=(*(counts.get(stage.index, N) for stage, N in ending), window.nodes[-1]))


def closeness(applied: np.ndarray, without: np.ndarray, own: np.ndarray) -> float:
    """Compute how far the applied control has come from the one without a stage towards the stage's own optimum.

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


def nearest_combination(u: np.ndarray, applied: np.ndarray) -> np.ndarray:
    """Compute the weights (S,) of the convex combination of controls u (S, n) that is nearest to the applied one (n,).

    With differences D = (u - applied)', nonnegative w that minimize |D w|^2 + (sum w - 1)^2 are a multiple of the
    weights: for w = s c with sum c = 1 the minimum over s is d^2 / (1 + d^2), d = |D c|, which rises with d.
    """
    differences = (u - applied).T
    scale = max(float(np.linalg.norm(differences, axis=0).max()), DISTINCT)
    found, _ = nnls(np.vstack([differences / scale, np.ones(len(u))]), np.r_[np.zeros(len(applied)), 1.0])
    return np.asarray(found / found.sum())
