"""Options that several commands have in common."""

from typing import Annotated

import typer

FOLDERS = "Missing folders are made."
"""What becomes of an -o in a folder that does not exist."""

Changes = Annotated[
    list[str] | None, typer.Option("--set", metavar="PATH=VALUE", help="Change any key of the task; repeatable.")
]
"""Keys of the task given on the command line."""

Jobs = Annotated[
    int | None, typer.Option(min=1, metavar="N", help="Processes at once. Default: one a core.", show_default=False)
]
"""How many processes run at once."""

Dask = Annotated[str | None, typer.Option(metavar="ADDRESS", help="Run on the Dask cluster with its scheduler there.")]
"""Which cluster runs are made on."""

Resume = Annotated[bool, typer.Option("--resume", help="Go on with one that was stopped.")]
"""Whether a study goes on with its file."""

Figures = Annotated[bool, typer.Option("--figures/--no-figures", help="Draw the figures beside the file.")]
"""Whether figures are drawn."""
