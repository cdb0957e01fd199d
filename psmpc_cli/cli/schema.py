"""`psmpc schema`: JSON Schema of the YAML kinds, for editors."""

import json
from enum import StrEnum

import typer


class Kind(StrEnum):
    """The kinds of description."""

    robot = "robot"
    task = "task"


def schema(
    kind: Kind | None = typer.Argument(None, help="Which kind; both, keyed by kind, if not given.", show_default=False),
) -> None:
    """Print the JSON Schema of robot and task descriptions."""
    from psmpc_cli.specs.library import json_schema, json_schemas

    found = json_schemas() if kind is None else json_schema(kind.value)
    typer.echo(json.dumps(found, indent=2))
