"""Pages as HTML files that need nothing from outside: what all are made of, the report of a run, and of a reproduction.

The templates of this folder have one style.
"""

import platform
import re
import shlex
from base64 import b64encode
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache, partial
from html import escape
from importlib.resources import files
from io import BytesIO
from itertools import groupby
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from matplotlib.figure import Figure

from psmpc_cli.figures.coordinates import plot_states
from psmpc_cli.figures.instants import plot_instants, plot_pull
from psmpc_cli.figures.pareto import plot_fronts
from psmpc_cli.figures.registry import figures_of
from psmpc_cli.figures.reproduction import plot_monitors, plot_presence, plot_schedule
from psmpc_cli.figures.snapshots import plot_snapshots
from psmpc_cli.figures.style import in_style, readable, title_of
from psmpc_cli.logs.files import write_new
from psmpc_cli.logs.run import Run
from psmpc_cli.report.texts import describe_mission, measure_rows, stage_rows
from psmpc_cli.specs.arguments import as_path, require
from psmpc_cli.studies import fronts, judge
from psmpc_cli.studies.judge import Reproduction
from psmpc_cli.studies.sweep import recommend

DPI = 200
CSS_DPI = 96
"""Pixels an inch in the file of a figure, and on a page."""

CAPTIONS = {
    "snapshots": "The robot at the key instants, with the targets of the stages that act.",
    "instants": "Planned switch times over time, and the actual ends of the stages.",
    "states": "Base pose and joint angles; stages are shaded, early starts dotted.",
    "velocities": "Velocities, with the limits in force.",
    "controls": "Applied accelerations, constant over each sample, with the limits in force.",
    "forces": "Generalized forces of the low-level controller.",
    "errors": "Largest errors against the current stage's target, with the tolerances of its end condition.",
    "shares": "Share of each stage in the applied control.",
    "solve_time": "Wall time of the solves.",
}
"""What the figures show, in the order of the page; a figure without a caption here has its name."""

Draw = Callable[[], Figure]


@dataclass(frozen=True)
class Page:
    """One page, which a notebook shows in place.

    Attributes:
        html: Its text.
    """

    html: str

    def _repr_html_(self) -> str:
        style = "width: 100%; height: 760px; border: 1px solid #d0d7de"
        return f'<iframe srcdoc="{escape(self.html)}" style="{style}" allowfullscreen></iframe>'

    def save(self, path: Path | str, force: bool = False) -> Path:
        """Write the page into a file, whole or not at all, and return its path.

        Raises:
            InputError: The path is none, the file exists and `force` is not set, or it cannot be written.
        """
        path = as_path("path", path)
        require("force", force, bool, "True or False")
        write_new(path, self.html.encode(errors="backslashreplace"), force, hdf5=False)
        return path


def render(template: str, **context: Any) -> Page:
    """Fill in a template."""
    return Page(_environment().get_template(template).render(**context))


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("psmpc_cli", "report"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    environment.globals |= {"source": _source}
    environment.filters["unbroken"] = partial(re.sub, r"(?<=\d) (?=s\b)", "\N{NO-BREAK SPACE}")
    environment.filters |= {"title": title_of, "png": _png, "mission": describe_mission}
    environment.filters["shown"] = lambda value: f"{value:.4g}" if isinstance(value, float) else str(value)
    return environment


def _source(name: str) -> Markup:
    """Read a style sheet or a script of this folder."""
    return Markup(files("psmpc_cli.report").joinpath(name).read_text("utf-8"))


def versions_of(attributes: Mapping[str, Any]) -> str:
    """List the versions with which a log was written."""
    keys = {name: f"{name.lower()}_version" for name in ("psmpc", "CasADi", "NumPy")}
    return ", ".join(f"{name} {attributes[key]}" for name, key in keys.items() if key in attributes)


def _png(draw: Draw) -> dict[str, str | int]:
    """Draw a figure as PNG data in base64, with its size on the page [px]."""
    with in_style():
        figure = draw()
        file = BytesIO()
        figure.savefig(file, format="png", dpi=DPI)
    width, height = (round(inches * CSS_DPI) for inches in figure.get_size_inches())
    return {"data": b64encode(file.getvalue()).decode("ascii"), "width": width, "height": height}


def report_run(run: Run) -> Page:
    """Report a run on one page.

    Raises:
        LogError: The run has no samples.
    """
    summary = run.summary()
    known = figures_of("run", run)
    names = [name for name in CAPTIONS | known if name in known]
    return render(
        "run.html.j2",
        title=readable(str(run.attributes["task_name"])),
        run=run,
        summary=summary,
        stages=stage_rows(summary),
        measures=list(measure_rows(summary, verbose=True)),
        figures={CAPTIONS.get(name, f"{readable(name)}."): partial(known[name], run) for name in names},
        versions=versions_of(run.attributes),
    )


def build_report(made: Reproduction, created: str) -> Page:
    """Build the report; `created` is its time in ISO 8601."""
    options = [word for change in made.changes for word in ("--set", change)]
    options += ["--weights", str(made.weights.results.attributes["sampling"])]
    options += [] if made.fronts is None else ["--fronts", str(len(made.fronts["ratio"]))]
    first = next(iter(made.runs.values())).attributes
    return render(
        "reproduction.html.j2",
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
    """Give what draws each figure, by the name that the template has for it."""
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
        yield f"ablation_{one.name}", partial(figures_of("ablations")[f"ablation_{one.name}"], one.panels)
