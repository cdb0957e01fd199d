"""What of a task's solver and plant runs as compiled C, made before its first sample."""

import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import casadi as ca

from psmpc_cli.native.functions import FLAGS, source_of
from psmpc_cli.native.library import library
from psmpc_cli.ocp.layout import StageShape
from psmpc_cli.ocp.stage_terms import stage_terms
from psmpc_cli.ocp.stages import Stage, build_stages
from psmpc_cli.plant import seconds_and_substeps
from psmpc_cli.plant.disturbed_rk4 import disturbed_tick
from psmpc_cli.plant.rk4 import tick_function
from psmpc_cli.robot.model import RobotModel, build_model
from psmpc_cli.simulation.uncertainty import disturbs
from psmpc_cli.solvers.riccati.kernel import kernel_library
from psmpc_cli.specs.load import Task
from psmpc_cli.specs.task import TaskSpec


@dataclass(frozen=True)
class Piece:
    """One library a task needs.

    Attributes:
        purpose: What it is for.
        make: Compile it, or find it in the cache; None where that cannot be done.
    """

    purpose: str
    make: Callable[[], Path | None]


@dataclass(frozen=True)
class Made:
    """A piece that was made: where it is, and how long that took [s]; in the cache already, next to nothing."""

    purpose: str
    path: Path | None
    seconds: float


def pieces(task: TaskSpec, model: RobotModel, stages: Sequence[Stage]) -> Iterator[Piece]:
    """Give what the windows and the plant of a task need, whichever of its stages stand in a window."""
    if task.solver.kind == "sqp":
        for space in sorted({stage.space for stage in stages}):
            terms = stage_terms(model, StageShape(space, "joint", (), False, False, False))
            yield _piece(f"cost and derivatives, {space} space", terms.cost)
            yield _piece(f"cost, {space} space", terms.error)
        for switches in range(len(stages)):
            yield Piece(f"quadratic programs, {switches} instants", partial(kernel_library, model.n, switches))
    if task.plant.kind == "rk4":
        tick, substeps = seconds_and_substeps(task.plant)
        one_tick = disturbed_tick if disturbs(task) else tick_function
        yield _piece("a tick of the plant", one_tick(model, tick, substeps))


def _piece(purpose: str, function: ca.Function) -> Piece:
    """Return a function as a piece; its source is written here, because CasADi is not for several threads."""
    return Piece(purpose, partial(library, source_of(function), function.name(), FLAGS))


def make_pieces(task: TaskSpec, model: RobotModel, stages: Sequence[Stage]) -> list[Made]:
    """Compile whatever a task needs and is not in the cache, several pieces at once."""
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        return list(threads.map(_make, pieces(task, model, stages)))


def _make(piece: Piece) -> Made:
    began = time.perf_counter()
    path = piece.make()
    return Made(piece.purpose, path, time.perf_counter() - began)


def compile_ahead(loaded: Task) -> list[Made]:
    """Compile what a run of a task needs, so that it finds it in the cache."""
    model = build_model(loaded.robot)
    return make_pieces(loaded.spec, model, build_stages(loaded.spec, loaded.robot, model))


def compiled_in_force(task: TaskSpec, model: RobotModel, stages: Sequence[Stage]) -> bool:
    """Return whether a run of the task uses compiled code: if it may, needs some, and all of it can be had."""
    made = make_pieces(task, model, stages) if task.solver.compiled else []
    return bool(made) and all(each.path is not None for each in made)
