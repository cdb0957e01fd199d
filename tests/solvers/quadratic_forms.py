"""Shared by the tests of quadratic and others."""

import pytest

from psmpc_cli.native.library import CompilationError, find_compiler
from psmpc_cli.solvers.quadratic import QpSolution, RiccatiQp, load_kernel

from .random_programs import Task


def our_method(task: Task, tolerance: float = 1e-9) -> RiccatiQp:
    """Our method, which is C; without a compiler there is none, and the test is skipped.

    Where there is a compiler that cannot make it, the test fails.
    """
    try:
        find_compiler()
    except CompilationError as error:
        pytest.skip(str(error))
    form = task.window.form
    kernel = load_kernel(form.grid.n, form.grid.switches, form.history)
    assert kernel is not None
    return RiccatiQp(kernel, tolerance)


def ours(task: Task, tolerance: float = 1e-9) -> QpSolution:
    """Solve a program by our method."""
    return our_method(task, tolerance).solve(task.window, task.model, task.here)
