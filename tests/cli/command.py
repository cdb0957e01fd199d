"""What a command of psmpc leaves behind in tests."""

from collections.abc import Callable
from typing import NamedTuple


class Ran(NamedTuple):
    """The exit code of a command, and what it wrote."""

    code: int
    stdout: str
    stderr: str


Psmpc = Callable[..., Ran]
"""The command line: words in, what came of them out."""
