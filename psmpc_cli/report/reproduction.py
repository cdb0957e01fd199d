"""The report of a reproduction: every claim with the figures beside it, in one HTML page that needs no network."""

import platform
import re
import shlex
from base64 import b64encode
from collections.abc import Callable, Iterator
from functools import partial
from io import BytesIO
from itertools import groupby

from jinja2 import Environment, PackageLoader, StrictUndefined
from matplotlib.figure import Figure

from psmpc_cli.figures.coordinates import plot_states
from psmpc_cli.figures.instants import plot_instants
from psmpc_cli.figures.pareto import plot_fronts
from psmpc_cli.figures.registry import figures_of
from psmpc_cli.figures.reproduction import plot_monitors, plot_presence, plot_schedule
from psmpc_cli.figures.snapshots import plot_snapshots
from psmpc_cli.figures.style import in_style, title_of
from psmpc_cli.studies.fronts import HEADINGS as FRONT_HEADINGS
from psmpc_cli.studies.fronts import NOTE, front_rows, front_texts
from psmpc_cli.studies.judge import ABSOLUTE, HEADINGS, RELATIVE, Reproduction, mission_end
from psmpc_cli.studies.sweep import recommend

DPI, CSS_DPI = 200, 96
"""Pixels an inch in the file of a figure, and on a page."""

VERSIONS = {"psmpc": "psmpc_version", "CasADi": "casadi_version", "NumPy": "numpy_version"}
"""Attributes of a log by the program whose version they have."""

Draw = Callable[[], Figure]


def build_report(made: Reproduction, created: str) -> str:
    """Return the report as HTML; `created` is its time in ISO 8601."""
    environment = Environment(
        loader=PackageLoader("psmpc_cli", "report"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    environment.filters["unbroken"] = partial(re.sub, r"(?<=\d) (?=s\b)", "\N{NO-BREAK SPACE}")
    environment.filters |= {"title": title_of, "png": _png, "mission_end": mission_end}
    environment.filters["shown"] = lambda value: f"{value:.4g}" if isinstance(value, float) else str(value)
    rows = () if made.fronts is None else front_rows(made.fronts)
    options = [word for change in made.changes for word in ("--set", change)]
    options += ["--weights", str(made.weights.results.attributes["sampling"])]
    options += [] if made.fronts is None else ["--fronts", str(len(made.fronts["ratio"]))]
    first = next(iter(made.runs.values())).attributes
    versions = ", ".join(f"{name} {first[key]}" for name, key in VERSIONS.items())
    return environment.get_template("reproduction.html.j2").render(
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
        versions=f"{versions}, Python {platform.python_version()}",
        plant=first["plant"],
        absolute=ABSOLUTE,
        relative=RELATIVE,
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
    for one in made.ablations:
        yield f"ablation_{one.name}", partial(figures_of("ablations")[f"ablation_{one.name}"].function, one.panels)


def _png(draw: Draw) -> dict[str, str | int]:
    """Draw a figure as PNG data in base64, with its size on the page [px]."""
    with in_style():
        figure, file = draw(), BytesIO()
        figure.savefig(file, format="png", dpi=DPI)
    width, height = (round(inches * CSS_DPI) for inches in figure.get_size_inches())
    return {"data": b64encode(file.getvalue()).decode("ascii"), "width": width, "height": height}
