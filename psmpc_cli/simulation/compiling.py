"""Compile what a task's solver and plant need before the first sample."""

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import casadi as ca

from psmpc_cli.native.functions import FLAGS, source_of
from psmpc_cli.native.library import library
from psmpc_cli.ocp.objective import StageShape, stage_functions
from psmpc_cli.ocp.problem import Stage
from psmpc_cli.plant import ticks_of
from psmpc_cli.plant.rk4 import tick_function
from psmpc_cli.plant.uncertainty import disturbs
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.solvers.quadratic import kernel_library
from psmpc_cli.specs.task import TaskSpec


def compile_for(task: TaskSpec, model: RobotModel, stages: Sequence[Stage]) -> bool:
    """Compile what a run of the task needs and is not in the cache, several libraries at once.

    Returns:
        Whether the run uses compiled code: the task allows it, needs some, and all of it could be made.
    """
    if not task.solver.compiled:
        return False
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        made = list(threads.map(lambda make: make(), _libraries(task, model, stages)))
    return bool(made) and all(path is not None for path in made)


def _libraries(task: TaskSpec, model: RobotModel, stages: Sequence[Stage]) -> Iterator[Callable[[], Path | None]]:
    """Give functions that make what windows and plant need, whichever stages are in a window."""
    if task.solver.kind == "sqp":
        for space in sorted({stage.space for stage in stages}):
            functions = stage_functions(model, StageShape(space))
            yield from (_library_of(functions.gauss_newton), _library_of(functions.state_cost))
        for switches in range(len(stages)):
            yield partial(kernel_library, model.n, switches)
    if task.plant.kind == "rk4":
        tick, substeps = ticks_of(task.plant)
        yield _library_of(tick_function(model, tick, substeps, disturbs(task)))


def _library_of(function: ca.Function) -> Callable[[], Path | None]:
    """Return what compiles a function; its source is written here, because CasADi is not thread-safe."""
    return partial(library, source_of(function), function.name(), FLAGS)
