"""`psmpc reproduce`: run what the paper's claims need, and lay published and reproduced side by side."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from psmpc_cli.cli.options import FOLDERS, Changes, Jobs

if TYPE_CHECKING:
    from psmpc_cli.studies.reproduce import Reproduction

REPORT, ABLATION = "report.html", "ablation_{}.png"


def reproduce(
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="DIR", help=f"Directory of the report and the logs. {FOLDERS}")
    ] = Path("runs/reproduce"),
    json: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Write the claim table as JSON as well.")
    ] = None,
    ablations: Annotated[
        bool, typer.Option("--ablations", help="Also run the task without each of our departures from the paper.")
    ] = False,
    weights: Annotated[
        str,
        typer.Option(metavar="AxB", help="Points of the weights of Approach and Capture that are tried, for Fig. 6."),
    ] = "7x7",
    fronts: Annotated[
        int, typer.Option(min=3, metavar="N", help="Points of each Pareto front of Approach and Capture, for Fig. 7.")
    ] = 13,
    strict: Annotated[bool, typer.Option("--strict", help="Exit with 1 if a claim does not hold.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Overwrite an earlier reproduction.")] = False,
    changes: Changes = None,
    jobs: Jobs = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress and no table.")] = False,
) -> None:
    """Run what the paper's claims need: a table of published against reproduced, and a report with the figures."""
    from datetime import UTC, datetime
    from json import dumps

    from psmpc_cli.figures.registry import draw
    from psmpc_cli.report.reproduction import build_report
    from psmpc_cli.studies.reproduce import FRONTS, LOGS, WEIGHTS, as_data, load_weights_sweep

    load_weights_sweep(changes or [], weights)
    report = output / REPORT
    drawn = output.glob(ABLATION.format("*")) if ablations else ()
    results = (output / name for name in (LOGS, WEIGHTS, FRONTS))
    _refuse_old([*results, report, *([] if json is None else [json]), *drawn], force)
    reproduction = _run(output, changes or [], weights, fronts, ablations, force, jobs, quiet)
    created = datetime.now(UTC).isoformat(timespec="seconds")
    _write(report, build_report(reproduction, created))
    for ablation in reproduction.ablations:
        draw("ablations", ablation.panels, output, only=[f"ablation_{ablation.name}"], force=True)
    if json is not None:
        _write(json, dumps(as_data(reproduction, created), indent=2, allow_nan=False) + "\n")
    if not quiet:
        _print_claims(reproduction)
        typer.echo(f"report: {report}")
    if strict and reproduction.failing:
        raise typer.Exit(1)


def _run(
    directory: Path,
    changes: list[str],
    weights: str,
    fronts: int,
    ablations: bool,
    force: bool,
    jobs: int | None,
    quiet: bool,
) -> "Reproduction":
    """Run everything with a progress display; a signal ends it, and no report is written."""
    from psmpc_cli.cli.parallel import watching_runs
    from psmpc_cli.cli.study import watching_study
    from psmpc_cli.cli.termination import stopping_on_signals
    from psmpc_cli.studies.reproduce import ablate, find_fronts, judge_claims, run_methods, sweep_weights

    def found(instant: float, ended: int, count: int) -> None:
        if not quiet:
            typer.echo(f"fronts: {instant:.1f} s done, {ended} of {count}", err=True)

    def ablated(name: str) -> None:
        if not quiet:
            typer.echo(f"ablations: {name} done", err=True)

    with stopping_on_signals() as interruption:
        try:
            with watching_runs(quiet) as runs:
                logs = run_methods(directory, changes, force, jobs, runs.began, runs.done)
            with watching_study(quiet) as watch:
                cells = sweep_weights(directory, changes, weights, force, jobs, watch)
            results = find_fronts(directory, logs["psmpc"], fronts, force, jobs, found)
            departures = ablate(directory, changes, jobs, ablated) if ablations else ()
            return judge_claims(logs, cells, results, changes, departures)
        except KeyboardInterrupt as reason:
            typer.echo(f"psmpc: {reason}; no report was written", err=True)
            raise typer.Exit(interruption.exit_code) from None


def _print_claims(reproduction: "Reproduction") -> None:
    """Print every claim, and why some do not hold or are earlier than published."""
    from psmpc_cli.cli.summary import print_table
    from psmpc_cli.studies.claims import HEADINGS
    from psmpc_cli.studies.weights import recommend

    print_table(HEADINGS, [tuple(finding.row.values()) for finding in reproduction.findings], left=1)
    for finding in reproduction.findings:
        if finding.cause:
            holds = "holds" if finding.holds else "does not hold"
            typer.echo(f"\n{finding.claim.id} {holds}: {finding.claim.statement}")
            for point in finding.cause:
                typer.echo(f"  - {point}")
    if best := recommend(reproduction.weights):
        typer.echo(f"\nweights: {best}")
    for ablation in reproduction.ablations:
        typer.echo(f"\nwithout our {ablation.name.replace('_', ' ')}: {ablation.sentence}")
    count = len(reproduction.findings)
    typer.echo(f"\n{count - len(reproduction.failing)} of {count} claims hold")


def _refuse_old(files: list[Path], force: bool) -> None:
    """Find out before the runs, not after them, what would be overwritten or could not be written."""
    from psmpc_cli.errors import InputError

    for path in files:
        if path.is_dir():
            raise InputError(f"{path} is a directory, expected a file or nothing")
        if path.exists() and not force:
            raise InputError(
                f"{path} exists already: choose another place with -o or --json, or overwrite with --force"
            )
        if path.parent.exists() and not path.parent.is_dir():
            raise InputError(f"{path.parent} is no directory: choose another place with -o or --json")


def _write(path: Path, text: str) -> None:
    from psmpc_cli.errors import InputError

    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path} cannot be written: {error.strerror or error}") from None
