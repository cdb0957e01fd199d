"""What the commands of studies have in common: where calls are made, what is overwritten, how a signal ends it all."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import typer

from psmpc_cli.errors import InputError

if TYPE_CHECKING:
    from psmpc_cli.studies.parallel import Calls

T = TypeVar("T")


def refuse_what_stands(path: Path, force: bool, figures: bool) -> None:
    """Refuse to write over an earlier study or its figures.

    Raises:
        InputError: There is one.
    """
    from psmpc_cli.cli.outputs import refuse_old_figures
    from psmpc_cli.figures.registry import default_directory
    from psmpc_cli.logs.new_file import refuse

    refuse(path, force)
    if figures:
        refuse_old_figures(default_directory(path), force)


def refuse_both(resume: bool, force: bool) -> None:
    """Refuse --resume with --force.

    Raises:
        InputError: Both are given.
    """
    if resume and force:
        raise InputError("found both --resume and --force, expected at most one of them")


def calls_of(jobs: int | None, dask: str | None) -> "Calls":
    """Return what makes the calls: processes of this machine, or a Dask cluster.

    Raises:
        InputError: Both are asked for, or there is no such cluster.
    """
    from psmpc_cli.studies.parallel import LocalCalls

    if dask is None:
        return LocalCalls(jobs)
    if jobs is not None:
        raise InputError("found both --jobs and --dask, expected at most one: a cluster has as many workers as it has")
    from psmpc_cli.studies.cluster import DaskCalls

    return DaskCalls(dask)


@contextmanager
def resumable(path: Path) -> Iterator[None]:
    """Let a signal end what fills in a file; what there is stays."""
    from psmpc_cli.cli.termination import stopping_on_signals

    with stopping_on_signals() as interruption:
        try:
            yield
        except KeyboardInterrupt as reason:
            typer.echo(f"psmpc: {reason}; {path} holds what was done: go on with --resume", err=True)
            raise typer.Exit(interruption.exit_code) from None


def present(
    path: Path,
    results: T,
    table: Callable[[T], None],
    draw: Callable[..., list[Path]],
    figures: bool,
    force: bool,
    quiet: bool,
) -> None:
    """Print the table of a study's results and draw their figures beside its file."""
    from psmpc_cli.figures.registry import default_directory

    if not quiet:
        table(results)
    if figures:
        directory = default_directory(path)
        drawn = draw(results, directory, force=force)
        if not quiet:
            typer.echo(f"{len(drawn)} figures in {directory}")
