"""`--set path=value`, or an option short for it: one key of a task given on the command line instead of in the file."""

import copy
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

from psmpc_cli.specs.document import Data, Document, Entry, describe, read
from psmpc_cli.specs.messages import Path, Place, choice, dotted, quoted

_PATH = re.compile(r"[^.\[\]=]+(?:\.[^.\[\]=]+|\[\d+\])*")
_STEP = re.compile(r"\[(\d+)\]|([^.\[\]=]+)")

LONGEST = 20_000
"""Characters of all overrides together."""

SHORTHANDS: tuple[Path, ...] = (("controller",), ("solver",), ("plant",), ("onset",))
"""Where a text alone stands for a mapping with that `kind`."""


class _MisplacedError(Exception):
    """A path leads nowhere."""


@dataclass(frozen=True)
class Short:
    """An option that is short for `--set key=value`.

    Attributes:
        option: As it is typed, such as --plant.
        key: Path of the key it sets.
        value: What was typed after it.
    """

    option: str
    key: str
    value: str

    @property
    def text(self) -> str:
        """What would stand after `--set`."""
        return f"{self.key}={self.value}"


Change = str | Short
"""One key to change: `path=value`, or an option short for that."""


@dataclass(frozen=True)
class _Edit:
    """One override, read: what the user typed, its number, the steps of its path as given, and its value."""

    typed: str
    number: int
    steps: Path
    value: Document


def override(document: Document, changes: Sequence[Change]) -> tuple[Document, tuple[str, ...]]:
    """Return the document with the overrides applied in their order, and what is wrong with those that could not be."""
    complaints = []
    texts = [change if isinstance(change, str) else change.text for change in changes]
    if (length := sum(map(len, texts))) > LONGEST:
        return document, (f"--set: found {length} characters, expected at most {LONGEST}: put them into the file",)
    for number, (change, text) in enumerate(zip(changes, texts, strict=True), start=1):
        typed = f"--set {change}" if isinstance(change, str) else f"{change.option} {change.value}"
        try:
            document = _apply(document, _parse(text, typed, number))
        except _MisplacedError as error:
            complaints.append(f"{typed}: {error}")
    return document, tuple(complaints)


def _parse(text: str, typed: str, number: int) -> _Edit:
    """Read `path=value`; the value is YAML."""
    path, separator, value = text.partition("=")
    if not separator:
        raise _MisplacedError('found no "=", expected path=value, such as controller.nodes=25')
    if not _PATH.fullmatch(path.strip()):
        raise _MisplacedError(
            f"found the path {quoted(path)}, expected one such as stages[1].priority or stages.capture.priority"
        )
    read_value = read("--set", value)
    if read_value.faults:
        raise _MisplacedError(read_value.faults[0].message)
    steps = tuple(int(index) if index else name for index, name in _STEP.findall(path.strip()))
    return _Edit(typed, number, steps, read_value)


def _apply(document: Document, edit: _Edit) -> Document:
    """Return the document with one value replaced or added."""
    data, entries = copy.deepcopy(document.data), dict(document.entries)
    value: Data = data
    path: Path = ()
    for step in edit.steps[:-1]:
        key = _key(value, step, path)
        path = (*path, key)
        child = _get(value, key)
        if child is None or (isinstance(child, str) and path in SHORTHANDS):
            entries.update(_opened(document, path, edit.typed))
            child = {} if child is None else {"kind": child}
            _put(value, key, child)
        value = child
    key = _key(value, edit.steps[-1], path)
    path = (*path, key)
    _put(value, key, edit.value.data)
    entries = {at: entry for at, entry in entries.items() if at[: len(path)] != path}
    for at, entry in {(): Entry(Place(1, 1)), **edit.value.entries}.items():
        entries[(*path, *at)] = replace(entry, place=Place(edit.number, entry.place.column), override=edit.typed)
    return replace(document, data=data, entries=entries)


def _opened(document: Document, path: Path, typed: str) -> dict[Path, Entry]:
    """Return the entries of a mapping that takes the place of nothing, or of the shorthand for its `kind`."""
    entry = document.entry(path)
    opened = {path: replace(entry, written=None, override=typed)}
    return opened | ({(*path, "kind"): entry} if entry.written else {})


def _key(value: Data, step: str | int, path: Path) -> str | int:
    """Return the key or index that a step means inside a value."""
    if isinstance(value, dict) and isinstance(step, str):
        return step
    if isinstance(value, list):
        return _index(value, step, path)
    where = f"{dotted(path)}: " if path else ""
    raise _MisplacedError(f"{where}found {describe(value)}, expected a mapping or list to set {dotted((step,))} in")


def _index(entries: list[Data], step: str | int, path: Path) -> int:
    """Return the index of the entry that a step means: one with that `name`, or the index itself."""
    names = {str(entry["name"]): i for i, entry in enumerate(entries) if isinstance(entry, dict) and "name" in entry}
    if isinstance(step, str) and step in names:
        return names[step]
    if str(step).isdecimal() and int(step) < len(entries):
        return int(step)
    if isinstance(step, str) and names:
        raise _MisplacedError(f"{dotted(path)}: found no entry named {quoted(step)}{choice(step, names)}")
    last = f"an index from [0] to [{len(entries) - 1}]" if entries else "no index, the list is empty"
    raise _MisplacedError(f"{dotted(path)}: found {dotted((step,))}, expected {last}")


def _get(value: Data, key: str | int) -> Data:
    """Return one entry of a mapping or list, None if there is none."""
    if isinstance(value, dict):
        return value.get(str(key))
    return value[key] if isinstance(value, list) and isinstance(key, int) else None


def _put(value: Data, key: str | int, item: Data) -> None:
    """Set one entry of a mapping or list."""
    if isinstance(value, dict):
        value[str(key)] = item
    elif isinstance(value, list) and isinstance(key, int):
        value[key] = item
