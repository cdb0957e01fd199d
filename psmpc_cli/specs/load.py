"""Robot and task descriptions from files, names, mappings or stored texts to validated data."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydantic import BaseModel, ValidationError

from psmpc_cli.errors import SpecError
from psmpc_cli.specs.arguments import rejected, require
from psmpc_cli.specs.controller import CONTROLLERS, ControllerSpec
from psmpc_cli.specs.document import (
    Changes,
    Document,
    Fault,
    for_controller,
    mapping,
    origins_of,
    override,
    printable,
    quoted,
    read,
    with_controller,
    write,
)
from psmpc_cli.specs.fields import faults_of, keys_of
from psmpc_cli.specs.files import read_text, shown
from psmpc_cli.specs.library import Kind, built_ins, find
from psmpc_cli.specs.parts import MOBILITIES, Context, Mobility, MobilityTraits
from psmpc_cli.specs.priorities import priorities_of
from psmpc_cli.specs.robots.robot import (
    PlanarRobot,
    RobotSpec,
    SpatialRobot,
    UrdfRobot,
    missing_directions,
    wheel_faults,
)
from psmpc_cli.specs.robots.urdf import Urdf, is_xml, kind_of_xml, read_urdf, spatial_robot
from psmpc_cli.specs.task import TaskSpec

Model = TypeVar("Model", bound=BaseModel)


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

    def __repr__(self) -> str:
        size = f"{len(self.spec.stages)} stages"
        return f"<Task {self.spec.name}: {size}, robot {self.robot.name}, controller {self.spec.controller.kind}>"

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the task and its robot as data, however their files are written."""
        task = self.spec.model_dump(mode="json")
        # former keys: without them, logs would hold other tasks than they say
        task["uncertainty"]["force_limits"] = {}
        task["controller"]["known_delay"] = 0
        task["uncertainty"]["delay"] = self.spec.uncertainty.delay or 0
        content = {
            "task": task,
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
        InputError: The reference or the changes are of another type.
        SpecError: Something is wrong with the task, the robot's file or a change; the message lists all of it.
    """
    require("task", reference, (str, PathLike, Mapping), "the name of a task, the path of a file, or a mapping of keys")
    _require_changes(set)
    if isinstance(reference, Mapping):
        return _build_task(read("task", write(reference)), Path(), "task", set)  # a robot's path is from here
    path = find("task", reference)
    if is_xml(path):
        keys = ", ".join(_required_keys(TaskSpec))
        found = f"found {kind_of_xml(path)}, expected a task: a YAML file with the keys {keys}"
        raise SpecError(f"{shown(path)}: {found}; its key robot refers to a robot, which may be a URDF file")
    return _build_task(read(shown(path), read_text(path)), path.parent, printable(path.stem), set)


def _require_changes(changes: Changes) -> None:
    """Make sure that changes of a task have the type `Changes`, before anything reads them.

    They may be a mapping of values by path, or a sequence whose entries are texts `path=value` or pairs of texts. A
    text alone is none, though it is a sequence.

    Raises:
        InputError: They are not.
    """
    wanted = 'a mapping such as {"controller.nodes": 25}, or a sequence of texts "path=value"'
    if isinstance(changes, str):
        raise rejected("set", changes, wanted)
    require("set", changes, (Mapping, Sequence), wanted)
    for change in changes:
        pair = isinstance(change, tuple) and len(change) == 2 and all(isinstance(text, str) for text in change)
        if not (isinstance(change, str) or pair):
            raise rejected("set", change, wanted)


def load_robot(reference: str | Path) -> RobotSpec:
    """Load a robot from a path or by the name of a built-in one.

    Raises:
        InputError: The reference is neither.
        SpecError: Something is wrong with the file; the message lists all of it.
    """
    require("robot", reference, (str, PathLike), "the name of a robot or the path of a file")
    robot, faults = validate_robot(document := _read_robot(find("robot", reference)))
    if robot is None:
        raise SpecError(document.report(faults))
    return robot


@dataclass(frozen=True, eq=False)
class TaskDocuments:
    """A task and its robot as read from texts, from which tasks with other keys are made without reading them again.

    Attributes:
        task: The task as it was read.
        robot: Its robot.
        name: The name of the task if it has none of its own.
    """

    task: Document
    robot: Document
    name: str

    def changed(self, set: Changes = ()) -> Task:
        """Make the task with keys changed, as for `load_task`.

        Raises:
            SpecError: Something is wrong with the texts or a change.
        """
        return _build_task(self.task, self.robot, self.name, set)


def read_documents(task_yaml: str, robot_yaml: str, name: str) -> TaskDocuments:
    """Read a task and its robot from texts stored elsewhere, such as in a log, without reading files.

    Args:
        task_yaml: The text of the task.
        robot_yaml: The text of its robot.
        name: The name of the task if it has none of its own.
    """
    return TaskDocuments(read(name, task_yaml), read(f"{name} (robot)", robot_yaml), name)


def parse_task(task_yaml: str, robot_yaml: str, name: str, set: Changes = ()) -> Task:
    """Rebuild a task from texts as `read_documents` reads them, with keys changed as for `load_task`.

    Raises:
        SpecError: Something is wrong with the texts or a change.
    """
    return read_documents(task_yaml, robot_yaml, name).changed(set)


def kind_of_reference(reference: str | Path) -> Kind:
    """Return whether a path or a built-in name is that of a robot or a task; a task if in doubt.

    Raises:
        SpecError: There is no such file, or it cannot be read.
    """
    if str(reference) in built_ins("robot") and not Path(reference).is_file():
        return "robot"
    path = find("task", reference)
    if is_xml(path):
        return "robot"
    return _kind_of_description(read(shown(path), read_text(path))) or "task"


def validate_robot(
    document: Document, mobility: Mobility | None = None, of_stages: Sequence[MobilityTraits] = ()
) -> tuple[RobotSpec | None, tuple[Fault, ...]]:
    """Validate a robot's file, also against what a task says of the mobility of its base: what moves it.

    A base that moves needs a mass, thrusters must push and turn it in every direction, and there are neither thrusters
    nor wheels on a base that is fixed.

    Args:
        document: The robot's file.
        mobility: What a task has instead of the robot's own mobility; None if it has nothing.
        of_stages: What moves the base in those stages of the task that have a mobility of their own.

    Returns:
        The robot, None if it is not valid; and every fault of the document.
    """
    spatial = "space" in mapping(document.data)
    for path in document.origins if not spatial else ():
        # arms.NAME.links[i].joint, a key of spatial robots that tells that `space: spatial` was forgotten
        joint_of_link = len(path) == 5 and (path[0], path[2], path[4]) == ("arms", "links", "joint")
        if joint_of_link or (path == ("base", "inertia") and isinstance(document.value(path), list)):
            found = f'found {document.found(path)}, which only a robot in space has, and no key "space"'
            return None, (*document.faults, Fault(path, f"{found}; expected space: spatial at the top of the file"))
    robot, faults = _validate_document(document, "robot", SpatialRobot if spatial else PlanarRobot, Context(document))
    if robot is None:
        return None, faults
    robot = robot if mobility is None else robot.model_copy(update={"mobility": mobility})
    if robot.moved_by.moves:
        lacking = [("base", key) for key in ("mass", "inertia") if not np.any(getattr(robot.base, key))]
        wanted = f"expected a number greater than 0: a {robot.mobility} base moves, only a fixed one may have none"
        faults = tuple(Fault(path, f"found {document.found(path)}, {wanted}") for path in lacking)
    moves = any(moved_by.moves for moved_by in (robot.moved_by, *of_stages))
    held_in_stages = robot.moved_by.moves and not all(moved_by.moves for moved_by in of_stages)
    if robot.wheels and held_in_stages:
        found = "found wheels on a base that is fixed in some stages; expected none, or another mobility there"
        faults = (*faults, Fault(("wheels",), found))
    idle_actuators = [key for key in ("thrusters", "wheels") if getattr(robot, key) and not moves]
    if robot.thrusters and moves and (missing := missing_directions(robot)):
        wanted = "expected thrusters that push and turn it in every direction: others, or in other places"
        faults = (
            *faults,
            Fault(("thrusters",), f"found some that cannot give the base {', '.join(missing)} alone; {wanted}"),
        )
    faults = (
        *faults,
        *(
            Fault((key,), f"found {key} on a base that is fixed; expected none, or another mobility")
            for key in idle_actuators
        ),
        *(Fault(("wheels",), fault) for fault in wheel_faults(robot, [robot.moved_by, *of_stages])),
    )
    return None if faults else robot, faults


def _read_robot(path: Path) -> Document:
    """Read the file of a robot, and the URDF file that it may refer to.

    A robot's file may be YAML with all keys, YAML with the key `urdf` and some keys, or a URDF file itself, which is
    read like YAML that has nothing but `urdf`. In the last two cases the document that is returned has the bodies,
    joints and limits from the URDF in the place of the keys that refer to it. Other keys of the YAML file take
    precedence over the URDF.

    Raises:
        SpecError: It cannot be read, or its URDF describes no robot or not what the file names.
    """
    if is_xml(path):
        # without the text, messages do not repeat a line that is not in the file
        document = replace(read(shown(path), f"urdf: {json.dumps(path.name)}"), text="")
    else:
        document = read(shown(path), read_text(path))
    if (reference := document.value(("urdf",))) is None:
        return document
    is_named = isinstance(reference, str) and bool(reference)
    if is_named and (path.parent / str(reference)).is_dir():
        wrong = Fault(("urdf",), f"found the directory {quoted(str(reference))}, expected a URDF file")
        raise SpecError(document.report([wrong]))
    urdf = read_urdf(path.parent / str(reference)) if is_named else None
    file, faults = _validate_document(document, "robot", UrdfRobot, urdf)
    if file is None or urdf is None:
        raise SpecError(document.report(faults))
    built, sources = spatial_robot(urdf, file)
    notes = [f"{Path(file.urdf).name}, {note}" for note in urdf.notes]
    keys_that_refer = ("urdf", "locked", "base", "arms")  # they say what of the URDF the robot is made of
    yaml_keys = {key: value for key, value in mapping(document.data).items() if key not in keys_that_refer}
    urdf_limits = built["limits"]
    yaml_limits = {
        part: {quantity: bounds for quantity, bounds in of_part.items() if bounds is not None}
        for part, of_part in yaml_keys.get("limits", {}).items()
    }
    limits = {
        part: {**urdf_limits.get(part, {}), **yaml_limits.get(part, {})} for part in {**urdf_limits, **yaml_limits}
    }
    data = {**built, **yaml_keys, "limits": limits, "assumed": notes}
    if shapes := {**built.get("geometry", {}), **mapping(yaml_keys.get("geometry"))}:
        data["geometry"] = shapes
    origins = {path: origin for path, origin in origins_of(data, sources).items() if path not in document.origins}
    return replace(document, data=data, origins={**document.origins, **origins}, changed=True)


def _build_task(document: Document, robot: Document | Path, name: str, changes: Changes) -> Task:
    """Make the task of a document, and of its robot's or of one that it refers to from a folder.

    The task has what its `by_controller` sets for its controller, and is validated with what that sets for others, too.
    Of another controller what is wrong without these keys does not count.

    Raises:
        SpecError: Something is wrong with either; the message lists all of it.
    """
    own_robot = document.value(("robot",))
    document, misplaced = override(document, changes)
    source = robot if isinstance(robot, Document) else None
    reference = document.value(("robot",))
    if isinstance(robot, Path) and isinstance(reference, str) and reference:
        is_changed_to_file = reference != own_robot and Path(reference).is_file()  # seen from the working directory
        try:
            source = _read_robot(find("robot", reference, Path() if is_changed_to_file else robot))
        except SpecError as error:
            document = replace(document, faults=(*document.faults, Fault(("robot",), str(error))))
    kind = document.value(("controller", "kind")) or document.value(("controller",))
    own = for_controller(document, kind if isinstance(kind, str) else ControllerSpec().kind)
    mobility = own.value(("mobility",))
    of_task = next((each for each in MOBILITIES if each == mobility), None)
    of_stages = Context(own).mobilities[1:]
    spec, robot_faults = (None, ()) if source is None else validate_robot(source, of_task, of_stages)
    of_robot = (
        (
            spec.parts,
            spec.limits,
            spec.mobility if of_task or mobility is None else None,
            spec.sliding,
            bool(spec.thrusters),
            spec.has_plumes,
        )
        if spec
        else ()
    )
    task, faults = _validate_document(own, "task", TaskSpec, Context(own, *of_robot))
    reports = [own.report(faults)]
    for other in CONTROLLERS:
        if for_controller(document, other) in (document, own):
            continue
        plain = with_controller(document, other)
        variant = for_controller(plain, other)
        _, found = _validate_document(variant, "task", TaskSpec, Context(variant, *of_robot))
        if found:
            _, without_keys = _validate_document(plain, "task", TaskSpec, Context(plain, *of_robot))
            reports.append(variant.report(fault for fault in found if fault not in (*faults, *without_keys)))
    reports += [*misplaced, source.report(robot_faults) if source else ""]
    if any(reports) or task is None or spec is None or source is None:
        raise SpecError("\n".join(report for report in reports if report))
    stages = task.stages
    if task.priorities is not None:
        omega = priorities_of(task.priorities.compare, [stage.name for stage in stages])
        stages = tuple(stage.model_copy(update={"priority": omega[i]}) for i, stage in enumerate(stages))
    return Task(
        spec=task.model_copy(update={"name": task.name or name, "stages": stages}),
        robot=spec,
        task_yaml=document.yaml,
        robot_yaml=source.yaml,
        source=own,
    )


def _required_keys(model: type[BaseModel]) -> list[str]:
    """Return the keys that a description must have."""
    return [name for name, field in keys_of(model).items() if field.is_required()]


def _kind_of_description(document: Document) -> Kind | None:
    """Return whether a document describes a robot or a task by the keys that only one of them has, None if in doubt."""
    keys = set(mapping(document.data))
    keys_of_robots = {key for model in (PlanarRobot, SpatialRobot, UrdfRobot) for key in keys_of(model)}
    keys_of_tasks = set(keys_of(TaskSpec))
    robot = bool(keys & (keys_of_robots - keys_of_tasks))
    task = bool(keys & (keys_of_tasks - keys_of_robots))
    return None if robot == task else "robot" if robot else "task"


def _validate_document(
    document: Document, kind: Kind, model: type[Model], context: Context | Urdf | None
) -> tuple[Model | None, tuple[Fault, ...]]:
    """Validate the data of a document with a model of pydantic.

    Args:
        document: A task or robot as it was read.
        kind: What it is expected to be.
        model: The model of such a description.
        context: What the rules of its keys know of the rest of the description, or the URDF that it refers to.

    Returns:
        The model, None if the document is not valid; and all faults of the document, those of its YAML among them.
    """
    data = document.data
    other = _kind_of_description(document)
    if not isinstance(data, dict) or other not in (kind, None):
        required = _required_keys(model)
        found = "an empty file" if data is None else f"the description of a {other}" if other else document.found(())
        wanted = f"found {found}, expected a {kind}: a mapping with the keys {', '.join(required)}"
        return None, document.faults or (Fault((), wanted),)
    try:
        valid = model.model_validate(data, context=context)
    except ValidationError as error:
        return None, (*document.faults, *faults_of(error, document))
    return None if document.faults else valid, document.faults
