"""One window with one switch, solved for one trade-off between its two stage costs after another."""

from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca
import numpy as np

from psmpc_cli.ocp.plan import Plan
from psmpc_cli.ocp.window import Bounds, Window, bounds, pack_guess, parameter_vector, unpack_plan
from psmpc_cli.solvers import Guess, Outcome, Solution, Solver, build_solver
from psmpc_cli.studies.one_window import OneWindow, held

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
        multipliers: Those of the variables and of the rows, where J_2 was bounded.
    """

    J: Vector
    wait: float
    objective: float
    ratio: float
    outcome: Outcome
    plan: Plan
    multipliers: tuple[Vector, Vector] | None = None


@dataclass(frozen=True, eq=False)
class _Bounded:
    """The window's NLP with a cost as last row, its parameters standing twice: for the objective and for the row."""

    problem: dict[str, ca.SX]
    nx: tuple[int, ...] = ()
    nu: tuple[int, ...] = ()
    ng: tuple[int, ...] = ()


class TradeOff:
    """Solves scalarizations of one window.

    J_s is what stage s adds to the objective at priority 1: its normalized cost integral, and of the last stage the
    terminal cost where the task has one. Paper eqs. (12), (29).
    """

    def __init__(self, one: OneWindow) -> None:
        self.one = one
        self._windows = one.experiment.controller.windows
        self._nlp, self._solver = self._windows.compiled_for(one.window)
        self._objective = ca.Function("J", [self._nlp.x, self._nlp.p], [self._nlp.f])

    @cached_property
    def _bounded(self) -> Solver:
        """IPOPT, whatever the task says: a row that reaches over all nodes breaks the structure others live on."""
        nlp, again = self._nlp, ca.SX.sym("p_again", self._nlp.p.shape)
        row = self._objective(nlp.x, again)
        problem = {"x": nlp.x, "p": ca.vertcat(nlp.p, again), "f": nlp.f, "g": ca.vertcat(nlp.g, row)}
        return build_solver(_Bounded(problem), self._windows.task.solver.model_copy(update={"kind": "ipopt"}))

    def solve(self, scalarization: Scalarization, near: Point | Plan, wait: float | None) -> Point:
        """Return the optimum, started from a plan or another point, with the instant so long after T0 [s], or free."""
        one, nlp = self.one, self._nlp
        guess, multipliers = (near.plan, near.multipliers) if isinstance(near, Point) else (near, None)
        window = replace(one.window, omega=np.array(scalarization.weights))
        at = guess.instants if wait is None else np.array([window.start + wait])
        free, p = bounds(nlp, window), parameter_vector(nlp, window, at)
        limits = free if wait is None else held(nlp, free, wait)
        z = pack_guess(nlp, window, guess, at, one.experiment.costs)
        if np.isinf(scalarization.bound):
            solution = self._solver.solve(Guess(z), p, limits)
            return self._point(solution, scalarization.weights[1] / scalarization.weights[0], guess, at)
        lbg, ubg = np.append(limits.lbg, -np.inf), np.append(limits.ubg, scalarization.bound)
        start = Guess(z, *multipliers) if multipliers else Guess(z)
        both = np.concatenate([p, self._second_alone(at)])
        solution = self._bounded.solve(start, both, Bounds(limits.lbx, limits.ubx, lbg, ubg))
        point = self._point(solution, float(solution.lam_g[-1]), guess, at)
        return replace(point, multipliers=(solution.lam_x, solution.lam_g)) if solution.outcome.usable else point

    def _point(self, solution: Solution, ratio: float, guess: Plan, at: Vector) -> Point:
        """Return what a solve has come to; without a solution nothing but its outcome, and the guess."""
        window, outcome = self.one.window, solution.outcome
        if not outcome.usable:
            return Point(np.full(2, np.nan), np.nan, np.nan, np.nan, outcome, guess)
        plan = unpack_plan(self._nlp, window, solution.z)
        wait = float(plan.instants[0]) - window.start
        return Point(self._costs(solution.z, at), wait, solution.objective, ratio, outcome, plan)

    def costs_of(self, plan: Plan) -> Vector:
        """Return J_1 and J_2 (2,) of a plan."""
        one = self.one
        return self._costs(pack_guess(self._nlp, one.window, plan, plan.instants, one.experiment.costs), plan.instants)

    def value(self, scalarization: Scalarization, point: Point) -> float:
        """Return what a scalarization makes of a point, whatever that was found for; infinite where it is not allowed.

        All points of a window share one feasible set, so each is a candidate for every scalarization.
        """
        allowed = point.J[1] <= scalarization.bound * (1 + SLACK)
        value = float(np.dot(scalarization.weights, point.J)) + self.one.window.pending_cost * point.wait
        return value if allowed and np.isfinite(value) else np.inf

    def _costs(self, z: Vector, at: Vector) -> Vector:
        first, second = self._alone((1.0, 0.0), at), self._second_alone(at)
        return np.array([float(self._objective(z, p)) for p in (first, second)])

    def _second_alone(self, at: Vector) -> Vector:
        return self._alone((0.0, 1.0), at)

    def _alone(self, weights: tuple[float, float], at: Vector) -> Vector:
        """Return the parameters with which the objective is one stage's cost."""
        window: Window = replace(self.one.window, omega=np.array(weights), pending_cost=0.0)
        return parameter_vector(self._nlp, window, at)
