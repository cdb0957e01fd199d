"""The paper's claims, published against reproduced: `psmpc reproduce`."""

from datetime import UTC, datetime
from json import dumps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from psmpc_cli.cli.options import Changes, Force, Jobs, Quiet, output_folder, output_option
from psmpc_cli.errors import InputError

if TYPE_CHECKING:
    from psmpc_cli.studies.reproduce import Reproduction

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
    from psmpc_cli.report.reproduction import build_report
    from psmpc_cli.studies.reproduce import as_data, load_weights_sweep

    load_weights_sweep(changes or [], weights)
    folder = output_folder(output, "reproduce", force)
    if json is not None and (json.is_dir() or (json.exists() and not force)):
        raise InputError(f"{json} exists already: choose another file with --json, or overwrite it with --force")
    reproduction = _run(folder, changes or [], weights, fronts, ablations, force, jobs, quiet)
    created = datetime.now(UTC).isoformat(timespec="seconds")
    _write(folder / REPORT, build_report(reproduction, created))
    for ablation in reproduction.ablations:
        draw("ablations", ablation.panels, folder, only=[f"ablation_{ablation.name}"], force=True)
    if json is not None:
        _write(json, dumps(as_data(reproduction, created), indent=2, allow_nan=False) + "\n")
    if not quiet:
        _print_claims(reproduction)
        typer.echo(f"report: {folder / REPORT}")
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
    """Run everything with its progress; a signal ends it, and no report is written."""
    from psmpc_cli.cli.progress import ended_runs, ending_on_signals, watched_study
    from psmpc_cli.studies.reproduce import METHODS, ablate, find_fronts, judge_claims, run_methods, sweep_weights

    def echo(line: str) -> None:
        if not quiet:
            typer.echo(line, err=True)

    def front_found(instant: float, ended: int, count: int) -> None:
        echo(f"fronts: {instant:.1f} s done, {ended} of {count}")

    with ending_on_signals("no report was written"):
        with ended_runs(quiet, len(METHODS)) as done:
            logs = run_methods(directory, changes, force, jobs, done)
        with watched_study(quiet, "cells failed") as watch:
            cells = sweep_weights(directory, changes, weights, force, jobs, watch)
        results = find_fronts(directory, logs["psmpc"], fronts, force, jobs, front_found)
        departures = ablate(directory, changes, jobs, lambda name: echo(f"ablations: {name} done")) if ablations else ()
        return judge_claims(logs, cells, results, changes, departures)


def _print_claims(reproduction: "Reproduction") -> None:
    """Print every claim, and why some do not hold or are earlier than published."""
    from psmpc_cli.cli.tables import print_table
    from psmpc_cli.studies.claims import HEADINGS
    from psmpc_cli.studies.weights import guidance

    print_table(HEADINGS, [tuple(finding.row.values()) for finding in reproduction.findings], left=1)
    for finding in reproduction.findings:
        if finding.cause:
            holds = "holds" if finding.holds else "does not hold"
            typer.echo(f"\n{finding.claim.id} {holds}: {finding.claim.statement}")
            for point in finding.cause:
                typer.echo(f"  - {point}")
    typer.echo(f"\nweights: {guidance(reproduction.weights)}")
    for ablation in reproduction.ablations:
        typer.echo(f"\nwithout our {ablation.name.replace('_', ' ')}: {ablation.sentence}")
    count = len(reproduction.findings)
    typer.echo(f"\n{count - len(reproduction.failing)} of {count} claims hold")


def _write(path: Path, text: str) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path} cannot be written: {error.strerror or error}") from None
