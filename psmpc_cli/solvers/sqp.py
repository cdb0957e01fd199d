"""Sequential quadratic programming with the Gauss-Newton Hessian: one iteration a sample on the shifted plan.

A window whose guess is warm is the last one, shifted: it gets the iterations the task asks for. Any
other guess is cold (an append, a drop, another shape) and is iterated until the step is small. Steps that bring nothing
are halved.
"""

import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from psmpc_cli.ocp.gauss_newton import Linearization, Point, Residuals, VelocityForm
from psmpc_cli.ocp.plan import Plan, mesh
from psmpc_cli.ocp.problem import Problem
from psmpc_cli.ocp.window import PENALTY, Parameters, Window, plan_on_mesh, window_numbers, window_shape
from psmpc_cli.solvers.base import FEASIBLE, Outcome, Solution, Solver
from psmpc_cli.solvers.nlp import Report
from psmpc_cli.solvers.qp_multistage import MultistageQp
from psmpc_cli.solvers.riccati import RiccatiQp, load_kernel
from psmpc_cli.solvers.sqp_window import (
    QpShape,
    QpSolution,
    QpStatus,
    Violation,
    WindowBounds,
    beyond,
    change_of_violations,
    fixed_limits,
    linearize_penalized,
    penalized,
    violation,
    window_limits,
)
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

Qp = MultistageQp | RiccatiQp


@dataclass(frozen=True, eq=False)
class Iterate:
    """A point, its residuals, and the step that led to it.

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


@dataclass(frozen=True, eq=False)
class _Setup:
    """What the windows over the same stages and nodes share: form, bounds, programs by soft and fixed durations."""

    form: VelocityForm
    limits: WindowBounds
    programs: dict[QpShape, Qp] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class _Problem:
    """One window: its numbers, its limits and the quadratic programs of its structure."""

    setup: _Setup
    p: Parameters[np.ndarray]
    limits: WindowBounds
    qp: Qp

    @property
    def form(self) -> VelocityForm:
        return self.setup.form

    @property
    def horizon(self) -> float:
        return float(self.p.horizon)


class SqpSolver(Solver):
    """Windows by sequential quadratic programming.

    Args:
        problem: The problem.
        spec: Settings.
        report: Takes the lines of the table of iterations.
    """

    def __init__(self, problem: Problem, spec: SolverSpec, report: Report | None = None) -> None:
        self._model, self._spec, self._report = problem.model, spec, report
        self._setups: dict[tuple[object, ...], _Setup] = {}

    def _setup(self, window: Window) -> _Setup:
        key = (window.stages, window.nodes, window.discretization, window.soft)
        if key not in self._setups:
            shape = window_shape(window)
            form = VelocityForm(self._model, shape, self._spec.compiled)
            self._setups[key] = _Setup(form, fixed_limits(form, window))
        return self._setups[key]

    def _solve(self, window: Window, guess: Plan, previous: Solution | None, within: float) -> Solution:
        began = time.perf_counter()
        setup, tau = self._setup(window), np.diff(guess.instants, prepend=window.start)
        limits = window_limits(setup.limits, window, tau, within)
        problem = self._problem(setup, window_numbers(window, guess.instants), limits)
        iterate, model = self._begin(problem, Point(guess.X, tau))
        ends = _end_multipliers(setup, previous)
        qp = self._program(problem, iterate, model, ends)
        if qp.status is not QpStatus.SOLVED and previous is None:
            point = later(setup.form, limits, iterate.point, problem.horizon)
            if point is not None:
                iterate, model = self._begin(problem, point)
                qp = self._program(problem, iterate, model, ends)
        iterate, outcome, count = self._iterate(problem, iterate, model, qp, began, previous is not None)
        point = iterate.point
        return Solution(
            outcome=outcome,
            plan=plan_on_mesh(window, point.X, setup.form.inputs(point, window.horizon), point.tau),
            objective=iterate.at.objective,
            iterations=count,
            wall_time=time.perf_counter() - began,
            window=window,
            guess=guess,
            warm=previous is not None,
            costs=iterate.at.costs,
            terminal=iterate.at.terminal,
            violations=beyond(limits, point)[1:].max(axis=0) / PENALTY,
            duals=_duals(setup, iterate.qp),
            guess_duals=np.concatenate([np.zeros(0), *ends.values()]),
        )

    def _begin(self, problem: _Problem, point: Point) -> tuple[Iterate, Linearization]:
        """Return the iterate at a guess, and the model there."""
        model = linearize_penalized(problem.form, problem.limits, point, problem.p)
        return Iterate(point, model.at, self._violation(problem, point, model.at)), model

    def _program(
        self, problem: _Problem, iterate: Iterate, model: Linearization, ends: Mapping[int, np.ndarray]
    ) -> QpSolution:
        """Return the solution of the program at an iterate.

        Our own method counts in the curvature of end conditions at the given multipliers. Where it finds that program
        not convex, and with PIQP, which takes no other, the Gauss-Newton model stands alone. Where soft limits would be
        violated so far that the numbers break down, hard ones say whether there is a solution.
        """
        horizon = problem.horizon
        if ends and isinstance(problem.qp, RiccatiQp):
            curved = problem.form.curved(model, iterate.point, problem.p, ends)
            qp = problem.qp.solve(curved, problem.limits, iterate.point, horizon)
            if qp.status is QpStatus.SOLVED:
                return qp
        qp = problem.qp.solve(model, problem.limits, iterate.point, horizon)
        if qp.status is QpStatus.FAILED and problem.limits.soft:
            hard = self._problem(problem.setup, problem.p, replace(problem.limits, soft=False))
            proof = hard.qp.solve(model, hard.limits, iterate.point, horizon)
            return qp if proof.status is QpStatus.FAILED else proof
        return qp

    def _problem(self, setup: _Setup, p: Parameters[np.ndarray], limits: WindowBounds) -> _Problem:
        if limits.shape not in setup.programs:
            setup.programs[limits.shape] = self._quadratic_programs(setup.form, limits.shape)
        return _Problem(setup, p, limits, setup.programs[limits.shape])

    def _quadratic_programs(self, form: VelocityForm, shape: QpShape) -> Qp:
        """Return our own method where it can be compiled, else PIQP."""
        kernel = load_kernel(form.grid.n, form.grid.switches) if self._spec.compiled else None
        if kernel is None:
            return MultistageQp(form, shape, self._spec.tolerance)
        return RiccatiQp(form, shape, SHARPER * self._spec.tolerance, kernel)

    def _iterate(
        self,
        problem: _Problem,
        iterate: Iterate,
        model: Linearization,
        qp: QpSolution,
        began: float,
        warm: bool,
    ) -> tuple[Iterate, Outcome, int]:
        """Return the last iterate, how it is to be taken, and the number of iterations."""
        self._tell(0, iterate, None)
        for count in range(1, self._spec.max_iterations + 1):
            before = iterate
            if qp.status is QpStatus.SOLVED:
                iterate = self._step(problem, iterate, model, qp)
            self._tell(count, iterate, qp)
            if qp.status is QpStatus.INFEASIBLE:
                return iterate, Outcome.INFEASIBLE, count
            if qp.status is QpStatus.FAILED:
                return iterate, self._unfinished(iterate, Outcome.FAILED), count
            if iterate.step <= np.sqrt(self._spec.tolerance) and iterate.violation.worst <= FEASIBLE:
                return iterate, Outcome.OPTIMAL, count
            if iterate.point is before.point:
                return iterate, self._unfinished(iterate, Outcome.FAILED), count
            enough = count >= self._spec.iterations and (warm or iterate.step <= SMALL)
            if enough and iterate.violation.worst <= FEASIBLE:
                return iterate, Outcome.FEASIBLE, count
            if self._spec.deadline is not None and time.perf_counter() - began >= self._spec.deadline:
                return iterate, self._unfinished(iterate, Outcome.DEADLINE), count
            if count < self._spec.max_iterations:
                model = linearize_penalized(problem.form, problem.limits, iterate.point, problem.p)
                ends = {s: qp.ends[s] for s in problem.form.curved_stages}
                qp = self._program(problem, iterate, model, ends)
        return iterate, self._unfinished(iterate, Outcome.ITERATION_LIMIT), self._spec.max_iterations

    def _tell(self, count: int, iterate: Iterate, qp: QpSolution | None) -> None:
        """Report an iteration: where it led, and the program whose step it took, if it has one."""
        if self._report is None:
            return
        if qp is None:
            self._report(HEADING)
        line = f"{count:4d} {iterate.at.objective:15.8e} {iterate.violation.worst:8.2e}"
        if qp is None:
            line += f" {'-':>8} {'-':>8} {'-':>3}"
        elif qp.status is QpStatus.SOLVED:
            line += f" {iterate.step:8.2e} {iterate.share:8.2e} {qp.iterations:3d}"
        else:
            line += f" {'-':>8} {'-':>8} {qp.iterations:3d}  {qp.status.value}"
        self._report(line)

    def _unfinished(self, iterate: Iterate, otherwise: Outcome) -> Outcome:
        """Return how an iterate that is not settled is to be taken."""
        stepped = iterate.qp is not None
        return Outcome.FEASIBLE if stepped and iterate.violation.worst <= FEASIBLE else otherwise

    def _step(self, problem: _Problem, iterate: Iterate, model: Linearization, qp: QpSolution) -> Iterate:
        """Return the iterate after the longest tried share of the step that counts; the point itself, if none does."""
        step = float(max(np.abs(qp.step.X).max(), np.abs(qp.step.tau).max(initial=0.0)))
        slope = float((model.gradient * qp.step.X).sum() + model.gradient_tau @ qp.step.tau)
        horizon, form = problem.horizon, problem.form
        slope += change_of_violations(form, problem.limits, iterate.point, qp.step, horizon)
        share = 1.0
        while share >= SHORTEST_STEP:
            point = iterate.point.moved(qp.step, share)
            at = penalized(form, problem.limits, point, form.residuals(point, problem.p), horizon)
            found = Iterate(point, at, self._violation(problem, point, at), step, share, qp)
            if _counts(found, iterate, share * slope, 2 * qp.largest):
                return found
            share /= 2
        return Iterate(iterate.point, iterate.at, iterate.violation, step, qp=qp)

    def _violation(self, problem: _Problem, point: Point, at: Residuals) -> Violation:
        return violation(problem.form, problem.limits, point, at, problem.horizon)


def _end_multipliers(setup: _Setup, previous: Solution | None) -> Mapping[int, np.ndarray]:
    """Return the multipliers of curved end conditions by stage, where the solve before has left any."""
    sizes = [setup.form.stages[s].end_rows for s in setup.form.curved_stages]
    if previous is None or not sizes or len(previous.duals) != sum(sizes):
        return {}
    return dict(zip(setup.form.curved_stages, np.split(previous.duals, np.cumsum(sizes)[:-1]), strict=True))


def _duals(setup: _Setup, qp: QpSolution | None) -> np.ndarray:
    """Return the multipliers that the next solve starts from: those of curved end conditions, stage by stage."""
    return np.concatenate([np.zeros(0), *(qp.ends[s] for s in setup.form.curved_stages if qp is not None)])


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


def later(form: VelocityForm, limits: WindowBounds, point: Point, horizon: float) -> Point | None:
    """Return the motion of a guess with its last switch near the latest instant; None where that cannot move.

    A stage that is too short for its end condition has to last longer and to be faster at once. The product of the two
    is not in a linear program; from a late instant the second alone is enough.
    """
    last = len(point.tau) - 1
    if last < 0 or {last, last - 1, last + 1} & {*limits.shape.fixed, *limits.shape.tied}:
        return None
    room = min(limits.tau_high[last], limits.together - point.tau[:last].sum()) - point.tau[last]
    if room <= 0:
        return None
    tau = point.tau.copy()
    tau[last] += LATER * room
    times = mesh(form.durations(point, horizon), form.grid.nodes)
    motion = Plan(times, point.X, form.inputs(point, horizon), np.cumsum(point.tau))
    longer = Point(point.X, tau)
    X = motion.states_at(mesh(form.durations(longer, horizon), form.grid.nodes))
    return Point(np.vstack([point.X[:1], X[1:]]), tau)
