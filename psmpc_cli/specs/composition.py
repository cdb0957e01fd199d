"""Text to YAML nodes, within bounds: no tags, no towers, no floods."""

from typing import Any, cast

from yaml.composer import Composer
from yaml.error import Mark, MarkedYAMLError
from yaml.events import AliasEvent
from yaml.nodes import Node
from yaml.parser import Parser
from yaml.reader import Reader, ReaderError
from yaml.resolver import BaseResolver
from yaml.scanner import Scanner

from psmpc_cli.specs.problem import Place, Problem, quoted
from psmpc_cli.specs.syntax import explain

DEEPEST = 30
"""Levels of nesting; a task has seven."""

MOST_VALUES = 20_000
"""Values of a file once its aliases are expanded; each may be a problem of its own, to be put in words."""


class RefusedError(Exception):
    """A text is no YAML, or more than a description can be."""

    def __init__(self, problem: Problem) -> None:
        super().__init__(problem.message)
        self.problem = problem


class _Composition(Reader, Scanner, Parser, Composer, BaseResolver):
    """PyYAML's reader without its YAML 1.1 scalars, and with bounds."""

    def __init__(self, text: str) -> None:
        Reader.__init__(self, text)
        Scanner.__init__(self)
        Parser.__init__(self)
        Composer.__init__(self)
        BaseResolver.__init__(self)
        self.depth = 0
        self.values = 0

    def compose_node(self, parent: Node | None, index: int) -> Node | None:
        """Compose one node and what is inside it."""
        event = cast(Any, self).peek_event()
        self.values += 1
        refuse_beyond_bounds(self.depth, self.values, event.start_mark)
        if not isinstance(event, AliasEvent) and event.tag is not None:
            tag = event.tag.replace("tag:yaml.org,2002:", "!!")
            message = f"found the tag {quoted(tag)}, expected plain YAML without tags"
            raise RefusedError(Problem((), message, place_of(event.start_mark)))
        self.depth += 1
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node


def compose(text: str) -> Node | None:
    """Return the root node of a YAML text, None if it holds none.

    Raises:
        RefusedError: The text is not YAML, holds several documents or tags, or is nested too deeply or too large.
    """
    try:
        return _Composition(text).get_single_node()
    except MarkedYAMLError as error:
        raise RefusedError(explain(error)) from None
    except ReaderError as error:
        raise RefusedError(_unprintable(text, error.position)) from None


def place_of(mark: Mark) -> Place:
    """Return the place of a mark of PyYAML."""
    return Place(mark.line + 1, mark.column + 1)


def refuse_beyond_bounds(depth: int, values: int, mark: Mark) -> None:
    """Make sure that a text is neither nested too deeply nor too large.

    Raises:
        RefusedError: It is.
    """
    if depth > DEEPEST:
        raise RefusedError(
            Problem((), f"found a value nested deeper than {DEEPEST} levels, expected less", place_of(mark))
        )
    if values > MOST_VALUES:
        raise RefusedError(
            Problem((), f"found more than {MOST_VALUES} values with aliases expanded, expected fewer", place_of(mark))
        )


def _unprintable(text: str, position: int) -> Problem:
    """Name a control character and where it is."""
    start = text.rfind("\n", 0, position) + 1
    place = Place(text.count("\n", 0, position) + 1, position - start + 1)
    return Problem((), f"found the control character U+{ord(text[position]):04X}, expected printable text", place)
