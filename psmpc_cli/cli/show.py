"""`psmpc show`: what a file written by psmpc holds."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated

import typer

from psmpc_cli.errors import InputError


def show(
    log: Annotated[Path, typer.Argument(help="A log, or results of any study.")],
    csv: Annotated[
        Path | None, typer.Option("--csv", metavar="DIR", help="Export a log's tables as CSV files.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite exported tables.")] = False,
) -> None:
    """Print the summary of a log, or the table of a comparison or a study, again, or export tables of logs."""
    from psmpc_cli.logs.files import kind_of
    from psmpc_cli.logs.schema import COMPARISON, MONTE_CARLO, PARETO, RUN, SWEEP

    shown: Mapping[str, Callable[[Path], None]] = {
        RUN: _show_run,
        COMPARISON: _show_comparison,
        SWEEP: _show_sweep,
        PARETO: _show_fronts,
        MONTE_CARLO: _show_monte_carlo,
    }
    kind = kind_of(log)
    if csv is None:
        shown.get(kind, _show_run)(log)  # which refuses what it does not know
    elif kind in (RUN, COMPARISON):
        _export(log, kind, csv, force)
    else:
        raise InputError(f"--csv: {log} holds a {kind}, expected logs; other programs open its file, such as xarray")


def _show_run(log: Path) -> None:
    from psmpc_cli.cli.summary import print_summary
    from psmpc_cli.logs.run import read_run

    print_summary(read_run(log).summary(), log)


def _show_comparison(log: Path) -> None:
    from psmpc_cli.cli.comparison import print_comparison
    from psmpc_cli.logs.run import read_comparison

    print_comparison({name: run.summary() for name, run in read_comparison(log).items()}, log)


def _show_sweep(log: Path) -> None:
    from psmpc_cli.cli.sweep_weights import print_sweep
    from psmpc_cli.logs.results import read_results
    from psmpc_cli.logs.schema import SWEEP
    from psmpc_cli.studies.weights import sweep_cells

    print_sweep(sweep_cells(read_results(log, SWEEP)))


def _show_fronts(log: Path) -> None:
    from psmpc_cli.cli.fronts import print_fronts
    from psmpc_cli.studies.fronts import read_pareto

    print_fronts(read_pareto(log), log)


def _show_monte_carlo(log: Path) -> None:
    from psmpc_cli.cli.monte_carlo import print_monte_carlo
    from psmpc_cli.studies.monte_carlo import read_monte_carlo

    print_monte_carlo(read_monte_carlo(log))


def _export(log: Path, kind: str, directory: Path, force: bool) -> None:
    """Write the tables of a log, or those of every log of a comparison below their names."""
    from psmpc_cli.logs.run import read_comparison, read_run
    from psmpc_cli.logs.schema import RUN

    logs = {"": read_run(log)} if kind == RUN else read_comparison(log)
    for name, run in logs.items():
        for path in run.to_csv(directory / name, force):
            typer.echo(str(path))
