"""Multistart: a window solved from several guesses of its switch times, since one solve may end in the lesser basin.

See docs/formulation.md, section 6.
"""

from dataclasses import replace
from itertools import combinations_with_replacement
from math import comb

import numpy as np

from psmpc_cli.ocp.end import SHORTEST
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.ocp.window import Window, shortest_durations
from psmpc_cli.solvers import Outcome, Solution, Solver
from psmpc_cli.specs.controller import ControllerSpec

BETTER = 1e-4
"""By what part of its J the last plan's own basin must be beaten: two solves of one basin differ by up to 2e-5."""

EARLIEST_PENDING_COST = 2.0
"""Pending cost on top of the window's own that makes the earliest switch times the optimum."""

IN_SWEEPS = 3
"""Guesses a window is solved from in a sweep whose pending cost allows of several basins."""


def multistart_for(controller: ControllerSpec) -> int:
    """Return from how many guesses a sweep solves each window: what the task says, else 3 with delta < 1, else 1.

    With delta = 1 no instant was found that is better than the one a single solve returns.
    """
    if controller.multistart is not None:
        return controller.multistart
    return IN_SWEEPS if controller.pending_cost < 1 else 1


def solve_from_several(solver: Solver, window: Window, guess: Plan, previous: Solution | None, starts: int) -> Solution:
    """Return the best solve of a window from so many guesses of its switch times: those of a plan, then others.

    The others are spread from the earliest switch times that can be met to the latest, each solved with the durations
    kept near the guess: set free, an interior-point method leaves an early basin, uphill, for the end of the horizon.
    The prediction's original basin is solved again if the free solve left it, and is given up only for one that is
    `BETTER`. A window without a free switch time is solved once; so is one without a solution from the prediction,
    because none of the others finds one then. Wall time and iterations are those of all solves.
    """
    original = solver.solve(window, guess, previous)
    if not original.outcome.usable or all(stage.end.shape.is_fixed for stage in window.stages[:-1]):
        return original
    earliest = solver.solve(replace(window, pending_cost=window.pending_cost + EARLIEST_PENDING_COST), guess)
    slack = _switch_time_slack(window, earliest.plan.switch_times)
    if earliest.outcome is not Outcome.OPTIMAL or slack.max() < 10 * SHORTEST:
        return _with_total_effort(original, original, earliest)
    shares, half_step = even_shares(len(guess.switch_times), starts - 1)
    within = half_step * float(slack.max())
    solves = [original, earliest]
    mine = original
    if np.abs(original.plan.switch_times - guess.switch_times).max() > within:
        solves.append(_solve_near(solver, window, guess, guess.switch_times, within))
        mine = solves[-1] if _winning_guess(original, solves[-1:]) else original
    spread = earliest.plan.switch_times + shares * slack
    others = [_solve_near(solver, window, earliest.plan, switch_times, within) for switch_times in spread]
    basin = _winning_guess(mine, others)
    return replace(_with_total_effort((mine, *others)[basin], *solves, *others), basin=basin)


def even_shares(switches: int, count: int) -> tuple[np.ndarray, float]:
    """Return so many nondecreasing sequences of numbers from 0 to 1, (count, S), and half the step between them.

    They are picked evenly from the grid of all such sequences, 0 ... 0 first, 1 ... 1 last.
    """
    levels = next(n for n in range(1, count + 2) if comb(n + switches - 1, switches) >= count)
    grid = list(combinations_with_replacement(np.linspace(0.0, 1.0, levels), switches))
    picked = np.array([grid[round(k)] for k in np.linspace(0, len(grid) - 1, count)])
    return picked, 0.5 / max(levels - 1, 1)


def _switch_time_slack(window: Window, earliest: np.ndarray) -> np.ndarray:
    """Return how much later than its earliest time each switch may be (S,) [s], dwell and fixed times heeded.

    Args:
        window: The window.
        earliest: Earliest switch times (S,) [s].
    """
    latest = np.zeros(len(earliest))
    bound = window.start + window.horizon
    shortest = shortest_durations(window)
    for s in reversed(range(len(earliest))):
        bound = min(bound - shortest[s + 1], window.stages[s].end.latest)
        latest[s] = bound
    return np.asarray(np.maximum(latest - earliest, 0.0))


def _solve_near(solver: Solver, window: Window, plan: Plan, switch_times: np.ndarray, within: float) -> Solution:
    """Solve a window from a plan stretched to guessed switch times (S,), durations kept within so many seconds of them.

    A moving target is known about the guessed switch times alone, so the window is solved again about those it found.
    """
    solved = solver.solve(window, _stretched(plan, switch_times), None, within)
    if solved.outcome is Outcome.OPTIMAL and any(stage.reference.moves for stage in window.stages):
        again = solver.solve(window, solved.plan, None, within)
        return _with_total_effort(again, solved, again)
    return solved


def _stretched(plan: Plan, switch_times: np.ndarray) -> Plan:
    """Return a plan in which the robot is at other switch times where the plan is at its own; velocities stay."""
    old, new = (np.r_[plan.start, marks, plan.end] for marks in (plan.switch_times, switch_times))
    return replace(plan, times=np.interp(plan.times, old, new), switch_times=switch_times)


def _winning_guess(original: Solution, others: list[Solution]) -> int:
    """Return which guess wins: 0 for the prediction's own, unless one of the others has a `BETTER` basin.

    Only the objective at an optimum says something of its basin.
    """
    objectives = [one.objective if one.outcome is Outcome.OPTIMAL else np.inf for one in others]
    best = int(np.argmin(objectives))
    beaten = original.objective
    return best + 1 if objectives[best] < beaten - BETTER * abs(beaten) else 0


def _with_total_effort(solved: Solution, *all_solves: Solution) -> Solution:
    """Return a solve with the iterations and the wall time of all that were made for it."""
    iterations = sum(one.iterations for one in all_solves)
    wall_time = sum(one.wall_time for one in all_solves)
    return replace(solved, iterations=iterations, wall_time=wall_time)
