"""The application of Typer: the commands of `psmpc` and what belongs to none of them."""

import logging
import sys
from collections.abc import Callable, Iterator, Mapping
from importlib import import_module
from itertools import chain
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

import psmpc_cli
from psmpc_cli import __version__
from psmpc_cli.cli import inspect, run, study
from psmpc_cli.cli.common import LoggedProgress, escaped
from psmpc_cli.progress import Progress

ABOUT = "Priority-based switching MPC for space robots: YAML task specs in, HDF5 logs and figures out."

Command = Callable[..., None]

OWN_COMMANDS: Mapping[str, tuple[Command, ...]] = {
    "Run": (run.simulate, run.rerun, run.replay, run.verify),
    "Study": (study.compare, study.sweep_weights, study.monte_carlo, study.pareto, inspect.bench),
    "Look": (run.show, run.plot, run.view, run.report),
    "Help": (inspect.tasks, inspect.check, inspect.init, inspect.schema),
}
"""The commands of this layer by what they are for, in the order of the help."""


def plugin_commands() -> Iterator[Mapping[str, tuple[Command, ...]]]:
    """Yield the commands of layers above this one, by group: the `COMMANDS` of every file `commands.py` of a layer."""
    for file in sorted(Path(psmpc_cli.__file__).parent.glob("*/commands.py")):
        yield import_module(f"psmpc_cli.{file.parent.name}.commands").COMMANDS


def grouped_commands() -> dict[str, tuple[Command, ...]]:
    """Return all commands by group: those of plug-ins stand behind those of this layer."""
    plugins = list(plugin_commands())
    return {
        title: (*own, *chain.from_iterable(commands.get(title, ()) for commands in plugins))
        for title, own in OWN_COMMANDS.items()
    }


GROUPS = grouped_commands()
"""All commands by what they are for, in the order of the help."""

EXAMPLES = {
    "psmpc simulate transport --view": "run a built-in task, and write its page: the robot in 3-D with its plans",
    "psmpc compare transport": "run it under every controller, and recommend one",
}

TASKS_HELP = "{names}. `psmpc tasks` says what each shows."
"""What the help says of the built-in tasks."""


class GroupedHelp(TyperGroup):
    """The help of `psmpc`: commands by what they are for, then examples and the built-in tasks."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the commands of each group, with the first line of their help."""
        for title, members in GROUPS.items():
            with formatter.section(title):
                names = [each.__name__.replace("_", "-") for each in members]
                formatter.write_dl([(name, self.commands[name].short_help) for name in names])

    def format_epilog(self, ctx: Any, formatter: Any) -> None:
        """Write the examples, and the names of the built-in tasks."""
        from psmpc_cli.specs.library import built_ins

        with formatter.section("Examples"):
            formatter.write_dl(list(EXAMPLES.items()))
        with formatter.section("Built-in tasks"):
            formatter.write_text(TASKS_HELP.format(names=", ".join(built_ins("task"))))


app = typer.Typer(
    name="psmpc",
    cls=GroupedHelp,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 120},
)
for command in chain.from_iterable(GROUPS.values()):
    app.command(short_help=(command.__doc__ or "").partition("\n")[0])(command)  # wrapped, not cut


class EchoHandler(logging.Handler):
    """Writes messages of the library to the present standard error, which a live display replaces for a while."""

    def __init__(self) -> None:
        super().__init__()
        self._progress = LoggedProgress()

    def emit(self, record: logging.LogRecord) -> None:
        """Write one message as one line, or show the progress that it is."""
        if isinstance(record.msg, Progress):
            self._progress.show(record.msg)
            return
        level = f"{record.levelname.lower()}: " if record.levelno > logging.INFO else ""
        sys.stderr.write(f"{level}{escaped(record.getMessage())}\n")

    def close(self) -> None:
        """End what is shown."""
        self._progress.end()
        super().close()


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
