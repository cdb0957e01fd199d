"""The report of a reproduction: every claim with the figures beside it, in one HTML page that needs no network."""

import platform
import shlex
from collections.abc import Iterator
from functools import partial
from itertools import groupby

from psmpc_cli.figures.coordinates import plot_states
from psmpc_cli.figures.instants import plot_instants, plot_pull
from psmpc_cli.figures.pareto import plot_fronts
from psmpc_cli.figures.registry import figures_of
from psmpc_cli.figures.reproduction import plot_monitors, plot_presence, plot_schedule
from psmpc_cli.figures.snapshots import plot_snapshots
from psmpc_cli.report.page import Draw, Page, render, versions_of
from psmpc_cli.studies.fronts import HEADINGS as FRONT_HEADINGS
from psmpc_cli.studies.fronts import NOTE, front_rows, front_texts
from psmpc_cli.studies.judge import ABSOLUTE, HEADINGS, RELATIVE, Reproduction, mission_end
from psmpc_cli.studies.sweep import recommend


def build_report(made: Reproduction, created: str) -> Page:
    """Build the report; `created` is its time in ISO 8601."""
    rows = () if made.fronts is None else front_rows(made.fronts)
    options = [word for change in made.changes for word in ("--set", change)]
    options += ["--weights", str(made.weights.results.attributes["sampling"])]
    options += [] if made.fronts is None else ["--fronts", str(len(made.fronts["ratio"]))]
    first = next(iter(made.runs.values())).attributes
    return render(
        "reproduction.html.j2",
        made=made,
        groups={name: list(group) for name, group in groupby(made.findings, lambda one: one.claim.group)},
        headings=HEADINGS,
        recommended=recommend(made.weights).sentence,
        rows=rows,
        fronts=() if made.fronts is None else front_texts(made.fronts),
        front_headings=FRONT_HEADINGS,
        note=NOTE,
        figures=dict(_figures(made)),
        command=shlex.join(["psmpc", "reproduce", *options]),
        created=created,
        versions=f"{versions_of(first)}, Python {platform.python_version()}",
        plant=first["plant"],
        absolute=ABSOLUTE,
        relative=RELATIVE,
        mission_end=mission_end,
    )


def _figures(made: Reproduction) -> Iterator[tuple[str, Draw]]:
    """Give what draws each figure, by the name that the template has for it."""
    ends, cells, fronts = {}, made.weights, made.fronts
    for method, run in made.runs.items():
        ends[method] = made.published(method, starts=False)
        yield f"{method} times", partial(plot_states, run)
        yield f"{method} starts", partial(plot_presence, run, made.published(method, starts=True))
        yield f"{method} mission", partial(plot_monitors, run)
    yield "schedule", partial(plot_schedule, made.runs, ends)
    yield "instants", partial(plot_instants, made.runs)
    yield "snapshots", partial(plot_snapshots, made.runs)
    for name, entry in figures_of("sweep", cells).items() if cells.ended.any() else ():
        yield f"sweep {name}", partial(entry.function, cells)
    if fronts is not None and any(row["failed"] < row["points"] for row in front_rows(fronts)):
        yield "fronts", partial(plot_fronts, fronts)
    for method, run in made.grasps.items():
        yield f"{method} pull", partial(plot_pull, run)
    for one in made.ablations:
        yield f"ablation_{one.name}", partial(figures_of("ablations")[f"ablation_{one.name}"].function, one.panels)
