"""`psmpc show`: what a log holds."""

from pathlib import Path
from typing import Annotated

import typer


def show(
    log: Annotated[Path, typer.Argument(help="A log written by psmpc simulate.")],
    csv: Annotated[
        Path | None, typer.Option("--csv", metavar="DIR", help="Export the log's tables as CSV files.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite exported tables.")] = False,
) -> None:
    """Print the summary of a log again, or export its tables."""
    from psmpc_cli.cli.summary import print_summary
    from psmpc_cli.experiment.summary import summarize
    from psmpc_cli.logs.export import export_csv
    from psmpc_cli.logs.read import read_log

    loaded = read_log(log)
    if csv is None:
        print_summary(summarize(loaded), log)
        return
    for path in export_csv(loaded, csv, force):
        typer.echo(str(path))
