"""Runs as pages: `psmpc view`, interactive, and `psmpc report`, to read and print."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from psmpc_cli.cli.options import Force, Quiet, free_path, output_option
from psmpc_cli.cli.progress import watched_run
from psmpc_cli.errors import InputError

if TYPE_CHECKING:
    from psmpc_cli.logs.run import Run
    from psmpc_cli.report.page import Page
    from psmpc_cli.studies.monte_carlo import MonteCarloRuns

Open = Annotated[bool, typer.Option("--open", help="Open the page in the browser.")]


def view(
    logs: Annotated[list[Path], typer.Argument(help="Logs of runs, comparisons, Monte Carlo studies.")],
    output: Annotated[Path | None, output_option("beside the first log", what="The page.")] = None,
    run: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="This run of a comparison; the number of one of a Monte Carlo; repeatable."),
    ] = None,
    open_it: Open = False,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Write runs as one interactive HTML page: the robot in 3-D with its plans, a time line, and linked plots."""
    from psmpc_cli.report.view import view as show

    path = output or free_path(logs[0].with_name(f"{logs[0].stem}-view.html"), force)
    runs: dict[str, Run] = {}
    for log in logs:
        for name, found in _runs_of(log, run or [], quiet).items():
            runs[name if name not in runs else f"{name} of {log.stem} {len(runs) + 1}"] = found
    _save(show(runs), path, force, open_it)


def report(
    log: Annotated[Path, typer.Argument(help="The log of a run.")],
    output: Annotated[Path | None, output_option("beside the log", what="The page.")] = None,
    open_it: Open = False,
    force: Force = False,
) -> None:
    """Write a run as one HTML page to read and print: verdict, stages, figures, measurements and settings."""
    from psmpc_cli.logs.run import read_run
    from psmpc_cli.report.reports import report_run

    path = output or free_path(log.with_name(f"{log.stem}-report.html"), force)
    _save(report_run(read_run(log)), path, force, open_it)


def _save(page: "Page", path: Path, force: bool, open_it: bool) -> None:
    """Write a page, say where it is, and open it if asked to."""
    import webbrowser

    typer.echo(f"page: {page.save(path, force)}")
    if open_it and not webbrowser.open(path.resolve().as_uri()):
        typer.echo("psmpc: no browser was opened: found none; set BROWSER, or open the page yourself", err=True)


def _runs_of(log: Path, chosen: Sequence[str], quiet: bool) -> "Mapping[str, Run]":
    """Read the runs of a file by name, those chosen; that of a Monte Carlo study is repeated from its seed."""
    from psmpc_cli.cli.tables import read_file
    from psmpc_cli.logs.schema import COMPARISON, MONTE_CARLO, RUN

    kind, content, _ = read_file(log)
    if kind == MONTE_CARLO:
        return {f"run {number}": _repeated(content, number, log, quiet) for number in chosen or [""]}
    if kind == COMPARISON:
        if unknown := [name for name in chosen if name not in content]:
            raise InputError(f"--run: found no run '{unknown[0]}' in {log}, expected one of {', '.join(content)}")
        return {name: found for name, found in content.items() if name in (chosen or content)}
    if kind != RUN or chosen:
        wanted = "a comparison or a Monte Carlo study" if chosen else "the log of a run, or a file of several"
        raise InputError(f"{'--run: ' if chosen else ''}{log} holds a {kind}, expected {wanted}")
    return {str(content.attributes["controller"]): content}


def _repeated(study: "MonteCarloRuns", number: str, log: Path, quiet: bool) -> "Run":
    """Repeat a run of a Monte Carlo study.

    Raises:
        InputError: The study has no such run.
    """
    count = len(study["seed"])
    if not number.isdecimal() or int(number) >= count:
        found = f"no run '{number}'" if number else "no --run"
        raise InputError(f"{log} holds a Monte Carlo study: found {found}, expected --run with 0 to {count - 1}")
    with watched_run(quiet) as (watch, interruption):
        run = study.repeat(int(number), watch)
    if run.interrupted:
        raise typer.Exit(interruption.exit_code)
    return run
