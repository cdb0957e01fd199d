"""The page of a reproduction: the claims with their findings, the figures, and how it was reproduced."""

import platform
import shlex
from collections.abc import Iterator
from functools import partial
from itertools import groupby

from psmpc_cli.figures.coordinates import plot_states
from psmpc_cli.figures.instants import plot_grasps, plot_instants
from psmpc_cli.figures.pareto import plot_fronts
from psmpc_cli.figures.registry import figures_of
from psmpc_cli.figures.snapshots import plot_snapshots
from psmpc_cli.paper import claims, judge, missions
from psmpc_cli.paper.departures import PRINTED
from psmpc_cli.paper.figures import ABLATIONS, has_waiting_stage, plot_monitors, plot_presence, plot_schedule
from psmpc_cli.paper.judge import Reproduction
from psmpc_cli.report.pages import Draw, Page, render, versions_of
from psmpc_cli.studies import fronts
from psmpc_cli.studies.sweep import recommend


def report_reproduction(reproduction: Reproduction, created: str) -> Page:
    """Build the HTML page of a reproduction: claims with their findings, figures, and the command that repeats it.

    A claim is a statement of the paper, a finding what became of it here. Claims about priorities are judged by a study
    of weights, and those about trade-offs between two stages by Pareto fronts at several samples, if they were
    computed. The template says what is on the page; here it gets what it writes about, and the modules of which it
    uses functions and constants.

    Args:
        reproduction: What was run for the claims, and their findings.
        created: When, in ISO 8601.

    Returns:
        The page, which is drawn and written by its method `save`.
    """
    # the command that repeats it, from what was run
    options = [word for change in reproduction.changes for word in ("--set", change)]
    options += ["--weights", str(reproduction.weights.results.attributes["sampling"])]
    options += [] if reproduction.fronts is None else ["--fronts", str(len(reproduction.fronts["ratio"]))]
    options += ["--as-printed"] if reproduction.task == PRINTED else []
    first = next(iter(reproduction.runs.values())).attributes
    findings_in_general = reproduction.part(None)  # those without a section of their own; groups stand together
    return render(
        "reproduction.html.j2",
        layer="paper",
        reproduction=reproduction,
        groups={name: list(group) for name, group in groupby(findings_in_general, lambda finding: finding.claim.group)},
        apart=claims.APART,
        # where the paper was searched for a claim is no column of the page, but a line below the claim
        headings=[heading for heading in claims.HEADINGS if heading != "searched"],
        judge=judge,  # this and the next two are modules
        tolerances=missions,
        study=fronts,
        recommended=recommend(reproduction.weights).sentence,
        figures=dict(_figures_by_name(reproduction)),
        command=shlex.join(["psmpc", "reproduce", *options]),
        created=created,
        versions=f"{versions_of(first)}, Python {platform.python_version()}",
        plant=first["plant"],
    )


def _figures_by_name(reproduction: Reproduction) -> Iterator[tuple[str, Draw]]:
    """Yield names and functions of the figures of a reproduction; the page's template asks for them by these names.

    Figures are left out for which nothing was measured, such as that of waiting stages of a method that has none.
    """
    published_ends = {}
    cells = reproduction.weights
    for method, run in reproduction.runs.items():
        published_ends[method] = reproduction.published(method, starts=False)
        yield f"{method} times", partial(plot_states, run)
        if has_waiting_stage(run):
            yield f"{method} starts", partial(plot_presence, run, reproduction.published(method, starts=True))
        if run.task.spec.monitors:
            yield f"{method} mission", partial(plot_monitors, run)
    yield "schedule", partial(plot_schedule, reproduction.runs, published_ends)
    yield "instants", partial(plot_instants, reproduction.runs)
    yield "snapshots", partial(plot_snapshots, reproduction.runs)
    for name, make in figures_of("sweep", cells).items() if cells.ended.any() else ():
        yield f"sweep {name}", partial(make, cells)
    results = reproduction.fronts
    if results is not None and any(row["failed"] < row["points"] for row in fronts.front_rows(results)):
        yield "fronts", partial(plot_fronts, results)
    for method, run in reproduction.grasps.items():
        yield f"{method} grasps", partial(plot_grasps, run)
    for ablation in reproduction.ablations:
        yield f"ablation_{ablation.name}", partial(ABLATIONS[ablation.name], ablation.panels)
