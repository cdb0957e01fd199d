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

LEAST_SLACK = 10 * SHORTEST
"""Switch times that can be moved by less than this [s] are not guessed anew."""

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
    """Return the best of several solves of a window, which start from different guesses of its switch times.

    The cost of a window may have several local minima in the switch times; a solve finds that in whose basin it starts.
    So guesses are spread from the earliest switch times that the robot can meet to the latest. Each is solved with the
    durations of stages kept near the guess. Set free, an interior-point method leaves an early basin, uphill, for the
    end of the horizon.

    The basin of the given guess, `original`, is given up only for one that is `BETTER`. It is solved once more near the
    guess if its free solve has left it. A window without a free switch time is solved once. So is one that has no
    solution from the given guess, because other guesses do not find one then.

    Args:
        solver: Solves the windows.
        window: The window.
        guess: The plan that a single solve would start from.
        previous: The solve of the sample before, which the first solve continues; None: a cold start.
        starts: Number of guesses, the given one included; at least 2.

    Returns:
        The best solution; its `basin` is the number of its guess, 0 for the given one, and its iterations and wall time
        are those of all solves. It is -1 if the window was solved once.
    """
    original = solver.solve(window, guess, previous)
    if not original.outcome.usable or all(stage.end.shape.is_fixed for stage in window.stages[:-1]):
        return original
    earliest = solver.solve(replace(window, pending_cost=window.pending_cost + EARLIEST_PENDING_COST), guess)
    # how much later than the earliest time each switch may be, and guesses spread over that
    slack = _switch_time_slack(window, earliest.plan.switch_times)
    if earliest.outcome is not Outcome.OPTIMAL or slack.max() < LEAST_SLACK:
        return _with_total_effort(original, original, earliest)
    shares, half_step = even_shares(len(guess.switch_times), starts - 1)
    within = half_step * float(slack.max())  # half the distance of two guesses [s]
    solves = [original, earliest]
    of_given_guess = original
    if np.abs(original.plan.switch_times - guess.switch_times).max() > within:
        solves.append(_solve_near(solver, window, guess, guess.switch_times, within))
        of_given_guess = solves[-1] if _winning_guess(original, solves[-1:]) else original
    spread = earliest.plan.switch_times + shares * slack
    others = [_solve_near(solver, window, earliest.plan, switch_times, within) for switch_times in spread]
    basin = _winning_guess(of_given_guess, others)
    return replace(_with_total_effort((of_given_guess, *others)[basin], *solves, *others), basin=basin)


def even_shares(switches: int, count: int) -> tuple[np.ndarray, float]:
    """Return so many nondecreasing sequences of numbers from 0 to 1, (count, S), and half the step between them.

    They are picked evenly from the grid of all such sequences, 0 ... 0 first, 1 ... 1 last.
    """
    levels = next(n for n in range(1, count + 2) if comb(n + switches - 1, switches) >= count)
    grid = list(combinations_with_replacement(np.linspace(0.0, 1.0, levels), switches))
    picked = np.array([grid[round(k)] for k in np.linspace(0, len(grid) - 1, count)])
    return picked, 0.5 / max(levels - 1, 1)


def _switch_time_slack(window: Window, earliest: np.ndarray) -> np.ndarray:
    """Return how much later than its earliest time each switch may be (S,) [s].

    The latest times leave every later stage its shortest duration, and keep the latest times that stages are given.

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
    """Solve a window from a plan that is stretched in time, so that it switches at guessed times (S,).

    The solve keeps the durations of stages within so many seconds of the guessed ones. A moving target is known near
    the guessed switch times alone, so the window is solved again near those that were found.
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
    """Return the number of the best guess: 0 for the original, unless another solve, from 1 on, is `BETTER`.

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
