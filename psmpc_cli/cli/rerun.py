"""`psmpc rerun`: repeat a run from its log and say how far the two differ."""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated

import typer

from psmpc_cli.cli.options import FOLDERS

if TYPE_CHECKING:
    from psmpc_cli.logs.comparison import Comparison, Difference
    from psmpc_cli.logs.run import Run


def rerun(
    log: Annotated[Path, typer.Argument(help="A log written by psmpc simulate.")],
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="FILE", help=f"Keep the new log. {FOLDERS} Default: it is dropped."),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite the log named with -o.")] = False,
    strict: Annotated[bool, typer.Option("--strict", help="Exit code 1 if anything differs.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress.")] = False,
) -> None:
    """Repeat a run from its log and say whether every dataset but the wall times is equal."""
    from psmpc_cli.logs.run import read_run
    from psmpc_cli.simulation.run import unequal_conditions

    loaded = read_run(log)
    with TemporaryDirectory(prefix="psmpc-") as directory:
        comparison = _repeat(loaded, output or Path(directory) / "again.h5", force, quiet)
    if not comparison.differences:
        typer.echo(f"equal: all {comparison.compared} datasets but the wall times")
        return
    print_differences(comparison)
    for condition in unequal_conditions(loaded):
        typer.echo(f"note: {condition}")
    if strict:
        raise typer.Exit(1)


def _repeat(log: "Run", path: Path, force: bool, quiet: bool) -> "Comparison":
    """Repeat a run under the eyes of the progress display."""
    from psmpc_cli.cli.progress import watching
    from psmpc_cli.cli.termination import noticing_signals
    from psmpc_cli.logs.schema import Sample
    from psmpc_cli.simulation.run import rerun as repeat

    with noticing_signals() as interruption, watching(quiet) as show:

        def watch(sample: Sample) -> None:
            show(sample)
            interruption.check()

        comparison = repeat(log, path, force, watch)
    if comparison is None:
        raise typer.Exit(interruption.exit_code)
    return comparison


def print_differences(comparison: "Comparison") -> None:
    """Print what differs, and how far."""
    from psmpc_cli.cli.summary import print_table

    differences = comparison.differences
    print_table(("dataset", "units", "largest difference", "first in row"), [_row(each) for each in differences])
    typer.echo(f"differs: {len(differences)} of {comparison.compared} datasets; wall times were not compared")


def _row(difference: "Difference") -> tuple[str, str, str, str]:
    largest = "" if difference.largest != difference.largest else f"{difference.largest:.1e}"
    said = f"{largest} ({difference.what})" if largest and difference.what else difference.what or largest
    return difference.path, difference.units, said, "" if difference.row < 0 else str(difference.row)
