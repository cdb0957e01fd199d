"""The command `psmpc`: registers the commands and turns errors into one message and an exit code."""

import logging
import sys

import typer

from psmpc_cli import __version__
from psmpc_cli.cli import (
    bench,
    check,
    compare,
    init,
    monte_carlo,
    pareto,
    plot,
    replay,
    reproduce,
    rerun,
    schema,
    show,
    simulate,
    sweep_weights,
    verify,
)
from psmpc_cli.errors import PsmpcError, SpecError

app = typer.Typer(
    name="psmpc",
    help="Priority-based switching MPC for space robots: YAML task specs in, HDF5 logs and figures out.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)
for command in (
    simulate.simulate,
    compare.compare,
    pareto.pareto,
    sweep_weights.sweep_weights,
    monte_carlo.monte_carlo,
    bench.bench,
    check.check,
    plot.plot,
    reproduce.reproduce,
    replay.replay,
    rerun.rerun,
    verify.verify,
    show.show,
    init.init,
    schema.schema,
):
    app.command()(command)


class EchoHandler(logging.Handler):
    """Writes what the library reports to whatever standard error is now: a live display stands in for it at times."""

    def emit(self, record: logging.LogRecord) -> None:
        """Write one message as one line."""
        sys.stderr.write(f"{record.levelname.lower()}: {record.getMessage()}\n")


def print_version(wanted: bool) -> None:
    """Print the version and leave."""
    if wanted:
        typer.echo(f"psmpc {__version__}")
        raise typer.Exit


@app.callback()
def options(
    version: bool = typer.Option(
        False, "--version", callback=print_version, is_eager=True, help="Print the version and exit."
    ),
) -> None:
    """Priority-based switching MPC for space robots: YAML task specs in, HDF5 logs and figures out."""


def complain(message: str) -> None:
    """Write what is wrong to standard error; nothing in a file or its name can command the terminal."""
    from psmpc_cli.specs.messages import printable

    shown = "\n".join("\t".join(map(printable, line.split("\t"))) for line in message.split("\n"))
    typer.echo(shown, err=True)


def main() -> None:
    """Run the command line; exit codes: 0 done, 1 a check asked for fails, 2 bad input, 3 the run could not go on."""
    logging.basicConfig(handlers=[EchoHandler()], level=logging.WARNING)
    try:
        app()
    except PsmpcError as error:
        located = isinstance(error, SpecError)  # begins with file:line:column, which terminals and editors can follow
        complain(str(error) if located else f"psmpc: {error}")
        sys.exit(error.exit_code)
    except OSError as error:
        if error.filename is None:
            raise
        complain(f"psmpc: {error.filename}: {error.strerror}")
        sys.exit(PsmpcError.exit_code)
