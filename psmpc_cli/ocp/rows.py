"""Where the rows of g stand in a window's NLP."""

from dataclasses import dataclass

import numpy as np

from psmpc_cli.ocp.layout import Layout, WindowShape


@dataclass(frozen=True, eq=False)
class Rows:
    """The rows of g: node by node the gap to the next node first, then the path rows of this one.

    Attributes:
        equality: Whether each row is an equality.
        path: Number of path rows at each node, (K + 1,).
        gaps: Rows that close the gap after each interval, (K, nx).
        x0: Rows that fix the initial state, (2n,).
        last_duration: Row with the last stage's duration, None with one stage.
        instants: Row with the cumulated duration to the end of a stage with a fixed switching time, by stage.
        ends: Rows with the end condition, error rows first, then rates, by stage of the window.
        limits: Rows of soft limits on [Q; Qdot] at the nodes, below and above, (2, K + 1, 2n); (2, K + 1, 0) if hard.
    """

    equality: tuple[bool, ...]
    path: tuple[int, ...]
    gaps: np.ndarray
    x0: np.ndarray
    last_duration: int | None
    instants: dict[int, int]
    ends: dict[int, np.ndarray]
    limits: np.ndarray

    @property
    def count(self) -> int:
        """Number of rows."""
        return len(self.equality)


def place_rows(layout: Layout, shape: WindowShape) -> Rows:
    """Return where the rows of a window of this shape stand."""
    path = np.zeros(layout.K + 1, int)
    fixed = [s for s, stage in enumerate(shape.stages[:-1]) if stage.fixed_end]
    path[0] = 2 * layout.n + bool(layout.switches) + len(fixed)
    for s, stage in enumerate(shape.stages[:-1]):
        path[layout.first_node[s + 1]] = len(stage.end_rows) * (2 if stage.end_velocity else 1)
    ending = path.copy()
    path += 2 * layout.violations
    path[-1] += shape.bounded
    first = layout.nx * np.arange(layout.K + 1) + np.r_[0, np.cumsum(path[:-1])]
    gaps = first[:-1, None] + np.arange(layout.nx)
    after = first + np.r_[np.full(layout.K, layout.nx), 0]
    start = int(after[0]) + 2 * layout.n
    ends = {s: after[at] + np.arange(ending[at]) for s, at in enumerate(layout.first_node[1:-1]) if ending[at]}
    instants = {s: start + 1 + i for i, s in enumerate(fixed)}
    below = (after + ending)[:, None] + np.arange(layout.violations)
    equality = np.zeros(layout.K * layout.nx + path.sum(), bool)
    for rows in (gaps, after[0] + np.arange(2 * layout.n), list(instants.values())):
        equality[np.asarray(rows, int)] = True
    return Rows(
        equality=tuple(bool(yes) for yes in equality),
        path=tuple(int(count) for count in path),
        gaps=gaps,
        x0=after[0] + np.arange(2 * layout.n),
        last_duration=start if layout.switches else None,
        instants=instants,
        ends=ends,
        limits=np.array([below, below + layout.violations]),
    )
