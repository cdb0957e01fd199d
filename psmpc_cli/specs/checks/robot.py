"""A robot's own: names of arms, and limits that fit its parts."""

from collections.abc import Iterator

from psmpc_cli.specs.checks.limits import check_layer
from psmpc_cli.specs.cursor import Cursor
from psmpc_cli.specs.messages import Fault, quoted

RESERVED = ("base", "arms", "all", "control", "times")
"""Names that mean something else wherever arms are named."""


def check_robot(robot: Cursor) -> Iterator[Fault]:
    """Give what does not fit together in a robot description."""
    lengths = {name: arm["links"].length or 0 for name, arm in robot["arms"].items()}
    reserved = [name for name in lengths if name in RESERVED]
    for name in reserved:
        found = f"found the reserved name {quoted(name)}, expected none of {', '.join(RESERVED)}"
        yield robot["arms"][name].problem(found, at_key=True)
    if lengths and all(lengths.values()) and not reserved:
        yield from check_layer(robot["limits"], {"base": 3, **lengths})
