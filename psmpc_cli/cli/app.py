"""The application of Typer: the commands of `psmpc` and what belongs to none of them."""

import logging
import sys
from typing import Annotated

import typer

from psmpc_cli import __version__
from psmpc_cli.cli import inspect, run, study
from psmpc_cli.cli.common import escaped

ABOUT = "Priority-based switching MPC for space robots: YAML task specs in, HDF5 logs and figures out."

COMMANDS = (
    run.simulate,
    study.compare,
    study.pareto,
    study.sweep_weights,
    study.monte_carlo,
    inspect.bench,
    inspect.check,
    run.plot,
    run.view,
    run.report,
    study.reproduce,
    run.replay,
    run.rerun,
    run.verify,
    run.show,
    inspect.init,
    inspect.schema,
)
"""All commands, in the order of the help."""

app = typer.Typer(
    name="psmpc",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 120},
)
for command in COMMANDS:
    app.command(short_help=(command.__doc__ or "").partition("\n")[0])(command)  # wrapped, not cut


class EchoHandler(logging.Handler):
    """Writes messages of the library to the present standard error, which a live display replaces for a while."""

    def emit(self, record: logging.LogRecord) -> None:
        """Write one message as one line."""
        level = f"{record.levelname.lower()}: " if record.levelno > logging.INFO else ""
        sys.stderr.write(f"{level}{escaped(record.getMessage())}\n")


def print_version(wanted: bool) -> None:
    """Print the version and exit."""
    if wanted:
        typer.echo(f"psmpc {__version__}")
        raise typer.Exit


@app.callback(help=ABOUT)
def options(
    version: Annotated[
        bool, typer.Option("--version", callback=print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Accept the options of `psmpc` itself."""
