"""Robot and task descriptions from files, names or stored texts to validated data."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from psmpc_cli.errors import SpecError
from psmpc_cli.specs.cursor import Cursor
from psmpc_cli.specs.document import Document, read, write
from psmpc_cli.specs.library import Kind, built_ins, find, look_up, read_text, shown
from psmpc_cli.specs.messages import Fault
from psmpc_cli.specs.overrides import Change, override
from psmpc_cli.specs.robot import RobotSpec
from psmpc_cli.specs.task import TaskSpec
from psmpc_cli.specs.validate import kind_of, validate_robot, validate_task

LONGEST_PATH = 1000
"""Characters of a path that a task refers to."""


@dataclass(frozen=True)
class LoadedRobot:
    """A robot and where it came from.

    Attributes:
        spec: The robot.
        robot_yaml: The text it was read from.
        source: Locates a path in that text.
    """

    spec: RobotSpec
    robot_yaml: str
    source: Document


@dataclass(frozen=True)
class Task:
    """A task with its robot, and where they came from.

    Attributes:
        spec: The task.
        robot: Its robot.
        task_yaml: The effective text, overrides applied: it loads again to the same task.
        robot_yaml: The robot's text.
        source: Locates a path of the task in its file.
    """

    spec: TaskSpec
    robot: RobotSpec
    task_yaml: str
    robot_yaml: str
    source: Document

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the task and its robot, whatever the files look like."""
        content = {
            "task": self.spec.model_dump(mode="json"),
            "robot": self.robot.model_dump(mode="json"),
            "parts": list(self.robot.parts),
        }
        canonical = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
        return hashlib.sha256(canonical.encode()).hexdigest()


def load_task(reference: str | Path, set: Sequence[Change] = ()) -> Task:
    """Load a task and its robot.

    Args:
        reference: A path, or the name of a built-in task.
        set: Keys of the task to change, each `path=value` or an option short for that.

    Raises:
        SpecError: Something is wrong with the file, the robot's file or an override; the message has all of it.
    """
    path = find("task", reference)
    document, complaints = override(read(shown(path), read_text(path)), set)
    robot, problem = _robot_of(document, path.parent)
    return _task(document, robot, path.stem, complaints, () if problem is None else (problem,))


def load_robot(reference: str | Path) -> LoadedRobot:
    """Load a robot from a path or by the name of a built-in one.

    Raises:
        SpecError: Something is wrong with the file; the message has all of it.
    """
    path = find("robot", reference)
    document = read(shown(path), read_text(path))
    robot, problems = validate_robot(document)
    if robot is None:
        raise SpecError(document.report(problems))
    return LoadedRobot(robot, document.text, document)


def kind_of_reference(reference: str | Path) -> Kind:
    """Return whether a path or a built-in name stands for a robot or a task, a task if in doubt.

    Raises:
        SpecError: There is no such file, or it cannot be read.
    """
    if str(reference) in built_ins("robot") and not Path(reference).is_file():
        return "robot"
    path = find("task", reference)
    return kind_of(read(shown(path), read_text(path)))


def parse_task(task_yaml: str, robot_yaml: str, name: str, set: Sequence[Change] = ()) -> Task:
    """Rebuild a task from texts stored elsewhere, such as in a log; no file is touched.

    Args:
        task_yaml: The effective text of the task.
        robot_yaml: The text of its robot.
        name: What the task is called if it does not say so itself.
        set: Keys of the task to change, each `path=value` or an option short for that.

    Raises:
        SpecError: Something is wrong with the texts or an override.
    """
    document, complaints = override(read(name, task_yaml), set)
    return _task(document, read(f"{name} (robot)", robot_yaml), name, complaints)


def _robot_of(task: Document, folder: Path) -> tuple[Document | None, Fault | None]:
    """Return the document of the robot a task refers to, or the problem with the reference."""
    reference = Cursor(task)["robot"].text
    if not reference:
        return None, None
    if len(reference) > LONGEST_PATH:
        wrong = (
            f"found {len(reference)} characters, expected a built-in robot's name or a path of at most {LONGEST_PATH}"
        )
        return None, Fault(("robot",), wrong)
    try:
        path = look_up("robot", reference, folder)
        return read(shown(path), read_text(path)), None
    except (LookupError, SpecError) as error:
        return None, Fault(("robot",), str(error.args[0]))


def _task(
    document: Document,
    robot_document: Document | None,
    name: str,
    complaints: Sequence[str] = (),
    problems: Sequence[Fault] = (),
) -> Task:
    """Return the task of two documents, or raise everything that is wrong with them."""
    robot, robot_problems = (None, ()) if robot_document is None else validate_robot(robot_document)
    task, task_problems = validate_task(document, robot)
    if task is None or robot is None or robot_document is None or complaints or problems:
        robot_report = "" if robot_document is None else robot_document.report(robot_problems)
        reports = (document.report((*task_problems, *problems)), *complaints, robot_report)
        raise SpecError("\n".join(text for text in reports if text))
    return Task(
        spec=task if task.name else task.model_copy(update={"name": name}),
        robot=robot,
        task_yaml=_effective(document),
        robot_yaml=robot_document.text,
        source=document,
    )


def _effective(document: Document) -> str:
    """Return the text of a document; written anew if it has been overridden."""
    overridden = any(entry.override is not None for entry in document.entries.values())
    return write(document.data) if overridden else document.text
