"""Sequential quadratic programming with the Gauss-Newton Hessian: one iteration a sample on the shifted plan.

A window whose guess is warm is the last one, shifted: it gets the iterations the task asks for. Any
other guess is cold (an append, a drop, another shape) and is iterated until the step is small. Steps that bring nothing
are halved. The levels of HTMPC, where earlier costs are constraints and need their curvature, are left to fatrop.
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from psmpc_cli.ocp.end_curvature import EndCurvature
from psmpc_cli.ocp.gauss_newton import Linearization
from psmpc_cli.ocp.parameters import Parameters
from psmpc_cli.ocp.transcription import Nlp
from psmpc_cli.ocp.velocity_form import Point, Residuals, VelocityForm
from psmpc_cli.ocp.window import Bounds
from psmpc_cli.solvers import fatrop
from psmpc_cli.solvers.base import FEASIBLE, Guess, Outcome, Solution, Solver, StructuredNlp
from psmpc_cli.solvers.qp_multistage import MultistageQp
from psmpc_cli.solvers.qp_solution import QpSolution, QpStatus
from psmpc_cli.solvers.riccati.kernel import load_kernel
from psmpc_cli.solvers.riccati.program import RiccatiQp
from psmpc_cli.solvers.sqp_guess import later
from psmpc_cli.solvers.sqp_iterate import Iterate, counts
from psmpc_cli.solvers.sqp_limits import Limits, QpShape, Violation, limits, violation
from psmpc_cli.solvers.sqp_soft import beyond, change_of_violations, linearize_penalized, penalized
from psmpc_cli.specs.task import SolverSpec

SMALL = 1e-2
"""Step at which a cold start is iterated enough [m, rad, m/s, rad/s, s]: what is left after it is a tenth and less."""

SHARPER = 0.1
"""Our own method's tolerance in units of the solver's: its last iterations are cheap, and flat directions gain."""

SHORTEST_STEP = 1 / 32
"""The shortest share of a step that is tried."""


Watch = Callable[[int, Iterate, QpSolution | None], None]
"""Takes the number of an iteration, where it led, and its program; at the guess, number 0, there is none."""


def build(nlp: StructuredNlp, spec: SolverSpec) -> Solver:
    """Return the solver of a window; of anything else fatrop."""
    return SqpSolver(nlp, spec) if isinstance(nlp, Nlp) else fatrop.build(nlp, spec)


@dataclass(frozen=True, eq=False)
class _Problem:
    """One window: its numbers, its limits and the quadratic programs of its structure."""

    p: Parameters[np.ndarray]
    limits: Limits
    qp: MultistageQp | RiccatiQp


class SqpSolver:
    """The windows of one shape; `watch` is told of every iteration."""

    def __init__(self, nlp: Nlp, spec: SolverSpec, watch: Watch | None = None) -> None:
        self._nlp, self._spec, self._watch = nlp, spec, watch
        self._form = VelocityForm(nlp.model, nlp.shape, nlp.layout, spec.compiled)
        self._kernel = load_kernel(nlp.layout.n, nlp.layout.switches) if spec.compiled else None
        self._programs: dict[QpShape, MultistageQp | RiccatiQp] = {}
        self._curvature = EndCurvature(self._form)

    def watched(self, watch: Watch) -> "SqpSolver":
        """Return the same solver, which tells of its iterations."""
        return SqpSolver(self._nlp, self._spec, watch)

    def solve(self, guess: Guess, p: np.ndarray, bounds: Bounds) -> Solution:
        """Solve for the parameters p from the guess."""
        began = time.perf_counter()
        numbers = self._form.numbers(p)
        problem = self._problem(numbers, limits(self._nlp, bounds, float(numbers.horizon)))
        iterate, model = self._begin(problem, self._form.point(guess.z, numbers))
        ends = self._end_multipliers(guess)
        qp = self._program(problem, iterate, model, ends)
        if qp.status is not QpStatus.SOLVED and not guess.warm:
            point = later(self._form, problem.limits, iterate.point, float(numbers.horizon))
            if point is not None:
                iterate, model = self._begin(problem, point)
                qp = self._program(problem, iterate, model, ends)
        iterate, outcome, count = self._iterate(problem, iterate, model, qp, began, guess.warm)
        lam_x, lam_g = self._multipliers(iterate.qp)
        z = self._form.decision(iterate.point, numbers)
        z[self._nlp.layout.violation_index] = beyond(problem.limits, iterate.point)
        return Solution(
            outcome=outcome,
            z=z,
            lam_x=lam_x,
            lam_g=lam_g,
            objective=iterate.at.objective,
            iterations=count,
            wall_time=time.perf_counter() - began,
        )

    def _begin(self, problem: _Problem, point: Point) -> tuple[Iterate, Linearization]:
        """Return the iterate at a guess, and the model there."""
        model = linearize_penalized(self._form, problem.limits, point, problem.p)
        return Iterate(point, model.at, self._violation(problem, point, model.at)), model

    def _end_multipliers(self, guess: Guess) -> Mapping[int, np.ndarray]:
        """Return the multipliers of curved end conditions by stage, where the guess has any."""
        if guess.lam_g is None:
            return {}
        return {s: guess.lam_g[self._nlp.end_rows[s]] for s in self._curvature.stages}

    def _multipliers(self, qp: QpSolution | None) -> tuple[np.ndarray, np.ndarray]:
        """Return the multipliers that the next solve starts from: of end conditions, if some are curved, else none."""
        if qp is None or not self._curvature.stages:
            return np.zeros(0), np.zeros(0)
        lam_g = np.zeros(len(self._nlp.equality))
        for s in self._curvature.stages:
            lam_g[self._nlp.end_rows[s]] = qp.ends[s]
        return np.zeros(self._nlp.layout.size), lam_g

    def _program(
        self, problem: _Problem, iterate: Iterate, model: Linearization, ends: Mapping[int, np.ndarray]
    ) -> QpSolution:
        """Return the solution of the program at an iterate.

        Our own method counts in the curvature of end conditions at the given multipliers. Where it finds that program
        not convex, and with PIQP, which takes no other, the Gauss-Newton model stands alone. Where soft limits would be
        violated so far that the numbers break down, hard ones say whether there is a solution.
        """
        horizon = float(problem.p.horizon)
        if ends and isinstance(problem.qp, RiccatiQp):
            curved = self._curvature.added_to(model, iterate.point, problem.p, ends)
            qp = problem.qp.solve(curved, problem.limits, iterate.point, horizon)
            if qp.status is QpStatus.SOLVED:
                return qp
        qp = problem.qp.solve(model, problem.limits, iterate.point, horizon)
        if qp.status is QpStatus.FAILED and problem.limits.soft:
            hard = self._problem(problem.p, replace(problem.limits, soft=False))
            proof = hard.qp.solve(model, hard.limits, iterate.point, horizon)
            return qp if proof.status is QpStatus.FAILED else proof
        return qp

    def _problem(self, p: Parameters[np.ndarray], limits: Limits) -> _Problem:
        shape = limits.shape
        if shape not in self._programs:
            self._programs[shape] = self._quadratic_programs(shape)
        return _Problem(p, limits, self._programs[shape])

    def _quadratic_programs(self, shape: QpShape) -> MultistageQp | RiccatiQp:
        """Return our own method where it can be compiled, else PIQP."""
        tolerance = self._spec.tolerance
        if self._kernel is None:
            return MultistageQp(self._form, shape, tolerance)
        return RiccatiQp(self._form, shape, SHARPER * tolerance, self._kernel)

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
                model = linearize_penalized(self._form, problem.limits, iterate.point, problem.p)
                qp = self._program(problem, iterate, model, {s: qp.ends[s] for s in self._curvature.stages})
        return iterate, self._unfinished(iterate, Outcome.ITERATION_LIMIT), self._spec.max_iterations

    def _tell(self, count: int, iterate: Iterate, qp: QpSolution | None) -> None:
        if self._watch is not None:
            self._watch(count, iterate, qp)

    def _unfinished(self, iterate: Iterate, otherwise: Outcome) -> Outcome:
        """Return how an iterate that is not settled is to be taken."""
        stepped = iterate.qp is not None
        return Outcome.FEASIBLE if stepped and iterate.violation.worst <= FEASIBLE else otherwise

    def _step(self, problem: _Problem, iterate: Iterate, model: Linearization, qp: QpSolution) -> Iterate:
        """Return the iterate after the longest tried share of the step that counts; the point itself, if none does."""
        step = float(max(np.abs(qp.step.X).max(), np.abs(qp.step.tau).max(initial=0.0)))
        slope = float((model.gradient * qp.step.X).sum() + model.gradient_tau @ qp.step.tau)
        horizon = float(problem.p.horizon)
        slope += change_of_violations(self._form, problem.limits, iterate.point, qp.step, horizon)
        share = 1.0
        while share >= SHORTEST_STEP:
            point = iterate.point.moved(qp.step, share)
            at = self._form.residuals(point, problem.p)
            at = penalized(self._form, problem.limits, point, at, horizon)
            found = Iterate(point, at, self._violation(problem, point, at), step, share, qp)
            if counts(found, iterate, share * slope, 2 * qp.largest):
                return found
            share /= 2
        return Iterate(iterate.point, iterate.at, iterate.violation, step, qp=qp)

    def _violation(self, problem: _Problem, point: Point, at: Residuals) -> Violation:
        return violation(self._form, problem.limits, point, at, float(problem.p.horizon))
