"""`psmpc bench`: how long solves take and how near they come, back-end by back-end, on windows of real runs."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from psmpc_cli.cli.options import Changes

if TYPE_CHECKING:
    from psmpc_cli.studies.bench import BenchTasks, Choices
    from psmpc_cli.studies.bench_document import Data


def bench(
    task: Annotated[str, typer.Argument(help="Task file, or the name of a built-in task.")] = "transport",
    nodes: Annotated[
        str | None, typer.Option(metavar="N,...", help="Intervals a stage. Default: 25,50,100,200,auto.")
    ] = None,
    solvers: Annotated[str, typer.Option(metavar="NAME,...", help="Back-ends.")] = "sqp,fatrop,ipopt",
    repeat: Annotated[
        int | None,
        typer.Option(min=1, metavar="N", help="Timed solves of each window. Default: 3.", show_default=False),
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="A try in less than a minute: few windows, coarse meshes, each solve once.")
    ] = False,
    growth: Annotated[
        bool, typer.Option("--growth", help="Measure robots of 6 to 24 degrees of freedom as well.")
    ] = False,
    json: Annotated[Path | None, typer.Option(metavar="FILE", help="Write everything that was found.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite earlier results.")] = False,
    changes: Changes = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress and no table.")] = False,
) -> None:
    """Time the solves of windows recorded from real runs: every back-end, warm and cold, against CasADi with IPOPT."""
    use_one_thread()
    from psmpc_cli.cli.bench_table import print_bench
    from psmpc_cli.studies.bench import load_bench, parse_solvers
    from psmpc_cli.studies.bench_document import refuse_document, write_document

    choices = replace(_choices(quick, nodes, repeat), solvers=parse_solvers(solvers))
    if json is not None:
        refuse_document(json, force)
    found = _measure(load_bench(task, changes or [], choices), growth, quiet)
    if json is not None:
        write_document(json, found, force)
    if not quiet:
        print_bench(found)
        if json is not None:
            typer.echo(f"written: {json}")


def use_one_thread() -> None:
    """Keep NumPy's library to one thread, as long as it is not loaded."""
    import os

    os.environ["OMP_NUM_THREADS"] = "1"


def _choices(quick: bool, nodes: str | None, repeat: int | None) -> "Choices":
    """Return what is measured, the defaults of a quick bench or a whole one changed by what is given."""
    from psmpc_cli.studies.bench import QUICK, Choices, parse_nodes

    choices = QUICK if quick else Choices()
    choices = choices if nodes is None else replace(choices, nodes=parse_nodes(nodes))
    return choices if repeat is None else replace(choices, repeat=repeat)


def _measure(tasks: "BenchTasks", growth: bool, quiet: bool) -> "Data":
    """Measure and say how far it is; a signal ends it, and nothing is written."""
    from psmpc_cli.studies.bench import run_bench
    from psmpc_cli.studies.bench_document import document
    from psmpc_cli.studies.bench_freedom import measure_freedom

    def told(line: str) -> None:
        if not quiet:
            typer.echo(line, err=True)

    with _ended_by_signals() as passed:
        bench = run_bench(tasks, told, passed)
        freedom = measure_freedom(tasks.choices, told, passed) if growth else ()
    return document(bench, freedom)


@contextmanager
def _ended_by_signals() -> Iterator[Callable[[], None]]:
    """Give what is to be called between two solves: there, not within them, a signal ends the command."""
    from psmpc_cli.cli.termination import noticing_signals

    with noticing_signals() as interruption:
        try:
            yield interruption.check
        except KeyboardInterrupt as reason:
            typer.echo(f"psmpc: {reason}; no results were written", err=True)
            raise typer.Exit(interruption.exit_code) from None
