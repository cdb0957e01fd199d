"""The compiled interior-point method: one library for each number of coordinates and of free durations."""

import ctypes
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path

import numpy as np

from psmpc_cli.native.library import library

SOURCES = ("recursion.c", "program.c", "soft.c", "newton.c", "interior_point.c")

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
    code = sizes + "".join(files(__package__).joinpath(name).read_text(encoding="utf-8") for name in SOURCES)
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
