"""One window of a run, taken from its log and solved again: instant fixed, from other guesses, on other meshes."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from psmpc_cli.errors import LogError
from psmpc_cli.logs.run import Run
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.ocp.window import SHORTEST, Window, normalization
from psmpc_cli.simulation.replay import logged_solve
from psmpc_cli.simulation.setup import Experiment, build_experiment, converging
from psmpc_cli.solvers import build_solver

Vector = np.ndarray

LATE_IN_HORIZON = 0.3
"""Where in the horizon the optimized instant of the window that is looked at lies."""

CLOSE = 0.005
"""How well the earliest feasible instant is found [s]."""


@dataclass(frozen=True, eq=False)
class OneWindow:
    """A window with a switch in it, and the plan the run made of it.

    Attributes:
        label: Priorities of its stages, the first one's as 1, such as 1 : 100.
        experiment: The run's experiment, built anew.
        window: The window.
        plan: Its optimum.
    """

    label: str
    experiment: Experiment
    window: Window
    plan: Plan


@dataclass(frozen=True, eq=False)
class Scan:
    """J over the window's largest priority, as printed (delta = 0), with the instant fixed and all else optimized.

    Attributes:
        instants: Instants after T0 that can be met (G,) [s], rising from the earliest.
        cost: J at each.
    """

    instants: Vector
    cost: Vector

    def with_pending(self, delta: float) -> Vector:
        """Return J with a pending cost (G,): with the instant fixed it is a constant."""
        return np.asarray(self.cost + delta * self.instants)


def pick_window(log: Run) -> OneWindow:
    """Return the window of a log's first switch whose optimized instant lies `LATE_IN_HORIZON`.

    Raises:
        LogError: The log has no plans, or no window with one switch.
    """
    experiment = build_experiment(converging(log.task))
    count, first = log["window/count"], log["window/first"]
    with_one = np.flatnonzero(count == 2)
    if not len(with_one):
        raise LogError(f"{log.path}: found no window with one switch, expected a run of several stages")
    with_one = with_one[first[with_one] == first[with_one[0]]]
    ahead = log["window/instants"][with_one, first[with_one[0]]] - log.time[with_one]
    sample = int(with_one[np.argmin(np.abs(ahead - LATE_IN_HORIZON * experiment.task.controller.horizon))])
    return window_at(log, experiment, sample)


def window_at(log: Run, experiment: Experiment, sample: int) -> OneWindow:
    """Return the window of a sample from what its solve was given, and its plan.

    Raises:
        LogError: The log has no plans, or what it holds is not of this window.
    """
    solve = logged_solve(log, experiment.problem, sample)
    return OneWindow(_ratio(solve.window.omega), experiment, solve.window, solve.plan)


def _ratio(omega: Vector) -> str:
    return " : ".join(f"{part:.3g}" for part in omega / omega[0])


def with_priorities(one: OneWindow, priorities: tuple[float, float]) -> OneWindow:
    """Return the window with other priorities, in the state to which its own have led.

    It is normalized from the optimum they have with the old normalization, as at the sample after they were changed.
    """
    experiment, window = one.experiment, replace(one.window, omega=np.array(priorities))
    controller, solver = experiment.task.controller, experiment.controller.solver
    plan = solver.solve(window, one.plan).plan
    begins = np.r_[window.start - window.elapsed, plan.instants]
    kind, zeta, step = controller.normalization, controller.zeta, controller.sample_time
    offset, scale = normalization(kind, zeta, window.stages, begins, experiment.costs, plan, step)
    window = replace(window, offset=offset, scale=scale)
    optimum = solver.solve(window, plan).plan
    return OneWindow(f"{_ratio(window.omega)} from {one.label}", experiment, window, optimum)


def scan_instants(one: OneWindow, grid: Vector) -> Scan:
    """Return J over the instant, on a grid (G,) [s] after T0 down to the earliest feasible one."""
    window = replace(one.window, pending_cost=0.0)
    plan, scanned, tried = one.plan, {}, sorted(map(float, grid), reverse=True)
    infeasible = 0.0
    for instant in tried:
        solved = _solve_fixed(one, window, instant, plan)
        if solved is None:
            infeasible = instant
            break
        scanned[instant], plan = solved
    while scanned and min(scanned) - infeasible > CLOSE:
        instant = (min(scanned) + infeasible) / 2
        solved = _solve_fixed(one, window, instant, plan)
        if solved is None:
            infeasible = instant
        else:
            scanned[instant], plan = solved
    instants = np.array(sorted(scanned))
    return Scan(instants, np.array([scanned[instant] for instant in instants]))


def _solve_fixed(one: OneWindow, window: Window, instant: float, plan: Plan) -> tuple[float, Plan] | None:
    """Return cost and plan with the instant [s] after T0 fixed; None if there is no solution from either guess."""
    at = np.array([window.start + instant])
    for guess in (plan, one.plan):
        solved = one.experiment.controller.solver.solve(window, replace(guess, instants=at), within=0.0)
        if solved.outcome.usable:
            return solved.objective, solved.plan
    return None


def optimize_instants(one: OneWindow, pending_cost: float, guesses: Iterable[float]) -> Vector:
    """Return the instants after T0 (len(guesses),) [s] that the solver returns from guesses [s]; NaN if it fails."""
    window = replace(one.window, pending_cost=pending_cost)
    found = []
    for guess in guesses:
        started = replace(one.plan, instants=np.array([window.start + guess]))
        solved = one.experiment.controller.solver.solve(window, started)
        found.append(float(solved.plan.instants[0]) - window.start if solved.outcome.usable else np.nan)
    return np.array(found)


def on_mesh(one: OneWindow, nodes: int, discretization: str) -> tuple[float, float]:
    """Return how far the prediction of a plan on another mesh is from where its control leads.

    First the largest difference of a coordinate at a node [m, rad], then the largest error at the switch over the
    tolerance of the end condition [1]; both NaN if there is no solution.
    """
    costs = one.experiment.costs
    window = replace(one.window, nodes=(nodes,) * len(one.window.stages), discretization=discretization)
    solved = build_solver(one.experiment.problem).solve(window, one.plan)
    if not solved.outcome.usable:
        return np.nan, np.nan
    real, stage = led_to(solved.plan), one.window.stages[0]
    n = one.experiment.model.n
    missed = np.abs(costs.errors(stage, real[nodes : nodes + 1])[0, list(stage.end_rows)]) / stage.tolerance
    return float(np.abs(solved.plan.X[:, :n] - real[:, :n]).max()), float(np.max(missed, initial=0.0))


def led_to(plan: Plan) -> Vector:
    """Return the states at the nodes (K + 1, 2n) to which the plan's control leads from its first one."""
    n, dt = plan.u.shape[1], np.diff(plan.times)[:, None]
    nothing = np.zeros((1, n))
    Qdot = plan.X[0, n:] + np.vstack([nothing, np.cumsum(dt * plan.u, axis=0)])
    Q = plan.X[0, :n] + np.vstack([nothing, np.cumsum(dt * Qdot[:-1] + dt**2 / 2 * plan.u, axis=0)])
    return np.hstack([Q, Qdot])


def instant_grid(horizon: float, points: int) -> Vector:
    """Return instants after T0 [s], evenly through the horizon and ever denser towards its end."""
    near = horizon - SHORTEST * 4.0 ** np.arange(4)
    return np.union1d(np.linspace(0.0, horizon, points + 2)[1:-1], near)
