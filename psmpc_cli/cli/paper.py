"""The paper's claims, published against reproduced: `psmpc reproduce`."""

from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from psmpc_cli.cli.options import Changes, Force, Jobs, Quiet, output_folder, output_option
from psmpc_cli.cli.progress import ending_on_signals, live_line

if TYPE_CHECKING:
    from psmpc_cli.studies.judge import Reproduction

REPORT = "report.html"


def reproduce(
    output: Annotated[Path | None, output_option("runs/reproduce", "DIR", "Directory of report and logs.")] = None,
    json: Annotated[Path | None, typer.Option(metavar="FILE", help="Write the claims as JSON as well.")] = None,
    ablations: Annotated[bool, typer.Option("--ablations", help="Run without each departure from the paper.")] = False,
    weights: Annotated[str, typer.Option(metavar="AxB", help="Points of the priorities' grid, Fig. 6.")] = "7x7",
    fronts: Annotated[int, typer.Option(min=3, metavar="N", help="Points of each Pareto front, Fig. 7.")] = 13,
    strict: Annotated[bool, typer.Option("--strict", help="Exit with 1 if a claim does not hold.")] = False,
    force: Force = False,
    changes: Changes = None,
    jobs: Jobs = None,
    quiet: Quiet = False,
) -> None:
    """Run what the paper's claims need: a table of published against reproduced, and a report with the figures."""
    from psmpc_cli.figures.registry import draw
    from psmpc_cli.logs.files import check_output, write_new
    from psmpc_cli.report.reports import build_report
    from psmpc_cli.studies import reproduce as study

    folder = output_folder(output, "reproduce", force)
    if json is not None:
        check_output(json, force, "--json", hdf5=False)
    with ending_on_signals("no report was written"), live_line(quiet) as show:
        made = study.reproduce(folder, changes or [], weights, fronts, ablations, force, jobs, show)
    created = datetime.now(UTC).isoformat(timespec="seconds")
    build_report(made, created).save(folder / REPORT, force=True)
    for ablation in made.ablations:
        draw("ablations", ablation.panels, folder, only=[f"ablation_{ablation.name}"], force=True)
    if json is not None:
        write_new(json, study.claims_json(made, created), force, hdf5=False)
    if not quiet:
        _print_claims(made)
        typer.echo(f"report: {folder / REPORT}")
    if strict and made.failing:
        raise typer.Exit(1)


def _print_claims(made: "Reproduction") -> None:
    """Print every claim, and why some do not hold or are earlier than published."""
    from psmpc_cli.cli.tables import print_table
    from psmpc_cli.studies.judge import HEADINGS
    from psmpc_cli.studies.sweep import recommend

    print_table(HEADINGS, [finding.row for finding in made.findings], left=1)
    for finding in made.findings:
        if finding.cause:
            holds = "holds" if finding.holds else "does not hold"
            typer.echo(f"\n{finding.claim.id} {holds}: {finding.claim.statement}")
            for point in finding.cause:
                typer.echo(f"  - {point}")
    typer.echo(f"\nweights: {recommend(made.weights).sentence}")
    for ablation in made.ablations:
        typer.echo()
        rows = [(name, f"{value:.4g}") for name, value in ablation.numbers.items()]
        print_table((f"without our {ablation.name.replace('_', ' ')}", "measured"), rows, left=1)
    typer.echo(f"\n{made.outcome}")
