"""Our own method as C: several sizes in one program, the compiler's warnings, sanitizers, on random programs."""

import ctypes
import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from psmpc_cli.native.library import CompilationError, find_compiler
from psmpc_cli.solvers import quadratic
from psmpc_cli.solvers.quadratic import (
    ACCEPTABLE,
    ARRAYS,
    BOUND_PUSH,
    INITIAL_BARRIER,
    MAX_ITERATIONS,
    REPORT_SIZE,
    QpArrays,
    QpMethod,
    QpSolution,
    QpStatus,
    QuadraticProgram,
    kernel_source,
    kernel_symbols,
    load_kernel,
)

from . import random_programs
from .quadratic_forms import ours
from .random_programs import Task, random_task, soft_rows

STRICT = ("-std=c11", "-Wall", "-Wextra", "-Werror", "-Wno-unknown-pragmas", "-Wno-psabi")
SANITIZED = ("-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")

TOLERANCE = 1e-9
"""Residuals and complementarity at which a program is solved."""

STEP_DIFFERENCE = 1e-10
"""Other flags round differently: on these programs steps differed by 1e-12 at most."""

SOLVE = """
#include <stdio.h>
#include <stdlib.h>
int {name}(void) {{
    {arrays}
    double report[{report_size}];
    QuadraticProgram program = {{{members}, .report = report}};
    size_t workspace_size = (size_t){symbols.workspace_size}(&program) * sizeof(double);
    program.workspace = aligned_alloc(64, (workspace_size + 63) / 64 * 64);
    int64_t status = {symbols.solve}(&program);
    printf("%d", (int)status);
    for (size_t i = 0; i < sizeof X / sizeof *X; i++) printf(" %.17g", X[i]);
    printf("\\n");
    free(program.workspace);
    return 0;
}}
"""


class Recorded(QpMethod):
    """Records the arrays of a program instead of solving it."""

    def _solve(self, arrays: QpArrays) -> tuple[QpStatus, int]:
        self.arrays = arrays
        return QpStatus.FAILED, 0


Sizes = tuple[int, int, int]


def source_of(task: Task, name: str) -> tuple[Sizes, str]:
    """The sizes of a program, and the C source of a function that solves it and prints status and step."""
    method = Recorded()
    method.solve(task.window, task.model, task.here)
    arrays = method.arrays
    form = task.window.form
    grid = form.grid
    sizes = (grid.n, grid.switches, form.history)
    members = {
        "K": grid.K,
        "S": grid.switches,
        "node_row_count": len(arrays.row_jacobian),
        "interval_row_count": len(arrays.interval_row),
        "has_input_rows": int(len(arrays.input_low) > 0),
        "max_iterations": MAX_ITERATIONS,
        "tolerance": TOLERANCE,
        "acceptable_tolerance": max(ACCEPTABLE, TOLERANCE),
        "initial_barrier": INITIAL_BARRIER,
        "bound_push": BOUND_PUSH,
        **{array: array for array in ARRAYS},
    }
    function = SOLVE.format(
        name=name,
        arrays="\n    ".join(_declared(array, getattr(arrays, array)) for array in ARRAYS),
        report_size=REPORT_SIZE,
        members=", ".join(f".{member} = {value}" for member, value in members.items()),
        symbols=kernel_symbols(*sizes),
    )
    return sizes, function


def _declared(name: str, values: np.ndarray) -> str:
    kind = "int64_t" if values.dtype.kind == "i" else "double"
    each = [repr(value).replace("inf", "INFINITY") for value in values.ravel().tolist()] or ["0"]
    return f"static {kind} {name}[] = {{{', '.join(each)}}};"


def run(command: Sequence[str], folder: Path) -> str:
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout


def solve_as_one_program(tasks: Sequence[Task], flags: Sequence[str], folder: Path) -> list[list[str]]:
    """Compile a file for each size, link them, and return what the functions of tasks print, word by word."""
    try:
        compiler = find_compiler()
    except CompilationError as error:
        pytest.skip(str(error))
    names = [f"solve_{number}" for number in range(len(tasks))]
    functions: dict[Sizes, str] = {}
    for name, task in zip(names, tasks, strict=True):
        sizes, function = source_of(task, name)
        functions[sizes] = functions.get(sizes, "") + function
    objects = [f"kernel_{'_'.join(map(str, sizes))}.o" for sizes in functions]
    for file, (sizes, text) in zip(objects, functions.items(), strict=True):
        source = Path(file).with_suffix(".c")
        (folder / source).write_text(kernel_source(*sizes) + text)
        run([*compiler, *STRICT, *flags, "-O1", "-c", str(source), "-o", file], folder)
    declarations = " ".join(f"int {name}(void);" for name in names)
    calls = " || ".join(f"{name}()" for name in names)
    (folder / "main.c").write_text(f"{declarations}\nint main(void) {{ return {calls}; }}\n")
    run([*compiler, *STRICT, *flags, "main.c", *objects, "-o", "solve", "-lm"], folder)
    return [line.split() for line in run(["./solve"], folder).splitlines()]


def assert_same_solution(printed: Sequence[str], expected: QpSolution) -> None:
    status, *step = printed
    assert tuple(QpStatus)[int(status)] is expected.status
    np.testing.assert_allclose(np.array(step, float), expected.step.X[1:].ravel(), rtol=0, atol=STEP_DIFFERENCE)


def test_a_kernel_whose_members_of_a_program_are_swapped_is_not_loaded(monkeypatch: pytest.MonkeyPatch) -> None:
    """Both bounds of a row are pointers: the structure keeps its size."""
    names = [name for name, _ in QuadraticProgram._fields_]
    low, high = names.index("low"), names.index("high")
    members = list(QuadraticProgram._fields_)
    members[low], members[high] = members[high], members[low]
    swapped = type("QuadraticProgram", (ctypes.Structure,), {"_fields_": members})
    assert ctypes.sizeof(swapped) == ctypes.sizeof(QuadraticProgram)
    monkeypatch.setattr(quadratic, "QuadraticProgram", swapped)
    with pytest.raises(RuntimeError, match=r"QuadraticProgram\.high is at byte \d+ in C, expected \d+ as declared"):
        load_kernel(1, 1)


@pytest.mark.slow
def test_kernels_of_several_sizes_solve_side_by_side_in_one_program(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every name for callers has the sizes in it, and no other name leaves its file: else they would not link."""
    tasks = []
    for coordinates, nodes in ((2, (4,)), (3, (3, 4))):
        monkeypatch.setattr(random_programs, "COORDINATES", coordinates)
        tasks.append(random_task(np.random.default_rng(3), nodes, {"inputs"}))
    printed = solve_as_one_program(tasks, (), tmp_path)
    for words, task in zip(printed, tasks, strict=True):
        assert_same_solution(words, ours(task, TOLERANCE))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("nodes", "what"),
    [((5,), ""), ((4, 6), "inputs intervals fixed"), ((3, 4, 5), "equal intervals tied"), ((4, 4), "history inputs")],
)
def test_the_kernel_has_no_warning_and_touches_no_foreign_memory(
    nodes: tuple[int, ...], what: str, tmp_path: Path
) -> None:
    """With hard bounds, and with soft ones."""
    task = random_task(np.random.default_rng(3), nodes, set(what.split()))
    tasks = [task.with_bounds(soft=soft_rows(task, states=soft, node_rows=soft)) for soft in (False, True)]
    for words, each in zip(solve_as_one_program(tasks, SANITIZED, tmp_path), tasks, strict=True):
        assert_same_solution(words, ours(each, TOLERANCE))
