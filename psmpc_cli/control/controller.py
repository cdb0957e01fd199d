"""The switching controllers. PSMPC, SMPC and hard switching are one piece of code with two switches."""

from dataclasses import dataclass, replace

import numpy as np

from psmpc_cli.control.decision import Decision
from psmpc_cli.control.multistart import solve_from_several
from psmpc_cli.control.sequence import Sequence, Switch, detect, drop_met, drop_passed
from psmpc_cli.control.window_solver import SolvedWindow, WindowSolver
from psmpc_cli.ocp.normalization import normalization
from psmpc_cli.ocp.plan import Plan, braking_plan, resting_plan, shift
from psmpc_cli.ocp.stages import Stage
from psmpc_cli.ocp.window import Window
from psmpc_cli.specs.task import ControllerSpec

ONE_STAGE = ("hard", "htmpc")
"""Controllers whose window holds the current stage alone."""

BRAKING_TIME = 0.5
"""Time within which a robot without a plan comes to rest [s], longer where acceleration limits ask for it."""


@dataclass(frozen=True, eq=False)
class ControllerMemory:
    """What a controller remembers from one sample to the next.

    Attributes:
        sequence: The stages in the window.
        plan: The plan in force; None before the first sample.
        braking: The plan that brakes to rest, once the other is used up.
        solved: The last solve, whose multipliers start the next one.
    """

    sequence: Sequence
    plan: Plan | None
    braking: Plan | None
    solved: SolvedWindow | None


class SwitchingController:
    """Priority-based switching MPC and what it is compared with. Paper Algorithm 1."""

    def __init__(self, spec: ControllerSpec, stages: tuple[Stage, ...], windows: WindowSolver) -> None:
        self.spec, self.stages, self.windows = spec, stages, windows
        self.costs = windows.costs
        self._sequence = Sequence(0, np.zeros(0), 0.0)
        self._plan: Plan | None = None
        self._braking: Plan | None = None
        self._solved: SolvedWindow | None = None

    @property
    def memory(self) -> ControllerMemory:
        """What it remembers; another controller of the same task that is given this decides alike from here on."""
        return ControllerMemory(self._sequence, self._plan, self._braking, self._solved)

    @memory.setter
    def memory(self, memory: ControllerMemory) -> None:
        self._sequence, self._plan = memory.sequence, memory.plan
        self._braking, self._solved = memory.braking, memory.solved

    @property
    def sequence(self) -> Sequence:
        """The stages in the window."""
        return self._sequence

    def hand_over(self, now: float, x: np.ndarray) -> tuple[Switch, ...]:
        """Drop the stages that are over at time now [s], by the plan or by the measured state x (2n,)."""
        sequence, passed = drop_passed(self._sequence, now)
        self._sequence, met = drop_met(sequence, self.stages, self.costs, now, x)
        return (*passed, *met)

    def decide(self, now: float, x: np.ndarray) -> Decision:
        """Return the decision at time now [s] from the measured state x (2n,)."""
        sequence, prediction = self._sequence, self._predict(now, x)
        longer = None if self.spec.kind in ONE_STAGE else self._detect(sequence, prediction)
        solved = self._solve(longer or sequence, prediction, x)
        postponed = longer is not None and not solved.solution.outcome.usable
        if longer is not None and not postponed:
            sequence = longer
        elif postponed:
            solved = _after(solved, self._solve(sequence, prediction, x))
        usable = solved.solution.outcome.usable
        if usable:
            sequence = Sequence(sequence.first, solved.plan.instants, sequence.entered)
        self._sequence, self._solved = sequence, solved
        return Decision(
            plan=self._plan_in_force(solved, prediction, now, x),
            sequence=sequence,
            solved=solved,
            prediction=prediction,
            appended=longer is not None and not postponed,
            postponed=postponed,
            fallback=not usable,
            exhausted=self._braking is not None,
        )

    def _plan_in_force(self, solved: SolvedWindow, prediction: Plan, now: float, x: np.ndarray) -> Plan:
        """Return the solved plan, else the one before it; when that is used up, one that brakes to rest."""
        if solved.solution.outcome.usable:
            self._plan, self._braking = solved.plan, None
        elif self._plan is None:
            self._plan = prediction
        elif self._braking is None and now > self._plan.end - self.spec.sample_time:
            self._braking = self._brake(now, x)
        return self._plan if self._braking is None else self._braking

    def window(self, sequence: Sequence, prediction: Plan, x: np.ndarray) -> Window:
        """Return the window over a sequence, its costs normalized from the prediction."""
        spec, stages = self.spec, self.stages[sequence.first : sequence.last + 1]
        offset, scale = self._normalization(stages, sequence.begins, prediction)
        return Window(
            stages=stages,
            start=prediction.start,
            elapsed=prediction.start - sequence.entered,
            x0=x,
            omega=priorities_in_force(spec, stages),
            offset=offset,
            scale=scale,
            horizon=spec.horizon,
            pending_cost=spec.pending_cost,
            terminal_cost=spec.terminal_cost,
        )

    def _normalization(
        self, stages: tuple[Stage, ...], begins: np.ndarray, prediction: Plan
    ) -> tuple[np.ndarray, np.ndarray]:
        spec = self.spec
        return normalization(spec.normalization, spec.zeta, stages, begins, self.costs, prediction, spec.sample_time)

    def _predict(self, now: float, x: np.ndarray) -> Plan:
        if self._plan is None:
            return resting_plan(now, self.spec.horizon, self.spec.nodes, x)
        return shift(self._plan, now, self.spec.horizon, x)

    def _detect(self, sequence: Sequence, prediction: Plan) -> Sequence | None:
        return detect(sequence, self.stages, self.costs, prediction, self.spec.detection_margin)

    def _solve(self, sequence: Sequence, prediction: Plan, x: np.ndarray) -> SolvedWindow:
        window = self.window(sequence, prediction, x)
        starts = self.spec.multistart or 1
        return solve_from_several(self.windows, window, prediction, sequence.instants, self._solved, starts)

    def _brake(self, now: float, x: np.ndarray) -> Plan:
        Qdot, limits = x[len(x) // 2 :], self.stages[self._sequence.first].limits
        strongest = np.minimum(limits.acceleration_high, -limits.acceleration_low)
        return braking_plan(now, x, max(BRAKING_TIME, float(np.max(np.abs(Qdot) / strongest))))


def priorities_in_force(spec: ControllerSpec, stages: tuple[Stage, ...]) -> np.ndarray:
    """Return omega of each stage (stages,); SMPC knows none but 1."""
    return np.array([1.0 if spec.kind == "smpc" else stage.priority for stage in stages])


def _after(failed: SolvedWindow, solved: SolvedWindow) -> SolvedWindow:
    """Return a solve whose wall time counts the failed one before it in the same sample."""
    solution = replace(solved.solution, wall_time=failed.solution.wall_time + solved.solution.wall_time)
    return replace(solved, solution=solution)
