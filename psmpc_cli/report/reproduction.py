"""The report of a reproduction: every claim with the figures beside it, in one HTML page that needs no network."""

import platform
import re
import shlex
from base64 import b64encode
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from importlib.resources import files
from io import BytesIO
from itertools import groupby
from math import isfinite

from jinja2 import Environment, StrictUndefined
from matplotlib.figure import Figure

from psmpc_cli.figures.coordinates import plot_states
from psmpc_cli.figures.instants import plot_compared_instants
from psmpc_cli.figures.pareto import plot_fronts
from psmpc_cli.figures.registry import figures_of
from psmpc_cli.figures.reproduction import plot_monitors, plot_presence, plot_schedule
from psmpc_cli.figures.snapshots import plot_compared_snapshots
from psmpc_cli.figures.style import in_style, title_of
from psmpc_cli.logs.run import Run
from psmpc_cli.studies.claims import HEADINGS, load_claims, settled
from psmpc_cli.studies.fronts import HEADINGS as FRONT_HEADINGS
from psmpc_cli.studies.fronts import NOTE, front_movement, front_rows, front_texts
from psmpc_cli.studies.judge import ABSOLUTE, RELATIVE, mission_end
from psmpc_cli.studies.reproduce import METHODS, Reproduction
from psmpc_cli.studies.weights import recommend

TOPICS = {"times": "When the stages end", "starts": "When the stages start", "mission": "How the mission ends"}

RUN_HEADINGS = ("run", "mission", "ended at", "samples", "failed solves", "postponed", "median of iterations")

SWEEP_CAPTIONS = {
    "surface": "The actual start over both weights (Fig. 6 of the paper).",
    "heat_map": "The same from above, with the contour of t_s - T_h.",
    "starts": "The actual start against the ratio of the weights, for every threshold.",
    "sensitivity": "Completion, effort and final error against the ratio, and the recommended ratio.",
}

DPI, CSS_DPI = 200, 96
"""Pixels an inch in the file of a figure, and on a page."""


@dataclass(frozen=True)
class Image:
    """A figure in the page: PNG data in base64, what it shows for those who cannot see it, its caption, size [px]."""

    data: str
    alt: str
    caption: str
    width: int
    height: int


def build_report(reproduction: Reproduction, created: str) -> str:
    """Return the report as HTML; `created` is its time in ISO 8601."""
    environment = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=StrictUndefined)
    environment.filters["unbroken"] = partial(re.sub, r"(?<=\d) (?=s\b)", "\N{NO-BREAK SPACE}")
    environment.filters["title"] = title_of
    text = files("psmpc_cli.report").joinpath("reproduction.html.j2").read_text(encoding="utf-8")
    results = reproduction.fronts
    return environment.from_string(text).render(
        findings=reproduction.findings,
        groups={name: list(group) for name, group in groupby(reproduction.findings, lambda one: one.claim.group)},
        headings=HEADINGS,
        methods=METHODS,
        topics=TOPICS,
        cells=reproduction.weights,
        recommended=recommend(reproduction.weights),
        results=results,
        rows=() if results is None else front_rows(results),
        fronts=[] if results is None else [front_texts(row) for row in front_rows(results)],
        front_headings=FRONT_HEADINGS,
        note=NOTE,
        images=dict(_images(reproduction)),
        ablations=reproduction.ablations,
        facts=_facts(reproduction, created),
        run_headings=RUN_HEADINGS,
        runs=[_run_row(name, log) for name, log in reproduction.logs.items()],
        absolute=ABSOLUTE,
        relative=RELATIVE,
    )


def _images(reproduction: Reproduction) -> Iterator[tuple[str, Image]]:
    """Give every figure with the name that the template has for it."""
    runs = dict(reproduction.logs)
    for method, run in runs.items():
        yield from ((f"{method} {topic}", image) for topic, image in _method_images(method, run))
    ends = "; ".join(f"{title_of(name)} after {run.motion.end:.1f} s" for name, run in runs.items())
    published = {name: load_claims().published(name, "end") for name in runs}
    caption = "All methods: bars are the stages as reproduced, triangles their ends as published."
    yield "schedule", _image(partial(plot_schedule, runs, published), caption, f"The runs end: {ends}.")
    caption = "Planned switch times (Fig. 11 of the paper)."
    yield "instants", _image(partial(plot_compared_instants, runs), caption, "Over time, with the actual ends.")
    caption = "The robot at the switch times (Fig. 5 of the paper)."
    yield "snapshots", _image(partial(plot_compared_snapshots, runs), caption, "A row for each method.")
    cells, results = reproduction.weights, reproduction.fronts
    if cells.ended.any():
        start, ratio = settled(cells)
        for name, entry in figures_of("sweep", cells).items():
            short = f"From ratio {ratio:.4g} on the actual start stays at {start:.2f} s."
            yield f"sweep {name}", _image(partial(entry.function, cells), SWEEP_CAPTIONS[name], short)
    if results is not None and any(row.failed < row.points for row in front_rows(results)):
        caption = "The Pareto fronts at several samples (Fig. 7 of the paper)."
        said = f"In short: {front_movement(results).over_ratio}."
        yield "fronts", _image(partial(plot_fronts, results), caption, said)
    for one in reproduction.ablations:
        draw = partial(figures_of("ablations")[f"ablation_{one.name}"].function, one.panels)
        yield f"ablation {one.name}", _image(draw, f"With and without the {one.name.replace('_', ' ')}.", one.sentence)


def _method_images(method: str, run: Run) -> Iterator[tuple[str, Image]]:
    """Give the figures beside the claims of a method, by topic."""
    title, published = title_of(method), load_claims().published(method, "start")
    ends = ", ".join(f"{span.name} at {span.end:.1f} s" for span in run.spans)
    yield "times", _image(partial(plot_states, run), f"{title}: base pose and joint angles.", f"Stages end: {ends}.")
    early = ", ".join(f"{span.name} at {span.early:.1f} s" for span in run.spans if span.early is not None) or "none"
    caption = f"{title}: what each waiting stage adds to the control. It starts where that reaches the threshold."
    yield "starts", _image(partial(plot_presence, run, published), caption, f"Early starts: {early}.")
    monitors = [one for one in run.summary().monitors if isfinite(one.broken_at)]
    broken = ", ".join(f"{one.name} at {one.broken_at:.1f} s" for one in monitors) or "none"
    yield "mission", _image(partial(plot_monitors, run), f"{title}: the monitored quantities.", f"Violated: {broken}.")


def _image(draw: Callable[[], Figure], caption: str, short: str) -> Image:
    """Draw a figure; `short` is its description."""
    with in_style():
        figure, file = draw(), BytesIO()
        figure.savefig(file, format="png", dpi=DPI)
    width, height = (round(inches * CSS_DPI) for inches in figure.get_size_inches())
    return Image(b64encode(file.getvalue()).decode("ascii"), f"{caption} {short}", caption, width, height)


def _facts(reproduction: Reproduction, created: str) -> dict[str, str]:
    """Return how the reproduction was made; nothing of the machine."""
    attributes = reproduction.weights.results.attributes
    options = [word for change in reproduction.changes for word in ("--set", change)]
    options += ["--weights", str(attributes["sampling"])]
    if reproduction.fronts is not None:
        options += ["--fronts", str(len(reproduction.fronts["ratio"]))]
    first = next(iter(reproduction.logs.values())).attributes
    versions = {"psmpc": "psmpc_version", "CasADi": "casadi_version", "NumPy": "numpy_version"}
    named = [f"{name} {first[key]}" for name, key in versions.items()]
    digests = {title_of(name): str(log.attributes["digest"]) for name, log in reproduction.logs.items()}
    digests["weights"] = str(attributes["digest"])
    return {
        "command": shlex.join(["psmpc", "reproduce", *options]),
        "date": created,
        "versions": ", ".join([*named, f"Python {platform.python_version()}"]),
        "plant": str(first["plant"]),
        **{f"task digest, {name}": digest for name, digest in digests.items()},
    }


def _run_row(name: str, log: Run) -> tuple[str, ...]:
    summary = log.summary()
    return (
        title_of(name),
        "succeeded" if summary.succeeded else "; ".join(("failed", *mission_end(summary))),
        f"{summary.duration:.1f} s",
        str(len(log.time)),
        str(summary.failed_solves),
        str(summary.postponed),
        f"{summary.solves.iterations:.0f}",
    )
