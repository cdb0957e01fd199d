"""What is wrong with a description and where, and how messages write paths, texts and the names to choose from."""

import json
from collections.abc import Iterable
from dataclasses import dataclass
from difflib import get_close_matches

Path = tuple[str | int, ...]
"""Keys and indices from the root of a file to a value."""

LONGEST = 60
"""Characters of a value that a message repeats."""

MOST_CHOICES = 60
"""Names that a message lists."""


@dataclass(frozen=True, order=True)
class Place:
    """A position in a text, both counted from 1."""

    line: int
    column: int


@dataclass(frozen=True)
class Fault:
    """One thing that is wrong with a description.

    Attributes:
        path: Where, from the root of the file.
        message: What was found and what was expected.
        at_key: Whether the position is that of the path's key, not of its value.
        place: The position, if it is that of neither.
    """

    path: Path
    message: str
    at_key: bool = False
    place: Place | None = None


def dotted(path: Path) -> str:
    """Write a path as in messages and `--set`: `stages[1].target.base`."""
    steps = [f"[{step}]" if isinstance(step, int) else f".{printable(shortened(step))}" for step in path]
    return "".join(steps).removeprefix(".")


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
    """Write a number of things: `1 key`, `2 keys`."""
    return f"{number} {one if number == 1 else many}"


def suggestion(name: str, valid: Iterable[str]) -> str | None:
    """Return the valid name nearest to `name`, None if none is near."""
    by_folded = {candidate.casefold(): candidate for candidate in valid}
    near = get_close_matches(name.casefold(), by_folded, n=1, cutoff=0.6)
    return by_folded[near[0]] if near else None


def choice(name: str, valid: Iterable[str]) -> str:
    """Write the end of a message about a name that is not valid: the nearest valid one, and all of them."""
    names = list(dict.fromkeys(valid))
    near = suggestion(name, names)
    hint = f" (did you mean {quoted(near)}?)" if near else ""
    listed = ", ".join(printable(shortened(each)) for each in names[:MOST_CHOICES])
    more = f" and {len(names) - MOST_CHOICES} more" if len(names) > MOST_CHOICES else ""
    return f"{hint}, expected {'one of ' if len(names) > 1 else ''}{listed}{more}"
