"""A document becomes a robot or task: every problem of it, or the specification."""

from collections.abc import Iterator
from typing import TypeVar

from pydantic import BaseModel, ValidationError

from psmpc_cli.specs.checks.limits import check_limits
from psmpc_cli.specs.checks.names import check_coordinates, check_input, check_names
from psmpc_cli.specs.checks.parts import check_parts
from psmpc_cli.specs.checks.priorities import check_priorities
from psmpc_cli.specs.checks.robot import check_robot
from psmpc_cli.specs.checks.solver import check_mesh, check_solver
from psmpc_cli.specs.checks.stages import check_stages
from psmpc_cli.specs.checks.timing import check_timing
from psmpc_cli.specs.checks.trajectories import check_times, check_trajectories
from psmpc_cli.specs.checks.uncertainty import check_known_delay, check_uncertain_parts, check_uncertainty
from psmpc_cli.specs.complaints import complain
from psmpc_cli.specs.cursor import Cursor
from psmpc_cli.specs.document import Document
from psmpc_cli.specs.library import Kind
from psmpc_cli.specs.messages import Fault
from psmpc_cli.specs.priorities import prioritize
from psmpc_cli.specs.robot import RobotSpec
from psmpc_cli.specs.task import TaskSpec

Model = TypeVar("Model", bound=BaseModel)

MARKS: dict[Kind, tuple[str, ...]] = {"robot": ("arms", "base"), "task": ("stages", "skills", "robot")}
"""Keys by which a description is known for what it is."""


def kind_of(document: Document) -> Kind:
    """Return whether a document describes a robot or a task, a task if in doubt."""
    keys = document.data if isinstance(document.data, dict) else {}
    return "robot" if any(key in keys for key in MARKS["robot"]) and not _marked(keys, "task") else "task"


def validate_robot(document: Document) -> tuple[RobotSpec | None, tuple[Fault, ...]]:
    """Return the robot a document describes, None if it is not valid, and every problem of the document."""
    robot, problems = _validate(document, "robot", RobotSpec)
    if isinstance(document.data, dict):
        problems = (*problems, *check_robot(Cursor(document)))
    return (None if problems else robot), problems


def validate_task(document: Document, robot: RobotSpec | None) -> tuple[TaskSpec | None, tuple[Fault, ...]]:
    """Return the task a document describes, None if it is not valid, and every problem of the document.

    Without a robot what depends on it is not checked. Priorities that are compared in pairs are resolved.
    """
    task, problems = _validate(document, "task", TaskSpec)
    if isinstance(document.data, dict) and kind_of(document) == "task":
        problems = (*problems, *_check_task(Cursor(document), robot))
    return (None if problems or task is None else prioritize(task)), problems


def _check_task(task: Cursor, robot: RobotSpec | None) -> Iterator[Fault]:
    """Give what does not fit together."""
    yield from check_names(task)
    yield from check_input(task)
    yield from check_solver(task)
    yield from check_mesh(task)
    yield from check_stages(task)
    yield from check_timing(task)
    yield from check_times(task)
    yield from check_priorities(task)
    yield from check_uncertainty(task)
    yield from check_known_delay(task)
    if robot is not None:
        yield from check_parts(task, robot)
        yield from check_trajectories(task, robot)
        yield from check_coordinates(task, robot)
        yield from check_limits(task, robot)
        yield from check_uncertain_parts(task, robot)


def _validate(document: Document, kind: Kind, model: type[Model]) -> tuple[Model | None, tuple[Fault, ...]]:
    """Return a document as a model, None if it is none, and why."""
    if not document.readable:
        return None, document.faults
    required = [name for name, field in model.model_fields.items() if field.is_required()]
    wanted = f"a {kind}: a mapping with the keys {', '.join(required)}"
    if document.data is None:
        return None, (Fault((), f"found an empty file, expected {wanted}"),)
    if not isinstance(document.data, dict):
        return None, (*document.faults, Fault((), f"found {document.found(())}, expected {wanted}"))
    if kind_of(document) != kind and not _marked(document.data, kind):
        return None, (Fault((), f"found the description of a {kind_of(document)}, expected {wanted}"),)
    try:
        return model.model_validate(document.data), document.faults
    except ValidationError as error:
        return None, (*document.faults, *complain(error, document, model))


def _marked(keys: object, kind: Kind) -> bool:
    """Tell whether a mapping has keys that only this kind has."""
    return isinstance(keys, dict) and any(key in keys for key in MARKS[kind])
