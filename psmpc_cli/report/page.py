"""Pages: HTML files that need nothing from outside, made from the templates of this folder with one style."""

import re
from base64 import b64encode
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, partial
from html import escape
from importlib.resources import files
from io import BytesIO
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from matplotlib.figure import Figure

from psmpc_cli.figures.style import in_style, title_of
from psmpc_cli.logs.files import write_new
from psmpc_cli.report.texts import describe_mission

DPI, CSS_DPI = 200, 96
"""Pixels an inch in the file of a figure, and on a page."""

IN_NOTEBOOK = 760
"""Height of a page in a notebook [px]."""

VERSIONS = {"psmpc": "psmpc_version", "CasADi": "casadi_version", "NumPy": "numpy_version"}
"""Attributes of a log by the program whose version they have."""

Draw = Callable[[], Figure]


@dataclass(frozen=True)
class Page:
    """One page, which a notebook shows in place.

    Attributes:
        html: Its text.
    """

    html: str

    def _repr_html_(self) -> str:
        style = f"width: 100%; height: {IN_NOTEBOOK}px; border: 1px solid #d0d7de"
        return f'<iframe srcdoc="{escape(self.html)}" style="{style}" allowfullscreen></iframe>'

    def save(self, path: Path | str, force: bool = False) -> Path:
        """Write the page into a file, whole or not at all, and return its path.

        Raises:
            InputError: The file exists and `force` is not set, or it cannot be written.
        """
        write_new(path := Path(path), self.html.encode(), force, hdf5=False)
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
    return ", ".join(f"{name} {attributes[key]}" for name, key in VERSIONS.items() if key in attributes)


def _png(draw: Draw) -> dict[str, str | int]:
    """Draw a figure as PNG data in base64, with its size on the page [px]."""
    with in_style():
        figure, file = draw(), BytesIO()
        figure.savefig(file, format="png", dpi=DPI)
    width, height = (round(inches * CSS_DPI) for inches in figure.get_size_inches())
    return {"data": b64encode(file.getvalue()).decode("ascii"), "width": width, "height": height}
