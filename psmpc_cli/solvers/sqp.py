"""Sequential quadratic programming with the Gauss-Newton Hessian: one iteration a sample on the shifted plan.

A window whose guess is warm is the last one, shifted, or what is left of it when its first stage is over: it gets the
iterations the task asks for. Other guesses are cold (an append, a stage that waits again) and iterated until steps are
small. The filter halves a step until it accepts it.
"""

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from psmpc_cli.native.functions import BatchFunction, tape_library
from psmpc_cli.native.library import Library, compile_all
from psmpc_cli.ocp.constraints import ConstraintFunctions, IntervalFunctions
from psmpc_cli.ocp.constraints.boxes import PENALTY
from psmpc_cli.ocp.gauss_newton import Linearization, Unknowns, VelocityForm
from psmpc_cli.ocp.objective import ChangeFunctions, RateFunctions, stage_functions
from psmpc_cli.ocp.plan import Plan, mesh
from psmpc_cli.ocp.problem import Problem
from psmpc_cli.ocp.stage import Stage, cost_shape, end_shape, stage_shape, without_end
from psmpc_cli.ocp.window import Window, WindowShape, durations, plan_on_mesh, window_numbers, window_shape
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.solvers.base import FEASIBLE, Outcome, Solution, Solver
from psmpc_cli.solvers.bounded import LONGEST_CALL
from psmpc_cli.solvers.nlp import Report
from psmpc_cli.solvers.quadratic import PiqpQp, QpMethod, QpSolution, QpStatus, RiccatiQp, kernel_library, load_kernel
from psmpc_cli.solvers.sqp_window import (
    NEAR_BOUND,
    NEARER,
    Evaluation,
    SqpWindow,
    WindowBounds,
    fixed_bounds,
    window_bounds,
)
from psmpc_cli.specs.controller import SolverSpec
from psmpc_cli.specs.robots.robot import Limits

SMALL = 1e-2
"""Step at which a cold start is iterated enough [m, rad, m/s, rad/s, s]: what is left after it is a tenth and less."""

MODEL_ERROR = 1e-3
"""Largest violation of soft rows beyond the program's prediction at which a warm window is settled [m, rad].

A gap that is left at a sample lets the filter accept a step that raises the objective. The next iteration starts
without a gap, and rejects such a step.
"""

QP_TOLERANCE_FACTOR = 0.1
"""Tolerance of our own QP method over that of the solver: its last iterations are cheap, and flat directions gain."""

SHORTEST_STEP = 1 / 32
"""The shortest step length that is tried."""

LARGEST_CUT = 0.5
"""Largest share of its duration by which a step shortens a stage: the gaps are bilinear in durations and velocities.

Longer first steps of cold windows may end at a later local minimum; 0.3 to 0.7 give the same optima.
"""

MARGIN = 0.1
"""gamma: share of the violation by which a step must improve on an entry of the filter.

The source has 1e-5. So little lets the iterations zigzag between two points while the violation falls by a few per
cent: up to 22 iterations of a warm window, where 0.1 takes up to 5.
"""

AITKEN_MIN_RATIO = 0.8
"""A step that undoes the last one is shortened if it is at least this long, in units of that one."""

AITKEN_MIN_FACTOR = 0.25
"""Smallest factor of a shortened step: one that is many times as long as the last one has another cause."""

NEARLY_FEASIBLE = 1e-2
"""Largest violation at which steps are shortened (`aitken_factor`) or corrected; above it they have to lower it."""

S_PHI = 2.3
S_THETA = 1.1
"""Exponents of the rule that says when the objective has to fall."""

DECREASE = 1e-4
"""eta: share of the predicted decrease of the objective that a step from a feasible point must bring (Armijo)."""

ROUNDING = 1e-9
"""Relative rise of the objective that is taken for rounding."""

LATE_SWITCH_FRACTION = 0.9
"""Where a program has no solution: fraction of the way to its latest time by which the last switch is delayed."""

BROKEN_DOWN = (QpStatus.NOT_CONVEX, QpStatus.FAILED)
"""How programs of the Gauss-Newton model end where their numbers break down: that model is convex but for rounding."""

HEADING = "iter       objective   inf_pr    ||d||    alpha  qp"
"""Columns of the table of iterations, the guess first.

Number of the iteration; objective, J over the window's largest priority; largest violation of a constraint; largest
component of the program's full step [m, rad, m/s, rad/s, s]; fraction of it that was taken, 0 if it was rejected;
interior-point iterations of the program, and whether it had no solution or was an elastic one.
"""


@dataclass(frozen=True, eq=False)
class Program:
    """A quadratic program and its solution.

    Attributes:
        model: The model it is of.
        qp: The solution.
        reached: The point after the full step; where the step begins, if there is none.
        is_elastic: Its rows at nodes may be violated at a cost, see `SqpWindow.elastic`.
    """

    model: Linearization
    qp: QpSolution
    reached: Evaluation
    is_elastic: bool = False

    @property
    def remark(self) -> str:
        """What the table of iterations says of it behind its number of iterations."""
        if self.qp.status is not QpStatus.SOLVED:
            return f"  {self.qp.status.value}"
        return "  elastic" * self.is_elastic


@dataclass(frozen=True, eq=False)
class Iterate:
    """A point that an iteration has reached, and the step from the iteration before.

    Attributes:
        reached: The point.
        step: Largest component of the program's full step [m, rad, m/s, rad/s, s].
        step_length: alpha, fraction of that step that was taken; 0 if it was rejected.
        unpredicted_violation: Largest violation of a soft row beyond the program's prediction [m, rad].
        qp: The program's solution, None at the guess.
    """

    reached: Evaluation
    step: float = np.inf
    step_length: float = 0.0
    unpredicted_violation: float = 0.0
    qp: QpSolution | None = None


@dataclass(frozen=True, eq=False)
class _Setup:
    """What windows share that are alike.

    Attributes:
        form: Windows of one shape as functions of states and durations.
        method: For their programs.
        limits: Of their stages.
        bounds: Those that follow from the limits; `window_bounds` completes them for each window.
    """

    form: VelocityForm
    method: QpMethod
    limits: tuple[Limits, ...]
    bounds: WindowBounds


class SqpSolver(Solver):
    """Windows by sequential quadratic programming.

    Args:
        problem: The problem.
        spec: Settings.
        report: Takes the lines of the table of iterations.
    """

    def __init__(self, problem: Problem, spec: SolverSpec, report: Report | None = None) -> None:
        self._model = problem.model
        self._spec = spec
        self._report = report
        self.deadline = np.inf if spec.deadline is None else spec.deadline
        self._setups: dict[WindowShape, _Setup] = {}
        if spec.compiled:
            compile_all(libraries(problem))  # before the robot moves: of a spatial robot it takes seconds
        for function in _functions(problem):
            function.prepare()

    def _setup(self, window: Window) -> "_Setup":
        """Return what windows of one shape and limits share.

        A reserve of speed changes limits at every sample, so of each shape only the last bounds are kept.
        """
        shape = window_shape(window)
        limits = tuple(stage.limits for stage in window.stages)
        setup = self._setups.get(shape)
        if setup is None:
            form = VelocityForm(self._model, shape)
            setup = _Setup(form, self._method(form), limits, fixed_bounds(form, window))
            self._setups[shape] = setup
        elif setup.limits != limits:
            setup = replace(setup, limits=limits, bounds=fixed_bounds(setup.form, window))
            self._setups[shape] = setup
        return setup

    def _method(self, form: VelocityForm) -> QpMethod:
        """Return our own method where it can be compiled, else PIQP."""
        kernel = load_kernel(form.grid.n, form.grid.switches, form.history) if self._spec.compiled else None
        if kernel is None:
            return PiqpQp(self._spec.tolerance)
        return RiccatiQp(kernel, QP_TOLERANCE_FACTOR * self._spec.tolerance)

    def _solve(self, window: Window, guess: Plan, previous: Solution | None, within: float) -> Solution:
        """Solve a window by SQP: set up the iterations from what its shape shares, run them, return the last as a plan.

        Args:
            window: The window.
            guess: The guessed plan on its mesh.
            previous: The solution before, of which the guess is the shifted plan: the solve is warm then. None: cold.
            within: Durations stay within so many seconds of the guessed ones.
        """
        began = time.perf_counter()
        tau = durations(guess.switch_times, window.start, window.horizon)[:-1]
        setup = self._setup(window)
        form = setup.form
        parameters = window_numbers(window, guess.switch_times)
        sqp_window = SqpWindow(form, window_bounds(form, setup.bounds, window, guess, tau, within), parameters)
        is_warm = previous is not None
        solve = _Solve(
            spec=self._spec,
            window=sqp_window,
            method=setup.method,
            report=self._report,
            stop_at=self.stop_time(began),
            stop_at_cpu_time=time.process_time() + LONGEST_CALL,
            most_iterations=self._most_iterations or self._spec.max_iterations,
            is_warm=is_warm,
            restores=not is_warm and not all(stage.moved_by.actuated for stage in window.stages),
        )
        multipliers = np.zeros(0)  # of the rows at nodes: they weigh the curvature of these in the first program
        if previous is not None and form.curved and len(previous.duals) == len(form.row_node):
            multipliers = previous.duals
        iterate, outcome, count = solve.run(Unknowns(guess.X, tau), multipliers)
        point = iterate.reached.point
        residuals = iterate.reached.residuals
        return Solution(
            outcome=outcome,
            plan=plan_on_mesh(window, point.X, form.inputs(point, window.horizon), point.tau),
            objective=iterate.reached.objective,
            iterations=count,
            wall_time=time.perf_counter() - began,
            window=window,
            guess=guess,
            warm=is_warm,
            costs=residuals.costs,
            terminal=residuals.terminal,
            violations=sqp_window.state_violations(point) if window.soft else np.zeros(0),
            duals=iterate.qp.node_multipliers if form.curved and iterate.qp is not None else np.zeros(0),
            guess_duals=multipliers,
        )


def libraries(problem: Problem) -> Iterator[Library]:
    """Yield the libraries that the windows of a problem need, whichever stages are in them."""
    yield tape_library()
    n = problem.model.n
    histories = {n if stage.has_rates else 0 for stage in problem.stages}
    windows = product(range(len(problem.stages)), sorted(histories))
    yield from dict.fromkeys(kernel_library(n, switches, history) for switches, history in windows)


def _functions(problem: Problem) -> Iterator[BatchFunction]:
    """Yield the functions that the windows of a problem evaluate, whichever stages are in them."""
    base_reacts = not all(stage.moved_by.actuated for stage in problem.stages)
    for shape in dict.fromkeys(cost_shape(stage_shape(stage)) for stage in problem.stages):
        of_stage = stage_functions(problem.model, shape)
        yield from of_stage.prepare()
        if base_reacts:
            yield of_stage.residual_curvature
    for shape in dict.fromkeys(end_shape(stage_shape(stage)) for stage in problem.stages):
        yield from stage_functions(problem.model, shape).prepare()
    of_rows = [functions for stage in problem.stages for functions in _functions_of_rows(problem.model, stage)]
    for row_functions in dict.fromkeys(of_rows):
        yield from row_functions.prepare()


def _functions_of_rows(
    model: RobotModel, stage: Stage
) -> list[ConstraintFunctions | ChangeFunctions | IntervalFunctions | RateFunctions]:
    """Return the functions of the rows that a stage may have, its end's and those that samples set among them."""
    constraints = tuple((name, constraint.structure) for name, constraint in stage.constraints.items())
    shape = replace(stage_shape(stage), constraints=constraints)
    stages = shape, without_end(shape)
    form = VelocityForm(model, WindowShape(stages=stages, nodes=(1, 1), discretization="exact"))
    return [*(rows.functions for rows in form.node_rows), *(rows.functions for rows in form.interval_rows)]


@dataclass(frozen=True, eq=False)
class _Solve:
    """One solve of a window.

    Attributes:
        spec: Settings.
        window: The window.
        method: Method for its programs.
        report: Takes the lines of the table of iterations.
        stop_at: When the solve has to stop, an instant of `time.perf_counter` [s].
        stop_at_cpu_time: The same of `time.process_time`, far beyond what windows take [s].
        most_iterations: Iterations after which it stops.
        is_warm: The guess is the last solution, shifted.
        restores: Elastic programs stand in for those without a solution, see `_with_elastic_program`.
    """

    spec: SolverSpec
    window: SqpWindow
    method: QpMethod
    report: Report | None
    stop_at: float
    stop_at_cpu_time: float
    most_iterations: int
    is_warm: bool
    restores: bool

    def run(self, guess: Unknowns, multipliers: np.ndarray) -> tuple[Iterate, Outcome, int]:
        """Iterate from a guess until the solve has ended, one quadratic program and one step at a time.

        An iterate that meets all constraints is remembered: where a later one fails or time is up, it is the result.

        Args:
            guess: States at the nodes and durations to start from.
            multipliers: Of the rows at nodes, (E,), from the solve before; (0,) if there are none.

        Returns:
            The last iterate, or the last feasible one; how the solve ended; the number of iterations.
        """
        iterate, program = self._begin(guess, multipliers)
        if not self.is_warm:
            iterate, program = self._with_later_switch(iterate, program, guess, multipliers)
        self._tell(0, iterate, None)
        filter_ = Filter()
        last_feasible = None
        for count in range(1, self.most_iterations + 1):
            before = iterate
            if program.qp.status is QpStatus.SOLVED:
                iterate = self._line_search(iterate, program, filter_)
            self._tell(count, iterate, program)
            outcome = self._outcome(count, iterate, before, program)  # None: go on
            if self._is_applicable(iterate):
                last_feasible = iterate
            if outcome is not None:
                if last_feasible is None or outcome.usable:
                    return iterate, outcome, count
                return last_feasible, Outcome.FEASIBLE, count
            if count < self.most_iterations:
                here, model = self.window.linearize(iterate.reached.point, program.model)
                program = self._with_elastic_program(
                    here, self._solved_program(here, model, program.qp.node_multipliers)
                )
        if last_feasible is not None:
            return last_feasible, Outcome.FEASIBLE, self.most_iterations
        return iterate, Outcome.ITERATION_LIMIT, self.most_iterations

    def _with_later_switch(
        self, iterate: Iterate, program: Program, guess: Unknowns, multipliers: np.ndarray
    ) -> tuple[Iterate, Program]:
        """Return iterate and program at a guess, or at one with a later switch if only that one keeps limits.

        A cold guess, which no earlier solve has made, may leave a stage too little time for its end condition. Its
        quadratic program then has no solution, or one far beyond soft limits. A later last switch may help.

        Args:
            iterate: The iterate at the guess.
            program: The solved program there.
            guess: The guess: states at nodes and durations.
            multipliers: Multipliers of the rows at nodes from an earlier solve, (E,), or (0,) without one.
        """
        if self._keeps_limits(program):
            return iterate, program
        later_guess = later_switch(self.window, guess)
        if later_guess is None:
            return iterate, program
        later_iterate, later_program = self._begin(later_guess, multipliers)
        return (later_iterate, later_program) if self._keeps_limits(later_program) else (iterate, program)

    def _begin(self, guess: Unknowns, multipliers: np.ndarray) -> tuple[Iterate, Program]:
        """Return the iterate at a guess, and the program there."""
        here, model = self.window.linearize(self.window.with_dependent_rates(guess))
        return Iterate(here), self._with_elastic_program(here, self._solved_program(here, model, multipliers))

    def _keeps_limits(self, program: Program) -> bool:
        """Tell whether a program has a solution, which violates soft limits no further than the measured state does."""
        return program.qp.status is QpStatus.SOLVED and self.window.keeps_soft_limits(program.reached)

    def _with_elastic_program(self, here: Evaluation, program: Program) -> Program:
        """Return the program of an iterate; if it has no solution, the elastic one, which brings violations down.

        An elastic program may violate rows at nodes, such as end conditions, at a cost:

            min  model + rho t |violations of the rows at nodes|_1,   t the share of time of their node.

        It has a solution as long as limits of states leave one, and after its step the programs of later iterates have
        solutions. Elastic programs are for robots without thrusters, on cold guesses (`restores`). Such a robot reaches
        a pose by its arms alone. Linearized where they are nearly stretched, the pose asks for several times the joint
        angles that lead there, which limits of rates do not allow. Robots with thrusters do without: their windows
        without a solution are most often those to which the next stage was added too early, which takes many times as
        long to find out by elastic programs (docs/decisions.md).

        Args:
            here: The iterate's point.
            program: The program there and its solution, if it has one.

        Source: Gill, Murray, Saunders: SNOPT: An SQP algorithm for large-scale constrained optimization (2005), on
        elastic programs.
        """
        if program.qp.status is QpStatus.SOLVED or not self.restores:
            return program
        elastic = self.window.elastic
        restoring = self._solved_with_missed_rows(
            elastic, program.model, elastic.evaluated(here.point, program.model.residuals)
        )
        return replace(restoring, is_elastic=True) if restoring.qp.status is QpStatus.SOLVED else program

    def _solved_program(self, here: Evaluation, model: Linearization, multipliers: np.ndarray) -> Program:
        """Return the solved quadratic program of an iterate: its Gauss-Newton model, with curvature where that helps.

        Three attempts, each where the one before does not say whether there is a step:

        1. With multipliers from before, the model with the curvature of rows at nodes times these.
        2. Where that is not convex, or there are none: the Gauss-Newton model alone.
        3. Where soft limits would be violated so far that the numbers break down: the same with hard limits, which says
           whether it is infeasible.

        Args:
            here: The iterate's point.
            model: The Gauss-Newton model there.
            multipliers: Of the rows at nodes, (E,), from the program before; (0,) if there are none.
        """
        window = self.window
        if window.form.curved and len(multipliers):
            curved = window.form.with_curvature(model, here.point, window.p, multipliers)
            program = self._solved_with_missed_rows(window, curved, here)
            # Both models have the same constraints: the other one is infeasible too.
            if program.qp.status in (QpStatus.SOLVED, QpStatus.INFEASIBLE):
                return program
        program = self._solved_with_missed_rows(window, model, here)
        if program.qp.status in BROKEN_DOWN and window.bounds.soft.any():
            hard = replace(window, bounds=replace(window.bounds, soft=np.zeros_like(window.bounds.soft)))
            proof = self._solved_with_missed_rows(hard, model, here)
            return program if proof.qp.status in BROKEN_DOWN else proof
        return program

    def _solved_with_missed_rows(self, window: SqpWindow, model: Linearization, here: Evaluation) -> Program:
        """Solve the quadratic program of a model, adding rows that it left out until its step violates none of them.

        Of the many rows over intervals, and of distances between bodies, a model has only those near their bounds. The
        others do not change the solution, unless the step leads beyond their bounds.

        Args:
            window: The window with its bounds.
            model: Objective and constraints, linearized at the point.
            here: The point and what was evaluated there.

        Returns:
            The last program with its solution and the point after its full step; if it has no solution, with its status
            and the point itself.
        """
        near = NEAR_BOUND
        while True:
            qp = self.method.solve(window, model, here)
            if qp.status is not QpStatus.SOLVED:
                return Program(model, qp, here)
            reached = self._evaluation_after(here, qp.step, 1.0)
            missed_node_rows, missed_interval_rows = window.missed_rows(model, reached, near)
            if len(missed_node_rows) + len(missed_interval_rows) == 0:
                return Program(model, qp, reached)
            model = window.with_rows(model, here.point, missed_node_rows, missed_interval_rows)
            near *= NEARER  # more rows each time: few rounds are enough

    def _evaluation_after(self, here: Evaluation, step: Unknowns, step_length: float) -> Evaluation:
        """Return the point after a step of a length, 1 being the full one."""
        return self.window.evaluation(self.window.with_dependent_rates(here.point.moved(step, step_length)))

    def _outcome(self, count: int, iterate: Iterate, before: Iterate, program: Program) -> Outcome | None:
        """Return how the solve has ended after an iteration; None where it goes on.

        Args:
            count: Number of the iteration.
            iterate: Where its step led; the point before, where the step was rejected.
            before: The iterate before it.
            program: The program of its step.
        """
        is_feasible = iterate.reached.violation <= FEASIBLE
        has_not_moved = iterate.reached is before.reached
        if program.qp.status is QpStatus.INFEASIBLE:
            return Outcome.INFEASIBLE
        if program.is_elastic and has_not_moved:  # violations are the least nearby
            return self._unfinished(iterate, Outcome.INFEASIBLE)
        if program.qp.status in BROKEN_DOWN:
            return self._unfinished(iterate, Outcome.FAILED)
        # About an optimum the objective is quadratic in the step: its error is of the order of the step squared.
        if iterate.step <= np.sqrt(self.spec.tolerance) and is_feasible:
            return Outcome.OPTIMAL
        if has_not_moved:
            return self._unfinished(iterate, Outcome.FAILED)
        # A warm window, the last one shifted, is near its optimum: the iterations that the task asks for are enough.
        is_settled = (self.is_warm and iterate.unpredicted_violation <= MODEL_ERROR) or iterate.step <= SMALL
        if count >= self.spec.iterations and is_settled and is_feasible:
            return Outcome.FEASIBLE
        if time.perf_counter() >= self.stop_at:
            return self._unfinished(iterate, Outcome.DEADLINE)
        if time.process_time() >= self.stop_at_cpu_time:
            return self._unfinished(iterate, Outcome.TIMEOUT)
        return None

    def _tell(self, count: int, iterate: Iterate, program: Program | None) -> None:
        """Report an iteration: where it led, and the program whose step it took, if it has one."""
        if self.report is None:
            return
        if program is None:
            self.report(HEADING)
        solved = program is not None and program.qp.status is QpStatus.SOLVED
        step = f"{iterate.step:8.2e} {iterate.step_length:8.2e}" if solved else f"{'-':>8} {'-':>8}"
        of_program = f"{'-':>3}" if program is None else f"{program.qp.iterations:3d}{program.remark}"
        reached = iterate.reached
        self.report(f"{count:4d} {reached.objective:15.8e} {reached.violation:8.2e} {step} {of_program}")

    def _unfinished(self, iterate: Iterate, otherwise: Outcome) -> Outcome:
        """Return how an iterate that is not settled is to be taken."""
        return Outcome.FEASIBLE if self._is_applicable(iterate) else otherwise

    def _is_applicable(self, iterate: Iterate) -> bool:
        """Tell whether an iterate may be applied before it settles: a step led there, and it meets all constraints."""
        return iterate.qp is not None and iterate.reached.violation <= FEASIBLE

    def _line_search(self, iterate: Iterate, program: Program, filter_: "Filter") -> Iterate:
        """Return the iterate after the longest step that the filter accepts, halving a program's step until it does.

        If the filter accepts none, the iterate is the point where the step begins, with step length 0. A step that
        leaves the constraints, by their curvature, from a point near them is first corrected (second-order correction),
        if that brings it nearer to them. It is not corrected where soft rows are violated: the correction would change
        their violations against each other.

        Args:
            iterate: Where the step begins.
            program: The program there, with its solution.
            filter_: What the new iterate must improve on; it may remember where the step begins.
        """
        model = program.model
        qp = program.qp
        here = iterate.reached
        step_size = _largest(qp.step)
        # The change of objective and penalties that the model predicts for a full step, to first order.
        slope = float((model.gradient * qp.step.X).sum() + model.gradient_tau @ qp.step.tau)
        predicted_rows = self.window.predicted_rows(here, model, qp.step)
        slope += self.window.change_of_penalty(here, predicted_rows)
        step_length = min(self._longest_step(here.point, qp.step), aitken_factor(iterate, qp.step))
        reached = program.reached if step_length == 1 else self._evaluation_after(here, qp.step, step_length)
        violates_soft_rows = reached.penalties.max(initial=0.0) > PENALTY * FEASIBLE
        leaves_constraints = reached.violation > FEASIBLE and here.violation <= NEARLY_FEASIBLE
        if leaves_constraints and not violates_soft_rows and not program.is_elastic:
            corrected = self._corrected(iterate, program)
            is_nearer = corrected is not None and corrected.reached.violation < reached.violation
            if corrected is not None and is_nearer and filter_.accepts(corrected, iterate, slope, is_elastic=False):
                return corrected
        while step_length >= SHORTEST_STEP:
            trial = Iterate(reached, step_size, step_length, qp=qp)
            if filter_.accepts(trial, iterate, slope, program.is_elastic):
                unpredicted = self.window.unpredicted_violation(here, predicted_rows, step_length, reached)
                return replace(trial, unpredicted_violation=unpredicted)
            step_length /= 2
            reached = self._evaluation_after(here, qp.step, step_length)
        return Iterate(here, step_size, qp=qp)

    def _corrected(self, iterate: Iterate, program: Program) -> Iterate | None:
        """Return the iterate after the second-order correction of a program's step; None where it has no solution.

        Multipliers are those of the program itself.
        """
        here, model = self.window.corrected(iterate.reached, program.model, program.qp.step, program.reached)
        correction = self.method.solve(self.window, model, here)
        if correction.status is not QpStatus.SOLVED:
            return None
        reached = self._evaluation_after(iterate.reached, correction.step, 1.0)
        qp = replace(program.qp, step=correction.step)
        return Iterate(reached, _largest(program.qp.step), 1.0, qp=qp)

    def _longest_step(self, point: Unknowns, step: Unknowns) -> float:
        """Return the largest step length that shortens no stage by more than `LARGEST_CUT` of its duration."""
        durations = self.window.form.durations(point, self.window.horizon)
        changes = self.window.form.stage_durations @ step.tau
        cuts = -changes / durations
        return LARGEST_CUT / max(LARGEST_CUT, float(cuts.max()))


def _largest(step: Unknowns) -> float:
    """Return the largest component of a step [m, rad, m/s, rad/s, s]."""
    return float(max(np.abs(step.X).max(), np.abs(step.tau).max(initial=0.0)))


class Filter:
    """What later iterates of one solve must improve on: pairs of violation theta_j and objective phi_j.

    A trial point after a step of length alpha from iterate k is acceptable to the filter if for every entry

        theta <= (1 - gamma) theta_j   or   phi <= phi_j - gamma theta_j.

    Where iterate k is feasible and its step leads so steeply downhill, m being the change of phi that the gradient
    predicts, that alpha (-m)^2.3 > theta_k^1.1, the objective has to fall by Armijo's rule as well:

        phi <= phi_k + eta alpha m.

    Else the trial point has to improve on iterate k as on an entry, and iterate k becomes one. The step of an elastic
    program is there to restore feasibility: it has to improve on the violation of iterate k, whatever the objective.

    Source: Waechter, Biegler: On the implementation of an interior-point filter line-search algorithm for large-scale
    nonlinear programming (2006), section 2.3. theta is the largest violation here, not their sum: a stage that gets
    much shorter leaves a gap at each of its nodes, a second-order term each that the next iteration closes. For the
    same reason no merit function is used, see docs/decisions.md.
    """

    def __init__(self) -> None:
        self._entries: list[tuple[float, float]] = []

    def accepts(self, trial: Iterate, iterate: Iterate, slope: float, is_elastic: bool) -> bool:
        """Tell whether a step of the line search is accepted; if so, the filter may remember where it started.

        theta is the largest violation of a constraint, phi the objective, and k the iterate before the step. A step
        that leads steeply downhill from a feasible iterate has to lower phi by Armijo's rule. Any other has to improve
        on iterate k in theta or in phi, and iterate k becomes an entry that later iterates have to improve on.

        Args:
            trial: The iterate after the step.
            iterate: Iterate k, where the step starts.
            slope: m, the predicted change of phi by a full step, with the penalties of soft limits.
            is_elastic: The step is that of an elastic program, which restores feasibility: only theta counts.
        """
        theta = trial.reached.violation
        theta_k = iterate.reached.violation
        phi_k = iterate.reached.objective
        phi = trial.reached.objective - ROUNDING * (1 + abs(phi_k))
        is_steep = slope < 0 and trial.step_length * (-slope) ** S_PHI > theta_k**S_THETA
        if theta_k <= FEASIBLE and is_steep:
            return self._acceptable(theta, phi) and phi <= phi_k + DECREASE * trial.step_length * slope
        improves = _reduces(theta, theta_k) if is_elastic else _improves(theta, phi, theta_k, phi_k)
        if not (self._acceptable(theta, phi) and improves):
            return False
        self._entries.append((theta_k, phi_k))
        return True

    def _acceptable(self, theta: float, phi: float) -> bool:
        return all(_improves(theta, phi, *entry) for entry in self._entries)


def _improves(theta: float, phi: float, old_theta: float, old_phi: float) -> bool:
    """Tell whether violation or objective of a point improves on those of an earlier one."""
    return _reduces(theta, old_theta) or phi <= old_phi - MARGIN * old_theta


def _reduces(theta: float, old_theta: float) -> bool:
    """Tell whether the violation of a point improves on that of an earlier one."""
    return theta <= (1 - MARGIN) * old_theta


def aitken_factor(iterate: Iterate, step: Unknowns) -> float:
    """Return the step length a that stops a step from undoing the last one, where two alternate; else 1.

    Where the Gauss-Newton model misses curvature, steps alternate about the optimum. Let d_ be the last step, taken
    with length a_, and d this one. If the iteration is linear, the length of d that removes the error along the change
    of the step is

        a = -a_ d_ . (d - d_) / |d - d_|^2,

    but at least `AITKEN_MIN_FACTOR`. Steps are shortened that turn round and are about as long as the last one. Where
    soft rows are violated the objective has kinks, and steps turn round for another reason: they are left alone.

    Args:
        iterate: Where the step begins, with the step that led there.
        step: The full step d.

    Source: Irons, Tuck: A version of the Aitken accelerator for computer iteration (1969).
    """
    here = iterate.reached
    if iterate.qp is None or iterate.step_length == 0.0 or here.violation > NEARLY_FEASIBLE:
        return 1.0
    violates_soft_rows = here.penalties.max(initial=0.0) > PENALTY * FEASIBLE
    if violates_soft_rows:
        return 1.0
    last_step = np.append(iterate.qp.step.X, iterate.qp.step.tau)
    this_step = np.append(step.X, step.tau)
    turns_round = last_step @ this_step < 0.0
    is_about_as_long = this_step @ this_step >= AITKEN_MIN_RATIO**2 * (last_step @ last_step)
    if not (turns_round and is_about_as_long):
        return 1.0
    change = this_step - last_step
    return max(AITKEN_MIN_FACTOR, iterate.step_length * float(-(last_step @ change) / (change @ change)))


def later_switch(window: SqpWindow, point: Unknowns) -> Unknowns | None:
    """Return a guess of the same motion whose last switch is near its latest time, to make a program solvable.

    A stage that is too short for its end condition has both to last longer and to move faster. A linearized program has
    the two changes, but not their product; from a guess whose switch is late already, a faster motion is enough.

    Args:
        window: The window.
        point: The guess: states at nodes, and the durations tau (S,) of all stages but the last [s].

    Returns:
        The guess; None where there is no switch, or the last one cannot be later.
    """
    form = window.form
    tau = point.tau
    last = len(tau) - 1
    if last < 0:
        return None
    # Behind the rows of states stand the durations, then their sums (the switch times from the window's start).
    high = window.bounds.high[window.states :]
    longest_duration = high[last]
    latest_switch = high[len(tau) + last]
    longest = min(longest_duration, latest_switch - tau[:last].sum())
    if longest <= tau[last]:
        return None
    later_tau = tau.copy()
    later_tau[last] += LATE_SWITCH_FRACTION * (longest - tau[last])
    edges = np.r_[0.0, np.cumsum(tau), window.horizon]  # start, switch times and end
    later_edges = np.r_[0.0, np.cumsum(later_tau), window.horizon]
    # The states of the guess at the times of the later mesh.
    motion = Plan(mesh(edges, form.grid.nodes), point.X, form.inputs(point, window.horizon), edges[1:-1])
    X = motion.states_at(mesh(later_edges, form.grid.nodes))
    return Unknowns(np.vstack([point.X[:1], X[1:]]), later_tau)
