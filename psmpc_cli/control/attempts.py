"""Which windows are solved at a sample, and which solution counts: the longest sequence that has one."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from psmpc_cli.control.multistart import solve_from_several
from psmpc_cli.control.sequence import MovingSequence
from psmpc_cli.control.window_builder import WindowBuilder
from psmpc_cli.ocp.constraints import soft_row_violations
from psmpc_cli.ocp.constraints.boxes import initial_violations
from psmpc_cli.ocp.plan import Plan, shift
from psmpc_cli.ocp.problem import Problem
from psmpc_cli.ocp.stage import PlacedStage
from psmpc_cli.solvers import FEASIBLE, Outcome, Solution, Solver

RESERVE = 0.4
"""Share of a deadline that is left for the window without a stage that has appeared, should the one with it not end."""


@dataclass(frozen=True, eq=False)
class Attempt:
    """What came of a sample's solves.

    Attributes:
        sequence: The stages in the window that counts.
        solution: Its solve; its wall time is that of all.
        unfinished: The solve that was tried first, if it ran out of iterations or time before an iterate counted: the
            next sample goes on from it.
    """

    sequence: MovingSequence
    solution: Solution
    unfinished: Solution | None


class Attempts:
    """The solves of one sample."""

    def __init__(
        self,
        problem: Problem,
        solver: Solver,
        stop_at: float,
        builder: WindowBuilder,
        stages: Sequence[PlacedStage],
        prediction: Plan,
        previous: Solution | None,
        unfinished: Solution | None,
        applied: np.ndarray,
    ) -> None:
        """Prepare the solves; `solve_longest` makes them.

        Args:
            problem: The task made computable.
            solver: Solves its windows.
            stop_at: When the sample's solves have to stop, an instant of `time.perf_counter` [s].
            builder: Builds the windows.
            stages: All stages of the task, placed at this sample.
            prediction: The last plan, shifted; it begins at the measured state.
            previous: The solve of the sample before; None at the first sample.
            unfinished: A solve that the sample before left unfinished; else None.
            applied: Acceleration that was commanded last (n,); (0,) where changes of acceleration neither cost nor are
                limited.
        """
        self._spec = problem.spec.controller
        self._costs = problem.costs
        self._model = problem.model
        self._solver = solver.stopping(stop_at)
        # a window with a stage that has appeared stops earlier, so that the window without it can still be solved
        reserve = RESERVE * solver.deadline if np.isfinite(solver.deadline) else 0.0
        self._solver_of_longer = solver.stopping(stop_at - reserve, problem.spec.solver.entry_iterations)
        self._builder = builder
        self._stages = stages
        self._prediction = prediction
        self._previous = previous
        self._unfinished = unfinished
        self._applied = applied

    def solve_longest(self, sequence: MovingSequence, longer: MovingSequence | None) -> Attempt:
        """Solve windows, the one with the most stages first, until one has a solution that counts.

        The command of the sample follows from what is returned. Windows are tried in this order:

        1. `longer`, the window with a stage more, whose beginning has just come within the horizon;
        2. `sequence`, the window as it was, started from the solve of the sample before;
        3. `sequence` again with a cold start, which may move switch times far;
        4. the current stage alone, without the later stages that wait in the window. It may have a solution where, for
           example, an impact has put the end condition of the current stage out of reach. The later stages are
           appended again when they are detected.

        A window that violates soft limits further than a window with fewer stages counts as one without a solution. If
        no window has a solution, the failed solve of `sequence` is returned.

        Steps 3 and 4 are left out if the next switch is planned before the next sample, and the measured state meets
        the end condition within the detection margin. The plan in force then makes the switch: the rest of the stage is
        too short to correct the error of a measurement. What is returned then counts as infeasible.

        Args:
            sequence: The stages that are in the window.
            longer: The same with the stage that has appeared; None where none has.
        """
        solver = self._solver if longer is None else self._solver_of_longer
        solved = self._solve(longer or sequence, self._unfinished, solver)
        ran_out = solved.outcome in (Outcome.ITERATION_LIMIT, Outcome.DEADLINE)
        unfinished = solved if ran_out else None
        if longer is not None:  # step 1 has been made
            if solved.outcome.usable and self._keeps_limits(solved):
                return Attempt(longer, solved, unfinished)
            shorter = self._solve(sequence, unfinished, self._solver)  # what `longer` may violate soft limits by
            if solved.outcome.usable and self._keeps_limits(solved, shorter):
                return Attempt(longer, _with_total_time(solved, shorter), unfinished)
            solved = _with_total_time(shorter, solved)
        if solved.outcome is not Outcome.INFEASIBLE and self._keeps_limits(solved):
            return Attempt(sequence, solved, unfinished)
        if self._switch_is_imminent(sequence):
            return Attempt(sequence, replace(solved, outcome=Outcome.INFEASIBLE), unfinished)
        if len(sequence.segments) == 1:
            return Attempt(sequence, solved, unfinished)
        if solved.warm:  # step 3
            cold = self._solve(sequence, unfinished, self._solver, is_warm=False)
            if cold.outcome.usable and self._keeps_limits(cold):
                return Attempt(sequence, _with_total_time(cold, solved), unfinished)
            solved = _with_total_time(solved, cold)
        current_solved = self._solve(sequence.current_only, unfinished, self._solver)  # step 4
        better = solved.outcome is Outcome.INFEASIBLE or not self._keeps_limits(solved, current_solved)
        if current_solved.outcome.usable and better:
            return Attempt(sequence.current_only, _with_total_time(current_solved, solved), unfinished)
        return Attempt(sequence, _with_total_time(solved, current_solved), unfinished)

    def _keeps_limits(self, solved: Solution, shorter: Solution | None = None) -> bool:
        """Tell whether a window violates soft limits no further than the measured state does, or a shorter window."""
        largest, acceptable = self._violations(solved)
        if shorter is not None and shorter.outcome.usable:
            acceptable = np.maximum(acceptable, self._violations(shorter)[0])
        return bool((largest <= acceptable + FEASIBLE).all())

    def _violations(self, solved: Solution) -> tuple[np.ndarray, np.ndarray]:
        """Return by how much soft limits of states and rows are violated at the nodes, and by the measured state."""
        window = solved.window
        of_states = solved.violations
        initial = initial_violations(window.x0, window.stages) if window.soft else np.zeros(0)
        of_rows, initial_of_rows = soft_row_violations(self._model, window, solved.plan)
        return np.append(of_states, of_rows), np.append(initial[: len(of_states)], initial_of_rows)

    def _switch_is_imminent(self, sequence: MovingSequence) -> bool:
        """Tell whether the next stage is to begin before the next sample while the current one is near its target."""
        prediction = self._prediction
        if sequence.planned_end > prediction.start + self._spec.sample_time:
            return False
        stage = self._stages[sequence.first]
        return bool(self._costs.met(stage, prediction.X[:1], self._spec.detection_margin)[0])

    def _solve(
        self, sequence: MovingSequence, unfinished: Solution | None, solver: Solver, is_warm: bool = True
    ) -> Solution:
        window = self._builder.build(sequence, self._stages, self._prediction, self._previous, self._applied)
        guess = self._guess(sequence, unfinished)
        starts = self._spec.multistart or 1
        previous = self._previous if is_warm else None
        if starts == 1:
            return solver.solve(window, guess, previous)
        return solve_from_several(solver, window, guess, previous, starts)

    def _guess(self, sequence: MovingSequence, unfinished: Solution | None) -> Plan:
        """Return the guess of a window: the prediction, or the unfinished iterate over the same stages, shifted."""
        prediction = self._prediction
        if unfinished is not None and unfinished.window.stages[-1].index == sequence.last:
            started = unfinished.plan.in_chart(prediction.chart)
            if np.isfinite(started.X).all():
                iterate = shift(started, prediction.start, self._spec.horizon, prediction.X[0])
                if len(iterate.switch_times) == len(sequence.switch_times):
                    return iterate
        return sequence.guess(prediction)


def _with_total_time(solved: Solution, other: Solution) -> Solution:
    """Return a solve, its wall time that of both it and another one in the same sample."""
    return replace(solved, wall_time=other.wall_time + solved.wall_time)
