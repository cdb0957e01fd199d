"""Pages as HTML files that need nothing from outside: what all are made of, and the report of a run."""

import re
from base64 import b64encode
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, partial
from html import escape
from io import BytesIO
from pathlib import Path
from typing import Any

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from matplotlib.figure import Figure

from psmpc_cli import __version__
from psmpc_cli.figures.registry import FIGURES, figures_of
from psmpc_cli.figures.style import in_style, title_of, words_of
from psmpc_cli.logs.files import PAGE, write_new
from psmpc_cli.logs.run import Run
from psmpc_cli.logs.schema import RUN
from psmpc_cli.progress import Work
from psmpc_cli.report.texts import (
    NO_LIMITS,
    describe_mission,
    filled_columns,
    measure_rows,
    stage_rows,
    warnings_of,
)
from psmpc_cli.specs.arguments import as_path, require

DPI = 200
CSS_DPI = 96
"""Pixels an inch in the file of a figure, and on a page."""

Draw = Callable[[], Figure]


@dataclass(frozen=True)
class Page:
    """One page, which a notebook shows in place.

    Attributes:
        html: Its text.
    """

    html: str

    def __repr__(self) -> str:
        return f"<Page: {len(self.html)} characters of HTML>"

    def _repr_html_(self) -> str:
        style = "width: 100%; height: 760px; border: 1px solid #d0d7de"
        return f'<iframe srcdoc="{escape(self.html)}" style="{style}" allowfullscreen></iframe>'

    def save(self, path: Path | str, force: bool = False) -> Path:
        """Write the page into a file, whole or not at all, and return its path.

        Raises:
            InputError: The path is none, the file exists and `force` is not set or it is no page of psmpc, or it cannot
                be written.
        """
        path = as_path("path", path)
        require("force", force, bool, "True or False")
        write_new(path, self.html.encode(errors="backslashreplace"), force, PAGE)
        return path


def render(template: str, layer: str = "report", **context: Any) -> Page:
    """Fill in a template in the folder of a layer, which may extend those of `report`."""
    return Page(_environment(layer).get_template(template).render(**context))


@cache
def _environment(layer: str) -> Environment:
    """Build the Jinja environment in which the HTML pages of a layer are rendered.

    Templates, styles and scripts are looked for in the folder of the layer, then in that of `report`, whose templates
    all pages extend. Text is escaped. A variable that a template uses and that it is not given is an error.

    Args:
        layer: Folder of psmpc_cli, such as report or paper.
    """
    loader = ChoiceLoader([PackageLoader("psmpc_cli", folder) for folder in (layer, "report")])
    environment = Environment(
        loader=loader,
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    # functions of templates; `source` puts a style or script, whose text is not escaped, into the page
    environment.globals |= {
        "source": lambda name: Markup(loader.get_source(environment, name)[0]),
        "filled_columns": filled_columns,
        "version": __version__,
    }
    # no line break between a number and its s of seconds
    environment.filters["unbroken"] = partial(re.sub, r"(?<=\d) (?=s\b)", "\N{NO-BREAK SPACE}")
    environment.filters |= {"title": title_of, "png": _png, "mission": describe_mission}
    environment.filters["shown"] = lambda value: f"{value:.4g}" if isinstance(value, float) else str(value)
    return environment


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
    """Report a run on one HTML page: verdicts, warnings, stages, measures, and all figures that it has data for.

    The template draws the figures while the page is rendered, and the progress counts them.

    Returns:
        The page, which needs no other files.

    Raises:
        LogError: The run has no samples.
    """
    summary = run.summary()
    makers_by_name = figures_of(RUN, run)
    work = Work("figures", len(makers_by_name), title="drawing", small_parts=True)

    def draw(make: Callable[[Run], Figure]) -> Figure:
        figure = make(run)
        work.advance()
        return figure

    return render(
        "run.html.j2",
        title=words_of(str(run.attributes["task_name"])),
        run=run,
        summary=summary,
        stages=stage_rows(summary),
        warnings=list(warnings_of(summary)),
        measures=list(measure_rows(summary)),
        no_limits=NO_LIMITS,
        figures={FIGURES[RUN][name].caption: partial(draw, make) for name, make in makers_by_name.items()},
        versions=versions_of(run.attributes),
    )
