"""The command `psmpc reproduce`, which the command line finds here."""

from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from psmpc_cli.cli import common, options
from psmpc_cli.cli.common import GOOD, WARNING, echo, ending_on_signals, live_line

if TYPE_CHECKING:
    from psmpc_cli.paper.judge import Reproduction


def reproduce(
    output: Annotated[Path | None, options.output("runs/reproduce", "DIR", "Directory of report and logs.")] = None,
    json: Annotated[Path | None, typer.Option(metavar="FILE", help="Write the claims as JSON as well.")] = None,
    ablations: Annotated[bool, typer.Option("--ablations", help="Run without each departure from the paper.")] = False,
    as_printed: Annotated[
        bool,
        typer.Option("--as-printed", help="Also judge the task as the paper prints it, in DIR/transport_as_printed."),
    ] = False,
    weights: Annotated[str, typer.Option(metavar="AxB", help="Points of the priorities' grid, Fig. 6.")] = "7x7",
    fronts: Annotated[int, typer.Option(min=3, metavar="N", help="Points of each Pareto front, Fig. 7.")] = 13,
    strict: Annotated[bool, options.strict("a claim does not hold, except claims on inputs")] = False,
    force: options.Force = False,
    changes: options.Changes = None,
    jobs: options.Jobs = None,
    quiet: options.Quiet = False,
) -> None:
    """Reproduce the paper: judge its claims, and write a report with its figures."""
    from psmpc_cli.logs.files import BY_ENDING, CLAIMS, check_output, write_new
    from psmpc_cli.paper import reproduce as study
    from psmpc_cli.paper.departures import PRINTED, SHIPPED
    from psmpc_cli.paper.figures import ABLATIONS, figure_of, save_ablation
    from psmpc_cli.paper.page import report_reproduction

    folder = output or common.free_path(common.RUNS / "reproduce", force)
    common.ensure_fillable(folder, force)
    folders = {SHIPPED: folder, **({PRINTED: folder / PRINTED} if as_printed else {})}
    of_ablations = dict.fromkeys(map(figure_of, ABLATIONS), BY_ENDING["png"])
    for task, into in folders.items():
        for name, kind in {**study.OUTPUTS, **of_ablations}.items():
            check_output(into / name, force, kind)
        study.load_variants(changes or [], task)  # what does not fit one of them is said before anything is run
    if json is not None:
        check_output(json, force, CLAIMS, "--json")
    made = {}
    with ending_on_signals("no report was written"), live_line(quiet) as line:
        for task, into in folders.items():
            made[task] = study.reproduce(into, changes or [], weights, fronts, ablations, force, jobs, line.show, task)
    created = datetime.now(UTC).isoformat(timespec="seconds")
    for task, into in folders.items():
        page = report_reproduction(made[task], created).save(into / study.REPORT, force=True)
        for ablation in made[task].ablations:
            save_ablation(ablation, into)
        if not quiet:
            print_claims(made[task])
            echo(f"report: {page}")
    if json is not None:
        write_new(json, study.claims_json(made[SHIPPED], created, made.get(PRINTED)), force, CLAIMS, "--json")
    if as_printed and not quiet:
        echo()
        for reproduction in made.values():
            echo(f"{reproduction.task}: {reproduction.outcome}")
    if strict and any(reproduction.failing for reproduction in made.values()):
        raise typer.Exit(1)


def print_claims(made: "Reproduction") -> None:
    """Print how many claims of the paper hold, and every claim with its finding.

    Claims that are counted come first, then, with the reason, those that stand apart. Causes follow for claims that do
    not hold or times that are earlier than published, the recommended weights, and what ablations measured.
    """
    from psmpc_cli.cli.tables import print_table
    from psmpc_cli.paper.claims import APART, HEADINGS
    from psmpc_cli.studies.sweep import recommend

    echo(f"{made.outcome}\n", colour=WARNING if made.failing else GOOD)
    print_table(HEADINGS, [finding.row for finding in made.part(None)], left_aligned=1)
    for kind, reason in APART.items():
        echo(f"\n{reason}:")
        print_table(HEADINGS, [finding.row for finding in made.part(kind)], left_aligned=1)
    for finding in made.findings:
        if finding.earlier or not finding.holds:
            holds = "holds" if finding.holds else "does not hold"
            echo(f"\n{finding.claim.id} {holds}: {finding.claim.statement}")
            for point in finding.cause:
                echo(f"  - {point}")
    echo(f"\nweights: {recommend(made.weights).sentence}")
    for ablation in made.ablations:
        echo()
        rows = [(name, f"{value:.4g}") for name, value in ablation.numbers.items()]
        print_table((f"without our {ablation.name.replace('_', ' ')}", "measured"), rows, left_aligned=1)


COMMANDS = {"Study": (reproduce,)}
"""The commands by their group in the help."""
