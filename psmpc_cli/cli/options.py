"""The options and arguments that several commands have, each declared once."""

import logging
from pathlib import Path
from typing import Annotated, Any

import typer

TASK = "Task file, or the name of a built-in task such as transport."

RUN = "One run of a comparison, or the number of a Monte Carlo run"


TAKES_LONG = ("psmpc_cli.native", "psmpc_cli.progress", "psmpc_cli.specs.robots.covers")
"""Loggers whose information is shown too: what takes seconds is said as it begins."""


def _set_log_level(quiet: bool) -> bool:
    """Choose which messages of the library are printed: warnings and the compilation, which comes once, or errors."""
    logging.getLogger("psmpc_cli").setLevel(logging.ERROR if quiet else logging.WARNING)
    for takes_long in TAKES_LONG:
        logging.getLogger(takes_long).setLevel(logging.ERROR if quiet else logging.INFO)
    return quiet


def output(default: str, metavar: str = "FILE", what: str = "Results.") -> Any:
    """Build the option -o of a command whose default output is `default`."""
    help = f"{what} Missing folders are made. Default: {default}{', numbered' if '/' in default else ''}."
    return typer.Option("-o", "--output", metavar=metavar, help=help, show_default=False)


def strict(condition: str) -> Any:
    """Build the option --strict of a command that fails on a condition."""
    return typer.Option("--strict", help=f"Exit with 1 if {condition}.")


Task = Annotated[str, typer.Argument(help=TASK)]
OptionalTask = Annotated[str | None, typer.Argument(help=TASK, show_default=False)]
Log = Annotated[Path, typer.Argument(help="The log of a run.")]
AnyFile = Annotated[Path, typer.Argument(help="A log, or results of any study.")]

Changes = Annotated[
    list[str] | None, typer.Option("--set", metavar="PATH=VALUE", help="Change any key of the task; repeatable.")
]
Stages = Annotated[str, typer.Option(metavar="A,B", help="The two stages in a row that vary, by number or name.")]
OneRun = Annotated[str | None, typer.Option("--run", metavar="NAME", help=f"{RUN}.")]
SomeRuns = Annotated[list[str] | None, typer.Option("--run", metavar="NAME", help=f"{RUN}; repeatable.")]

Force = Annotated[bool, typer.Option("--force", help="Overwrite files of an earlier command.")]
Figures = Annotated[bool, typer.Option("--figures/--no-figures", help="Draw the figures beside the file.")]
Render = Annotated[bool, typer.Option("--render", help="Film the run with MuJoCo's renderer (psmpc[mujoco]).")]
Open = Annotated[bool, typer.Option("--open", help="Open the page in the browser.")]
Quiet = Annotated[
    bool, typer.Option("--quiet", "-q", callback=_set_log_level, help="No progress, no warnings and no summary.")
]
Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="Print every event and every measured quantity.")]

Jobs = Annotated[
    int | None, typer.Option(min=1, metavar="N", help="Processes at once. Default: one a core.", show_default=False)
]
Dask = Annotated[str | None, typer.Option(metavar="ADDRESS", help="Run on the Dask cluster with this scheduler.")]
Resume = Annotated[bool, typer.Option("--resume", help="Continue a study that was stopped, in its file.")]
