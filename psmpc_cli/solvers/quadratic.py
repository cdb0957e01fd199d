"""The quadratic programs of a window: an interior-point method of our own in C, and PIQP where it cannot be compiled.

Unknowns are the steps of x_1 .. x_K = [Q; Qdot] and those of the durations; x_0 is measured.
"""

import ctypes
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from enum import Enum
from functools import cache
from importlib.resources import files
from typing import Any, NamedTuple

import numpy as np
import piqp
from numpy.typing import ArrayLike
from scipy.sparse import csr_array, diags_array, triu, vstack

from psmpc_cli.native.library import Library, find_or_compile
from psmpc_cli.native.structures import layout_source, require_layout
from psmpc_cli.ocp.gauss_newton import Linearization, Unknowns
from psmpc_cli.solvers.sqp_window import Evaluation, SqpWindow

SOURCES = ("recursion.c", "interval_rows.c", "program.c", "interior_point.c")
"""Source files of the kernel, our own method in C, in the order in which they are joined."""

FLAGS = ("-O3", "-march=native", "-fopenmp-simd", "-fno-math-errno", "-ffp-contract=off")
"""Without -ffast-math: a step that is not finite has to be detected; without contraction: compilers round alike."""

MAX_ITERATIONS = 60
"""Interior-point iterations of one program; a solvable one takes 8 to 25."""

ACCEPTABLE = 1e-6
"""Residuals and duality gap at which a program that ran out of iterations counts as solved."""

INITIAL_BARRIER = 1e-2
"""Product of slack and multiplier our own method starts from: 1e-2 was best of 1e-5 to 1e-2."""

BOUND_PUSH = 3e-3
"""The smallest slack it starts from [m, rad, m/s, rad/s, s]."""

EQUALITY_WIDTH = 1e-8
"""Rows whose bounds are nearer to each other than this [m, rad, m/s, rad/s, s] are equations."""

SMALLEST_REGULARIZATION = 1e-10
"""PIQP lowers its regularization to 1e-13 where it gets stuck; with tiny intervals that loses the digits it needs."""

ALIGNMENT = 64
"""Bytes of a cache line, at which the kernel's workspace begins."""

REPORT_SIZE = 4
"""Numbers in the kernel's report: iterations, primal residual, dual residual, complementarity."""

DOUBLE_SIZE = 8
"""Bytes of a double."""


class QpStatus(Enum):
    """How a quadratic program ended, in the order of the C code."""

    SOLVED = "solved"
    INFEASIBLE = "no step meets the linearized constraints"
    NOT_CONVEX = "not convex, or so by rounding"
    FAILED = "not solved"


@dataclass(frozen=True, eq=False)
class QpSolution:
    """A program's step and multipliers.

    Attributes:
        status: How it ended.
        step: The step; that of x_0 is 0.
        gaps: Multipliers of the gaps, (K, n).
        rows: Of those rows of `SqpWindow` that the program has, (R,).
        node_multipliers: Of the constraints at nodes, a part of `rows`, (E,).
        iterations: Interior-point iterations.
    """

    status: QpStatus
    step: Unknowns
    gaps: np.ndarray
    rows: np.ndarray
    node_multipliers: np.ndarray
    iterations: int


@dataclass(frozen=True, eq=False)
class QpArrays:
    """The arrays of a quadratic program, in the order of `QuadraticProgram` in program.c; the last four are written.

        min  1/2 x'H x + g'x  over x = (X, tau)   s.t.   low <= C x <= high,
        Q_k+1 - Q_k + gap_velocity_k [v_k; v_k+1] + gap_tau_k tau + gaps_k = 0.

    X are the steps of x_1 .. x_K, tau those of the S free durations; C has the R rows of `SqpWindow`, of those at nodes
    and over intervals the ones of the model alone. H and g are those of `Linearization`.

    Attributes:
        H_QQ: Upper triangles of H by the positions, (K, n, n).
        gradient: g by X, (K, 2n).
        gradient_tau: g by tau, (S,).
        H_vv: Diagonal of H by v_k and v_k+1, the negative weight of (v_k+1 - v_k)^2 / 2, (K, n).
        H_x_tau: H by X and tau, (K, 2n, S).
        H_tau_tau: H by tau, (S, S).
        gap_velocity: Of the velocities at both ends of an interval, (K, 2).
        gap_tau: (K, n, S).
        gaps: (K, n).
        row_node: Nodes of the constraints at nodes, counted from x_1, ascending, (E,).
        row_jacobian: Their rows of C by the state at their node, (E, 2n).
        interval_row: Intervals of the constraints over intervals, ascending, (I,).
        interval_jacobian: Their rows of C by the states at both ends, tau, but for their bounds, and the velocities
            where the interval before begins, (I, 4n + S + history); history is n, or 0 where no row has the last part.
        interval_low, interval_high: Their bounds over the length of their interval, (I,).
        interval_weight: Of those that are residuals of the cost, which have no bounds, what they add to H: weight c'c,
            (I,); 0 of others.
        low, high: Bounds of the rows, (R,).
        input_low, input_high: Bounds of the accelerations, (K, n); (0, n) where none has one.
        interval_by_duration: Derivatives of the lengths of the intervals by tau, (K, S).
        penalty: Cost of a violation by 1 of each row that is soft, 0 of hard ones, (R,).
        X: Of the solution, (K, 2n).
        tau: Of the solution, (S,).
        gap_multipliers: (K, n).
        row_multipliers: Positive at an upper bound, negative at a lower one, (R,).
    """

    H_QQ: np.ndarray
    gradient: np.ndarray
    gradient_tau: np.ndarray
    H_vv: np.ndarray
    H_x_tau: np.ndarray
    H_tau_tau: np.ndarray
    gap_velocity: np.ndarray
    gap_tau: np.ndarray
    gaps: np.ndarray
    row_node: np.ndarray
    row_jacobian: np.ndarray
    interval_row: np.ndarray
    interval_jacobian: np.ndarray
    interval_low: np.ndarray
    interval_high: np.ndarray
    interval_weight: np.ndarray
    low: np.ndarray
    high: np.ndarray
    input_low: np.ndarray
    input_high: np.ndarray
    interval_by_duration: np.ndarray
    penalty: np.ndarray
    X: np.ndarray
    tau: np.ndarray
    gap_multipliers: np.ndarray
    row_multipliers: np.ndarray


ARRAYS = tuple(field.name for field in fields(QpArrays))
"""Names of the arrays that a program has in Python and in C."""


class QpMethod(ABC):
    """A method for the programs of windows over the same stages and nodes."""

    def solve(self, window: SqpWindow, model: Linearization, here: Evaluation) -> QpSolution:
        """Solve the quadratic program of an SQP iteration: its unknowns are the steps from the point `here`.

        Bounds are those of the steps: limits less the values of the rows at the point, which a second-order correction
        may have shifted against those of the model. Rows stand in the order of `SqpWindow`: states at nodes 1 to K,
        durations, their sums, rows at nodes (those that the model has), rows over intervals, accelerations.

        Args:
            window: The window, with its bounds and penalties of soft rows.
            model: Objective and constraints, linearized; the Hessian by states (H_QQ), by changes of velocity (H_vv),
                by durations (H_tau_tau), and by states and durations (H_x_tau).
            here: The point, with the values of all rows.

        Returns:
            Status, step and multipliers; those of rows at nodes that the program does not have are 0.
        """
        bounds = window.bounds
        K, n = model.H_vv.shape
        S = len(here.point.tau)
        in_program = window.rows_in_program(model)
        values = here.rows[in_program]
        X = np.zeros((K + 1, 2 * n))  # the step of x_0, which is measured, stays 0
        arrays = QpArrays(
            H_QQ=model.H_QQ[1:],
            gradient=model.gradient[1:],
            gradient_tau=model.gradient_tau,
            H_vv=model.H_vv,
            H_x_tau=model.H_x_tau[1:],
            H_tau_tau=model.H_tau_tau,
            gap_velocity=model.gap_velocity,
            gap_tau=model.gap_tau,
            gaps=model.residuals.gaps,
            row_node=window.form.row_node[model.node_rows] - 1,
            row_jacobian=model.rows_by_x,
            interval_row=window.form.row_interval[model.interval_rows],
            interval_jacobian=model.interval_rows_by,
            interval_low=bounds.interval_low[model.interval_rows],
            interval_high=bounds.interval_high[model.interval_rows],
            interval_weight=window.interval_weights[model.interval_rows],
            low=bounds.low[in_program] - values,
            high=bounds.high[in_program] - values,
            input_low=bounds.input_low,
            input_high=bounds.input_high,
            interval_by_duration=window.form.interval_steps,
            penalty=window.row_penalties(here, in_program),
            X=X[1:],
            tau=np.zeros(S),
            gap_multipliers=np.zeros((K, n)),
            row_multipliers=np.zeros(len(values)),
        )
        status, iterations = self._solve(arrays)  # writes step and multipliers into the last four arrays
        of_node_rows = slice(window.states + 2 * S, window.states + 2 * S + len(model.node_rows))
        node_multipliers = np.zeros(len(model.residuals.rows))
        node_multipliers[model.node_rows] = arrays.row_multipliers[of_node_rows]
        return QpSolution(
            status=status,
            step=Unknowns(X, arrays.tau),
            gaps=arrays.gap_multipliers,
            rows=arrays.row_multipliers,
            node_multipliers=node_multipliers,
            iterations=iterations,
        )

    @abstractmethod
    def _solve(self, arrays: QpArrays) -> tuple[QpStatus, int]:
        """Write step and multipliers into the arrays for them; return how the program ended, and the iterations."""


class QuadraticProgram(ctypes.Structure):
    """A quadratic program as the kernel takes it; program.c declares the same structure."""

    _fields_ = (
        *((name, ctypes.c_int64) for name in ("K", "S", "node_row_count", "interval_row_count", "has_input_rows")),
        ("max_iterations", ctypes.c_int64),
        *((name, ctypes.c_double) for name in ("tolerance", "acceptable_tolerance", "initial_barrier", "bound_push")),
        *((name, ctypes.c_void_p) for name in (*ARRAYS, "report", "workspace")),
    )


LANES = 4
"""Doubles of a vector; recursion.c has the same number."""


def most_durations(coordinates: int, durations: int) -> int:
    """Return of how many durations the kernel may be that solves programs of some, as fast as a kernel of fewer."""
    return -(-(coordinates + durations) // LANES) * LANES - coordinates


def kernel_library(coordinates: int, durations: int, history: int = 0) -> Library:
    """Return the shared library of the kernel for these sizes; several numbers of durations have the same.

    Args:
        coordinates: n.
        durations: The most free durations.
        history: n for programs whose rows over intervals depend on the interval before, else 0.
    """
    source = kernel_source(coordinates, durations, history)
    return Library(source, "qp", FLAGS, tuple(kernel_symbols(coordinates, durations, history)))


def kernel_source(coordinates: int, durations: int, history: int = 0) -> str:
    """Return the C source of the kernel for these sizes."""
    sizes = f"#define N {coordinates}\n#define S_MAX {most_durations(coordinates, durations)}\n"
    sizes += f"#define HISTORY {history}\n"
    sizes += f"#define EQUALITY_WIDTH {EQUALITY_WIDTH}\n"
    folder = files("psmpc_cli.solvers")
    source = "".join((folder / name).read_text(encoding="utf-8") for name in SOURCES)
    return (
        sizes + source + layout_source(QuadraticProgram, kernel_symbols(coordinates, durations, history).program_layout)
    )


class KernelSymbols(NamedTuple):
    """The names of a kernel's functions for callers.

    They end with the sizes that it is compiled for, so that kernels of several sizes can be linked into one program.

    Attributes:
        workspace_size: Returns how many doubles of workspace a program needs.
        solve: Solves a program; returns the index of its `QpStatus`.
        program_layout: Array with the layout of a `QuadraticProgram`, see `layout_source`.
    """

    workspace_size: str
    solve: str
    program_layout: str


def kernel_symbols(coordinates: int, durations: int, history: int = 0) -> KernelSymbols:
    """Return the names of the kernel's functions for these sizes."""
    sizes = f"{coordinates}_{most_durations(coordinates, durations)}_{history}"
    return KernelSymbols(
        workspace_size=f"psmpc_qp_workspace_size_{sizes}",
        solve=f"psmpc_qp_solve_{sizes}",
        program_layout=f"psmpc_qp_program_layout_{sizes}",
    )


@dataclass(frozen=True)
class Kernel:
    """The functions of the kernel for some sizes; they take a pointer to a `QuadraticProgram`.

    Attributes:
        workspace_size: Returns how many doubles of workspace a program needs.
        solve: Solves a program; returns the index of its `QpStatus`.
    """

    workspace_size: Callable[[Any], int]
    solve: Callable[[Any], int]


@cache
def load_kernel(coordinates: int, durations: int, history: int = 0) -> Kernel | None:
    """Load the kernel, our interior-point method in C for quadratic programs, compiled for these sizes.

    Args:
        coordinates: n.
        durations: The most free durations of a program.
        history: n for programs whose rows over intervals depend on the interval before, else 0.

    Returns:
        Its functions; None where nothing can be compiled.

    Raises:
        RuntimeError: Its `QuadraticProgram` has its members elsewhere than ours.
    """
    (path,) = find_or_compile([kernel_library(coordinates, durations, history)])
    if path is None:
        return None
    loaded = ctypes.CDLL(str(path))
    symbols = kernel_symbols(coordinates, durations, history)
    require_layout(loaded, QuadraticProgram, symbols.program_layout)
    workspace_size = getattr(loaded, symbols.workspace_size)
    solve = getattr(loaded, symbols.solve)
    workspace_size.restype = ctypes.c_int64
    solve.restype = ctypes.c_int64
    return Kernel(workspace_size=workspace_size, solve=solve)


RAW_BYTES = ctypes.c_byte * 0
"""A buffer of no bytes: from any array it takes its address."""


def address(array: np.ndarray) -> int:
    """Return where the memory of a writable array begins; `array.ctypes.data` takes ten times as long."""
    return ctypes.addressof(RAW_BYTES.from_buffer(array.data))


class RiccatiQp(QpMethod):
    """Programs by our own method, which uses the structure of double integrators."""

    def __init__(self, kernel: Kernel, tolerance: float) -> None:
        self._kernel = kernel
        self._tolerance = tolerance
        self._memory = np.zeros(0)

    def _solve(self, arrays: QpArrays) -> tuple[QpStatus, int]:
        """Solve a program by our own method in C, which reads the arrays and writes the solution into the last of them.

        Returns:
            How the program ended, and the interior-point iterations.
        """
        program = QuadraticProgram(
            K=len(arrays.H_vv),
            S=len(arrays.tau),
            node_row_count=len(arrays.row_jacobian),
            interval_row_count=len(arrays.interval_row),
            has_input_rows=len(arrays.input_low) > 0,
            max_iterations=MAX_ITERATIONS,
            tolerance=self._tolerance,
            acceptable_tolerance=max(ACCEPTABLE, self._tolerance),
            initial_barrier=INITIAL_BARRIER,
            bound_push=BOUND_PUSH,
        )
        report = np.zeros(REPORT_SIZE)
        # The structure has addresses alone: this dictionary keeps their arrays alive while C uses them.
        pointed_to = {name: np.ascontiguousarray(getattr(arrays, name)) for name in ARRAYS}
        pointed_to["report"] = report
        pointed_to["workspace"] = self._workspace(program)
        for name, array in pointed_to.items():
            setattr(program, name, address(array))
        status_index = self._kernel.solve(ctypes.byref(program))
        iterations = int(report[0])
        return tuple(QpStatus)[status_index], iterations

    def _workspace(self, program: QuadraticProgram) -> np.ndarray:
        """Return memory for a program that begins at a cache line; it is kept for the next one."""
        spare = ALIGNMENT // DOUBLE_SIZE
        size = int(self._kernel.workspace_size(ctypes.byref(program))) + spare
        if size > len(self._memory):
            self._memory = np.zeros(size)
        bytes_to_line = -address(self._memory) % ALIGNMENT
        return self._memory[bytes_to_line // DOUBLE_SIZE :]


class PiqpQp(QpMethod):
    """Programs by PIQP's back-end for multistage problems.

    Unknowns are ordered node by node, the durations last:
    they couple all nodes, which PIQP knows as an arrow. A soft bound has an unknown of its own for its violation.
    """

    def __init__(self, tolerance: float) -> None:
        self._tolerance = tolerance

    def _solve(self, arrays: QpArrays) -> tuple[QpStatus, int]:
        """Solve a program by PIQP as one with sparse matrices, and write the solution into the last of the arrays.

        PIQP may return a solution of a program that is not convex, and does not say so: the curvature of the objective
        along the step tells.

        Returns:
            How the program ended, and the interior-point iterations.
        """
        unknowns = _order_unknowns(arrays)
        kinds = _sort_rows(arrays, unknowns)
        hessian = _sparse(unknowns.count, unknowns.count, _hessian_entries(arrays, unknowns))
        if arrays.interval_weight.any():
            hessian += _hessian_of_rows(arrays, unknowns)
        solver = self._set_up(arrays, unknowns, kinds, hessian)
        piqp_status = solver.solve()
        result = solver.result
        _write_solution(result, arrays, unknowns, kinds)
        status = _status(piqp_status, result.info)
        if status is QpStatus.SOLVED and _curvature(hessian, np.array(result.x)) < -ACCEPTABLE:
            status = QpStatus.NOT_CONVEX
        return status, int(result.info.iter)

    def _set_up(
        self, arrays: QpArrays, unknowns: "_Unknowns", kinds: "_RowKinds", hessian: csr_array
    ) -> piqp.SparseSolver:
        """Return PIQP's solver with the program in it, written as PIQP takes it.

            min  1/2 x'P x + c'x   s.t.   A x = b,   h_l <= G x <= h_u,   x_l <= x <= x_u.

        x are the steps and, for each soft row, by how much it is violated, s >= 0, which costs its penalty times s. A
        soft row c x with low <= c x <= high becomes the two rows c x + s >= low and c x - s <= high.

        Args:
            arrays: The program.
            unknowns: Where its unknowns stand in x.
            kinds: Which of its rows become equations, bounds of x, and inequalities.
            hessian: Upper triangle of P.
        """
        size = unknowns.count
        row_count = len(arrays.low)
        gap_rows = _sparse(arrays.gaps.size, size, _gap_entries(arrays, unknowns))
        rows = _sparse(row_count, size, _row_entries(arrays, unknowns))
        soft_rows = np.flatnonzero(arrays.penalty)
        violation = _sparse(row_count, size, [(soft_rows, unknowns.violations, 1.0)])

        # Costs of the unknowns, and their bounds.
        cost = np.zeros(size)
        cost[unknowns.X] = arrays.gradient
        cost[unknowns.tau] = arrays.gradient_tau
        cost[unknowns.violations] = arrays.penalty[soft_rows]
        lowest = np.full(size, -np.inf)
        highest = np.full(size, np.inf)
        lowest[unknowns.violations] = 0.0
        lowest[kinds.boxed_unknowns] = arrays.low[kinds.box]
        highest[kinds.boxed_unknowns] = arrays.high[kinds.box]

        # Inequalities: soft rows at their lower bounds, at their upper bounds, then hard rows.
        low = [arrays.low[kinds.soft_low], np.full(kinds.soft_high.sum(), -np.inf), arrays.low[kinds.hard]]
        high = [np.full(kinds.soft_low.sum(), np.inf), arrays.high[kinds.soft_high], arrays.high[kinds.hard]]
        inequalities = [
            (rows + violation)[kinds.soft_low],
            (rows - violation)[kinds.soft_high],
            rows[kinds.hard],
        ]
        equation_values = (arrays.low[kinds.equation] + arrays.high[kinds.equation]) / 2

        solver = piqp.SparseSolver()
        solver.settings.kkt_solver = piqp.KKTSolver.sparse_multistage
        solver.settings.max_iter = MAX_ITERATIONS
        solver.settings.reg_finetune_lower_limit = SMALLEST_REGULARIZATION
        solver.settings.eps_abs = self._tolerance
        solver.settings.eps_duality_gap_abs = self._tolerance
        solver.setup(
            P=hessian.tocsc(),
            c=cost,
            A=vstack([gap_rows, rows[kinds.equation]], format="csc"),
            b=np.concatenate([-arrays.gaps.ravel(), equation_values]),
            G=vstack(inequalities, format="csc"),
            h_l=np.concatenate(low),
            h_u=np.concatenate(high),
            x_l=lowest,
            x_u=highest,
        )
        return solver


@dataclass(frozen=True, eq=False)
class _Unknowns:
    """Where the unknowns of PIQP's program stand.

    Attributes:
        X: Of the steps of [Q; v] at nodes 1 .. K, (K, 2n).
        violations: Of the soft rows, in their order; those of a node stand behind its state.
        tau: Of the steps of the durations, (S,).
        count: How many there are.
    """

    X: np.ndarray
    violations: np.ndarray
    tau: np.ndarray
    count: int

    @property
    def Q(self) -> np.ndarray:
        """Those of the positions, (K, n)."""
        return self.X[:, : self.X.shape[1] // 2]

    @property
    def v(self) -> np.ndarray:
        """Those of the velocities, (K, n)."""
        return self.X[:, self.X.shape[1] // 2 :]

    @property
    def of_rows(self) -> np.ndarray:
        """Those that the first rows of C are, the states and the durations, (2 n K + S,)."""
        return np.concatenate([self.X.ravel(), self.tau])


@dataclass(frozen=True, eq=False)
class _RowKinds:
    """What PIQP makes of the rows of C: masks of rows, (R,), and some unknowns.

    Attributes:
        equation: Rows whose bounds are equal.
        box: Rows that are an unknown between hard bounds.
        boxed_unknowns: These unknowns.
        soft_low, soft_high: Rows with a soft bound below, above.
        hard: Other rows with bounds.
    """

    equation: np.ndarray
    box: np.ndarray
    boxed_unknowns: np.ndarray
    soft_low: np.ndarray
    soft_high: np.ndarray
    hard: np.ndarray


def _order_unknowns(arrays: QpArrays) -> _Unknowns:
    """Return where the unknowns stand in PIQP's x: node by node its state and violations of soft rows, then durations.

    In this order the matrices are banded but for the columns of the durations, which couple all nodes, and PIQP's
    back-end for multistage problems is fast. A soft row has an unknown, its violation, that costs.

    Args:
        arrays: The program; a row is soft if its penalty is positive.
    """
    K, state_size = arrays.X.shape
    S = len(arrays.tau)
    # Rows of C: states, then durations and their sums, then rows at nodes. States and rows at nodes may be soft.
    state_rows = np.arange(K * state_size)
    node_rows = arrays.X.size + 2 * S + np.arange(len(arrays.row_node))
    is_soft_state = arrays.penalty[state_rows] > 0
    is_soft_node_row = arrays.penalty[node_rows] > 0
    node_of_state = state_rows // state_size
    node_of_violation = np.concatenate([node_of_state[is_soft_state], arrays.row_node[is_soft_node_row]])
    # Sorted by node, in which a stable sort leaves states before violations.
    node_of_unknown = np.concatenate([node_of_state, node_of_violation])
    place = np.empty(len(node_of_unknown), int)
    place[np.argsort(node_of_unknown, kind="stable")] = np.arange(len(node_of_unknown))
    return _Unknowns(
        X=place[: K * state_size].reshape(K, state_size),
        violations=place[K * state_size :],
        tau=len(node_of_unknown) + np.arange(S),
        count=len(node_of_unknown) + S,
    )


def _sort_rows(arrays: QpArrays, unknowns: _Unknowns) -> _RowKinds:
    """Sort the rows low <= C x <= high of a program into the kinds that PIQP takes in different ways.

    - A hard row whose bounds coincide is an equation.
    - The first rows of C are each a single unknown (a state or a duration): hard bounds of these are a box.
    - A soft row is an inequality for each of its finite bounds, since it may be violated at either.
    - All other rows with a bound are inequalities.

    Returns:
        Masks of the rows, and the unknowns in the box.
    """
    single_unknowns = unknowns.of_rows
    is_single_unknown = np.arange(len(arrays.low)) < len(single_unknowns)
    has_low = np.isfinite(arrays.low)
    has_high = np.isfinite(arrays.high)
    is_soft = arrays.penalty > 0
    equation = ~is_soft & (arrays.high <= arrays.low + EQUALITY_WIDTH)
    box = ~is_soft & ~equation & is_single_unknown
    return _RowKinds(
        equation=equation,
        box=box,
        boxed_unknowns=single_unknowns[box[: len(single_unknowns)]],
        soft_low=is_soft & has_low,
        soft_high=is_soft & has_high,
        hard=~is_soft & ~equation & ~box & (has_low | has_high),
    )


def _write_solution(result: piqp.Result, arrays: QpArrays, unknowns: _Unknowns, kinds: _RowKinds) -> None:
    """Write PIQP's step and multipliers into the program's arrays for them.

    A multiplier there is positive at the upper bound of a row and negative at the lower one; PIQP has one for each.

    Args:
        result: What PIQP returned: x, and multipliers of equations (y), inequalities (z_l, z_u) and box (z_bl, z_bu).
        arrays: The program; the last four arrays are written.
        unknowns: Where the unknowns stand in x.
        kinds: What PIQP was given each row as.
    """
    x = np.array(result.x)
    equation_multipliers = np.array(result.y)
    inequality_multipliers = np.array(result.z_u) - np.array(result.z_l)
    box_multipliers = np.array(result.z_bu) - np.array(result.z_bl)
    gap_count = arrays.gaps.size
    inequality_rows = [np.flatnonzero(mask) for mask in (kinds.soft_low, kinds.soft_high, kinds.hard)]

    arrays.X[:] = x[unknowns.X]
    arrays.tau[:] = x[unknowns.tau]
    arrays.gap_multipliers[:] = equation_multipliers[:gap_count].reshape(arrays.gaps.shape)  # gaps are equations too
    arrays.row_multipliers[kinds.equation] = equation_multipliers[gap_count:]
    arrays.row_multipliers[kinds.box] = box_multipliers[kinds.boxed_unknowns]
    # A soft row is two inequalities: their multipliers add up.
    np.add.at(arrays.row_multipliers, np.concatenate(inequality_rows), inequality_multipliers)


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
    """Return how a program ended by PIQP's status, or by what it reached where its iterations ran out."""
    if status == piqp.Status.PIQP_PRIMAL_INFEASIBLE:
        return QpStatus.INFEASIBLE
    is_acceptable = max(info.primal_res, info.dual_res, abs(info.duality_gap)) <= ACCEPTABLE
    return QpStatus.SOLVED if status == piqp.Status.PIQP_SOLVED or is_acceptable else QpStatus.FAILED


Entries = tuple[ArrayLike, ArrayLike, ArrayLike]
"""Rows, columns and values of some entries of a sparse matrix, broadcast to one shape."""


def _sparse(rows: int, columns: int, blocks: Sequence[Entries]) -> csr_array:
    """Return a sparse matrix; entries in the same place add up."""
    entries = [np.broadcast_arrays(*block) for block in blocks]
    row, column, value = (np.concatenate([entry[i].ravel() for entry in entries]) for i in range(3))
    return csr_array((value, (row, column)), shape=(rows, columns))


def _hessian_entries(arrays: QpArrays, unknowns: _Unknowns) -> list[Entries]:
    """Return the entries of the upper triangle of the Hessian H, as (rows, columns, values) that broadcast.

    They are those by positions, by velocities, by states and durations, and by durations. Velocities cost
    R_k (v_k+1 - v_k)^2 / 2 over interval k, with steps v_0 = 0: R on the diagonal at both nodes, -R between them.

    Args:
        arrays: The program.
        unknowns: Where its unknowns stand in PIQP's x.
    """
    Q = unknowns.Q
    v = unknowns.v
    tau = unknowns.tau
    R = -arrays.H_vv
    i, j = np.triu_indices(Q.shape[1])
    a, b = np.triu_indices(len(tau))
    return [
        (Q[:, i], Q[:, j], arrays.H_QQ[:, i, j]),
        (v, v, R),
        (v[:-1], v[:-1], R[1:]),
        (v[:-1], v[1:], -R[1:]),
        (unknowns.X[..., None], tau, arrays.H_x_tau),
        (tau[a], tau[b], arrays.H_tau_tau[a, b]),
    ]


def _hessian_of_rows(arrays: QpArrays, unknowns: _Unknowns) -> csr_array:
    """Return the upper triangle of what the rows over intervals add to H, C' diag(weight) C."""
    first = arrays.X.size + 2 * len(arrays.tau) + len(arrays.row_node)
    of_low = slice(first, first + len(arrays.interval_row))  # of a residual low is 0: it is the row itself
    C = _sparse(len(arrays.low), unknowns.count, _row_entries(arrays, unknowns))[of_low]
    return csr_array(triu(C.T @ (diags_array(arrays.interval_weight) @ C)))


def _gap_entries(arrays: QpArrays, unknowns: _Unknowns) -> list[Entries]:
    """Return the entries of the Jacobian of the gaps, as (rows, columns, values) that broadcast.

    The equations of the gaps say that positions follow from velocities over interval k, which depends on its length:
    Q_k+1 - Q_k + gap_velocity_k [v_k; v_k+1] + gap_tau_k tau = -gap. The step of x_0 is 0.

    Args:
        arrays: The program.
        unknowns: Where its unknowns stand in PIQP's x.
    """
    Q = unknowns.Q
    v = unknowns.v
    by_velocity = arrays.gap_velocity[:, :, None]
    row = np.arange(Q.size).reshape(Q.shape)
    return [
        # By the state at the end of each interval, at its beginning but for that of the first, and by durations.
        (row, Q, 1.0),
        (row, v, by_velocity[:, 1]),
        (row[1:], Q[:-1], -1.0),
        (row[1:], v[:-1], by_velocity[1:, 0]),
        (row[..., None], unknowns.tau, arrays.gap_tau),
    ]


def _row_entries(arrays: QpArrays, unknowns: _Unknowns) -> list[Entries]:
    """Return the entries of the matrix C of the rows low <= C x <= high, as (rows, columns, values) that broadcast.

    Unknowns are the states x_k and the durations tau, on which the length h of each interval depends. A bound over h,
    low h <= g, is written as a row g - low h >= 0, since h is unknown. The rows stand in this order:

        x, tau; sums of tau; constraints at nodes; g - low h and then g - high h of constraints g over intervals;
        dv - low h and then dv - high h of accelerations dv / h.

    Args:
        arrays: The program.
        unknowns: Where its unknowns stand in PIQP's x.
    """
    tau = unknowns.tau
    single_unknowns = unknowns.of_rows
    node_row_count = len(arrays.row_jacobian)
    interval_row_count = len(arrays.interval_row)
    first_sum = len(single_unknowns)
    first_node_row = first_sum + len(tau)
    first_interval_row = first_node_row + node_row_count
    first_input_row = first_interval_row + 2 * interval_row_count
    last, summand = np.tril_indices(len(tau))  # the sum up to duration `last` has each `summand` up to it
    node_row = first_node_row + np.arange(node_row_count)
    return [
        (np.arange(len(single_unknowns)), single_unknowns, 1.0),
        (first_sum + last, tau[summand], 1.0),
        (node_row[:, None], unknowns.X[arrays.row_node], arrays.row_jacobian),
        *_interval_row_entries(arrays, unknowns, first_interval_row, arrays.interval_low),
        *_interval_row_entries(arrays, unknowns, first_interval_row + interval_row_count, arrays.interval_high),
        *_input_row_entries(arrays, unknowns, first_input_row, arrays.input_low),
        *_input_row_entries(arrays, unknowns, first_input_row + arrays.input_low.size, arrays.input_high),
    ]


def _interval_row_entries(arrays: QpArrays, unknowns: _Unknowns, first: int, bound: np.ndarray) -> list[Entries]:
    """Return the entries of rows g - bound h: constraints g over intervals, h being the length of their interval.

    Args:
        arrays: The program.
        unknowns: Where its unknowns stand in PIQP's x.
        first: The first of these rows in C.
        bound: Bound over h of each of them, (I,).
    """
    X = unknowns.X
    state_size = X.shape[1]
    S = len(unknowns.tau)
    k = arrays.interval_row
    by_begin, by_end, by_tau, by_v_before = np.split(
        arrays.interval_jacobian, [state_size, 2 * state_size, 2 * state_size + S], axis=1
    )
    row = first + np.arange(len(k))[:, None]
    by_tau = by_tau - bound[:, None] * arrays.interval_by_duration[k]
    # X has nodes 1 to K: interval k ends at X[k] and begins at X[k - 1]; interval 0 begins at the measured state.
    begins_free = k > 0
    entries: list[Entries] = [
        (row, X[k], by_end),
        (row[begins_free], X[k[begins_free] - 1], by_begin[begins_free]),
        (row, unknowns.tau, by_tau),
    ]
    has_history = (k > 1) & (by_v_before.shape[1] > 0)  # the interval before does not begin at the measured state
    if has_history.any():
        entries.append((row[has_history], unknowns.v[k[has_history] - 2], by_v_before[has_history]))
    return entries


def _input_row_entries(arrays: QpArrays, unknowns: _Unknowns, first: int, bound: np.ndarray) -> list[Entries]:
    """Return the entries of the limits of accelerations, as rows of the changes of velocity: dv - bound h.

    h, the length of an interval, depends on the durations tau.

    Args:
        arrays: The program.
        unknowns: Where its unknowns stand in PIQP's x.
        first: The first of these rows in C.
        bound: Bound of each acceleration, (K, n); (0, n) where none has one.
    """
    if not bound.size:
        return []
    v = unknowns.v
    row = first + np.arange(bound.size).reshape(bound.shape)
    by_tau = -bound[..., None] * arrays.interval_by_duration[:, None]
    return [(row, v, 1.0), (row[1:], v[:-1], -1.0), (row[..., None], unknowns.tau, by_tau)]
