"""YAML 1.2 texts as plain data with the position of every value, messages about them, changes, and plain data as YAML.

PyYAML parses; scalars are resolved here by the core schema of YAML 1.2.
"""

import json
import math
import os
import re
import reprlib
import stat
from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from functools import lru_cache, reduce
from operator import getitem
from pathlib import Path
from typing import Any, NamedTuple

import yaml
from pydantic_core import to_jsonable_python
from yaml.error import MarkedYAMLError
from yaml.reader import ReaderError

from psmpc_cli.errors import SpecError

Scalar = None | bool | int | float | str
Data = Scalar | list["Data"] | dict[str, "Data"]
"""What YAML holds."""

Location = tuple[str | int, ...]
"""Keys and indices from the root of a file to a value."""

LONGEST = 60
"""Characters of a value that a message repeats."""

DEEPEST = 30
MOST_VALUES = 20_000
"""Levels of nesting (a task has seven), and values of a file once its aliases are expanded."""

MOST_FAULTS = 50
"""Faults of one file that a report lists."""

MOST_NAMES = 50
"""Valid names that a message lists."""

WIDEST = 120
"""Columns of a source line that a report repeats."""

LARGEST = 1e12
"""Magnitude of a number: results computed from it stay within a float's range."""

DECIMAL = r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?"

_WORDS: dict[str, Scalar] = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL")),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
    **dict.fromkeys((".nan", ".NaN", ".NAN"), math.nan),
    **{f"{sign}.{word}": float(f"{sign}inf") for sign in ("", "+", "-") for word in ("inf", "Inf", "INF")},
}
_INTEGER = re.compile(r"[-+]?[0-9]{1,300}|0o[0-7]+|0x[0-9a-fA-F]+")
"""Integers that are surely within the range of a float, if they are decimal."""

_PATH = re.compile(r"[^.\[\]=]+(?:\.[^.\[\]=]+|\[\d+\])*")
_STEP = re.compile(r"\[(\d+)\]|([^.\[\]=]+)")

BY_CONTROLLER = "by_controller"
"""Key of a task that holds, by controller, keys to change where that controller runs."""

NO_CONTROLLERS_OWN: tuple[Location, ...] = (("robot",), ("controller",), ("controller", "kind"), (BY_CONTROLLER,))
"""Keys that cannot depend on the controller."""

SECTIONS_WITH_A_KIND = ("controller", "solver", "plant", "onset")
"""Sections of a task for which a text stands for their `kind`."""

Change = str | tuple[str, str]
"""One key to change: `path=value`, or an option as it was typed and the `path=value` that it is short for."""

Changes = Mapping[str, Any] | Sequence[Change]
"""Keys to change: values by path, or a sequence of changes in their order."""


class Place(NamedTuple):
    """A position in a text, both counted from 1."""

    line: int
    column: int


@dataclass(frozen=True)
class Fault:
    """One fault of a description.

    Attributes:
        path: Where, from the root of the file.
        message: What was found and what was expected.
        at_key: Whether the position is that of the path's key, not of its value.
        place: The position, if it is that of neither.
    """

    path: Location
    message: str
    at_key: bool = False
    place: Place | None = None


@dataclass(frozen=True)
class Origin:
    """Where a value comes from: its position and its key's, how it was written, and what set it instead of the text.

    That is an override, or a part of another file, as a message names it.
    """

    place: Place
    key: Place | None = None
    written: str | None = None
    override: str | None = None


@dataclass(frozen=True)
class Document:
    """A robot or task description as it was read.

    Attributes:
        name: Its name in messages: the path as the user gave it.
        text: The YAML text.
        data: What it holds; None if it is empty or no YAML.
        origins: Where every value of `data` comes from.
        faults: What is wrong with it as YAML.
        changed: Whether `data` is no longer what the text says.
    """

    name: str
    text: str
    data: Data = None
    origins: Mapping[Location, Origin] = field(default_factory=dict)
    faults: tuple[Fault, ...] = ()
    changed: bool = False

    def __repr__(self) -> str:
        return f"<Document {self.name}: {counted(len(self.text.splitlines()), 'line', 'lines')}>"

    @property
    def yaml(self) -> str:
        """A text that says what it holds: its own, or one without comments if that was changed."""
        return write(self.data) if self.changed else self.text

    def origin(self, path: Location) -> Origin:
        """Return the origin of the value at a path, or of the nearest one around it."""
        while path and path not in self.origins:
            path = path[:-1]
        return self.origins.get(path, Origin(Place(1, 1)))

    def value(self, path: Location) -> Data:
        """Return the value at a path, None if there is none."""
        found: Data = _value_at(self.data, path) if path in self.origins else None
        return found

    def found(self, path: Location) -> str:
        """Describe the value at a path: its kind and, for a scalar or a short list of them, how it was written."""
        value = self.value(path)
        if isinstance(value, list) and 0 < len(value) <= 4 and not any(isinstance(x, list | dict) for x in value):
            written = (self.origins[(*path, i)].written for i in range(len(value)))
            return f"[{', '.join(shortened(word or 'null') for word in written)}]"
        if isinstance(value, list):
            return f"a list of {counted(len(value), 'entry', 'entries')}" if value else "an empty list"
        if isinstance(value, dict):
            return f"a mapping of {counted(len(value), 'key', 'keys')}" if value else "an empty mapping"
        if isinstance(value, str):
            return f"the text {quoted(value)}"
        return "nothing" if value is None else shortened(self.origins[path].written or str(value))

    def report(self, faults: Iterable[Fault]) -> str:
        """Write faults as the message that a user reads: `file:line:column: path: message`, then the line itself.

        Faults are in the order of their lines. Those of values that an override has set (`--set`) come last, and name
        the override instead of a line. Of more than `MOST_FAULTS` only the number of the others is written.
        """
        placed = []
        for fault in dict.fromkeys(faults):  # each once
            origin = self.origin(fault.path)
            place = fault.place or (fault.at_key and origin.key) or origin.place
            placed.append((origin.override is not None, place, origin, fault))
        placed.sort(key=lambda entry: entry[:2])  # texts before overrides, then by place
        lines = []
        for overridden, place, origin, fault in placed[:MOST_FAULTS]:
            what = f"{dotted(fault.path)}: {fault.message}" if fault.path else fault.message
            where = origin.override or f"{self.name}:{place.line}:{place.column}"
            lines.append(f"{where}: {what}{'' if overridden else self._source(place)}")
        more = [f"{self.name}: {len(placed) - MOST_FAULTS} more problems"] if len(placed) > MOST_FAULTS else []
        return "\n".join(lines + more)

    def _source(self, place: Place) -> str:
        """Write the line of a position with a caret below its column; nothing for a line that is not in the text."""
        line = "".join(self.text.splitlines()[place.line - 1 : place.line])
        if not line:
            return ""
        start = max(0, min(place.column - WIDEST // 2, len(line) - WIDEST))
        shown = "".join(c if c.isprintable() else " " for c in line[start : start + WIDEST])
        return f"\n{place.line:>4} | {shown.rstrip()}\n     | {' ' * (place.column - 1 - start)}^"


@lru_cache(maxsize=64)
def _compose(text: str) -> Any:
    """Return the nodes of a YAML text; of a text that was just read, such as the robot of many tasks, the same ones."""
    return yaml.compose(text, Loader=yaml.BaseLoader)


def read(name: str, text: str) -> Document:
    """Read a YAML text as plain data with the position of every value; raise nothing.

    What is wrong with the text as YAML is in the document's `faults`, with its position, so that it is reported along
    with what is wrong with its keys. A text that cannot be parsed has no data.

    Args:
        name: Name of the document in messages, such as the path of its file.
        text: The text.
    """
    origins: dict[Location, Origin] = {}
    faults: list[Fault] = []
    try:
        node = _compose(text)
        data = None if node is None else _to_plain_data(node, (), None, origins, faults)
        return Document(name, text, data, origins, tuple(faults))
    except MarkedYAMLError as error:
        since = f", {error.context} that begins in line {error.context_mark.line + 1}" if error.context_mark else ""
        message = f"found no plain YAML{since}: {error.problem}"
        place = _place_of(error.problem_mark)
    except ReaderError as error:
        start = text.rfind("\n", 0, error.position) + 1  # of the line, to count its columns
        place = Place(text.count("\n", 0, error.position) + 1, error.position - start + 1)
        message = f"found the control character U+{ord(text[error.position]):04X}, expected printable text"
    except RecursionError:
        message = f"found no plain YAML: {TOO_LARGE}"
        place = Place(1, 1)
    return Document(name, text, faults=(Fault((), message, place=place),))


def _with_value(
    document: Document, at: Location, new: Data, origins: Mapping[Location, Origin], without: Collection[Location] = ()
) -> Document:
    """Return the document with one value replaced or added.

    Mappings on the way to it that are missing are added. A section that is written as a text, such as
    `controller: htmpc`, becomes the mapping `{kind: htmpc}` first, so that it can hold a further key.

    Args:
        document: The document, which does not change.
        at: Path of the value.
        new: The value.
        origins: Where the value comes from, for messages, by the empty path; and what is inside it, by path from it.
        without: Paths of keys that are removed.
    """
    data = _copied_along(document.data, (at, *without))
    gone = {at, *without}
    lengths = {len(path) for path in gone}
    # origins of all values but those that are replaced or removed, and what is inside these
    kept = {path: origin for path, origin in document.origins.items() if gone.isdisjoint([path[:n] for n in lengths])}
    for removed in without:
        del _value_at(data, removed[:-1])[removed[-1]]
    around: Any = data  # the mapping or list that the next step leads into
    for length, key in enumerate(at[:-1], start=1):
        inner = around.get(key) if isinstance(around, dict) else around[key]
        place = at[:length]
        if inner is None or isinstance(inner, str):  # missing, or a section's kind as a text
            kept |= {(*place, "kind"): kept[place]} if inner else {}
            kept[place] = replace(origins[()], written=None)  # the mapping is there because of the new value
            around[key] = {} if inner is None else {"kind": inner}
        around = around[key]
    around[at[-1]] = new
    kept |= {(*at, *path): origin for path, origin in origins.items()}
    return replace(document, data=data, origins=kept, changed=True)


def _copied_along(data: Any, paths: Collection[Location]) -> Any:
    """Return data in which the values at some paths may be replaced without changing the original.

    Mappings and lists on the way to these paths are copied; all else is shared with the original. A document does not
    change, so changes of its keys are made in such data.
    """
    if not isinstance(data, dict | list):
        return data
    copied: Any = data.copy()
    onward: dict[int | str, list[Location]] = {}  # by first step, what is left of the paths
    for path in paths:
        if len(path) > 1:
            onward.setdefault(path[0], []).append(path[1:])
    for key, further in onward.items():
        if isinstance(data, list) or key in data:
            copied[key] = _copied_along(copied[key], further)
    return copied


def _value_at(data: Any, path: Location) -> Any:
    return reduce(getitem, path, data)


def origins_of(data: Data, sources: Mapping[Location, str]) -> dict[Location, Origin]:
    """Return where values come from that were built from another file, such as a URDF, for messages about them.

    Args:
        data: What was built.
        sources: Source of each value by its path, as a message names it, such as `arm.urdf:12: link "hand"`. Values
            inside it without a source of their own have the same one.

    Returns:
        Origin of every value by its path. Its place is only that of the beginning of a file: messages name the source.
    """
    origins = dict[Location, Origin]()

    def add(value: Data, path: Location, source: str | None) -> None:
        source = sources.get(path, source)
        inside = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
        origins[path] = Origin(Place(1, 1), written=None if value is None else str(value), override=source)
        for key, value_inside in inside:
            add(value_inside, (*path, key), source)

    add(data, (), None)
    return origins


def mapping(value: object) -> dict[str, Any]:
    """Return a mapping as it was read, an empty one for anything else."""
    return value if isinstance(value, dict) else {}


def lies_inside(path: Location, around: Location) -> bool:
    """Tell whether a path is another one, or leads into it."""
    return path[: len(around)] == around


def write(data: object) -> str:
    """Write data as YAML that reads back as the same data, keys in their order, short lists on one line.

    Raises:
        SpecError: It has no form in YAML.
    """
    data = plain(data)
    return yaml.dump(data, Dumper=_Writer, sort_keys=False, default_flow_style=None, allow_unicode=True, width=120)


def plain(value: Any) -> Data:
    """Convert a Python value to plain data for YAML or JSON: tuples and arrays to lists, paths and keys to texts.

    Raises:
        SpecError: The value, or one in it, cannot be converted.
    """
    try:
        data: Data = to_jsonable_python(value, fallback=lambda item: item.tolist())
    except (AttributeError, ValueError):  # no tolist(); contains itself, or cannot be serialized
        wanted = "numbers, texts, True, False, None, lists and mappings"
        raise SpecError(f"found {shortened(reprlib.repr(value))}, expected {wanted}") from None
    return data


def resolve(word: str) -> Scalar:
    """Return the meaning of an unquoted word in YAML 1.2; a number beyond a float's range is infinite."""
    if word in _WORDS:
        return _WORDS[word]
    if _INTEGER.fullmatch(word):
        return int(word, {"0o": 8, "0x": 16}.get(word[:2], 10))
    return float(word) if re.fullmatch(DECIMAL, word) else word


TOO_LARGE = f"more than {DEEPEST} levels or {MOST_VALUES} values with aliases expanded"


def _to_plain_data(
    node: Any, path: Location, key: Place | None, origins: dict[Location, Origin], faults: list[Fault]
) -> Data:
    """Convert a node of PyYAML and all inside it to plain data: mappings, lists, and scalars by the rules of YAML 1.2.

    Args:
        node: The node.
        path: Its path from the root of the file.
        key: Position of its key; None for the root and for entries of lists.
        origins: Receives the origin of every value by its path.
        faults: Receives what is wrong with keys: those that are no words, or that a mapping has twice, of which the
            first counts.

    Raises:
        MarkedYAMLError: Values are nested too deep or too many, or one has a tag, such as `!!binary`.
    """
    place = _place_of(node.start_mark)
    tag = node.tag.replace("tag:yaml.org,2002:", "!!")
    if len(path) > DEEPEST or len(origins) > MOST_VALUES:
        raise MarkedYAMLError(problem=TOO_LARGE, problem_mark=node.start_mark)
    if tag not in ("!!str", "!!seq", "!!map"):
        raise MarkedYAMLError(problem=f"the tag {quoted(tag)}", problem_mark=node.start_mark)
    origins[path] = Origin(place, key, node.value if isinstance(node, yaml.ScalarNode) else None)
    if isinstance(node, yaml.ScalarNode):
        return resolve(node.value) if node.style is None else str(node.value)  # with a style it is quoted: a text
    if isinstance(node, yaml.SequenceNode):
        return [_to_plain_data(item, (*path, index), None, origins, faults) for index, item in enumerate(node.value)]
    mapping: dict[str, Data] = {}
    for key_node, value_node in node.value:
        word = key_node.value
        place_of_key = _place_of(key_node.start_mark)
        if not isinstance(word, str):
            faults.append(Fault(path, "found a list or mapping as a key, expected a word", place=place_of_key))
        elif word in mapping:
            first = origins[(*path, word)].key
            line = f" (first in line {first.line})" if first else ""
            message = f"found this key again{line}, expected every key once"
            faults.append(Fault((*path, word), message, place=place_of_key))
        else:
            mapping[word] = _to_plain_data(value_node, (*path, word), place_of_key, origins, faults)
    return mapping


class _Writer(yaml.SafeDumper):
    """PyYAML's writer without anchors; texts that YAML 1.2 would read as something else are quoted."""

    def ignore_aliases(self, data: object) -> bool:
        return True

    def represent_str(self, data: str) -> yaml.ScalarNode:
        style = None if isinstance(resolve(data), str) else '"'
        return self.represent_scalar("tag:yaml.org,2002:str", data, style=style)


_Writer.add_representer(str, _Writer.represent_str)


def _place_of(mark: Any) -> Place:
    """Return the position of a mark of PyYAML."""
    return Place(mark.line + 1, mark.column + 1)


def dotted(path: Location) -> str:
    """Write a path as in messages and `--set`: `stages[1].target.base`."""
    steps = [f"[{step}]" if isinstance(step, int) else f".{printable(shortened(step))}" for step in path]
    return "".join(steps).removeprefix(".")


def read_regular(path: Path, most: int, wanted: str = "a file", cut: bool = False) -> bytes:
    """Read a regular file, never more than its size says.

    Other files, such as pipes, and files of the kernel may never end; a pipe is opened without waiting for its writer.

    Args:
        path: The file.
        most: Bytes that it may have.
        wanted: What was expected, for messages.
        cut: Whether of a larger file the beginning is returned.

    Raises:
        SpecError: It is no regular file, or too large.
        OSError: There is none, or it cannot be read.
    """
    status = path.stat()
    if not stat.S_ISREG(status.st_mode):
        kind = "a directory" if stat.S_ISDIR(status.st_mode) else "no regular file"
        raise SpecError(f"found {kind}, expected {wanted}")
    if status.st_size > most and not cut:
        raise SpecError(f"found {status.st_size} bytes, expected {wanted} of at most {most}")
    with open(path, "rb", opener=lambda name, flags: os.open(name, flags | os.O_NONBLOCK)) as file:
        return file.read(min(status.st_size, most))


def quoted(text: str) -> str:
    """Write a text in double quotes, on one line, shortened."""
    return printable(json.dumps(shortened(text), ensure_ascii=False))


def printable(text: str) -> str:
    """Write a text on one line, with escapes for characters that could control a terminal."""
    return text if text.isprintable() else "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


def shortened(text: str) -> str:
    """Cut a text to what a message repeats."""
    return text if len(text) <= LONGEST else text[: LONGEST - 3] + "..."


def counted(number: int, one: str, many: str) -> str:
    """Write a count with its noun: `1 key`, `2 keys`."""
    return f"{number} {one if number == 1 else many}"


def suggestion(name: str, valid: Iterable[str]) -> str | None:
    """Return the valid name nearest to `name`, None if none is near."""
    return _suggestion(name, tuple(valid))


@lru_cache(maxsize=256)
def _suggestion(name: str, valid: tuple[str, ...]) -> str | None:
    by_folded = {candidate.casefold(): candidate for candidate in valid}
    near = get_close_matches(name.casefold(), by_folded, n=1, cutoff=0.6)
    return by_folded[near[0]] if near else None


def choice(name: str, valid: Iterable[str]) -> str:
    """Write the end of a message about a name that is not valid: the nearest valid one, and all of them."""
    names = list(dict.fromkeys(valid))
    near = suggestion(name, names)
    hint = f" (did you mean {quoted(near)}?)" if near else ""
    listed = ", ".join(printable(shortened(each)) for each in names[:MOST_NAMES])
    listed += ", ..." if len(names) > MOST_NAMES else ""
    return f"{hint}, expected {'one of ' if len(names) > 1 else ''}{listed}"


def override(document: Document, changes: Changes) -> tuple[Document, tuple[str, ...]]:
    """Apply changes of keys to a document, as `--set` and the argument `set` of `load_task` mean them.

    A change holds for every controller. So it also removes that key, and keys around or inside it, from what
    `by_controller` sets for single controllers.

    Args:
        document: The task as it was read.
        changes: Keys to change, in their order.

    Returns:
        The document with the changes, and messages about those that could not be applied.
    """
    messages = []
    if isinstance(changes, Mapping):
        texts = (f"{path}={json.dumps(plain(value), ensure_ascii=False)}" for path, value in changes.items())
        changes = [(f"set {text}", text) for text in texts]
    for number, change in enumerate(changes, start=1):  # the number orders the messages about changed values
        typed, text = (f"--set {change}", change) if isinstance(change, str) else change
        try:
            document = _with_change(document, typed, number, text)
        except SpecError as error:
            messages.append(f"{typed}: {error}")
    return document, tuple(messages)


def for_controller(document: Document, kind: str) -> Document:
    """Return the document of a task with the keys that its `by_controller` sets for one kind of controller.

    Messages about their values point at `by_controller`. Keys that cannot be set there, such as `robot`, become faults
    of the document.

    Args:
        document: The task as it was read.
        kind: The controller, such as `htmpc`.
    """
    for key, value in mapping(document.value((BY_CONTROLLER, kind))).items():
        at = (BY_CONTROLLER, kind, key)
        try:
            path = _parse_path(document, key)
            if path in NO_CONTROLLERS_OWN or path[0] == BY_CONTROLLER:
                wanted = f"any key but {', '.join(map(dotted, NO_CONTROLLERS_OWN))}"
                raise SpecError(f"found the key {quoted(key)}, expected {wanted}")
            inside = {place[len(at) :]: origin for place, origin in document.origins.items() if lies_inside(place, at)}
            document = _with_value(document, _place_of_change(document, path, value), value, inside)
        except SpecError as error:
            document = replace(document, faults=(*document.faults, Fault(at, str(error), at_key=True)))
    return document


def with_controller(document: Document, kind: str) -> Document:
    """Return the document with a kind of controller in place of its own; itself where that section is malformed."""
    section = document.value(("controller",))
    if not (section is None or isinstance(section, str | dict)):
        return document
    return _with_value(document, ("controller", "kind"), kind, {(): Origin(Place(1, 1))})


def _with_change(document: Document, typed: str, number: int, text: str) -> Document:
    """Return the document with one change of a key applied, and its key removed from `by_controller`.

    Args:
        document: The document.
        typed: The change as messages repeat it, such as `--set controller.nodes=25`.
        number: Number of the change, which orders messages about several.
        text: The change, `path=value`; the value is YAML.

    Raises:
        SpecError: It has no `=`, its path leads nowhere, or its value is no YAML.
    """
    written, separator, value_text = text.partition("=")
    if not separator:
        raise SpecError('found no "=", expected path=value, such as controller.nodes=25')
    path = _parse_path(document, written.strip())
    new = read("--set", value_text)
    if new.faults:
        raise SpecError(new.faults[0].message)
    path = _place_of_change(document, path, new.data)
    # the number stands for a line, by which messages are ordered
    origins = {
        at: replace(origin, place=Place(number, origin.place.column), override=typed)
        for at, origin in (new.origins or {(): Origin(Place(1, 1))}).items()
    }
    overridden = []  # paths (by_controller, controller, key) of keys that the change replaces
    for at in (at for at in document.origins if len(at) == 3 and at[0] == BY_CONTROLLER):
        with suppress(SpecError):  # a key there that leads nowhere is a fault of its own
            path_there = _parse_path(document, str(at[2]))
            overridden += [at] if lies_inside(path_there, path) or lies_inside(path, path_there) else []
    return _with_value(document, path, new.data, origins, without=overridden)


def _parse_path(document: Document, written: str) -> Location:
    """Return the path that a text means; what it leads to need not be there, the lists on the way must be."""
    if not _PATH.fullmatch(written):
        wanted = "expected one such as stages[1].priority or stages.capture.priority"
        raise SpecError(f"found the path {quoted(written)}, {wanted}")
    value = document.data
    path: Location = ()
    for index, name in _STEP.findall(written):
        path = (*path, _resolve_step(document, value, int(index) if index else name, path))
        value = document.value(path)
        if value is None or (isinstance(value, str) and len(path) == 1):  # such as `controller: htmpc`
            value = {}
    return path


def _place_of_change(document: Document, path: Location, value: Data) -> Location:
    """Return the path at which a value is put: that of the kind where a text is set in place of a whole section.

    So `controller=hard` keeps the other keys of a section that is written as a mapping.
    """
    if len(path) != 1 or path[0] not in SECTIONS_WITH_A_KIND:
        return path
    names_the_kind = isinstance(value, str) and isinstance(document.value(path), dict)
    return (*path, "kind") if names_the_kind else path


def _resolve_step(document: Document, value: Data, step: str | int, path: Location) -> str | int:
    """Return the key or index that a step means inside a value; an entry of a list also goes by its `name`."""
    if isinstance(value, dict) and isinstance(step, str):
        return step
    if not isinstance(value, list):
        where = f"{dotted(path)}: " if path else ""
        found = f"found {document.found(path)}"
        raise SpecError(f"{where}{found}, expected a mapping or list to set {dotted((step,))} in")
    names = {str(entry["name"]): i for i, entry in enumerate(value) if isinstance(entry, dict) and "name" in entry}
    places = {str(i): i for i in range(len(value))} | names
    if str(step) in places:
        return places[str(step)]
    valid = [*names, f"an index from 0 to {len(value) - 1}"] if value else ["no index, the list is empty"]
    raise SpecError(f"{dotted(path)}: found no entry {step}{choice(str(step), valid)}")
