"""A YAML text as plain data that remembers where every value stands."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode

from psmpc_cli.specs.composition import RefusedError, compose, place_of, refuse_beyond_bounds
from psmpc_cli.specs.problem import Path, Place, Problem, quoted, shortened
from psmpc_cli.specs.scalars import resolve

Data = None | bool | int | float | str | list["Data"] | dict[str, "Data"]
"""What YAML holds."""


SHORT = 4
"""Entries of a list that a message repeats."""


@dataclass(frozen=True)
class Entry:
    """One value of a document: its place and its key's, how it was written, and the option it came from, as typed."""

    place: Place
    key: Place | None = None
    written: str | None = None
    override: str | None = None


@dataclass(frozen=True)
class Document:
    """A robot or task description as it was read.

    Attributes:
        name: What messages call it: the path as the user gave it.
        text: The YAML text.
        data: What it holds; None where `readable` is not.
        entries: Where every value of `data` stands.
        problems: What is wrong with it as YAML.
        readable: Whether `data` can be looked at in spite of `problems`.
    """

    name: str
    text: str
    data: Data = None
    entries: Mapping[Path, Entry] = field(default_factory=dict)
    problems: tuple[Problem, ...] = ()
    readable: bool = True

    def entry(self, path: Path) -> Entry:
        """Return the entry of a path, or of the nearest value around it."""
        while path and path not in self.entries:
            path = path[:-1]
        return self.entries.get(path, Entry(Place(1, 1)))

    def value(self, path: Path) -> Data:
        """Return the value at a path that exists."""
        value = self.data
        for step in path:
            value = _inside(value, step)
        return value

    def found(self, path: Path) -> str:
        """Describe the value at a path that exists, as it was written."""
        value = self.value(path)
        if isinstance(value, list) and 0 < len(value) <= SHORT and not any(isinstance(x, list | dict) for x in value):
            written = (self.entries[(*path, i)].written for i in range(len(value)))
            return f"[{', '.join(shortened(word or 'null') for word in written)}]"
        return describe(value, self.entry(path).written)


def read(name: str, text: str) -> Document:
    """Read a YAML text into a document; what is wrong with the YAML is in its `problems`."""
    try:
        root = compose(text)
        if root is None:
            return Document(name, text)
        conversion = _Conversion()
        data = conversion.convert(root, (), None, 0)
    except RefusedError as refused:
        return Document(name, text, problems=(refused.problem,), readable=False)
    return Document(name, text, data, conversion.entries, tuple(conversion.problems))


def describe(value: Data, written: str | None = None) -> str:
    """Say what a value is: its kind and, for a scalar, how it was written."""
    if isinstance(value, dict):
        return f"a mapping of {counted(len(value), 'key', 'keys')}" if value else "an empty mapping"
    if isinstance(value, list):
        return f"a list of {counted(len(value), 'entry', 'entries')}" if value else "an empty list"
    if value is None:
        return "nothing"
    if isinstance(value, str):
        return f"the text {quoted(value)}"
    if isinstance(value, bool):
        return "true" if value else "false"
    return shortened(written) if written else (f"{value:g}" if math.isfinite(value) else str(value))


def _inside(value: Data, step: str | int) -> Data:
    """Return what is one step inside."""
    if isinstance(value, dict) and isinstance(step, str):
        return value[step]
    if isinstance(value, list) and isinstance(step, int):
        return value[step]
    raise KeyError(step)


def counted(number: int, one: str, many: str) -> str:
    """Write a number of things."""
    return f"{number} {one if number == 1 else many}"


class _Conversion:
    """Nodes to plain data, with the place of every value on the way."""

    def __init__(self) -> None:
        self.entries: dict[Path, Entry] = {}
        self.problems: list[Problem] = []

    def convert(self, node: Node, path: Path, key: Place | None, depth: int) -> Data:
        """Return a node and what is inside it as plain data; an alias is copied."""
        refuse_beyond_bounds(depth, len(self.entries) + 1, node.start_mark)
        written = node.value if isinstance(node, ScalarNode) else None
        self.entries[path] = Entry(place_of(node.start_mark), key, written)
        if isinstance(node, MappingNode):
            return self._mapping(node, path, depth)
        if isinstance(node, SequenceNode):
            return [self.convert(item, (*path, i), None, depth + 1) for i, item in enumerate(node.value)]
        plain = isinstance(node, ScalarNode) and node.style is None
        return resolve(node.value) if plain else str(node.value)

    def _mapping(self, node: MappingNode, path: Path, depth: int) -> dict[str, Data]:
        """Return a mapping; of a key that comes twice the first counts."""
        mapping: dict[str, Data] = {}
        for key_node, value_node in node.value:
            place = place_of(key_node.start_mark)
            if not isinstance(key_node, ScalarNode):
                self.problems.append(Problem(path, "found a list or mapping as a key, expected a word", place))
                continue
            key = str(key_node.value)
            if key in mapping:
                first = self.entries[(*path, key)].key
                line = "" if first is None else f" (first in line {first.line})"
                message = f"found this key again{line}, expected every key once"
                self.problems.append(Problem((*path, key), message, place))
                continue
            mapping[key] = self.convert(value_node, (*path, key), place, depth + 1)
        return mapping
