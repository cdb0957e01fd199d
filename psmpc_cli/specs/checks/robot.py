"""A robot's own: names of arms, and limits that fit its parts."""

from collections.abc import Iterator

from psmpc_cli.specs.checks.limits import check_layer
from psmpc_cli.specs.cursor import Cursor
from psmpc_cli.specs.problem import Problem

RESERVED = ("base", "arms", "all", "control")
"""Names that mean something else wherever arms are named."""


def check_robot(robot: Cursor) -> Iterator[Problem]:
    """Give what does not fit together in a robot description."""
    for name, arm in robot["arms"].items():
        if name in RESERVED:
            yield arm.problem(f'found the reserved name "{name}", expected none of {", ".join(RESERVED)}', True)
    lengths = {name: arm["links"].length for name, arm in robot["arms"].items()}
    if lengths and None not in lengths.values():
        yield from check_layer(robot["limits"], {"base": 3, **{name: n for name, n in lengths.items() if n}})
