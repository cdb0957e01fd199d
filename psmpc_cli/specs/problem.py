"""One thing that is wrong with a description: where, and what."""

import json
from collections.abc import Iterable
from dataclasses import dataclass
from difflib import get_close_matches

Path = tuple[str | int, ...]
"""Keys and indices from the root of a file to a value."""

LONGEST = 60
"""Characters of a value that a message repeats."""


MOST_CHOICES = 60
"""Names that a message offers."""


@dataclass(frozen=True)
class Place:
    """A position in a text, both counted from 1."""

    line: int
    column: int


@dataclass(frozen=True)
class Problem:
    """What was found and what was expected at `path`.

    Attributes:
        path: Where, from the root of the file.
        message: What.
        at: The place, if it is not that of the path's value.
        aims_at_key: Whether the place is that of the path's key.
    """

    path: Path
    message: str
    at: Place | None = None
    aims_at_key: bool = False


def dotted(path: Path) -> str:
    """Write a path the way messages and `--set` do: `stages[1].target.base`."""
    steps = [f"[{step}]" if isinstance(step, int) else f".{printable(shortened(step))}" for step in path]
    return "".join(steps).removeprefix(".")


def quoted(text: str) -> str:
    """Write a text in double quotes, on one line and not too long."""
    return printable(json.dumps(shortened(text), ensure_ascii=False))


def printable(text: str) -> str:
    """Write a text in one line that cannot command a terminal: with escapes for what is not printable."""
    return text if text.isprintable() else "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


def shortened(text: str) -> str:
    """Write not too much of a text."""
    return text if len(text) <= LONGEST else text[: LONGEST - 3] + "..."


def suggestion(name: str, valid: Iterable[str]) -> str | None:
    """Return the valid name nearest to `name`, if one is near."""
    by_folded = {candidate.casefold(): candidate for candidate in valid}
    near = get_close_matches(name.casefold(), by_folded, n=1, cutoff=0.6)
    return by_folded[near[0]] if near else None


def choice(name: str, valid: Iterable[str]) -> str:
    """Write after what was found which names were expected, and before that the nearest one."""
    names = list(dict.fromkeys(valid))
    near = suggestion(name, names)
    hint = f" (did you mean {quoted(near)}?)" if near else ""
    listed = ", ".join(printable(shortened(each)) for each in names[:MOST_CHOICES])
    more = f" and {len(names) - MOST_CHOICES} more" if len(names) > MOST_CHOICES else ""
    return f"{hint}, expected {'one of ' if len(names) > 1 else ''}{listed}{more}"
