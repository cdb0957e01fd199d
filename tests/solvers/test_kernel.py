"""Our own method under the compiler's warnings and sanitizers, on programs of runs."""

import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from psmpc_cli.native.library import CompilationError, find_compiler
from psmpc_cli.solvers.quadratic import BARRIER, MAX_ITERATIONS, NEARLY, PUSH, QpMethod, QpStatus, kernel_source

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
    p.work = aligned_alloc(64, ((size_t)psmpc_qp_memory(&p) * sizeof(double) + 63) / 64 * 64);
    int64_t status = psmpc_qp_solve(&p);
    printf("%d %zu", (int)status, sizeof(Program));
    for (size_t i = 0; i < sizeof X / sizeof *X; i++) printf(" %.17g", X[i]);
    free(p.work);
    return 0;
}}
"""

POINTERS = (
    *("positions", "gradient", "gradient_tau", "coupling", "arrow", "durations", "gap_velocity", "gap_tau", "gaps"),
    *("end_node", "end_rows", "low", "high", "input_low", "input_high", "share", "penalty", "work", "X", "tau"),
    *("gap_multipliers", "multipliers", "report"),
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
    scalars = [grid.K, len(numbers["end_rows"]), int(len(numbers["input_low"]) > 0), MAX_ITERATIONS, int(method.soft)]
    scalars += [tolerance, max(NEARLY, tolerance), BARRIER, PUSH]
    arrays = [_declared(name, numbers[name]) for name in POINTERS if name != "work"]
    pointers = ", ".join("NULL" if name == "work" else name for name in POINTERS)
    values = ", ".join(repr(value) for value in scalars)
    main = MAIN.format(arrays="\n    ".join(arrays), numbers=values, pointers=pointers)
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
