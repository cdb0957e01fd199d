"""`psmpc init`: the built-in robots and tasks as files to edit."""

from pathlib import Path

import typer


def init(
    directory: Path = typer.Argument(..., metavar="DIR", help="Where to; made if it is not there.", show_default=False),
    force: bool = typer.Option(False, "--force", help="Overwrite files that exist."),
) -> None:
    """Copy the built-in robots and tasks, to edit them."""
    from psmpc_cli.specs.library import write_starter

    for path in write_starter(directory, overwrite=force):
        typer.echo(str(path))
