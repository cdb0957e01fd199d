"""Robot and task descriptions from files, names, mappings or stored texts to validated data."""

import hashlib
import json
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from psmpc_cli.errors import SpecError
from psmpc_cli.specs.checks import check_robot, check_task, known_names, parts_of
from psmpc_cli.specs.document import Document, Raw, plain, read, write
from psmpc_cli.specs.library import Kind, built_ins, find, read_text, shown
from psmpc_cli.specs.messages import Fault
from psmpc_cli.specs.messages import Path as Location
from psmpc_cli.specs.overrides import BY_CONTROLLER, Changes, for_controller, override
from psmpc_cli.specs.priorities import prioritize
from psmpc_cli.specs.robot import RobotSpec
from psmpc_cli.specs.task import ControllerSpec, TaskSpec

Model = TypeVar("Model", bound=BaseModel)

LONGEST_PATH = 1000
"""Characters of a path that a task refers to."""


@dataclass(frozen=True)
class LoadedRobot:
    """A robot and where it came from.

    Attributes:
        spec: The robot.
        robot_yaml: The text it was read from.
        source: That text with the position of every value.
    """

    spec: RobotSpec
    robot_yaml: str
    source: Document


@dataclass(frozen=True)
class Task:
    """A valid task with its robot: what controllers, simulations and studies start from.

    `load_task` makes one. `task.spec` has every key of the task file as an attribute, with defaults filled in, angles
    in rad, and priorities resolved from comparisons: `task.spec.controller.nodes`, `task.spec.stages[0].target`. A task
    does not change; load it with `set={...}` for another one, or `parse_task(task.task_yaml, task.robot_yaml, ...)`.

    Attributes:
        spec: The task.
        robot: Its robot; `robot.parts` are the names and sizes of the parts of Q.
        task_yaml: The text of the task with all overrides; it loads again to the same task. What `by_controller` has is
            in it as written: it holds for whichever controller a later override chooses.
        robot_yaml: The text of the robot.
        source: The task's text with the position of every value, for messages about it.
    """

    spec: TaskSpec
    robot: RobotSpec
    task_yaml: str
    robot_yaml: str
    source: Document

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the task and its robot as data, however their files are written."""
        content = {
            "task": self.spec.model_dump(mode="json"),
            "robot": self.robot.model_dump(mode="json"),
            "parts": list(self.robot.parts),
        }
        canonical = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
        return hashlib.sha256(canonical.encode()).hexdigest()


def load_task(reference: str | Path | Mapping[str, Any], set: Changes = ()) -> Task:
    """Load a task and its robot.

    Args:
        reference: The name of a built-in task, the path of a file, or the task itself as a mapping of its keys.
        set: Keys of the task to change: a mapping of paths to values, such as `{"controller.nodes": "auto"}` or
            `{"stages.capture.priority": 10}`, or a sequence of texts `path=value` and options short for them.

    Raises:
        SpecError: Something is wrong with the task, the robot's file or a change; the message lists all of it.
    """
    if isinstance(reference, Mapping):
        return _task(read("task", write(plain(reference))), Path(), "task", set)
    path, document = _read("task", reference)
    return _task(document, path.parent, path.stem, set)


def load_robot(reference: str | Path) -> LoadedRobot:
    """Load a robot from a path or by the name of a built-in one.

    Raises:
        SpecError: Something is wrong with the file; the message lists all of it.
    """
    document = _read("robot", reference)[1]
    robot, faults = validate_robot(document)
    if robot is None:
        raise SpecError(document.report(faults))
    return LoadedRobot(robot, document.text, document)


def parse_task(task_yaml: str, robot_yaml: str, name: str, set: Changes = ()) -> Task:
    """Rebuild a task from texts stored elsewhere, such as in a log, without reading files.

    Args:
        task_yaml: The text of the task.
        robot_yaml: The text of its robot.
        name: The name of the task if it has none of its own.
        set: Keys of the task to change, as for `load_task`.

    Raises:
        SpecError: Something is wrong with the texts or a change.
    """
    return _task(read(name, task_yaml), read(f"{name} (robot)", robot_yaml), name, set)


def kind_of_reference(reference: str | Path) -> Kind:
    """Return whether a path or a built-in name is that of a robot or a task; a task if in doubt.

    Raises:
        SpecError: There is no such file, or it cannot be read.
    """
    if str(reference) in built_ins("robot") and not Path(reference).is_file():
        return "robot"
    return _kind_of(_read("task", reference)[1]) or "task"


def validate_robot(document: Document) -> tuple[RobotSpec | None, tuple[Fault, ...]]:
    """Return the robot that a document describes, None if it is not valid, and every fault of the document."""
    robot, faults = _validate(document, "robot", RobotSpec, known_names(document, parts_of(document)))
    faults = (*faults, *check_robot(document))
    return None if faults else robot, faults


def validate_task(document: Document, robot: Document | None) -> tuple[TaskSpec | None, tuple[Fault, ...]]:
    """Return the task that a document describes, None if it is not valid, and every fault of the document.

    Checks that depend on the robot are made as far as its document can be read, even if that is not valid. Priorities
    are resolved from comparisons. The task has what its `by_controller` sets for its controller, and is validated
    with what that sets for any other one, too.
    """
    controller = Raw(document)["controller"].valid(ControllerSpec) or ControllerSpec()
    own, origins, _ = for_controller(document, controller.kind)
    task, faults = _validate_as_written(own, robot)
    found = [fault for fault in faults if _origin(fault, origins) is None]
    for kind, _ in Raw(document)[BY_CONTROLLER].items():
        variant, origins, misplaced = for_controller(document, kind)
        located = [_origin(fault, origins) for fault in _validate_as_written(variant, robot)[1]]
        found += [*misplaced, *(fault for fault in located if fault is not None)]
    return None if found or task is None else prioritize(task), tuple(found)


def _validate_as_written(document: Document, robot: Document | None) -> tuple[TaskSpec | None, tuple[Fault, ...]]:
    """Return the task that a document describes for no controller in particular, and every fault of it."""
    task, faults = _validate(document, "task", TaskSpec, known_names(document, parts_of(robot)))
    if _kind_of(document) != "robot":
        faults = (*faults, *check_task(document, robot))
    return task, faults


def _origin(fault: Fault, origins: Mapping[Location, Location]) -> Fault | None:
    """Return a fault of a key that a controller has of its own, located there; None if it is of another key."""
    for path, origin in origins.items():
        if fault.path[: len(path)] == path:
            return replace(fault, path=(*origin, *fault.path[len(path) :]))
    return None


def _read(kind: Kind, reference: str | Path) -> tuple[Path, Document]:
    """Find and read the file that a reference means."""
    try:
        path = find(kind, reference)
    except SpecError as error:
        raise SpecError(f"{reference}: {error}") from None
    return path, read(shown(path), read_text(path))


def _task(document: Document, robot: Document | Path, name: str, changes: Changes) -> Task:
    """Make the task of a document, and of its robot's or of one that it refers to from a folder.

    Raises:
        SpecError: Something is wrong with either; the message lists all of it.
    """
    document, misplaced = override(document, changes)
    source, missing = (robot, ()) if isinstance(robot, Document) else _robot_of(document, robot)
    spec, faults = (None, ()) if source is None else validate_robot(source)
    task, task_faults = validate_task(document, source)
    if task is None or spec is None or source is None or misplaced:
        reports = (document.report((*task_faults, *missing)), *misplaced, source.report(faults) if source else "")
        raise SpecError("\n".join(report for report in reports if report))
    overridden = any(entry.override is not None for entry in document.entries.values())
    return Task(
        spec=task if task.name else task.model_copy(update={"name": name}),
        robot=spec,
        task_yaml=write(document.data) if overridden else document.text,
        robot_yaml=source.text,
        source=for_controller(document, task.controller.kind)[0],
    )


def _robot_of(task: Document, folder: Path) -> tuple[Document | None, tuple[Fault, ...]]:
    """Read the robot that a task refers to; a fault if there is none."""
    reference = task.data.get("robot") if isinstance(task.data, dict) else None
    if not isinstance(reference, str) or not reference:
        return None, ()
    try:
        if len(reference) > LONGEST_PATH:
            wanted = f"expected a built-in robot's name or a path of at most {LONGEST_PATH}"
            raise SpecError(f"found {len(reference)} characters, {wanted}")
        path = find("robot", reference, folder)
        return read(shown(path), read_text(path)), ()
    except SpecError as error:
        return None, (Fault(("robot",), str(error)),)


def _kind_of(document: Document) -> Kind | None:
    """Return whether a document describes a robot or a task by the keys that only one of them has, None if in doubt."""
    keys: Collection[str] = document.data if isinstance(document.data, dict) else ()
    robot = any(key in keys for key in ("arms", "base"))
    task = any(key in keys for key in ("stages", "skills", "robot"))
    return None if robot == task else "robot" if robot else "task"


def _validate(
    document: Document, kind: Kind, model: type[Model], names: Mapping[str, Collection[str]]
) -> tuple[Model | None, tuple[Fault, ...]]:
    """Return a document as a model, None if it is none, and its faults."""
    required = [name for name, field in model.model_fields.items() if field.is_required()]
    wanted = f"a {kind}: a mapping with the keys {', '.join(required)}"
    if document.data is None:
        return None, document.faults or (Fault((), f"found an empty file, expected {wanted}"),)
    if not isinstance(document.data, dict):
        return None, (*document.faults, Fault((), f"found {document.found(())}, expected {wanted}"))
    if (found := _kind_of(document)) not in (kind, None):
        return None, (Fault((), f"found the description of a {found}, expected {wanted}"),)
    try:
        return model.model_validate(document.data, context=names), document.faults
    except ValidationError as error:
        return None, (*document.faults, *_faults(error, document))


def _faults(error: ValidationError, document: Document) -> Iterator[Fault]:
    """Give every error of a validation with its path in the document; its `loc` also names branches of unions."""
    for detail in error.errors(include_url=False):
        path: Location = ()
        for step in detail["loc"]:
            path = (*path, step) if (*path, step) in document.entries else path
        context = detail["ctx"]
        yield Fault(path, f"found {context['found'] or document.found(path)}{context['tail']}", context["at_key"])
