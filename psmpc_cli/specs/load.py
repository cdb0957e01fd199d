"""Robot and task descriptions from files, names, mappings or stored texts to validated data."""

import copy
import hashlib
import json
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from psmpc_cli.errors import SpecError
from psmpc_cli.specs.document import Data, Document, Origin, describe, lies_inside, plain, put, read, write
from psmpc_cli.specs.fields import Pose
from psmpc_cli.specs.library import Kind, built_ins, find, read_text, shown
from psmpc_cli.specs.messages import Fault, Place, choice, dotted, quoted
from psmpc_cli.specs.messages import Path as Location
from psmpc_cli.specs.parts import Context
from psmpc_cli.specs.priorities import priorities_of
from psmpc_cli.specs.robot import PlanarRobot, RobotSpec, SpatialRobot, UrdfRobot
from psmpc_cli.specs.task import CONTROLLERS, ControllerSpec, TaskSpec
from psmpc_cli.specs.urdf import Urdf, read_urdf, spatial_robot

Model = TypeVar("Model", bound=BaseModel)

POSE_KEYS = ("position", "attitude")
POSE_ROOTS = (("initial",), ("stages",), ("object",))

_PATH = re.compile(r"[^.\[\]=]+(?:\.[^.\[\]=]+|\[\d+\])*")
_STEP = re.compile(r"\[(\d+)\]|([^.\[\]=]+)")

SHORTHANDS: tuple[Location, ...] = (("controller",), ("solver",), ("plant",), ("onset",))
"""Where a text alone means a mapping with that `kind`."""

BY_CONTROLLER = "by_controller"
"""Key of a task that holds, by controller, keys to change where that controller runs."""

NO_CONTROLLERS_OWN: tuple[Location, ...] = (("robot",), ("controller",), ("controller", "kind"), (BY_CONTROLLER,))
"""Keys that cannot depend on the controller."""

Change = str | tuple[str, str]
"""One key to change: `path=value`, or an option as it was typed and the `path=value` that it is short for."""

Changes = Mapping[str, Any] | Sequence[Change]
"""Keys to change: values by path, or a sequence of changes in their order."""


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


Review = Callable[[Task, frozenset[int] | None], Iterable[Fault]]
"""Gives what else stands against a task, by the indices of its sound stages; None: the whole task is sound."""


def load_task(reference: str | Path | Mapping[str, Any], set: Changes = (), review: Review | None = None) -> Task:
    """Load a task and its robot.

    Args:
        reference: The name of a built-in task, the path of a file, or the task itself as a mapping of its keys.
        set: Keys of the task to change: a mapping of paths to values, such as `{"controller.nodes": "auto"}` or
            `{"stages.capture.priority": 10}`, or a sequence of texts `path=value` and options short for them.
        review: Further checks, whose faults come in the same message: of the task, or of its sound part.

    Raises:
        SpecError: Something is wrong with the task, the robot's file or a change; the message lists all of it.
    """
    if isinstance(reference, Mapping):
        return _task(read("task", write(plain(reference))), Path(), "task", set, review)
    path, document = _read("task", reference)
    return _task(document, path.parent, path.stem, set, review)


def load_robot(reference: str | Path) -> RobotSpec:
    """Load a robot from a path or by the name of a built-in one.

    Raises:
        SpecError: Something is wrong with the file; the message lists all of it.
    """
    robot, faults = validate_robot(document := _read("robot", reference)[1])
    if robot is None:
        raise SpecError(document.report(faults))
    return robot


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
    if Path(reference).suffix == ".urdf" or (str(reference) in built_ins("robot") and not Path(reference).is_file()):
        return "robot"
    return _kind_of(_read("task", reference)[1]) or "task"


def validate_robot(document: Document) -> tuple[RobotSpec | None, tuple[Fault, ...]]:
    """Return the robot that a document describes, None if it is not valid, and every fault of the document."""
    spatial = isinstance(document.data, dict) and "space" in document.data
    if not spatial and (path := next(filter(lambda path: _is_spatial(document, path), document.origins), None)):
        wanted = 'which only a robot in space has, and no key "space"; expected space: spatial at the top of the file'
        return None, (*document.faults, Fault(path, f"found {document.found(path)}, {wanted}"))
    context = Context(document.data, document.data)
    return _validate(document, "robot", SpatialRobot if spatial else PlanarRobot, context)


def _is_spatial(document: Document, path: Location) -> bool:
    """Tell whether only the files of spatial robots have a value like this: a joint of a link, or a list as inertia."""
    link = len(path) == 5 and (path[0], path[2], path[4]) == ("arms", "links", "joint")
    return link or (path == ("base", "inertia") and isinstance(document.value(path), list))


def _read(kind: Kind, reference: str | Path) -> tuple[Path, Document]:
    """Find and read the file that a reference means."""
    try:
        path = find(kind, reference)
    except SpecError as error:
        raise SpecError(f"{reference}: {error}") from None
    return path, _read_file(path) if kind == "robot" else read(shown(path), read_text(path))


def _read_file(path: Path) -> Document:
    """Read the file of a robot: YAML, with the bodies of a URDF if it refers to one, or a URDF.

    Raises:
        SpecError: It cannot be read, or its URDF describes no robot.
    """
    if path.suffix != ".urdf":
        return _expanded(read(shown(path), read_text(path)), path)
    urdf = read_urdf(path)
    return _of_urdf(Document(shown(path), "", {}, {(): Origin(Place(1, 1))}), urdf, None, None, {})


def _expanded(document: Document, path: Path) -> Document:
    """Return a robot's document with the bodies of the URDF it refers to, which lies beside its path.

    Raises:
        SpecError: The URDF cannot be read or does not have what the document names.
    """
    if document.value(("urdf",)) is None:
        return document
    file, faults = _validate(document, "robot", UrdfRobot, Context(document.data, None))
    if file is None:
        raise SpecError(document.report(faults))
    tips = None if file.arms is None else {name: arm.tip for name, arm in file.arms.items()}
    return _of_urdf(document, read_urdf(path.parent / file.urdf), file.base, tips, file.locked)


def _of_urdf(
    document: Document, urdf: Urdf, base: str | None, tips: Mapping[str, str] | None, locked: Mapping[str, float]
) -> Document:
    """Return a document with the keys of a spatial robot from a URDF in the place of those that refer to it."""
    built = spatial_robot(urdf, base, tips, locked)
    written: Any = document.data
    own = {key: value for key, value in written.items() if key not in ("urdf", "locked", "base", "arms")}
    given, limits = own.get("limits", {}), built["limits"]
    merged = {part: {**limits.get(part, {}), **given.get(part, {})} for part in {**limits, **given}}
    data = {**built, **own, "limits": merged, "assumed": [f"{Path(urdf.file).name}, {note}" for note in urdf.notes]}
    return replace(document, text=write(data), data=data, written=document.text)


def _task(
    document: Document, robot: Document | Path, name: str, changes: Changes, review: Review | None = None
) -> Task:
    """Make the task of a document, and of its robot's or of one that it refers to from a folder.

    The task has what its `by_controller` sets for its controller, and is validated with what that sets for others, too.

    Raises:
        SpecError: Something is wrong with either; the message lists all of it.
    """
    document, misplaced = override(document, changes)
    source, missing = (robot, ()) if isinstance(robot, Document) else _robot_of(document, robot)
    spec, robot_faults = (None, ()) if source is None else validate_robot(source)

    def validate(task: Document) -> tuple[TaskSpec | None, tuple[Fault, ...]]:
        context = Context(task.data, source.data if source else None, spec.limits if spec else {})
        return _validate(task, "task", TaskSpec, context)

    if spec is not None and spec.dimension == 3:
        document = with_numbers(document)

    kind = document.value(("controller", "kind")) or document.value(("controller",))
    own, unfit = for_controller(document, kind if isinstance(kind, str) else ControllerSpec().kind)
    task, faults = validate(own)
    reports = []
    for other in CONTROLLERS:
        variant, more = for_controller(document, other)
        unfit += more
        if variant not in (document, own):
            reports.append(variant.report(fault for fault in validate(variant)[1] if fault not in faults))
    if spec is not None and source is not None and review is not None:
        part, sound = (own, None) if task is not None else _sound_part(own, faults, spec) or (own, None)
        if (valid := validate(part)[0]) is not None:
            faults += tuple(review(Task(valid, spec, "", source.text, own), sound))
    reports = [
        own.report((*faults, *missing, *unfit)),
        *reports,
        *misplaced,
        source.report(robot_faults) if source else "",
    ]
    if any(reports) or task is None or spec is None or source is None:
        raise SpecError("\n".join(report for report in reports if report))
    stages = task.stages
    if task.priorities is not None:
        omega = priorities_of(task.priorities.compare, [stage.name for stage in stages])
        stages = tuple(stages[i].model_copy(update={"priority": omega[i]}) for i in range(len(stages)))
    overridden = any(origin.override is not None for origin in document.origins.values())
    return Task(
        spec=task.model_copy(update={"name": task.name or name, "stages": stages}),
        robot=spec,
        task_yaml=write(document.data) if overridden else document.text,
        robot_yaml=source.text,
        source=own,
    )


def _sound_part(
    document: Document, faults: Iterable[Fault], robot: RobotSpec
) -> tuple[Document, frozenset[int]] | None:
    """Return a task of the skills and stages without faults, and the indices of these stages; None if there are none.

    A stage without faults that has an end condition is in the place of every other one.
    """
    wrong = {fault.path[:length] for fault in faults for length in (1, 2)}
    skills, stages = document.value(("skills",)), document.value(("stages",))
    if not isinstance(skills, dict) or not isinstance(stages, list):
        return None
    kept = {name: skill for name, skill in skills.items() if ("skills", name) not in wrong}
    sound = {
        i: stage
        for i, stage in enumerate(stages)
        if isinstance(stage, dict) and ("stages", i) not in wrong and str(stage.get("skill")) in kept
    }
    instead = next((stage for stage in sound.values() if stage.get("ends_when")), None)
    if instead is None:
        return None
    at_rest: dict[str, Data] = {part: [0.0] * size for part, size in robot.parts.items()}
    data: dict[str, Data] = {
        "robot": robot.name,
        "initial": at_rest | ({"base": [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]} if robot.dimension == 3 else {}),
        "skills": kept,
        "limits": {} if ("limits",) in wrong else document.value(("limits",)) or {},
        "stages": [sound.get(i, {**instead, "name": f"stage {i}"}) for i in range(len(stages))],
    }
    return Document(document.name, "", data), frozenset(sound)


def _robot_of(task: Document, folder: Path) -> tuple[Document | None, tuple[Fault, ...]]:
    """Read the robot that a task refers to; a fault if there is none."""
    reference = task.value(("robot",))
    if not isinstance(reference, str) or not reference:
        return None, ()
    try:
        path = find("robot", reference, folder)
        return _read_file(path), ()
    except SpecError as error:
        return None, (Fault(("robot",), str(error)),)


def _kind_of(document: Document) -> Kind | None:
    """Return whether a document describes a robot or a task by the keys that only one of them has, None if in doubt."""
    keys = document.data if isinstance(document.data, dict) else ()
    robot = any(key in keys for key in ("arms", "base"))
    task = any(key in keys for key in ("stages", "skills", "robot"))
    return None if robot == task else "robot" if robot else "task"


def _validate(
    document: Document, kind: Kind, model: type[Model], context: Context
) -> tuple[Model | None, tuple[Fault, ...]]:
    """Return a document as a model, None if it is not valid, and its faults."""
    required = [name for name, field in model.model_fields.items() if field.is_required()]
    wanted = f"a {kind}: a mapping with the keys {', '.join(required)}"
    if document.data is None:
        return None, document.faults or (Fault((), f"found an empty file, expected {wanted}"),)
    if not isinstance(document.data, dict):
        return None, (*document.faults, Fault((), f"found {document.found(())}, expected {wanted}"))
    if (found := _kind_of(document)) not in (kind, None):
        return None, (Fault((), f"found the description of a {found}, expected {wanted}"),)
    try:
        valid = model.model_validate(document.data, context=context)
    except ValidationError as error:
        return None, (*document.faults, *_faults(error, document))
    return None if document.faults else valid, document.faults


def _faults(error: ValidationError, document: Document) -> Iterator[Fault]:
    """Give every error of a validation with its path in the document; its `loc` also names branches of unions."""
    for detail in error.errors(include_url=False):
        path: Location = ()
        for step in detail["loc"]:
            path = (*path, step) if (*path, step) in document.origins else path
        context = detail["ctx"]
        yield Fault(path, f"found {context['found'] or document.found(path)}{context['tail']}", context["at_key"])


def with_numbers(task: Document) -> Document:
    """Return a task with the numbers of its poses in their place; its faults have what is wrong with them."""
    faults = list(task.faults)
    for path in list(_poses(task.data, ())):
        try:
            numbers: Data = list(Pose.model_validate(task.value(path)).numbers)
            task = put(task, path, numbers, {(): task.origin(path)})
        except ValidationError as error:
            for detail in error.errors(include_url=False):
                at, context = (*path, *detail["loc"]), detail["ctx"]
                found = context["found"] or task.found(at)
                faults.append(Fault(at, f"found {found}{context['tail']}", context["at_key"]))
            task = put(task, path, [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], {(): task.origin(path)})
    return replace(task, faults=tuple(faults))


def _poses(data: Any, path: Location) -> Iterator[Location]:
    """Give the paths of all poses of a task: mappings that have one of a pose's keys, but a grasp's envelope."""
    if (
        isinstance(data, dict)
        and any(key in data for key in POSE_KEYS)
        and path[:1] in POSE_ROOTS
        and path[-1] != "envelope"
    ):
        yield path
    elif isinstance(data, dict | list):
        for key, value in data.items() if isinstance(data, dict) else enumerate(data):
            yield from _poses(value, (*path, key))


def override(document: Document, changes: Changes) -> tuple[Document, tuple[str, ...]]:
    """Return the document with the changes applied in their order, and messages about those that could not be.

    A change of a key also removes that key, and those around or inside it, from what `by_controller` has of it.
    """
    messages = []
    for number, (typed, text) in enumerate(_texts(changes), start=1):
        try:
            document = _apply(document, typed, number, text)
        except SpecError as error:
            messages.append(f"{typed}: {error}")
    return document, tuple(messages)


def for_controller(document: Document, kind: str) -> tuple[Document, tuple[Fault, ...]]:
    """Apply what the `by_controller` of a document has for one kind of controller.

    Returns:
        The document with those keys changed, located where `by_controller` has them; faults of keys that cannot be.
    """
    faults = []
    own = document.value((BY_CONTROLLER, kind))
    for key, value in own.items() if isinstance(own, dict) else ():
        at = (BY_CONTROLLER, kind, key)
        try:
            path = _path(document, key)
            if path in NO_CONTROLLERS_OWN or path[0] == BY_CONTROLLER:
                raise SpecError(
                    f"found the key {quoted(key)}, expected any key but {', '.join(map(dotted, NO_CONTROLLERS_OWN))}"
                )
            inside = {place[len(at) :]: origin for place, origin in document.origins.items() if lies_inside(place, at)}
            document = put(document, path, value, inside)
        except SpecError as error:
            faults.append(Fault(at, str(error), at_key=True))
    return document, tuple(faults)


def _texts(changes: Changes) -> Iterator[tuple[str, str]]:
    """Give for each change what messages repeat of it, and `path=value`."""
    if isinstance(changes, Mapping):
        for path, value in changes.items():
            text = f"{path}={json.dumps(plain(value), ensure_ascii=False)}"
            yield f"set {text}", text
        return
    for change in changes:
        yield (f"--set {change}", change) if isinstance(change, str) else change


def _apply(document: Document, typed: str, number: int, text: str) -> Document:
    """Return the document with one value replaced or added; the value is YAML."""
    written, separator, value_text = text.partition("=")
    if not separator:
        raise SpecError('found no "=", expected path=value, such as controller.nodes=25')
    path = _path(document, written.strip())
    new = read("--set", value_text)
    if new.faults:
        raise SpecError(new.faults[0].message)
    origins = {
        at: replace(origin, place=Place(number, origin.place.column), override=typed)
        for at, origin in {(): Origin(Place(1, 1)), **new.origins}.items()
    }
    overridden = []
    for at in document.origins:
        if len(at) == 3 and at[0] == BY_CONTROLLER:
            with suppress(SpecError):
                own = _path(document, str(at[2]))
                overridden += [at] if lies_inside(own, path) or lies_inside(path, own) else []
    for at in overridden:
        document = _without(document, at)
    return put(document, path, new.data, origins)


def _without(document: Document, path: Location) -> Document:
    """Return the document without the value at a path that leads to a key of a mapping."""
    data: Any = copy.deepcopy(document.data)
    around = data
    for step in path[:-1]:
        around = around[step]
    del around[path[-1]]
    return replace(
        document, data=data, origins={at: o for at, o in document.origins.items() if not lies_inside(at, path)}
    )


def _path(document: Document, written: str) -> Location:
    """Return the path that a text means; what it leads to need not be there, the lists on the way must be."""
    if not _PATH.fullmatch(written):
        wanted = "expected one such as stages[1].priority or stages.capture.priority"
        raise SpecError(f"found the path {quoted(written)}, {wanted}")
    value = document.data
    path: Location = ()
    for index, name in _STEP.findall(written):
        path = (*path, _key(value, int(index) if index else name, path))
        value = document.value(path)
        if value is None or (isinstance(value, str) and path in SHORTHANDS):
            value = {}
    return path


def _key(value: Data, step: str | int, path: Location) -> str | int:
    """Return the key or index that a step means inside a value; an entry of a list also goes by its `name`."""
    if isinstance(value, dict) and isinstance(step, str):
        return step
    if not isinstance(value, list):
        where = f"{dotted(path)}: " if path else ""
        raise SpecError(f"{where}found {describe(value)}, expected a mapping or list to set {dotted((step,))} in")
    names = {str(entry["name"]): i for i, entry in enumerate(value) if isinstance(entry, dict) and "name" in entry}
    if isinstance(step, str) and step in names:
        return names[step]
    if str(step).isdecimal() and int(step) < len(value):
        return int(step)
    valid = [*names, f"an index from 0 to {len(value) - 1}"] if value else ["no index, the list is empty"]
    raise SpecError(f"{dotted(path)}: found no entry {step}{choice(str(step), valid)}")
