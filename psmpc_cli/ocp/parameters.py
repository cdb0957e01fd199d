"""The parameters of a window's NLP, symbolic or numeric, in the order of its parameter vector."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Generic, TypeVar

import casadi as ca
import numpy as np

from psmpc_cli.ocp.layout import Layout, WindowShape

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Parameters(Generic[T]):
    """The NLP's parameters.

    Attributes:
        x0: Measured state (2n,).
        horizon: T_h [s].
        pending, terminal: delta and kappa.
        omega: Priorities over the window's largest, (S + 1,).
        offset, scale: Normalization L = (Lbar - offset) / scale, (S + 1,) each. Paper eq. (12).
        weights, control_weights: Of each stage, (rows,) and (inputs,).
        targets: Of each stage, (rows,): what its end condition is about, and its cost where the target stands still.
        paths: Of each stage, (rows, 2 (N_s + 1)): what its cost follows at its nodes as functions of its duration,
            first the values at duration 0, then the slopes; (rows, 0) where the target stands still.
    """

    x0: T
    horizon: T
    pending: T
    terminal: T
    omega: T
    offset: T
    scale: T
    weights: tuple[T, ...]
    control_weights: tuple[T, ...]
    targets: tuple[T, ...]
    paths: tuple[T, ...]

    def pieces(self) -> tuple[T, ...]:
        """Return all of them in order; matrices are meant column by column."""
        head = (self.x0, self.horizon, self.pending, self.terminal, self.omega, self.offset, self.scale)
        return (*head, *self.weights, *self.control_weights, *self.targets, *self.paths)


def symbolic_parameters(shape: WindowShape, layout: Layout) -> Parameters[ca.SX]:
    """Return the parameters as symbols."""
    stages = range(layout.switches + 1)
    columns = [2 * (N + 1) if stage.moving else 0 for stage, N in zip(shape.stages, shape.nodes, strict=True)]
    return Parameters(
        x0=ca.SX.sym("x0", 2 * layout.n),
        horizon=ca.SX.sym("T_h"),
        pending=ca.SX.sym("delta"),
        terminal=ca.SX.sym("kappa"),
        omega=ca.SX.sym("omega", layout.switches + 1),
        offset=ca.SX.sym("offset", layout.switches + 1),
        scale=ca.SX.sym("scale", layout.switches + 1),
        weights=tuple(ca.SX.sym(f"W_{s}", layout.rows[s]) for s in stages),
        control_weights=tuple(ca.SX.sym(f"W_r_{s}", layout.inputs[s]) for s in stages),
        targets=tuple(ca.SX.sym(f"target_{s}", layout.rows[s]) for s in stages),
        paths=tuple(ca.SX.sym(f"path_{s}", layout.rows[s], columns[s]) for s in stages),
    )


def split_parameters(p: np.ndarray, shape: WindowShape, layout: Layout) -> Parameters[np.ndarray]:
    """Return the pieces of a parameter vector: scalars, vectors and, column by column as they stand, matrices."""
    S1 = layout.switches + 1
    x0, horizon, pending, terminal, omega, offset, scale, *rest = (p[piece] for piece in _places(shape, layout))
    paths = [piece.reshape(-1, rows).T for piece, rows in zip(rest[3 * S1 :], layout.rows, strict=True)]
    return Parameters(
        x0=x0,
        horizon=horizon[0],
        pending=pending[0],
        terminal=terminal[0],
        omega=omega,
        offset=offset,
        scale=scale,
        weights=tuple(rest[:S1]),
        control_weights=tuple(rest[S1 : 2 * S1]),
        targets=tuple(rest[2 * S1 : 3 * S1]),
        paths=tuple(paths),
    )


@lru_cache(maxsize=256)
def _places(shape: WindowShape, layout: Layout) -> tuple[slice, ...]:
    """Return where each piece stands in a parameter vector."""
    S1, moving = layout.switches + 1, [stage.moving for stage in shape.stages]
    columns = [2 * (N + 1) if moves else 0 for N, moves in zip(shape.nodes, moving, strict=True)]
    sizes = [2 * layout.n, 1, 1, 1, S1, S1, S1, *layout.rows, *layout.inputs, *layout.rows]
    sizes += [rows * count for rows, count in zip(layout.rows, columns, strict=True)]
    ends = np.cumsum(sizes).tolist()
    return tuple(slice(end - size, end) for end, size in zip(ends, sizes, strict=True))


def reference(p: Parameters[ca.SX], layout: Layout, stage: int, node: int, tau: ca.SX) -> ca.SX:
    """Return what a stage's cost follows at one of its nodes, 0 to N_s, if the stage lasts tau [s]."""
    path, N = p.paths[stage], layout.nodes[stage]
    if path.shape[1] == 0:
        return p.targets[stage]
    return path[:, node] + path[:, N + 1 + node] * tau
