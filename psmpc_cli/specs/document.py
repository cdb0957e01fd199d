"""YAML 1.2 texts as plain data with the position of every value, and plain data as YAML.

PyYAML parses; scalars are resolved here by the core schema of YAML 1.2, and syntax errors are explained for people who
write YAML.
"""

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeVar, cast

import yaml
from pydantic import BaseModel, ValidationError
from pydantic_core import PydanticSerializationError, to_jsonable_python
from yaml.error import MarkedYAMLError
from yaml.reader import ReaderError

from psmpc_cli.errors import SpecError
from psmpc_cli.specs.messages import Fault, Path, Place, counted, dotted, quoted, shortened

Scalar = None | bool | int | float | str
Data = Scalar | list["Data"] | dict[str, "Data"]
"""What YAML holds."""

Model = TypeVar("Model", bound=BaseModel)

DEEPEST = 30
"""Levels of nesting; a task has seven."""

MOST_VALUES = 20_000
"""Values of a file once its aliases are expanded."""

MOST_FAULTS = 50
"""Faults of one file that a report lists."""

WIDEST = 120
"""Columns of a source line that a report repeats."""

MOST_DIGITS = 300
"""Digits of an integer that is surely within the range of a float."""

LARGEST = 1e12
"""Magnitude of a number: results computed from it stay within a float's range."""

DECIMAL = r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?"
ANGLE_PATTERN = rf"^{DECIMAL} *(deg|rad|°)$"

_WORDS: dict[str, Scalar] = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL")),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
    **dict.fromkeys((".nan", ".NaN", ".NAN"), math.nan),
}
_INTEGER = re.compile(r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+")
_INFINITE = re.compile(r"[-+]?\.(inf|Inf|INF)")


@dataclass(frozen=True)
class Entry:
    """One value of a document: its position and its key's, how it was written, and the override it came from."""

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
        entries: The position of every value of `data`.
        faults: What is wrong with it as YAML.
    """

    name: str
    text: str
    data: Data = None
    entries: Mapping[Path, Entry] = field(default_factory=dict)
    faults: tuple[Fault, ...] = ()

    def entry(self, path: Path) -> Entry:
        """Return the entry of a path, or of the nearest value around it."""
        while path and path not in self.entries:
            path = path[:-1]
        return self.entries.get(path, Entry(Place(1, 1)))

    def value(self, path: Path) -> Data:
        """Return the value at a path of `entries`."""
        value: Any = self.data
        for step in path:
            value = value[step]
        found: Data = value
        return found

    def found(self, path: Path) -> str:
        """Describe the value at a path of `entries` as it was written."""
        value = self.value(path)
        if isinstance(value, list) and 0 < len(value) <= 4 and not any(isinstance(x, list | dict) for x in value):
            written = (self.entries[(*path, i)].written for i in range(len(value)))
            return f"[{', '.join(shortened(word or 'null') for word in written)}]"
        return describe(value, self.entry(path).written)

    def report(self, faults: Iterable[Fault]) -> str:
        """Write faults as `file:line:column: path: message` with the line itself, in the order of the lines.

        Faults of overrides come last and repeat the override instead.
        """
        ordered = sorted(dict.fromkeys(faults), key=self._order)
        lines = [self._render(fault) for fault in ordered[:MOST_FAULTS]]
        if len(ordered) > MOST_FAULTS:
            lines.append(f"{self.name}: {len(ordered) - MOST_FAULTS} more problems")
        return "\n".join(lines)

    def _place(self, fault: Fault) -> Place:
        entry = self.entry(fault.path)
        return fault.place or (entry.key if fault.at_key and entry.key is not None else entry.place)

    def _order(self, fault: Fault) -> tuple[bool, int, int]:
        place = self._place(fault)
        return self.entry(fault.path).override is not None, place.line, place.column

    def _render(self, fault: Fault) -> str:
        what = f"{dotted(fault.path)}: {fault.message}" if fault.path else fault.message
        override = self.entry(fault.path).override
        if override is not None:
            return f"{override}: {what}"
        place = self._place(fault)
        return f"{self.name}:{place.line}:{place.column}: {what}{self._source(place)}"

    def _source(self, place: Place) -> str:
        """Write the line of a position with a caret below its column; nothing for a line that is not in the text."""
        lines = self.text.splitlines()
        if place.line > len(lines) or not lines[place.line - 1].strip():
            return ""
        line = lines[place.line - 1]
        start = max(0, place.column - WIDEST // 2) if len(line) > WIDEST else 0
        shown = "".join(c if c.isprintable() or c == "\t" else "?" for c in line[start : start + WIDEST]).rstrip()
        before = place.column - 1 - start
        pad = "".join("\t" if c == "\t" else " " for c in shown[:before]).ljust(before)
        margin = f"{place.line:>4} | "
        return f"\n{margin}{shown}\n{' ' * (len(margin) - 2)}| {pad}^"


@dataclass(frozen=True)
class Raw:
    """A path of a document as it was read, whether there is a value or not."""

    document: Document
    path: Path = ()

    def __getitem__(self, step: str | int) -> "Raw":
        return Raw(self.document, (*self.path, step))

    @property
    def value(self) -> Data:
        """The value, None if there is none."""
        return self.document.value(self.path) if self.path in self.document.entries else None

    @property
    def exists(self) -> bool:
        """Whether there is a value, and it is not null."""
        return self.value is not None

    @property
    def text(self) -> str | None:
        """The text, None if there is none."""
        return self.value if isinstance(self.value, str) else None

    @property
    def number(self) -> float | None:
        """The number or angle [rad], None if there is none."""
        value = angle(self.value) if isinstance(self.value, str) else self.value
        if isinstance(value, bool) or not isinstance(value, int | float):
            return None
        return float(value) if abs(value) <= LARGEST else None

    @property
    def length(self) -> int | None:
        """The length of the list, None if there is none."""
        return len(self.value) if isinstance(self.value, list) else None

    def items(self) -> Iterator[tuple[str, "Raw"]]:
        """Give the keys and values of a mapping."""
        yield from ((key, self[key]) for key in (self.value if isinstance(self.value, dict) else ()))

    def entries(self) -> Iterator["Raw"]:
        """Give the entries of a list; a text alone is a list of one."""
        if isinstance(self.value, str):
            yield self
        yield from (self[index] for index in range(self.length or 0))

    def texts(self, key: str) -> list[str]:
        """Return the texts that the entries of a list have under a key."""
        return [text for entry in self.entries() if (text := entry[key].text) is not None]

    def valid(self, model: type[Model]) -> Model | None:
        """Return the value as a model, its defaults if there is none, None if it is not valid."""
        try:
            return model.model_validate({} if self.value is None else self.value)
        except ValidationError:
            return None

    def fault(self, expected: str, found: str | None = None, at_key: bool = False) -> Fault:
        """Create a fault here; without `found` the message describes the value."""
        found = self.document.found(self.path) if found is None else found
        return Fault(self.path, f"found {found}, expected {expected}", at_key)


def read(name: str, text: str) -> Document:
    """Read a YAML text; what is wrong with it as YAML is in the document's `faults`."""
    entries: dict[Path, Entry] = {}
    faults: list[Fault] = []
    try:
        node = _Loader(text).get_single_node()
        data = None if node is None else _convert(node, (), None, entries, faults)
    except MarkedYAMLError as error:
        return Document(name, text, faults=(_explain(error),))
    except ReaderError as error:
        start = text.rfind("\n", 0, error.position) + 1
        place = Place(text.count("\n", 0, error.position) + 1, error.position - start + 1)
        code = f"found the control character U+{ord(text[error.position]):04X}, expected printable text"
        return Document(name, text, faults=(Fault((), code, place=place),))
    return Document(name, text, data, entries, tuple(faults))


def write(data: Data) -> str:
    """Write data as YAML that reads back as the same data, keys in their order, short lists on one line."""
    return yaml.dump(data, Dumper=_Writer, sort_keys=False, default_flow_style=None, allow_unicode=True, width=120)


def plain(value: Any) -> Data:
    """Return a value of Python as what YAML holds: tuples and arrays of numpy as lists, paths as texts.

    Raises:
        SpecError: It has no form in YAML.
    """
    try:
        data: Data = to_jsonable_python(value, fallback=lambda item: item.tolist())
    except (AttributeError, PydanticSerializationError):
        wanted = "numbers, texts, True, False, None, lists and mappings"
        raise SpecError(f"found {shortened(repr(value))}, expected {wanted}") from None
    return data


def resolve(word: str) -> Scalar:
    """Return the meaning of an unquoted word in YAML 1.2; a number beyond a float's range is infinite."""
    if word in _WORDS:
        return _WORDS[word]
    infinite = -math.inf if word.startswith("-") else math.inf
    if _INTEGER.fullmatch(word):
        return infinite if len(word) > MOST_DIGITS else int(word, {"0o": 8, "0x": 16}.get(word[:2], 10))
    if re.fullmatch(DECIMAL, word):
        return float(word)
    return infinite if _INFINITE.fullmatch(word) else word


def angle(word: str) -> float | None:
    """Return the angle [rad] that a word such as `30 deg` means, None if it is no angle."""
    match = re.fullmatch(rf"({DECIMAL}) *(deg|rad|°)", word)
    if match is None:
        return None
    return float(match[1]) if word.endswith("rad") else math.radians(float(match[1]))


def describe(value: Data, written: str | None = None) -> str:
    """Describe a value: its kind and, for a scalar, how it was written."""
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


class _Loader(yaml.BaseLoader):
    """Composes the nodes of a text of bounded size without tags."""

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._depth = self._nodes = 0

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        event = cast(Any, self).peek_event()  # untyped in the stubs of PyYAML
        if getattr(event, "tag", None) is not None:
            tag = quoted(event.tag.replace("tag:yaml.org,2002:", "!!"))
            raise _NotYamlError(
                problem=f"the tag {tag}, expected plain YAML without tags", problem_mark=event.start_mark
            )
        self._nodes += 1
        _check_size(self._depth, self._nodes, event.start_mark)
        self._depth += 1
        node = super().compose_node(parent, index)
        self._depth -= 1
        return node


class _NotYamlError(MarkedYAMLError):
    """A text has tags, or exceeds what a description can be."""


def _check_size(depth: int, values: int, mark: Any) -> None:
    """Raise an error beyond the bounds of a description."""
    if depth > DEEPEST:
        problem = f"a value nested deeper than {DEEPEST} levels with aliases expanded, expected less"
        raise _NotYamlError(problem=problem, problem_mark=mark)
    if values > MOST_VALUES:
        problem = f"more than {MOST_VALUES} keys and values with aliases expanded, expected fewer"
        raise _NotYamlError(problem=problem, problem_mark=mark)


def _convert(node: Any, path: Path, key: Place | None, entries: dict[Path, Entry], faults: list[Fault]) -> Data:
    """Return a node as plain data, and add the position of every value and what is wrong with keys.

    The first of equal keys counts.
    """
    _check_size(len(path), len(entries), node.start_mark)
    entries[path] = Entry(_place_of(node.start_mark), key, node.value if isinstance(node, yaml.ScalarNode) else None)
    if isinstance(node, yaml.ScalarNode):
        return resolve(node.value) if node.style is None else str(node.value)
    if isinstance(node, yaml.SequenceNode):
        return [_convert(item, (*path, index), None, entries, faults) for index, item in enumerate(node.value)]
    mapping: dict[str, Data] = {}
    for key_node, value_node in node.value:
        word, place = key_node.value, _place_of(key_node.start_mark)
        if not isinstance(word, str):
            faults.append(Fault(path, "found a list or mapping as a key, expected a word", place=place))
        elif word in mapping:
            first = entries[(*path, word)].key
            line = f" (first in line {first.line})" if first else ""
            faults.append(Fault((*path, word), f"found this key again{line}, expected every key once", place=place))
        else:
            mapping[word] = _convert(value_node, (*path, word), place, entries, faults)
    return mapping


class _Writer(yaml.SafeDumper):
    """PyYAML's writer without anchors; texts that YAML 1.2 would read as something else are quoted."""

    def ignore_aliases(self, data: object) -> bool:
        return True

    def represent_str(self, data: str) -> yaml.ScalarNode:
        style = None if isinstance(resolve(data), str) else '"'
        return self.represent_scalar("tag:yaml.org,2002:str", data, style=style)


_Writer.add_representer(str, _Writer.represent_str)

_TOKENS = {
    "<stream end>": "the end of the file",
    "<block end>": "the end of the block",
    "<block mapping start>": "a line indented differently",
    "<block sequence start>": "a list",
    "<scalar>": "a word",
    "?": "a key",
    "-": 'an entry "- "',
}
_KINDS = {"]": "list", "}": "mapping", "collection": "list", "mapping": "mapping"}

_IN_LIST = 'found {token}, expected "," or "{kind}" in the {what} that starts in {line}'
_IN_BLOCK = "found {token}, expected the {what} that starts in {line} to go on (is it indented like its neighbours?)"
_ONE_DOCUMENT = 'found more after the document, expected one document (no "---" or "...")'
_BEGAN: tuple[tuple[str, str], ...] = (
    (r"expected ',' or '(?P<kind>[\]}])', but got '(?P<token><stream end>)'", _IN_LIST),
    (r"could not find expected ':'", 'found a word alone, expected "key: value"'),
    (r"quoted scalar found unexpected end", "found a quote that is never closed, expected a second one"),
)
_SHOWS: tuple[tuple[str, str], ...] = (
    (r"mapping values are not", 'found ":" where no key can be, expected one "key: value" a line, a space after ":"'),
    (r"found character '\\t'", "found a tab, expected spaces"),
    (r"character '(?P<token>.)' that cannot start", "found {token} at the start of a word, expected it in quotes"),
    (r"expected ',' or '(?P<kind>[\]}])', but got '(?P<token>.+)'", _IN_LIST),
    (r"block (?P<kind>collection|mapping) expected <block end>, but found '(?P<token>.+)'", _IN_BLOCK),
    (r"undefined alias '(?P<kind>.+)'", "found the alias *{kind}, expected an anchor &{kind} before it"),
    (r"duplicate anchor '(?P<kind>.+)'", "found the anchor &{kind} again, expected every anchor once"),
    (r"expected '<document start>'|found another document", _ONE_DOCUMENT),
)
"""Patterns of PyYAML's errors and messages for them, located where the construct began or where the error shows."""


def _explain(error: MarkedYAMLError) -> Fault:
    """Say what a syntax error found and expected."""
    place = _place_of(error.problem_mark) if error.problem_mark else None
    if isinstance(error, _NotYamlError):
        return Fault((), f"found {error.problem}", place=place)
    text = " ".join(part for part in (error.context, error.problem) if part)
    line = f"line {error.context_mark.line + 1}" if error.context_mark else "its first line"
    for mark, rows in ((error.context_mark, _BEGAN), (error.problem_mark, _SHOWS)):
        for pattern, message in rows:
            if mark and (match := re.search(pattern, text)):
                kind, token = (match.groupdict().get(name, "") for name in ("kind", "token"))
                token = _TOKENS.get(token, f'"{token}"')
                found = message.format(token=token, kind=kind, what=_KINDS.get(kind), line=line)
                return Fault((), found, place=_place_of(mark))
    return Fault((), f"found no valid YAML, {error.problem}", place=place)


def _place_of(mark: Any) -> Place:
    """Return the position of a mark of PyYAML."""
    return Place(mark.line + 1, mark.column + 1)
