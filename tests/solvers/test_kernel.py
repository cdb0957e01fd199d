"""Our own method under the compiler's warnings and sanitizers, on programs of runs."""

import ctypes
import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from psmpc_cli.native.library import CompilationError, find_compiler
from psmpc_cli.solvers.quadratic import (
    ACCEPTABLE,
    BOUND_PUSH,
    INITIAL_BARRIER,
    MAX_ITERATIONS,
    Program,
    QpMethod,
    QpStatus,
    kernel_source,
    kernel_symbols,
)

from .random_programs import Task, random_task
from .test_programs import ours

STRICT = ("-std=c11", "-Wall", "-Wextra", "-Werror", "-Wno-unknown-pragmas", "-Wno-psabi")
SANITIZED = ("-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")

MAIN = """
#include <stdio.h>
#include <stdlib.h>
int main(void) {{
    {arrays}
    Program p = {{{numbers}, {pointers}}};
    p.work = aligned_alloc(64, ((size_t){memory}(&p) * sizeof(double) + 63) / 64 * 64);
    int64_t status = {solve}(&p);
    printf("%d %zu", (int)status, sizeof(Program));
    for (size_t i = 0; i < sizeof X / sizeof *X; i++) printf(" %.17g", X[i]);
    free(p.work);
    return 0;
}}
"""

POINTERS = (
    *("positions", "gradient", "gradient_tau", "coupling", "arrow", "durations", "gap_velocity", "gap_tau", "gaps"),
    *("row_node", "row_jacobian", "low", "high", "input_low", "input_high", "interval_by_duration", "penalty"),
    *("work", "X", "tau", "gap_multipliers", "multipliers", "report"),
)
"""The members of `Program` behind its numbers, in order."""


class Recorded(QpMethod):
    """Records the numbers of a program instead of solving it."""

    def _solve(self, numbers: dict[str, np.ndarray], soft: bool) -> tuple[QpStatus, int]:
        self.numbers = {**numbers, "report": np.zeros(4)}
        self.soft = soft
        return QpStatus.FAILED, 0


def program_of(task: Task, tolerance: float) -> str:
    """The C source of a program that solves one quadratic program and prints status, size and step."""
    method = Recorded()
    method.solve(task.window, task.model, task.point)
    numbers, grid = method.numbers, task.window.form.grid
    scalars = [
        grid.K,
        len(numbers["row_jacobian"]),
        int(len(numbers["input_low"]) > 0),
        MAX_ITERATIONS,
        int(method.soft),
    ]
    scalars += [tolerance, max(ACCEPTABLE, tolerance), INITIAL_BARRIER, BOUND_PUSH]
    arrays = [_declared(name, numbers[name]) for name in POINTERS if name != "work"]
    pointers = ", ".join("NULL" if name == "work" else name for name in POINTERS)
    values = ", ".join(repr(value) for value in scalars)
    memory, solve, _ = kernel_symbols(grid.n, grid.switches)
    main = MAIN.format(arrays="\n    ".join(arrays), numbers=values, pointers=pointers, memory=memory, solve=solve)
    return kernel_source(grid.n, grid.switches) + main


def _declared(name: str, values: np.ndarray) -> str:
    kind = "int64_t" if values.dtype.kind == "i" else "double"
    each = [repr(value).replace("inf", "INFINITY") for value in values.ravel().tolist()] or ["0"]
    return f"static {kind} {name}[] = {{{', '.join(each)}}};"


def run(source: str, flags: Sequence[str], folder: Path) -> list[str]:
    (folder / "kernel.c").write_text(source)
    command = [*find_compiler(), *STRICT, *flags, "kernel.c", "-o", "kernel", "-lm"]
    compiled = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert not compiled.returncode, compiled.stderr
    done = subprocess.run([folder / "kernel"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout.split()


TWO_SIZES = """
#include <stdint.h>
#include <stdio.h>
{declarations}
int main(void) {{ printf("{format}", {calls}); return 0; }}
"""


@pytest.mark.slow
def test_kernels_of_two_sizes_are_linked_side_by_side(tmp_path: Path) -> None:
    """Every name for callers has the sizes in it, and no other name leaves its file."""
    try:
        compiler = find_compiler()
    except CompilationError as error:
        pytest.skip(str(error))
    sizes = [(9, 1), (9, 2), (7, 1)]
    names = [kernel_symbols(*size)[2] for size in sizes]
    for number, size in enumerate(sizes):
        (tmp_path / f"kernel{number}.c").write_text(kernel_source(*size))
    declarations = "\n".join(f"int64_t {name}(void);" for name in names)
    calls = ", ".join(f"(int){name}()" for name in names)
    main = TWO_SIZES.format(declarations=declarations, format=" ".join(["%d"] * len(names)), calls=calls)
    (tmp_path / "main.c").write_text(main)
    sources = [f"kernel{number}.c" for number in range(len(sizes))]
    command = [*compiler, *STRICT, "-O1", *sources, "main.c", "-o", "main", "-lm"]
    compiled = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert not compiled.returncode, compiled.stderr
    done = subprocess.run([tmp_path / "main"], capture_output=True, text=True, check=False)
    assert done.stdout.split() == [str(ctypes.sizeof(Program))] * len(sizes)


@pytest.mark.slow
@pytest.mark.parametrize("soft", [False, True], ids=["hard", "soft"])
@pytest.mark.parametrize(("nodes", "what"), [((5,), ""), ((4, 6), "inputs fixed"), ((3, 4, 5), "equal tied")])
def test_the_kernel_has_no_warning_and_touches_no_foreign_memory(
    nodes: tuple[int, ...], what: str, soft: bool, tmp_path: Path
) -> None:
    try:
        find_compiler()
    except CompilationError as error:
        pytest.skip(str(error))
    task = random_task(np.random.default_rng(3), nodes, set(what.split())).with_bounds(soft=soft)
    found = ours(task)
    status, _, *step = run(program_of(task, 1e-9), SANITIZED, tmp_path)
    assert tuple(QpStatus)[int(status)] is found.status
    np.testing.assert_allclose(np.array(step, float), found.step.X[1:].ravel(), rtol=0, atol=1e-7)
