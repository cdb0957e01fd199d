"""`psmpc compile`: compile ahead what a task's runs would compile before their first sample."""

import logging
from typing import Annotated

import typer

from psmpc_cli.cli.options import Changes


def compile(
    task: Annotated[str, typer.Argument(help="A task: YAML file or built-in name.", show_default=False)],
    changes: Changes = None,
) -> None:
    """Compile what a task's solver and plant need, and say where it is, how large, and how long it took."""
    from psmpc_cli.cli.summary import print_table
    from psmpc_cli.errors import InputError
    from psmpc_cli.native.cache import cache_directory
    from psmpc_cli.simulation.compiling import compile_ahead
    from psmpc_cli.specs.load import load_task

    logging.getLogger("psmpc_cli.native").setLevel(logging.INFO)  # why a library could not be made
    loaded = load_task(task, changes or [])
    made = compile_ahead(loaded)
    solver, plant = loaded.spec.solver.kind, loaded.spec.plant.kind
    if not made:
        typer.echo(f"nothing to compile: solver {solver} and plant {plant} run as they are")
        return
    failed = [each.purpose for each in made if each.path is None]
    if failed:
        raise InputError(
            f"could not compile {', '.join(failed)}; expected a C compiler: the one CC names, else cc, gcc or clang on "
            "PATH; without compiled code runs are slower, and nothing else"
        )
    rows = [
        (each.purpose, each.path.name, f"{each.path.stat().st_size / 1024:.0f}", f"{each.seconds:.2f}")
        for each in made
        if each.path is not None
    ]
    print_table(("piece", "file", "size [KiB]", "time [s]"), rows)
    typer.echo(f"in {cache_directory()}")
    if not loaded.spec.solver.compiled:
        typer.echo("note: the task says solver.compiled: false, so its runs will not use this")
