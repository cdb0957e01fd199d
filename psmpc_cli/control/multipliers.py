"""Warm start of the multipliers: those of the last solve, moved along by the time that has passed."""

from dataclasses import dataclass

import numpy as np

from psmpc_cli.ocp.layout import Layout, mesh
from psmpc_cli.ocp.transcription import Nlp
from psmpc_cli.ocp.window import Window
from psmpc_cli.solvers import Guess, Solution


@dataclass(frozen=True, eq=False)
class Before:
    """The last solve: its NLP, its window, and what came out."""

    nlp: Nlp
    window: Window
    solution: Solution


def shift_multipliers(nlp: Nlp, z: np.ndarray, window: Window, before: Before) -> Guess:
    """Return the guess z with the last solution's multipliers, if it has any, at each node's time; cold without it.

    The solution serves where it is usable and its stages are the same. On another mesh, multipliers of bounds change
    with the length of the intervals that they stand for.
    """
    solution = before.solution
    if [s.index for s in before.window.stages] != [s.index for s in window.stages] or not solution.outcome.usable:
        return Guess(z)
    if not len(solution.lam_g):
        return Guess(z, warm=True)
    layout, old = nlp.layout, before.nlp.layout
    nodes = _same_node(layout, old, _node_times(layout, window, z), _node_times(old, before.window, solution.z))
    lam_x, lam_g = np.zeros(layout.size), np.zeros(len(nlp.equality))
    shorter = np.repeat(np.array(old.nodes) / np.array(layout.nodes), layout.nodes)
    at_nodes = np.r_[shorter, shorter[-1]][:, None]
    states = np.hstack([layout.state_index, layout.duration_index])
    states_before = np.hstack([old.state_index, old.duration_index])
    lam_x[states] = solution.lam_x[states_before[nodes]] * at_nodes
    for s in range(len(layout.nodes)):
        first, last = layout.first_node[s], layout.first_node[s + 1]
        intervals = np.minimum(nodes[first:last], old.first_node[s + 1] - 1) - old.first_node[s]
        lam_x[layout.input_index(s)] = solution.lam_x[old.input_index(s)[intervals]] * shorter[first:last, None]
    lam_g[nlp.gap_rows] = solution.lam_g[before.nlp.gap_rows[np.minimum(nodes[:-1], old.K - 1)]]
    lam_x[layout.violation_index] = solution.lam_x[old.violation_index[nodes]] * at_nodes
    lam_g[nlp.limit_rows] = solution.lam_g[before.nlp.limit_rows[:, nodes]] * at_nodes
    for rows, rows_before in zip(_other_rows(nlp), _other_rows(before.nlp), strict=True):
        lam_g[rows] = solution.lam_g[rows_before]
    return Guess(z, lam_x, lam_g, warm=True)


def _other_rows(nlp: Nlp) -> list[np.ndarray]:
    """Return the rows of g that close no gap and hold no soft limit, group by group."""
    last = [] if nlp.last_duration_row is None else [nlp.last_duration_row]
    return [nlp.x0_rows, np.array([*last, *nlp.instant_rows.values()], int), *nlp.end_rows.values()]


def _node_times(layout: Layout, window: Window, z: np.ndarray) -> np.ndarray:
    tau = z[layout.duration_index[0]]
    return window.start + mesh(np.append(tau, window.horizon - tau.sum()), layout.nodes)


def _same_node(layout: Layout, old: Layout, times: np.ndarray, old_times: np.ndarray) -> np.ndarray:
    """Return for each node the old node of the same stage nearest in time, (K + 1,)."""
    nodes = np.zeros(layout.K + 1, int)
    for s in range(len(layout.nodes)):
        here = slice(layout.first_node[s], layout.first_node[s + 1] + 1)
        there = slice(old.first_node[s], old.first_node[s + 1] + 1)
        index = np.interp(times[here], old_times[there], np.arange(there.start, there.stop))
        nodes[here] = np.round(index).astype(int)
    return nodes
