"""The quadratic programs of a window: an interior-point method of our own in C, and PIQP where it cannot be compiled.

Unknowns are the steps of x_1 .. x_K = [Q; Qdot] and those of the durations; x_0 is measured.
"""

import ctypes
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import piqp
from numpy.typing import ArrayLike
from scipy.sparse import csr_array, vstack

from psmpc_cli.native.library import library
from psmpc_cli.ocp.constraints.boxes import PENALTY
from psmpc_cli.ocp.gauss_newton import Linearization, Point
from psmpc_cli.solvers.sqp_window import SqpWindow

SOURCES = ("recursion.c", "program.c", "interior_point.c")


FLAGS = ("-O3", "-march=native", "-fopenmp-simd", "-fno-math-errno", "-ffp-contract=off")
"""Without -ffast-math: a step that is not finite has to be noticed; without contraction: compilers round alike."""

MAX_ITERATIONS = 60
"""Interior-point iterations of one program; a solvable one takes 8 to 25."""

ACCEPTABLE = 1e-6
"""Residuals and duality gap at which a program that ran out of iterations counts as solved."""

INITIAL_BARRIER = 1e-2
"""Product of slack and multiplier our own method starts from: 1e-2 was best of 1e-5 to 1e-2."""

BOUND_PUSH = 3e-3
"""The smallest slack it starts from [m, rad, m/s, rad/s, s]."""

NARROW = 1e-8
"""Rows whose bounds are nearer to each other than this [m, rad, m/s, rad/s, s] are equations."""

SMALLEST_REGULARIZATION = 1e-10
"""PIQP lowers its regularization to 1e-13 where it gets stuck; with tiny intervals that loses the digits it needs."""


Piece = tuple[ArrayLike, ArrayLike, ArrayLike]
"""Rows, columns and values of some entries of a sparse matrix, broadcast to one shape."""


class QpStatus(Enum):
    """How a quadratic program ended."""

    SOLVED = "solved"
    INFEASIBLE = "no step meets the linearized constraints"
    FAILED = "not solved"


@dataclass(frozen=True, eq=False)
class QpSolution:
    """A program's step and multipliers.

    Attributes:
        status: How it ended.
        step: The step; that of x_0 is 0.
        gaps: Multipliers of the gaps, (K, n).
        rows: Of the rows of `SqpWindow`, (R,).
        node_multipliers: Of the constraints at nodes, a part of `rows`, (E,).
        iterations: Interior-point iterations.
    """

    status: QpStatus
    step: Point
    gaps: np.ndarray
    rows: np.ndarray
    node_multipliers: np.ndarray
    iterations: int


class QpMethod(ABC):
    """A method for the programs of windows over the same stages and nodes."""

    def solve(self, window: SqpWindow, model: Linearization, point: Point) -> QpSolution:
        """Solve the program about a point."""
        bounds = window.bounds
        K, n = model.coupling.shape
        S = len(point.tau)
        states = window.states
        rows = window.rows(point, model.at)
        X = np.zeros((K + 1, 2 * n))
        numbers = {
            "positions": model.positions[1:],
            "gradient": model.gradient[1:],
            "gradient_tau": model.gradient_tau,
            "coupling": model.coupling,
            "arrow": model.arrow[1:],
            "durations": model.durations,
            "gap_velocity": model.gap_velocity,
            "gap_tau": model.gap_tau,
            "gaps": model.at.gaps,
            "row_node": window.form.row_node - 1,
            "row_jacobian": model.rows_by_x,
            "low": bounds.low - rows,
            "high": bounds.high - rows,
            "input_low": bounds.input_low,
            "input_high": bounds.input_high,
            "interval_by_duration": window.form.interval_steps,
            "penalty": PENALTY * window.shares(point)[1:],
            "X": X[1:],
            "tau": np.zeros(S),
            "gap_multipliers": np.zeros((K, n)),
            "multipliers": np.zeros(len(rows)),
        }
        status, iterations = self._solve(numbers, bounds.soft)
        z = numbers["multipliers"]
        of_nodes = z[states + 2 * S :][: len(model.at.rows)]
        return QpSolution(status, Point(X, numbers["tau"]), numbers["gap_multipliers"], z, of_nodes, iterations)

    @abstractmethod
    def _solve(self, numbers: dict[str, np.ndarray], soft: bool) -> tuple[QpStatus, int]:
        """Write the step and the multipliers into the last four arrays; return how it ended, and the iterations."""


class Program(ctypes.Structure):
    """A quadratic program as the C code takes it; see `Program` in program.c."""

    _fields_ = (
        [(name, ctypes.c_int64) for name in ("K", "node_rows", "inputs", "max_iterations", "soft")]
        + [(name, ctypes.c_double) for name in ("tolerance", "acceptable_tolerance", "initial_barrier", "bound_push")]
        + [(name, ctypes.c_void_p) for name in ("positions", "gradient", "gradient_tau", "coupling", "arrow")]
        + [(name, ctypes.c_void_p) for name in ("durations", "gap_velocity", "gap_tau", "gaps", "row_node")]
        + [(name, ctypes.c_void_p) for name in ("row_jacobian", "low", "high")]
        + [(name, ctypes.c_void_p) for name in ("input_low", "input_high", "interval_by_duration", "penalty")]
        + [(name, ctypes.c_void_p) for name in ("work", "X", "tau")]
        + [(name, ctypes.c_void_p) for name in ("gap_multipliers", "multipliers", "report")]
    )


def kernel_library(coordinates: int, durations: int) -> Path | None:
    """Return the shared library of our own method for these sizes; None where nothing can be compiled."""
    return library(kernel_source(coordinates, durations), "qp", FLAGS, kernel_symbols(coordinates, durations))


def kernel_source(coordinates: int, durations: int) -> str:
    """Return the C source of our own method for these sizes."""
    sizes = f"#define N {coordinates}\n#define S {durations}\n#define NARROW {NARROW}\n"
    folder = files("psmpc_cli.solvers")
    return sizes + "".join((folder / name).read_text(encoding="utf-8") for name in SOURCES)


def kernel_symbols(coordinates: int, durations: int) -> tuple[str, str, str]:
    """Return the names of its functions: the memory a program needs, the solver, the size of a program."""
    names = ("psmpc_qp_memory", "psmpc_qp_solve", "psmpc_qp_program_size")
    memory, solve, size = (f"{name}_{coordinates}_{durations}" for name in names)
    return memory, solve, size


@dataclass(frozen=True)
class Kernel:
    """The functions of our own method for some sizes, by pointers to a `Program`.

    Attributes:
        memory: Returns how many numbers of work memory a program needs.
        solve: Solves a program; returns the index of its `QpStatus`.
    """

    memory: Callable[[Any], int]
    solve: Callable[[Any], int]


@cache
def load_kernel(coordinates: int, durations: int) -> Kernel | None:
    """Load our own method for these sizes; None where nothing can be compiled.

    Raises:
        RuntimeError: Its `Program` is another structure than ours.
    """
    path = kernel_library(coordinates, durations)
    if path is None:
        return None
    kernel = ctypes.CDLL(str(path))
    memory, solve, program_size = (getattr(kernel, name) for name in kernel_symbols(coordinates, durations))
    for function in (memory, solve, program_size):
        function.restype = ctypes.c_int64
    if (size := program_size()) != ctypes.sizeof(Program):
        raise RuntimeError(f"a program has {size} bytes in C, expected the {ctypes.sizeof(Program)} of `Program`")
    return Kernel(memory, solve)


class RiccatiQp(QpMethod):
    """Programs by our own method, which uses the structure of double integrators."""

    def __init__(self, kernel: Kernel, tolerance: float) -> None:
        self._kernel = kernel
        self._tolerance = tolerance
        self._memory = np.zeros(0)

    def _solve(self, numbers: dict[str, np.ndarray], soft: bool) -> tuple[QpStatus, int]:
        program = Program(
            K=len(numbers["coupling"]),
            node_rows=len(numbers["row_jacobian"]),
            inputs=len(numbers["input_low"]) > 0,
            max_iterations=MAX_ITERATIONS,
            soft=soft,
            tolerance=self._tolerance,
            acceptable_tolerance=max(ACCEPTABLE, self._tolerance),
            initial_barrier=INITIAL_BARRIER,
            bound_push=BOUND_PUSH,
        )
        report = np.zeros(4)
        numbers = {**numbers, "report": report, "work": self._work(program)}
        held = {name: np.ascontiguousarray(array) for name, array in numbers.items()}  # alive while C reads them
        for name, array in held.items():
            setattr(program, name, array.ctypes.data)
        status = tuple(QpStatus)[self._kernel.solve(ctypes.byref(program))]
        return status, int(report[0])

    def _work(self, program: Program) -> np.ndarray:
        """Return memory for a program, aligned for vectors of 64 bytes."""
        size = int(self._kernel.memory(ctypes.byref(program))) + 8
        if size > len(self._memory):
            self._memory = np.zeros(size)
        return self._memory[-self._memory.ctypes.data % 64 // 8 :]


class PiqpQp(QpMethod):
    """Programs by PIQP's back-end for multistage problems.

    A program that is solved where it is not convex has failed. Unknowns are ordered node by node, the durations last:
    they couple all nodes, which PIQP knows as an arrow. A soft limit has an unknown of its own for its violation.
    """

    def __init__(self, tolerance: float) -> None:
        self._tolerance = tolerance

    def _solve(self, numbers: dict[str, np.ndarray], soft: bool) -> tuple[QpStatus, int]:
        K, n = numbers["coupling"].shape
        S = len(numbers["tau"])
        low = numbers["low"]
        high = numbers["high"]
        node = (4 if soft else 2) * n
        x = node * np.arange(K)[:, None] + np.arange(2 * n)
        e = x + 2 * n if soft else x[:, :0]
        tau = np.arange(node * K, node * K + S)
        size = node * K + S
        unknown = np.r_[x.ravel(), tau]
        row = np.arange(len(low))
        is_soft = soft & (row < x.size)
        equal = ~is_soft & (high <= low + NARROW)
        boxed = ~is_soft & ~equal & (row < x.size + S)
        below = is_soft & np.isfinite(low)
        above = is_soft & np.isfinite(high)
        of_box = unknown[row[boxed]]
        hard = ~is_soft & ~equal & ~boxed & (np.isfinite(low) | np.isfinite(high))
        rows = _matrix(len(low), size, _rows(numbers, x, tau))
        gaps = _matrix(K * n, size, _gaps(numbers, x, tau))
        violated = _matrix(len(low), size, [(np.arange(e.size), e.ravel(), 1.0)])
        cost = np.zeros(size)
        lowest = np.full(size, -np.inf)
        highest = np.full(size, np.inf)
        cost[x] = numbers["gradient"]
        cost[tau] = numbers["gradient_tau"]
        cost[e] = numbers["penalty"]
        lowest[e] = 0.0
        lowest[of_box] = low[boxed]
        highest[of_box] = high[boxed]
        hessian = _matrix(size, size, _hessian(numbers, x, tau))
        solver = piqp.SparseSolver()
        solver.settings.kkt_solver = piqp.KKTSolver.sparse_multistage
        solver.settings.max_iter = MAX_ITERATIONS
        solver.settings.reg_finetune_lower_limit = SMALLEST_REGULARIZATION
        solver.settings.eps_abs = solver.settings.eps_duality_gap_abs = self._tolerance
        solver.setup(
            P=hessian.tocsc(),
            c=cost,
            A=vstack([gaps, rows[equal]], format="csc"),
            b=np.r_[-numbers["gaps"].ravel(), (low[equal] + high[equal]) / 2],
            G=vstack([(rows + violated)[below], (rows - violated)[above], rows[hard]], format="csc"),
            h_l=np.r_[low[below], np.full(above.sum(), -np.inf), low[hard]],
            h_u=np.r_[np.full(below.sum(), np.inf), high[above], high[hard]],
            x_l=lowest,
            x_u=highest,
        )
        status = solver.solve()
        result = solver.result
        z = numbers["multipliers"]
        found = np.array(result.x)
        y = np.array(result.y)
        of_rows = np.array(result.z_u) - np.array(result.z_l)
        numbers["X"][:] = found[x]
        numbers["tau"][:] = found[tau]
        numbers["gap_multipliers"][:] = y[: K * n].reshape(K, n)
        z[equal] = y[K * n :]
        z[boxed] = (np.array(result.z_bu) - np.array(result.z_bl))[of_box]
        limited = np.r_[np.flatnonzero(below), np.flatnonzero(above), np.flatnonzero(hard)]
        np.add.at(z, limited, of_rows)
        outcome = _status(status, result.info)
        if outcome is QpStatus.SOLVED and _curvature(hessian, found) < -ACCEPTABLE:
            outcome = QpStatus.FAILED
        return outcome, int(result.info.iter)


def _curvature(upper: csr_array, step: np.ndarray) -> float:
    """Return step' H step over the step's square: negative, the program was not convex where it was solved.

    A test without the matrix's inertia, which PIQP does not tell: Chiang, Zavala: An inertia-free filter line-search
    algorithm for large-scale nonlinear programming (2016), section 3.

    Args:
        upper: Upper triangle of H.
        step: The program's solution.
    """
    curvature = step @ (2 * (upper @ step) - upper.diagonal() * step)
    return float(curvature / max(step @ step, np.finfo(float).tiny))


def _status(status: piqp.Status, info: piqp.Info) -> QpStatus:
    if status == piqp.Status.PIQP_PRIMAL_INFEASIBLE:
        return QpStatus.INFEASIBLE
    nearly = max(info.primal_res, info.dual_res, abs(info.duality_gap)) <= ACCEPTABLE
    return QpStatus.SOLVED if status == piqp.Status.PIQP_SOLVED or nearly else QpStatus.FAILED


def _matrix(rows: int, columns: int, pieces: Sequence[Piece]) -> csr_array:
    """Return a sparse matrix; entries in the same place add up."""
    entries = [np.broadcast_arrays(*piece) for piece in pieces]
    row, column, value = (np.concatenate([entry[i].ravel() for entry in entries]) for i in range(3))
    return csr_array((value, (row, column)), shape=(rows, columns))


def _hessian(numbers: dict[str, np.ndarray], x: np.ndarray, tau: np.ndarray) -> list[Piece]:
    """Return the upper triangle of the Hessian."""
    n = numbers["coupling"].shape[1]
    weight = -numbers["coupling"]
    Q = x[:, :n]
    v = x[:, n:]
    i, j = np.triu_indices(n)
    c, d = np.triu_indices(len(tau))
    return [
        (Q[:, i], Q[:, j], numbers["positions"][:, i, j]),
        (v, v, weight),
        (v[:-1], v[:-1], weight[1:]),
        (v[:-1], v[1:], -weight[1:]),
        (x[..., None], tau, numbers["arrow"]),
        (tau[c], tau[d], numbers["durations"][c, d]),
    ]


def _gaps(numbers: dict[str, np.ndarray], x: np.ndarray, tau: np.ndarray) -> list[Piece]:
    """Return the rows of gaps."""
    K, n = numbers["coupling"].shape
    by_v = numbers["gap_velocity"][:, :, None]
    row = np.arange(K * n).reshape(K, n)
    Q = x[:, :n]
    v = x[:, n:]
    return [
        (row, Q, 1.0),
        (row, v, by_v[:, 1]),
        (row[1:], Q[:-1], -1.0),
        (row[1:], v[:-1], by_v[1:, 0]),
        (row[..., None], tau, numbers["gap_tau"]),
    ]


def _rows(numbers: dict[str, np.ndarray], x: np.ndarray, tau: np.ndarray) -> list[Piece]:
    """Return the rows of `SqpWindow`."""
    K, n = numbers["coupling"].shape
    S = len(tau)
    ends = len(numbers["row_jacobian"])
    at = x.size + 2 * S
    v = x[:, n:]
    until, of = np.tril_indices(S)
    pieces: list[Piece] = [
        (np.arange(x.size + S), np.r_[x.ravel(), tau], 1.0),
        (x.size + S + until, tau[of], 1.0),
        (at + np.arange(ends)[:, None], x[numbers["row_node"]], numbers["row_jacobian"]),
    ]
    for first, limit in ((at + ends, numbers["input_low"]), (at + ends + K * n, numbers["input_high"])):
        row = first + np.arange(limit.size).reshape(limit.shape)
        if row.size:
            by_tau = -limit[..., None] * numbers["interval_by_duration"][:, None]
            pieces += [(row, v, 1.0), (row[1:], v[:-1], -1.0), (row[..., None], tau, by_tau)]
    return pieces
