"""`psmpc bench`: solve times and accuracy of every back-end on this machine, on windows of real runs."""

from dataclasses import replace
from typing import Annotated

import typer

from psmpc_cli.cli.options import Changes


def bench(
    task: Annotated[str, typer.Argument(help="Task file, or the name of a built-in task.")] = "transport",
    nodes: Annotated[
        str | None, typer.Option(metavar="N,...", help="Intervals a stage. Default: 25,50,100,200,auto.")
    ] = None,
    solvers: Annotated[
        str, typer.Option(metavar="NAME,...", help="Back-ends; piqp is sqp without compiled code.")
    ] = "sqp,piqp,fatrop,ipopt",
    repeat: Annotated[
        int | None,
        typer.Option(min=1, metavar="N", help="Timed solves of each window. Default: 3.", show_default=False),
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="A try in less than a minute: few windows, coarse meshes, each solve once.")
    ] = False,
    changes: Changes = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress.")] = False,
) -> None:
    """Time the solves of windows recorded from real runs: every back-end, warm and cold, against CasADi with IPOPT."""
    use_one_thread()
    from psmpc_cli.cli.summary import print_table
    from psmpc_cli.cli.termination import noticing_signals
    from psmpc_cli.studies import bench as study

    choices = study.QUICK if quick else study.Choices()
    choices = choices if nodes is None else replace(choices, nodes=study.parse_nodes(nodes))
    choices = choices if repeat is None else replace(choices, repeat=repeat)
    choices = replace(choices, solvers=study.parse_solvers(solvers))
    tasks = study.load_bench(task, changes or [], choices)

    def told(line: str) -> None:
        if not quiet:
            typer.echo(line, err=True)

    with noticing_signals() as interruption:  # between two solves, not within them, a signal ends the command
        try:
            found = study.run_bench(tasks, choices, told, interruption.check)
        except KeyboardInterrupt as reason:
            typer.echo(f"psmpc: {reason}", err=True)
            raise typer.Exit(interruption.exit_code) from None
    print_table(study.HEADINGS, list(study.bench_rows(found)), left=3)
    typer.echo(f"{study.NOTE}\n\n{study.describe_machine(found)}")


def use_one_thread() -> None:
    """Limit NumPy's linear algebra to one thread; it has an effect only before NumPy is loaded."""
    import os

    os.environ["OMP_NUM_THREADS"] = "1"
