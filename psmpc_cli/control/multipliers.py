"""Warm start of the multipliers: those of the last solve, moved along by the time that has passed."""

import numpy as np

from psmpc_cli.ocp.layout import Layout, mesh
from psmpc_cli.ocp.transcription import Nlp
from psmpc_cli.ocp.window import Window
from psmpc_cli.solvers import Guess, Solution


def shift_multipliers(nlp: Nlp, z: np.ndarray, window: Window, before: Window, solution: Solution) -> Guess:
    """Return the guess z with the last solution's multipliers at each node's time; without, if the stages changed."""
    if [s.index for s in before.stages] != [s.index for s in window.stages] or not solution.outcome.usable:
        return Guess(z)
    layout = nlp.layout
    old, new = _node_times(layout, before, solution.z), _node_times(layout, window, z)
    nodes = _same_node(layout, old, new)
    lam_x, lam_g = solution.lam_x.copy(), solution.lam_g.copy()
    _gather(lam_x, solution.lam_x, np.hstack([layout.state_index, layout.duration_index]), nodes)
    for s in range(len(layout.nodes)):
        first, last = layout.first_node[s], layout.first_node[s + 1]
        intervals = np.minimum(nodes[first:last], last - 1) - first
        _gather(lam_x, solution.lam_x, layout.input_index(s), intervals)
    _gather(lam_g, solution.lam_g, nlp.gap_rows, np.minimum(nodes[:-1], layout.K - 1))
    return Guess(z, lam_x, lam_g)


def _node_times(layout: Layout, window: Window, z: np.ndarray) -> np.ndarray:
    tau = z[layout.duration_index[0]]
    return window.start + mesh(np.append(tau, window.horizon - tau.sum()), layout.nodes)


def _same_node(layout: Layout, old: np.ndarray, new: np.ndarray) -> np.ndarray:
    """Return for each node the old node of the same stage nearest in time, (K + 1,)."""
    nodes = np.zeros(layout.K + 1, int)
    for s in range(len(layout.nodes)):
        first, last = layout.first_node[s], layout.first_node[s + 1] + 1
        index = np.interp(new[first:last], old[first:last], np.arange(first, last))
        nodes[first:last] = np.round(index).astype(int)
    return nodes


def _gather(into: np.ndarray, values: np.ndarray, index: np.ndarray, take: np.ndarray) -> None:
    into[index] = values[index[take]]
