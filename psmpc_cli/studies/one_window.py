"""One window of a run, taken from its log and solved again: instant fixed, from other guesses, on other meshes."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from psmpc_cli.control.window_solver import WindowSolver
from psmpc_cli.errors import LogError
from psmpc_cli.experiment.setup import Experiment, build_experiment
from psmpc_cli.experiment.summary import task_of
from psmpc_cli.logs.read import Log, read_plan
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.ocp.window import SHORTEST, Bounds, Window, bounds, pack_guess, parameter_vector, unpack_plan
from psmpc_cli.solvers import Guess

Vector = np.ndarray

LATE_IN_HORIZON = 0.3
"""Where in the horizon the optimized instant of the window that is looked at lies."""

CLOSE = 0.005
"""How well the earliest feasible instant is found [s]."""


@dataclass(frozen=True, eq=False)
class OneWindow:
    """A window with one switch in it, and the plan the run made of it.

    Attributes:
        experiment: The run's experiment, built anew.
        window: The window.
        plan: Its optimum.
    """

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


def pick_window(log: Log) -> OneWindow:
    """Return the window of a log's first switch whose optimized instant lies `LATE_IN_HORIZON`.

    Raises:
        LogError: The log has no plans, or no window with one switch.
    """
    experiment = build_experiment(task_of(log))
    count, first = log["window/count"], log["window/first"]
    with_one = np.flatnonzero(count == 2)
    if not len(with_one):
        raise LogError(f"{log.path}: found no window with one switch, expected a run of several stages")
    with_one = with_one[first[with_one] == first[with_one[0]]]
    ahead = log["window/instants"][with_one, first[with_one[0]]] - log.time[with_one]
    sample = int(with_one[np.argmin(np.abs(ahead - LATE_IN_HORIZON * experiment.task.controller.horizon))])
    return _window_at(log, experiment, sample)


def _window_at(log: Log, experiment: Experiment, sample: int) -> OneWindow:
    """Return the window of a sample from what its solve was given."""
    n, first = experiment.model.n, int(log["window/first"][sample])
    head = read_plan(log.path, "parameters", sample)[: 2 * n + 9]
    x0, (horizon, pending, terminal), omega, offset, scale = np.split(head, [2 * n, 2 * n + 3, 2 * n + 5, 2 * n + 7])
    start, entered = float(log.time[sample]), float(log.stages["switch_time"][first - 1]) if first else 0.0
    window = Window(
        stages=experiment.stages[first : first + 2],
        start=start,
        elapsed=start - entered,
        x0=x0,
        omega=omega,
        offset=offset,
        scale=scale,
        horizon=float(horizon),
        pending_cost=float(pending),
        terminal_cost=float(terminal),
    )
    windows = experiment.controller.windows
    nlp, _ = windows.compiled(windows.shape(window))
    return OneWindow(experiment, window, unpack_plan(nlp, window, read_plan(log.path, "solution", sample)))


def scan_instants(one: OneWindow, priorities: tuple[float, float], grid: Vector) -> Scan:
    """Return J over the instant for other priorities, on a grid (G,) [s] after T0 down to the earliest feasible one."""
    window = replace(one.window, omega=np.array(priorities), pending_cost=0.0)
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
    windows = one.experiment.controller.windows
    nlp, solver = windows.compiled(windows.shape(window))
    at, free, row = np.array([window.start + instant]), bounds(nlp, window), nlp.layout.duration_index[0]
    lbx, ubx = free.lbx.copy(), free.ubx.copy()
    lbx[row] = ubx[row] = instant
    for guess in (plan, one.plan):
        z = pack_guess(nlp, window, guess, at, one.experiment.costs)
        fixed = Bounds(lbx, ubx, free.lbg, free.ubg)
        solution = solver.solve(Guess(z), parameter_vector(nlp, window, at), fixed)
        if solution.outcome.usable:
            return solution.objective, unpack_plan(nlp, window, solution.z)
    return None


def optimize_instants(
    one: OneWindow, priorities: tuple[float, float], pending_cost: float, guesses: Sequence[float]
) -> Vector:
    """Return the instants after T0 (len(guesses),) [s] that the solver returns from guesses [s]; NaN if it fails."""
    window = replace(one.window, omega=np.array(priorities), pending_cost=pending_cost)
    found = []
    for guess in guesses:
        solved = one.experiment.controller.windows.solve(window, one.plan, np.array([window.start + guess]))
        usable = solved.solution.outcome.usable
        found.append(float(solved.plan.instants[0]) - window.start if usable else np.nan)
    return np.array(found)


def on_mesh(one: OneWindow, nodes: int, discretization: str) -> tuple[float, float]:
    """Return the optimized instant after T0 [s] on another mesh, and how far its prediction is from what happens.

    The latter is the largest difference of a coordinate at a node from where the plan's control leads [m, rad]. Both
    are NaN if there is no solution.
    """
    task = one.experiment.task
    controller = task.controller.model_copy(update={"nodes": nodes, "discretization": discretization})
    task = task.model_copy(update={"controller": controller})
    windows = WindowSolver(task, one.experiment.model, one.experiment.costs)
    solved = windows.solve(one.window, one.plan, one.plan.instants)
    if not solved.solution.outcome.usable:
        return np.nan, np.nan
    return float(solved.plan.instants[0]) - one.window.start, prediction_error(solved.plan)


def prediction_error(plan: Plan) -> float:
    """Return the largest difference of a plan's coordinates from where its control leads [m, rad]."""
    n, dt = plan.u.shape[1], np.diff(plan.times)[:, None]
    Q, Qdot = plan.X[0, :n], plan.X[0, n:]
    rates = Qdot + np.vstack([np.zeros(n), np.cumsum(dt * plan.u, axis=0)])
    happens = Q + np.cumsum(dt * rates[:-1] + dt**2 / 2 * plan.u, axis=0)
    return float(np.abs(plan.X[1:, :n] - happens).max())


def instant_grid(horizon: float, points: int) -> Vector:
    """Return instants after T0 [s], evenly through the horizon and ever denser towards its end."""
    near = horizon - SHORTEST * 4.0 ** np.arange(4)
    return np.union1d(np.linspace(0.0, horizon, points + 2)[1:-1], near)
