"""Keys of a task that are set from outside its file: `--set path=value`, options short for that, or a mapping."""

import copy
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from psmpc_cli.specs.document import Data, Document, Entry, Raw, describe, plain, read
from psmpc_cli.specs.messages import Fault, Path, Place, choice, dotted, quoted

_PATH = re.compile(r"[^.\[\]=]+(?:\.[^.\[\]=]+|\[\d+\])*")
_STEP = re.compile(r"\[(\d+)\]|([^.\[\]=]+)")

SHORTHANDS: tuple[Path, ...] = (("controller",), ("solver",), ("plant",), ("onset",))
"""Where a text alone means a mapping with that `kind`."""

BY_CONTROLLER = "by_controller"
"""Key of a task that holds, by controller, keys to change where that controller runs."""

NO_CONTROLLERS_OWN: tuple[Path, ...] = (("robot",), ("controller",), ("controller", "kind"), (BY_CONTROLLER,))
"""Keys that cannot depend on the controller."""


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


Change = str | Short
"""One key to change: `path=value`, or an option short for that."""

Changes = Mapping[str, Any] | Sequence[Change]
"""Keys to change: values by path, or a sequence of changes in their order."""


class _MisplacedError(Exception):
    """A path leads nowhere."""


def override(document: Document, changes: Changes) -> tuple[Document, tuple[str, ...]]:
    """Return the document with the changes applied in their order, and messages about those that could not be.

    A change of a key also removes that key, and those around or inside it, from what `by_controller` has of it.
    """
    messages = []
    for number, (typed, text) in enumerate(_texts(changes), start=1):
        try:
            document = _apply(document, typed, number, text)
        except _MisplacedError as error:
            messages.append(f"{typed}: {error}")
    return document, tuple(messages)


def for_controller(document: Document, kind: str) -> tuple[Document, dict[Path, Path], tuple[Fault, ...]]:
    """Apply what the `by_controller` of a document has for one kind of controller.

    Returns:
        The document with those keys changed, located where `by_controller` has them; the paths that were changed or
        added with those of their origin; and faults of keys that cannot be changed.
    """
    origins: dict[Path, Path] = {}
    faults = []
    for key, value in Raw(document)[BY_CONTROLLER][kind].items():
        entries = {at[len(value.path) :]: entry for at, entry in document.entries.items() if _inside(at, value.path)}
        before = document.entries
        try:
            document, path = _put(document, _steps(key), copy.deepcopy(value.value), entries)
        except _MisplacedError as error:
            faults.append(Fault(value.path, str(error), at_key=True))
            continue
        added = (path[:length] for length in range(len(path), 0, -1))
        origins |= {at: value.path for at in added if at == path or at not in before}
        if path in NO_CONTROLLERS_OWN or path[0] == BY_CONTROLLER:
            wanted = f"any key but {', '.join(map(dotted, NO_CONTROLLERS_OWN))}"
            faults.append(value.fault(wanted, f"the key {quoted(key)}", at_key=True))
    return document, origins, tuple(faults)


def _texts(changes: Changes) -> Iterator[tuple[str, str]]:
    """Give for each change what messages repeat of it, and `path=value`."""
    if isinstance(changes, Mapping):
        for path, value in changes.items():
            text = f"{path}={json.dumps(plain(value), ensure_ascii=False)}"
            yield f"set {text}", text
        return
    for change in changes:
        if isinstance(change, Short):
            yield f"{change.option} {change.value}", f"{change.key}={change.value}"
        else:
            yield f"--set {change}", change


def _apply(document: Document, typed: str, number: int, text: str) -> Document:
    """Return the document with one value replaced or added; the value is YAML."""
    written, separator, value_text = text.partition("=")
    if not separator:
        raise _MisplacedError('found no "=", expected path=value, such as controller.nodes=25')
    steps = _steps(written.strip())
    new = read("--set", value_text)
    if new.faults:
        raise _MisplacedError(new.faults[0].message)
    entries = {(): Entry(Place(1, 1)), **new.entries}
    typed_entries = {
        at: replace(entry, place=Place(number, entry.place.column), override=typed) for at, entry in entries.items()
    }
    document, path = _put(document, steps, new.data, typed_entries)
    return _without_own(document, path)


def _steps(written: str) -> list[str | int]:
    """Split a path as it is written into names and indices."""
    if not _PATH.fullmatch(written):
        wanted = "expected one such as stages[1].priority or stages.capture.priority"
        raise _MisplacedError(f"found the path {quoted(written)}, {wanted}")
    return [int(index) if index else name for index, name in _STEP.findall(written)]


def _put(
    document: Document, steps: Sequence[str | int], new: Data, new_entries: Mapping[Path, Entry]
) -> tuple[Document, Path]:
    """Return the document with one value replaced or added, and the path of that value.

    Args:
        document: The document.
        steps: Names and indices that lead to the value.
        new: The value.
        new_entries: Its entries and those inside it, by path from it.
    """
    data, entries = copy.deepcopy(document.data), dict(document.entries)
    value: Any = data
    path: Path = ()
    for step in steps[:-1]:
        key = _key(value, step, path)
        path = (*path, key)
        child = value.get(key) if isinstance(value, dict) else value[key]
        if child is None or (isinstance(child, str) and path in SHORTHANDS):
            entry = document.entry(path)
            entries |= {(*path, "kind"): entry} if entry.written else {}
            entries[path] = replace(entry, written=None, override=new_entries[()].override)
            child = {} if child is None else {"kind": child}
            value[key] = child
        value = child
    key = _key(value, steps[-1], path)
    path = (*path, key)
    value[key] = new
    entries = {at: entry for at, entry in entries.items() if not _inside(at, path)}
    entries |= {(*path, *at): entry for at, entry in new_entries.items()}
    return replace(document, data=data, entries=entries), path


def _without_own(document: Document, changed: Path) -> Document:
    """Return the document without the keys of `by_controller` that are a changed one, around it or inside it."""
    for kind, own in Raw(document)[BY_CONTROLLER].items():
        for key, value in own.items():
            try:
                path = _put(document, _steps(key), None, {(): Entry(Place(1, 1))})[1]
            except _MisplacedError:
                continue
            if _inside(path, changed) or _inside(changed, path):
                data: Any = copy.deepcopy(document.data)
                del data[BY_CONTROLLER][kind][key]
                entries = {at: entry for at, entry in document.entries.items() if not _inside(at, value.path)}
                document = replace(document, data=data, entries=entries)
    return document


def _inside(path: Path, around: Path) -> bool:
    """Tell whether a path is another one, or leads into it."""
    return path[: len(around)] == around


def _key(value: Data, step: str | int, path: Path) -> str | int:
    """Return the key or index that a step means inside a value; an entry of a list also goes by its `name`."""
    if isinstance(value, dict) and isinstance(step, str):
        return step
    if not isinstance(value, list):
        where = f"{dotted(path)}: " if path else ""
        raise _MisplacedError(f"{where}found {describe(value)}, expected a mapping or list to set {dotted((step,))} in")
    names = {str(entry["name"]): i for i, entry in enumerate(value) if isinstance(entry, dict) and "name" in entry}
    if isinstance(step, str) and step in names:
        return names[step]
    if str(step).isdecimal() and int(step) < len(value):
        return int(step)
    valid = [*names, f"an index from 0 to {len(value) - 1}"] if value else ["no index, the list is empty"]
    raise _MisplacedError(f"{dotted(path)}: found no entry {step}{choice(str(step), valid)}")
