"""One window with one switch, solved for one trade-off between its two stage costs after another."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from psmpc_cli.ocp.plan import Plan
from psmpc_cli.solvers import NlpSolver, Outcome, Solution
from psmpc_cli.studies.one_window import OneWindow

Vector = np.ndarray

SLACK = 1e-7
"""By how much a point may exceed a bound on J_2 and still stand for it, as a part of the bound."""


@dataclass(frozen=True)
class Scalarization:
    """What makes one problem of two costs: min w_1 J_1 + w_2 J_2 subject to J_2 <= bound.

    Attributes:
        weights: w_1 and w_2, the larger one 1.
        bound: The largest J_2; infinite for a weighted sum.
    """

    weights: tuple[float, float]
    bound: float = np.inf


def weighted_sum(ratio: float) -> Scalarization:
    """Return the weighted sum with this omega_2 / omega_1."""
    return Scalarization((min(1.0, 1.0 / ratio), min(1.0, ratio)))


def constrained(bound: float) -> Scalarization:
    """Return the epsilon-constraint problem: J_1 alone, with J_2 bounded."""
    return Scalarization((1.0, 0.0), bound)


@dataclass(frozen=True, eq=False)
class Point:
    """The optimum of a scalarization.

    Attributes:
        J: J_1 and J_2, normalized as in the window (2,); NaN if there is none.
        wait: t_s - T0 [s].
        objective: What was minimized, the pending cost included.
        ratio: omega_2 / omega_1 of the weighted sum with the same optimum, -dJ_1/dJ_2 of the front there.
        outcome: How the solve ended.
        plan: The plan.
        solution: The solve, where J_2 was bounded: its multipliers can start the next one.
    """

    J: Vector
    wait: float
    objective: float
    ratio: float
    outcome: Outcome
    plan: Plan
    solution: Solution | None = None


class TradeOff:
    """Solves scalarizations of one window.

    J_s is what stage s adds to the objective at priority 1: its normalized cost integral, and of the last stage the
    terminal cost where the task has one. Paper eqs. (12), (29).
    """

    def __init__(self, one: OneWindow) -> None:
        self.one = one
        problem = one.experiment.problem
        self._solver = NlpSolver(problem, problem.spec.solver)

    @cached_property
    def _bounded(self) -> NlpSolver:
        """IPOPT, whatever the task says: a row that reaches over all nodes breaks the structure others live on."""
        problem = self.one.experiment.problem
        return NlpSolver(problem, problem.spec.solver.model_copy(update={"kind": "ipopt"}))

    def solve(self, scalarization: Scalarization, near: Point | Plan, wait: float | None) -> Point:
        """Return the optimum, started from a plan or another point, with the instant so long after T0 [s], or free."""
        window = replace(self.one.window, omega=np.array(scalarization.weights), cost_bound=scalarization.bound)
        plan, before = (near.plan, near.solution) if isinstance(near, Point) else (near, None)
        guess, within = plan, np.inf
        if wait is not None:
            guess, within = replace(plan, instants=np.array([window.start + wait])), 0.0
        if np.isinf(scalarization.bound):
            solution = self._solver.solve(window, guess, within=within)
            return self._point(solution, scalarization.weights[1] / scalarization.weights[0], plan)
        solution = self._bounded.solve(window, guess, before, within)
        point = self._point(solution, solution.bound_multiplier, plan)
        return replace(point, solution=solution) if solution.outcome.usable else point

    def _point(self, solution: Solution, ratio: float, guess: Plan) -> Point:
        """Return what a solve has come to; without a solution nothing but its outcome, and the guess."""
        window, plan, outcome = self.one.window, solution.plan, solution.outcome
        if not outcome.usable:
            return Point(np.full(2, np.nan), np.nan, np.nan, np.nan, outcome, guess)
        J = solution.costs + np.array([0.0, solution.terminal])
        return Point(J, float(plan.instants[0]) - window.start, solution.objective, ratio, outcome, plan)

    def costs_of(self, plan: Plan) -> Vector:
        """Return J_1 and J_2 (2,) of a plan."""
        return self._solver.costs(self.one.window, plan)

    def value(self, scalarization: Scalarization, point: Point) -> float:
        """Return what a scalarization makes of a point, whatever that was found for; infinite where it is not allowed.

        All points of a window share one feasible set, so each is a candidate for every scalarization.
        """
        allowed = point.J[1] <= scalarization.bound * (1 + SLACK)
        value = float(np.dot(scalarization.weights, point.J)) + self.one.window.pending_cost * point.wait
        return value if allowed and np.isfinite(value) else np.inf
