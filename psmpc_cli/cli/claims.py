"""The claim table in a terminal, with the causes of what does not hold below it."""

import typer

from psmpc_cli.cli.summary import print_table
from psmpc_cli.simulation.recommendation import recommend
from psmpc_cli.studies.claim_table import HEADINGS, cells
from psmpc_cli.studies.reproduce import Reproduction


def print_claims(reproduction: Reproduction) -> None:
    """Print every claim, and why some do not hold or are earlier than published."""
    rows = [tuple(cells(judged).values()) for judged in reproduction.judged]
    print_table(HEADINGS, rows, left=1)
    for judged in reproduction.judged:
        if judged.finding.cause:
            holds = "holds" if judged.finding.holds else "does not hold"
            typer.echo(f"\n{judged.claim.id} {holds}: {judged.claim.statement}")
            for point in judged.finding.cause:
                typer.echo(f"  - {point}")
    if reproduction.weights is not None and (best := recommend(reproduction.weights)):
        typer.echo(f"\nweights: {best}")
    for ablation in reproduction.ablations:
        typer.echo(f"\nwithout our {ablation.name.replace('_', ' ')}: {ablation.sentence}")
    count = len(reproduction.judged)
    typer.echo(f"\n{count - len(reproduction.failing)} of {count} claims hold")
