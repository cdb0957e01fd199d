"""The results of a Pareto study as a table: a row a sample."""

from pathlib import Path

import numpy as np
import typer

from psmpc_cli.cli.summary import print_table
from psmpc_cli.logs.results import Results
from psmpc_cli.studies.fronts import HEADINGS, NOTE, WEIGHTED, front_movement, front_rows, front_texts, methods_in


def print_fronts(results: Results, path: Path) -> None:
    """Print what was found at every sample, how the fronts move, and where they are."""
    print_table(HEADINGS, [front_texts(row) for row in front_rows(results)], left=0)
    typer.echo(NOTE)
    if WEIGHTED in methods_in(results):
        movement = front_movement(results)
        for sentence in (movement.over_ratio, *movement.over_time):
            typer.echo(sentence)
    if "constrained_off_weighted" in results.quantities:
        off = results["constrained_off_weighted"]
        typer.echo(
            f"epsilon constraints lie at most {np.nanmax(off, initial=0.0):.1e} of a front above the chords of the "
            f"weighted sums, which miss such parts, and at most {-np.nanmin(off, initial=0.0):.1e} below their lines"
        )
    typer.echo(f"results: {path}")
