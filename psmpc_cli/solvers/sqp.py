"""Sequential quadratic programming with the Gauss-Newton Hessian: one iteration a sample on the shifted plan.

A window whose guess is warm is the last one, shifted: it gets the iterations the task asks for. Any
other guess is cold (an append, a drop, another shape) and is iterated until the step is small. Steps that bring nothing
are halved.
"""

import time
from dataclasses import dataclass, replace

import numpy as np

from psmpc_cli.ocp.gauss_newton import Linearization, Point, Residuals, VelocityForm
from psmpc_cli.ocp.objective import StageShape, stage_functions
from psmpc_cli.ocp.plan import Plan, mesh
from psmpc_cli.ocp.problem import Problem
from psmpc_cli.ocp.window import PENALTY, Window, plan_on_mesh, stage_shape, window_numbers, window_shape
from psmpc_cli.solvers.base import FEASIBLE, Outcome, Solution, Solver
from psmpc_cli.solvers.nlp import Report
from psmpc_cli.solvers.quadratic import PiqpQp, QpMethod, QpSolution, QpStatus, RiccatiQp, load_kernel
from psmpc_cli.solvers.sqp_window import SqpWindow, Violation, WindowBounds, fixed_bounds, window_bounds
from psmpc_cli.specs.task import SolverSpec

SMALL = 1e-2
"""Step at which a cold start is iterated enough [m, rad, m/s, rad/s, s]: what is left after it is a tenth and less."""

SHARPER = 0.1
"""Our own method's tolerance in units of the solver's: its last iterations are cheap, and flat directions gain."""

SHORTEST_STEP = 1 / 32
"""The shortest share of a step that is tried."""

DECREASE = 1e-4
"""Share of the predicted decrease of the merit function that a step must bring (Armijo)."""

NOISE = 1e-9
"""Relative rise of the objective that is taken for rounding."""

LATER = 0.9
"""How much of the time that a stage could last longer it is given in a guess for a program without a solution."""

HEADING = "iter       objective   inf_pr    ||d||    alpha  qp"
"""Columns of the table of iterations, the guess first.

Number of the iteration; objective, J over the window's largest priority; largest violation of a constraint; largest
component of the program's full step [m, rad, m/s, rad/s, s]; share of the step that was taken, 0 if none of it counted;
interior-point iterations of the program.
"""


@dataclass(frozen=True, eq=False)
class Iterate:
    """Point of an iteration with its residuals and the step that led to it.

    Attributes:
        step: Largest component of the program's full step [m, rad, m/s, rad/s, s].
        share: How much of that step was taken; 0 if no share of it counted.
        qp: The program's solution, None at the guess.
    """

    point: Point
    at: Residuals
    violation: Violation
    step: float = np.inf
    share: float = 0.0
    qp: QpSolution | None = None


class SqpSolver(Solver):
    """Windows by sequential quadratic programming.

    Args:
        problem: The problem.
        spec: Settings.
        report: Takes the lines of the table of iterations.
    """

    def __init__(self, problem: Problem, spec: SolverSpec, report: Report | None = None) -> None:
        self._model, self._spec, self._report = problem.model, spec, report
        self._setups: dict[tuple[object, ...], tuple[VelocityForm, WindowBounds, QpMethod]] = {}
        for stage in problem.stages:  # before the robot moves: of a spatial robot it takes a second
            stage_functions(problem.model, StageShape(stage.space), spec.compiled).prepare()
            stage_functions(problem.model, stage_shape(stage)).prepare()

    def _setup(self, window: Window) -> tuple[VelocityForm, WindowBounds, QpMethod]:
        """Return what windows of one shape, limits and tolerances share: form, bounds, method for their programs."""
        shape = window_shape(window)
        key = (shape, *((stage.limits, stage.tolerance.tobytes(), stage.end_velocity) for stage in window.stages))
        if key not in self._setups:
            form = VelocityForm(self._model, shape, self._spec.compiled)
            self._setups[key] = form, fixed_bounds(form, window), self._method(form)
        return self._setups[key]

    def _method(self, form: VelocityForm) -> QpMethod:
        """Return our own method where it can be compiled, else PIQP."""
        kernel = load_kernel(form.grid.n, form.grid.switches) if self._spec.compiled else None
        if kernel is None:
            return PiqpQp(self._spec.tolerance)
        return RiccatiQp(kernel, SHARPER * self._spec.tolerance)

    def _solve(self, window: Window, guess: Plan, previous: Solution | None, within: float) -> Solution:
        began, tau = time.perf_counter(), np.diff(guess.instants, prepend=window.start)
        form, shared, method = self._setup(window)
        numbers = window_numbers(window, guess.instants)
        sqp_window = SqpWindow(form, window_bounds(shared, window, guess, tau, within), numbers)
        solve = _Solve(self._spec, sqp_window, method, self._report, began)
        ends = np.zeros(0)
        if previous is not None and form.curved and len(previous.duals) == len(form.end_node):
            ends = previous.duals
        iterate, outcome, count = solve.run(Point(guess.X, tau), ends, previous is not None)
        point = iterate.point
        return Solution(
            outcome=outcome,
            plan=plan_on_mesh(window, point.X, form.inputs(point, window.horizon), point.tau),
            objective=iterate.at.objective,
            iterations=count,
            wall_time=time.perf_counter() - began,
            window=window,
            guess=guess,
            warm=previous is not None,
            costs=iterate.at.costs,
            terminal=iterate.at.terminal,
            violations=sqp_window.beyond(point)[1:].max(axis=0) / PENALTY if window.soft else np.zeros(0),
            duals=iterate.qp.ends if form.curved and iterate.qp is not None else np.zeros(0),
            guess_duals=ends,
        )


@dataclass(frozen=True, eq=False)
class _Solve:
    """One solve of a window."""

    spec: SolverSpec
    window: SqpWindow
    method: QpMethod
    report: Report | None
    began: float

    def run(self, guess: Point, ends: np.ndarray, warm: bool) -> tuple[Iterate, Outcome, int]:
        """Return the last iterate, how it is to be taken, and the number of iterations."""
        iterate, model = self._begin(guess)
        qp = self._program(iterate.point, model, ends)
        if qp.status is not QpStatus.SOLVED and not warm:
            point = later(self.window, guess)
            if point is not None:
                iterate, model = self._begin(point)
                qp = self._program(point, model, ends)
        self._tell(0, iterate, None)
        for count in range(1, self.spec.max_iterations + 1):
            before = iterate
            if qp.status is QpStatus.SOLVED:
                iterate = self._step(iterate, model, qp)
            self._tell(count, iterate, qp)
            outcome = self._outcome(count, iterate, before, qp, warm)
            if outcome is not None:
                return iterate, outcome, count
            if count < self.spec.max_iterations:
                model = self.window.linearize(iterate.point)
                qp = self._program(iterate.point, model, qp.ends)
        return iterate, self._unfinished(iterate, Outcome.ITERATION_LIMIT), self.spec.max_iterations

    def _begin(self, point: Point) -> tuple[Iterate, Linearization]:
        """Return the iterate at a guess, and the model there."""
        model = self.window.linearize(point)
        return Iterate(point, model.at, self.window.violation(point, model.at)), model

    def _program(self, point: Point, model: Linearization, ends: np.ndarray) -> QpSolution:
        """Return the solution of the program at a point.

        Our own method counts in the curvature of end conditions at the given multipliers. Where it finds that program
        not convex, and with PIQP, which takes no other, the Gauss-Newton model stands alone. Where soft limits would be
        violated so far that the numbers break down, hard ones say whether there is a solution.
        """
        window = self.window
        if window.form.curved and len(ends) and isinstance(self.method, RiccatiQp):
            qp = self.method.solve(window, window.form.with_curvature(model, point, window.p, ends), point)
            if qp.status is QpStatus.SOLVED:
                return qp
        qp = self.method.solve(window, model, point)
        if qp.status is QpStatus.FAILED and window.bounds.soft:
            hard = replace(window, bounds=replace(window.bounds, soft=False))
            proof = self.method.solve(hard, model, point)
            return qp if proof.status is QpStatus.FAILED else proof
        return qp

    def _outcome(self, count: int, iterate: Iterate, before: Iterate, qp: QpSolution, warm: bool) -> Outcome | None:
        """Return how the solve has ended after an iteration; None where it goes on."""
        feasible = iterate.violation.worst <= FEASIBLE
        if qp.status is QpStatus.INFEASIBLE:
            return Outcome.INFEASIBLE
        if qp.status is QpStatus.FAILED:
            return self._unfinished(iterate, Outcome.FAILED)
        if iterate.step <= np.sqrt(self.spec.tolerance) and feasible:
            return Outcome.OPTIMAL
        if iterate.point is before.point:
            return self._unfinished(iterate, Outcome.FAILED)
        if count >= self.spec.iterations and (warm or iterate.step <= SMALL) and feasible:
            return Outcome.FEASIBLE
        if self.spec.deadline is not None and time.perf_counter() - self.began >= self.spec.deadline:
            return self._unfinished(iterate, Outcome.DEADLINE)
        return None

    def _tell(self, count: int, iterate: Iterate, qp: QpSolution | None) -> None:
        """Report an iteration: where it led, and the program whose step it took, if it has one."""
        if self.report is None:
            return
        if qp is None:
            self.report(HEADING)
        solved = qp is not None and qp.status is QpStatus.SOLVED
        step = f"{iterate.step:8.2e} {iterate.share:8.2e}" if solved else f"{'-':>8} {'-':>8}"
        program = f"{'-':>3}" if qp is None else f"{qp.iterations:3d}" + f"  {qp.status.value}" * (not solved)
        self.report(f"{count:4d} {iterate.at.objective:15.8e} {iterate.violation.worst:8.2e} {step} {program}")

    def _unfinished(self, iterate: Iterate, otherwise: Outcome) -> Outcome:
        """Return how an iterate that is not settled is to be taken."""
        stepped = iterate.qp is not None
        return Outcome.FEASIBLE if stepped and iterate.violation.worst <= FEASIBLE else otherwise

    def _step(self, iterate: Iterate, model: Linearization, qp: QpSolution) -> Iterate:
        """Return the iterate after the longest tried share of the step that counts; the point itself, if none does."""
        step = float(max(np.abs(qp.step.X).max(), np.abs(qp.step.tau).max(initial=0.0)))
        slope = float((model.gradient * qp.step.X).sum() + model.gradient_tau @ qp.step.tau)
        slope += self.window.change_of_penalty(iterate.point, qp.step)
        share = 1.0
        while share >= SHORTEST_STEP:
            point = iterate.point.moved(qp.step, share)
            at = self.window.residuals(point)
            found = Iterate(point, at, self.window.violation(point, at), step, share, qp)
            if _counts(found, iterate, share * slope, 2 * qp.largest):
                return found
            share /= 2
        return Iterate(iterate.point, iterate.at, iterate.violation, step, qp=qp)


def _counts(found: Iterate, before: Iterate, slope: float, penalty: float) -> bool:
    """Tell whether a step brings enough: worst violation, objective or merit.

    The merit function alone would cut the long steps of a cold start: it adds up the gaps that a longer stage leaves at
    each of its nodes, each of them a second-order term that the next iteration closes.

    Args:
        found: After the step.
        before: Before it.
        slope: Change of the objective that its gradient predicts for the step, penalties of soft limits included.
        penalty: Weight of the violation in the merit function, above every multiplier.
    """
    noise = NOISE * (1 + abs(before.at.objective))
    rise = found.at.objective - before.at.objective
    if found.violation.worst <= before.violation.worst / 2 and before.violation.worst > FEASIBLE:
        return True
    if found.violation.worst <= FEASIBLE and rise <= DECREASE * slope + noise:
        return True
    predicted = slope - penalty * found.share * before.violation.total
    return rise + penalty * (found.violation.total - before.violation.total) <= DECREASE * predicted + noise


def later(window: SqpWindow, point: Point) -> Point | None:
    """Return the motion of a guess with its last switch near the latest instant; None where that cannot move.

    A stage that is too short for its end condition has to last longer and to be faster at once. The product of the two
    is not in a linear program; from a late instant the second alone is enough.
    """
    form, bounds, last, horizon = window.form, window.bounds, len(point.tau) - 1, window.horizon
    if last < 0:
        return None
    longest, together = bounds.high[window.states :][[last, 2 * last + 1]]
    room = min(longest, together - point.tau[:last].sum()) - point.tau[last]
    if room <= 0:
        return None
    tau = point.tau.copy()
    tau[last] += LATER * room
    before, after = (np.r_[0.0, np.cumsum(each), horizon] for each in (point.tau, tau))
    motion = Plan(mesh(before, form.grid.nodes), point.X, form.inputs(point, horizon), before[1:-1])
    X = motion.states_at(mesh(after, form.grid.nodes))
    return Point(np.vstack([point.X[:1], X[1:]]), tau)
