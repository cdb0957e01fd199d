"""`psmpc show`: what a log holds."""

from pathlib import Path
from typing import Annotated

import typer


def show(
    log: Annotated[Path, typer.Argument(help="A log written by psmpc simulate, or a file written by psmpc compare.")],
    csv: Annotated[
        Path | None, typer.Option("--csv", metavar="DIR", help="Export the log's tables as CSV files.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite exported tables.")] = False,
) -> None:
    """Print the summary of a log or the table of a comparison again, or export tables."""
    from psmpc_cli.cli.comparison import print_comparison
    from psmpc_cli.cli.summary import print_summary
    from psmpc_cli.experiment.summary import summarize
    from psmpc_cli.logs.comparison import read_comparison
    from psmpc_cli.logs.export import export_csv
    from psmpc_cli.logs.layout import COMPARISON
    from psmpc_cli.logs.read import kind_of, read_log

    compared = read_comparison(log) if kind_of(log) == COMPARISON else {}
    loaded = None if compared else read_log(log)
    if csv is not None:
        exports = [(run, csv / name) for name, run in compared.items()] if loaded is None else [(loaded, csv)]
        for path in (path for run, directory in exports for path in export_csv(run, directory, force)):
            typer.echo(str(path))
    elif loaded is None:
        print_comparison({name: summarize(run) for name, run in compared.items()}, log)
    else:
        print_summary(summarize(loaded), log)
