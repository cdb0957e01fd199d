"""Keys of a task that are set from outside its file: `--set path=value`, options short for that, or a mapping."""

import copy
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

from psmpc_cli.errors import SpecError
from psmpc_cli.specs.document import Data, Document, Origin, describe, plain, read
from psmpc_cli.specs.messages import Fault, Path, Place, choice, dotted, quoted

_PATH = re.compile(r"[^.\[\]=]+(?:\.[^.\[\]=]+|\[\d+\])*")
_STEP = re.compile(r"\[(\d+)\]|([^.\[\]=]+)")

SHORTHANDS: tuple[Path, ...] = (("controller",), ("solver",), ("plant",), ("onset",))
"""Where a text alone means a mapping with that `kind`."""

BY_CONTROLLER = "by_controller"
"""Key of a task that holds, by controller, keys to change where that controller runs."""

NO_CONTROLLERS_OWN: tuple[Path, ...] = (("robot",), ("controller",), ("controller", "kind"), (BY_CONTROLLER,))
"""Keys that cannot depend on the controller."""

Change = str | tuple[str, str]
"""One key to change: `path=value`, or an option as it was typed and the `path=value` that it is short for."""

Changes = Mapping[str, Any] | Sequence[Change]
"""Keys to change: values by path, or a sequence of changes in their order."""


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
            inside = {place[len(at) :]: origin for place, origin in document.origins.items() if _inside(place, at)}
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
                overridden += [at] if _inside(own, path) or _inside(path, own) else []
    for at in overridden:
        document = _without(document, at)
    return put(document, path, new.data, origins)


def _without(document: Document, path: Path) -> Document:
    """Return the document without the value at a path that leads to a key of a mapping."""
    data: Any = copy.deepcopy(document.data)
    around = data
    for step in path[:-1]:
        around = around[step]
    del around[path[-1]]
    return replace(document, data=data, origins={at: o for at, o in document.origins.items() if not _inside(at, path)})


def put(document: Document, path: Path, new: Data, origins: Mapping[Path, Origin]) -> Document:
    """Return the document with one value replaced or added, in mappings that are added too.

    Args:
        document: The document.
        path: Where the value goes.
        new: The value.
        origins: Its origin and those of values inside it, by path from it.
    """
    data = copy.deepcopy(document.data)
    kept = {at: origin for at, origin in document.origins.items() if not _inside(at, path)}
    around: Any = data
    for length in range(1, len(path)):
        key, at = path[length - 1], path[:length]
        inner = around.get(key) if isinstance(around, dict) else around[key]
        if inner is None or isinstance(inner, str):
            kept |= {(*at, "kind"): kept[at]} if inner else {}
            kept[at] = replace(origins[()], written=None)
            around[key] = {} if inner is None else {"kind": inner}
        around = around[key]
    around[path[-1]] = copy.deepcopy(new)
    return replace(document, data=data, origins=kept | {(*path, *at): origin for at, origin in origins.items()})


def _inside(path: Path, around: Path) -> bool:
    """Tell whether a path is another one, or leads into it."""
    return path[: len(around)] == around


def _path(document: Document, written: str) -> Path:
    """Return the path that a text means; what it leads to need not be there, the lists on the way must be."""
    if not _PATH.fullmatch(written):
        wanted = "expected one such as stages[1].priority or stages.capture.priority"
        raise SpecError(f"found the path {quoted(written)}, {wanted}")
    value = document.data
    path: Path = ()
    for index, name in _STEP.findall(written):
        path = (*path, _key(value, int(index) if index else name, path))
        value = document.value(path)
        if value is None or (isinstance(value, str) and path in SHORTHANDS):
            value = {}
    return path


def _key(value: Data, step: str | int, path: Path) -> str | int:
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
