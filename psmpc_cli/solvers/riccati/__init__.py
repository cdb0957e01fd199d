"""The quadratic programs of a window by an interior-point method of our own, in C.

It uses the structure of double integrators. One library is compiled for each number of coordinates and of durations.
"""

import ctypes
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path

import numpy as np

from psmpc_cli.native.library import library
from psmpc_cli.ocp.gauss_newton import Linearization, Point, VelocityForm
from psmpc_cli.ocp.window import PENALTY, shares_of_time
from psmpc_cli.solvers.qp_multistage import MAX_ITERATIONS, NEARLY
from psmpc_cli.solvers.sqp_window import QpShape, QpSolution, QpStatus, WindowBounds

SOURCES = ("recursion.c", "program.c", "interior_point.c")

FLAGS = ("-O3", "-march=native", "-fopenmp-simd", "-fno-math-errno")
"""Without -ffast-math: a step that is not finite has to be noticed."""

SOLVED, INFEASIBLE, FAILED = range(3)
"""What a solve returns."""


class Program(ctypes.Structure):
    """A quadratic program as the C code takes it; see `Program` in program.c."""

    _fields_ = (
        [(name, ctypes.c_int64) for name in ("K", "ends", "given", "inputs", "limit", "soft")]
        + [(name, ctypes.c_double) for name in ("tolerance", "nearly", "barrier", "push")]
        + [(name, ctypes.c_void_p) for name in ("positions", "gradient", "gradient_tau", "coupling", "arrow")]
        + [(name, ctypes.c_void_p) for name in ("durations", "gap_velocity", "gap_tau", "gaps", "end_node")]
        + [(name, ctypes.c_void_p) for name in ("end_rows", "given_rows", "given_change", "low", "high")]
        + [(name, ctypes.c_void_p) for name in ("input_low", "input_high", "share", "penalty", "work", "X", "tau")]
        + [(name, ctypes.c_void_p) for name in ("gap_multipliers", "multipliers", "given_multipliers", "report")]
    )


@dataclass(frozen=True, eq=False)
class Kernel:
    """The compiled functions."""

    library: ctypes.CDLL

    def memory(self, program: Program) -> np.ndarray:
        """Return memory for programs of this size, aligned for vectors of 64 bytes."""
        memory = np.zeros(int(self.library.psmpc_qp_memory(ctypes.byref(program))) + 8)
        return memory[-memory.ctypes.data % 64 // 8 :]

    def solve(self, program: Program) -> int:
        """Solve a program and return how it ended."""
        return int(self.library.psmpc_qp_solve(ctypes.byref(program)))


def kernel_library(coordinates: int, durations: int) -> Path | None:
    """Return the kernel's shared library for these sizes; None where nothing can be compiled."""
    sizes = f"#define N {coordinates}\n#define S {durations}\n"
    code = sizes + "".join(files(__name__).joinpath(name).read_text(encoding="utf-8") for name in SOURCES)
    return library(code, "qp", FLAGS)


@cache
def load_kernel(coordinates: int, durations: int) -> Kernel | None:
    """Return the kernel for these sizes; None where nothing can be compiled."""
    path = kernel_library(coordinates, durations)
    if path is None:
        return None
    compiled = ctypes.CDLL(str(path))
    compiled.psmpc_qp_memory.restype = compiled.psmpc_qp_solve.restype = ctypes.c_int64
    return Kernel(compiled)


STATUS = {SOLVED: QpStatus.SOLVED, INFEASIBLE: QpStatus.INFEASIBLE, FAILED: QpStatus.FAILED}

BARRIER = 1e-2
"""Product of slack and multiplier it starts from: 1e-2 was best of 1e-5 to 1e-2."""

PUSH = 3e-3
"""The smallest slack it starts from [m, rad, m/s, rad/s, s]."""


class RiccatiQp:
    """The programs of windows of one shape."""

    def __init__(self, form: VelocityForm, shape: QpShape, tolerance: float, kernel: Kernel) -> None:
        self.form, self.shape, self._kernel = form, shape, kernel
        layout = form.grid
        self._n, self._K, self._S = layout.n, layout.K, layout.switches
        self._inputs = bool(shape.input_low or shape.input_high)
        self._share = form.interval_steps
        node = [np.full(stage.end_rows, layout.first_node[s + 1] - 1) for s, stage in enumerate(form.stages)]
        self._end_node = np.concatenate(node).astype(np.int64)
        given = [np.arange(self._S) <= s for s in shape.tied] + [np.arange(self._S) == s for s in shape.fixed]
        self._given_rows = np.array(given, float).reshape(len(given), self._S)
        self._free = np.isin(np.arange(self._S), shape.fixed, invert=True)
        self._program = Program(
            K=self._K,
            ends=len(self._end_node),
            given=len(given),
            inputs=self._inputs,
            limit=MAX_ITERATIONS,
            tolerance=tolerance,
            nearly=max(NEARLY, tolerance),
            barrier=BARRIER,
            push=PUSH,
            soft=shape.soft,
        )
        self._memory = kernel.memory(self._program)

    def solve(self, model: Linearization, limits: WindowBounds, point: Point, horizon: float) -> QpSolution:
        """Solve the program about a point."""
        low, high = self._row_limits(model, limits, point, horizon)
        found = {
            "X": np.zeros((self._K + 1, 2 * self._n)),
            "tau": np.zeros(self._S),
            "gap_multipliers": np.zeros((self._K, self._n)),
            "multipliers": np.zeros(len(low)),
            "given_multipliers": np.zeros(len(self._given_rows)),
            "report": np.zeros(4),
        }
        tied = [limits.until[s] - point.tau[: s + 1].sum() for s in self.shape.tied]
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
            "end_node": self._end_node,
            "end_rows": self._end_rows(model),
            "given_rows": self._given_rows,
            "given_change": np.array([*tied, *(limits.tau_low - point.tau)[list(self.shape.fixed)]]),
            "low": low,
            "penalty": PENALTY * shares_of_time(self.form.steps(point, horizon))[1:],
            "high": high,
            "share": self._share,
            "work": self._memory,
            **found,
            "X": found["X"][1:],
        }
        if self._inputs:
            numbers["input_low"] = np.where(np.isfinite(limits.input_low), limits.input_low, 0.0)
            numbers["input_high"] = np.where(np.isfinite(limits.input_high), limits.input_high, 0.0)
        held = {name: np.ascontiguousarray(array) for name, array in numbers.items()}  # alive while C reads them
        for name, array in held.items():
            setattr(self._program, name, array.ctypes.data)
        return self._solution(STATUS[self._kernel.solve(self._program)], found)

    def _end_rows(self, model: Linearization) -> np.ndarray:
        """Return the end rows' derivatives by [Q; Qdot] at their nodes, (rows, 2n)."""
        rows, at = np.zeros((len(self._end_node), 2 * self._n)), 0
        for s, derivatives in model.end_derivatives.items():
            row, column = self.form.stages[s].end_places
            rows[at + row, column] = derivatives
            at += self.form.stages[s].end_rows
        return rows

    def _row_limits(
        self, model: Linearization, limits: WindowBounds, point: Point, horizon: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return low and high of the rows: states, durations, their sum, end rows, accelerations from either side."""
        low = [(limits.X_low - point.X[1:]).ravel(), np.where(self._free, limits.tau_low - point.tau, -np.inf)]
        high = [(limits.X_high - point.X[1:]).ravel(), np.where(self._free, limits.tau_high - point.tau, np.inf)]
        low.append(np.array([-np.inf]))
        high.append(np.array([limits.together - point.tau.sum() if self._S else np.inf]))
        for s, rows in model.at.ends.items():
            low.append(limits.ends[s][0] - rows)
            high.append(limits.ends[s][1] - rows)
        if self._inputs:
            h, none = self.form.steps(point, horizon), np.full(self._K * self._n, np.inf)
            dv = np.diff(point.X[:, self._n :], axis=0)
            low += [(h * limits.input_low - dv).ravel(), -none]
            high += [none, (h * limits.input_high - dv).ravel()]
        return np.concatenate(low), np.concatenate(high)

    def _solution(self, status: QpStatus, found: dict[str, np.ndarray]) -> QpSolution:
        n, K, S, given = self._n, self._K, self._S, found["given_multipliers"]
        rows, size = found["multipliers"], 2 * n * K
        at, ends = size + S + 1, {}
        for s, stage in enumerate(self.form.stages):
            if stage.end_rows:
                ends[s], at = rows[at : at + stage.end_rows], at + stage.end_rows
        return QpSolution(
            status=status,
            shape=self.shape,
            step=Point(found["X"], found["tau"]),
            gaps=found["gap_multipliers"],
            until=given[: len(self.shape.tied)],
            fixed=given[len(self.shape.tied) :],
            together=float(rows[size + S]),
            ends=ends,
            inputs=rows[at:].reshape(2, K, n).sum(axis=0) if self._inputs else np.zeros((K, n)),
            X=rows[:size].reshape(K, 2 * n),
            tau=rows[size : size + S],
            iterations=int(found["report"][0]),
        )
