"""The page of a reproduction: the claims with their findings, the figures, and how it was made."""

import platform
import shlex
from collections.abc import Iterator
from functools import partial
from itertools import groupby

from psmpc_cli.figures.coordinates import plot_states
from psmpc_cli.figures.instants import plot_instants, plot_pull
from psmpc_cli.figures.pareto import plot_fronts
from psmpc_cli.figures.registry import figures_of
from psmpc_cli.figures.snapshots import plot_snapshots
from psmpc_cli.paper import judge
from psmpc_cli.paper.figures import ABLATIONS, plot_monitors, plot_presence, plot_schedule
from psmpc_cli.paper.judge import Reproduction
from psmpc_cli.report.pages import Draw, Page, render, versions_of
from psmpc_cli.studies import fronts
from psmpc_cli.studies.sweep import recommend


def report_reproduction(made: Reproduction, created: str) -> Page:
    """Report a reproduction on one page; `created` is its time in ISO 8601."""
    options = [word for change in made.changes for word in ("--set", change)]
    options += ["--weights", str(made.weights.results.attributes["sampling"])]
    options += [] if made.fronts is None else ["--fronts", str(len(made.fronts["ratio"]))]
    first = next(iter(made.runs.values())).attributes
    return render(
        "reproduction.html.j2",
        room="paper",
        made=made,
        groups={name: list(group) for name, group in groupby(made.findings, lambda one: one.claim.group)},
        judge=judge,
        study=fronts,
        recommended=recommend(made.weights).sentence,
        figures=dict(_figures(made)),
        command=shlex.join(["psmpc", "reproduce", *options]),
        created=created,
        versions=f"{versions_of(first)}, Python {platform.python_version()}",
        plant=first["plant"],
    )


def _figures(made: Reproduction) -> Iterator[tuple[str, Draw]]:
    """Yield the functions that draw the figures, by the names that the template has for them."""
    ends = {}
    cells = made.weights
    for method, run in made.runs.items():
        ends[method] = made.published(method, starts=False)
        yield f"{method} times", partial(plot_states, run)
        yield f"{method} starts", partial(plot_presence, run, made.published(method, starts=True))
        yield f"{method} mission", partial(plot_monitors, run)
    yield "schedule", partial(plot_schedule, made.runs, ends)
    yield "instants", partial(plot_instants, made.runs)
    yield "snapshots", partial(plot_snapshots, made.runs)
    for name, make in figures_of("sweep", cells).items() if cells.ended.any() else ():
        yield f"sweep {name}", partial(make, cells)
    if made.fronts is not None and any(row["failed"] < row["points"] for row in fronts.front_rows(made.fronts)):
        yield "fronts", partial(plot_fronts, made.fronts)
    for method, run in made.grasps.items():
        yield f"{method} pull", partial(plot_pull, run)
    for one in made.ablations:
        yield f"ablation_{one.name}", partial(ABLATIONS[one.name], one.panels)
