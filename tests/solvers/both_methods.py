"""The two methods for the quadratic programs: our own, and PIQP's, which is held against it."""

import pytest
from psmpc_cli.solvers.qp_solution import QpSolution
from psmpc_cli.solvers.riccati.program import RiccatiQp

from psmpc_cli.native.library import CompilationError, find_compiler
from psmpc_cli.solvers.qp_multistage import MultistageQp
from psmpc_cli.solvers.riccati import load_kernel

from ..random_programs import Task


def our_method(task: Task, tolerance: float = 1e-9) -> RiccatiQp:
    """Our method, which is C: a machine without a compiler has but the other one, and nothing to hold against it.

    Where there is a compiler, a method that it cannot make is a fault.
    """
    try:
        find_compiler()
    except CompilationError as error:
        pytest.skip(str(error))
    kernel = load_kernel(task.form.layout.n, task.form.layout.switches)
    assert kernel is not None
    return RiccatiQp(task.form, task.limits.shape, tolerance, kernel)


def ours(task: Task, tolerance: float = 1e-9) -> QpSolution:
    """Solve a program by our method."""
    return our_method(task, tolerance).solve(task.model, task.limits, task.point, task.horizon)


def piqp(task: Task, tolerance: float = 1e-9) -> QpSolution:
    """Solve a program by PIQP."""
    qp = MultistageQp(task.form, task.limits.shape, tolerance)
    return qp.solve(task.model, task.limits, task.point, task.horizon)
