"""Where everything stands in the vectors of a window's NLP."""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np


@dataclass(frozen=True)
class StageShape:
    """What of a stage decides the structure of the NLP; all numbers are parameters."""

    space: str
    input: str
    end_rows: tuple[int, ...]  # rows of the error with an end condition at the stage's end; empty: none
    end_velocity: bool  # the rates of those rows are bounded too
    fixed_end: bool  # the stage switches at a given instant
    moving: bool  # the cost follows a desired trajectory


@dataclass(frozen=True)
class WindowShape:
    """The structure of a window: one compiled NLP serves all windows of the same shape."""

    stages: tuple[StageShape, ...]
    nodes: tuple[int, ...]  # N_s, intervals of each stage
    discretization: str
    soft: bool = False  # limits on the states may be violated, at a cost
    bounded: bool = False  # the cost integral of the last stage is bounded


@dataclass(frozen=True)
class Layout:
    """Offsets of the decision variables x_0, u_0, x_1, u_1, ..., x_K, each x_k = [Q; Qdot; tau_0 .. tau_{S-1}].

    Where limits are soft, rho times the violations of [Q; Qdot], e_k, follow on u_k, and on x_K.

    Attributes:
        n: Generalized coordinates.
        nodes: N_s of each stage.
        inputs: Inputs of each stage.
        rows: Error rows of each stage.
        soft: Limits on the states may be violated.
    """

    n: int
    nodes: tuple[int, ...]
    inputs: tuple[int, ...]
    rows: tuple[int, ...]
    soft: bool = False

    @property
    def switches(self) -> int:
        """Number of switching instants in the window, S."""
        return len(self.nodes) - 1

    @property
    def nx(self) -> int:
        """Size of x_k, the durations included."""
        return 2 * self.n + self.switches

    @property
    def K(self) -> int:
        """Number of intervals."""
        return sum(self.nodes)

    @cached_property
    def stage_of(self) -> np.ndarray:
        """Stage (in the window) of each interval, (K,)."""
        return np.repeat(np.arange(len(self.nodes)), self.nodes)

    @cached_property
    def first_node(self) -> np.ndarray:
        """First node of each stage, and the last node of all, (S + 2,)."""
        return np.concatenate([[0], np.cumsum(self.nodes)])

    @cached_property
    def offsets(self) -> np.ndarray:
        """Offset of x_k in the decision vector, (K + 1,)."""
        sizes = [self.nx + self.inputs[s] + self.violations for s in self.stage_of]
        return np.concatenate([[0], np.cumsum(sizes)]).astype(int)

    @property
    def size(self) -> int:
        """Size of the decision vector."""
        return int(self.offsets[-1]) + self.nx + self.violations

    @property
    def violations(self) -> int:
        """Number of violations e_k at a node: 0 where limits are hard."""
        return 2 * self.n if self.soft else 0

    @cached_property
    def state_index(self) -> np.ndarray:
        """Indices of [Q; Qdot] at each node, (K + 1, 2n)."""
        return self.offsets[:, None] + np.arange(2 * self.n)[None, :]

    @cached_property
    def duration_index(self) -> np.ndarray:
        """Indices of the durations at each node, (K + 1, S)."""
        return self.offsets[:, None] + 2 * self.n + np.arange(self.switches)[None, :]

    @cached_property
    def violation_index(self) -> np.ndarray:
        """Indices of the violations e_k at the nodes, (K + 1, 2n); (K + 1, 0) where limits are hard."""
        inputs = np.array([*(self.inputs[s] for s in self.stage_of), 0])
        return np.asarray((self.offsets + self.nx + inputs)[:, None] + np.arange(self.violations))

    @cached_property
    def input_indices(self) -> tuple[np.ndarray, ...]:
        """Indices of the inputs of each stage's intervals, (N_s, inputs)."""
        first = [self.offsets[a:b] for a, b in pairwise(self.first_node)]
        return tuple(k[:, None] + self.nx + np.arange(inputs) for k, inputs in zip(first, self.inputs, strict=True))

    def input_index(self, stage: int) -> np.ndarray:
        """Return the indices of the inputs of a stage's intervals, (N_s, inputs)."""
        return self.input_indices[stage]


def mesh(durations: np.ndarray, nodes: tuple[int, ...]) -> np.ndarray:
    """Return the node times (K + 1,) [s] from the start of the window; `durations` of all stages. Paper eq. (19)."""
    ends = np.concatenate([[0.0], np.cumsum(durations)])
    pieces = [a + (b - a) * np.arange(1, N + 1) / N for a, b, N in zip(ends[:-1], ends[1:], nodes, strict=True)]
    return np.concatenate([[0.0], *pieces])
