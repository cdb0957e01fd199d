"""The report of a reproduction: every claim with the figures beside it, in one HTML page that needs no network."""

import platform
import re
import shlex
from base64 import b64encode
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.resources import files
from io import BytesIO
from math import isfinite
from typing import Any

from jinja2 import Environment, StrictUndefined
from matplotlib.figure import Figure

from psmpc_cli.figures.coordinates import plot_states
from psmpc_cli.figures.instants import plot_compared_instants
from psmpc_cli.figures.pareto import plot_fronts
from psmpc_cli.figures.registry import figures_of
from psmpc_cli.figures.reproduction import plot_monitors, plot_presence, plot_schedule
from psmpc_cli.figures.run import Run, load_run
from psmpc_cli.figures.snapshots import plot_compared_snapshots
from psmpc_cli.figures.style import in_style, title_of
from psmpc_cli.logs.read import Log
from psmpc_cli.simulation.summary import summarize
from psmpc_cli.studies.claims import HEADINGS, Finding, load_claims
from psmpc_cli.studies.evidence import settled
from psmpc_cli.studies.front_movement import front_movement
from psmpc_cli.studies.front_table import HEADINGS as FRONT_HEADINGS
from psmpc_cli.studies.front_table import NOTE, front_rows, front_texts
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


@dataclass(frozen=True)
class Topic:
    """Claims with a figure beside them."""

    caption: str
    findings: Sequence[Finding]
    image: Image | None = None
    heading: str = ""


@dataclass(frozen=True)
class Section:
    """Topics with figures below them."""

    title: str
    topics: Sequence[Topic]
    wide: Sequence[Image] = ()


def build_report(reproduction: Reproduction, created: str) -> str:
    """Return the report as HTML; `created` is its time in ISO 8601."""
    findings = reproduction.findings
    environment = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=StrictUndefined)
    environment.filters["unbroken"] = partial(re.sub, r"(?<=\d) (?=s\b)", "\N{NO-BREAK SPACE}")
    text = files("psmpc_cli.report").joinpath("reproduction.html.j2").read_text(encoding="utf-8")
    return environment.from_string(text).render(
        held=sum(finding.holds for finding in findings),
        count=len(findings),
        earlier=sum(finding.earlier for finding in findings),
        failing=reproduction.failing,
        headings=HEADINGS,
        sections=list(_sections(reproduction)),
        weights=_weights(reproduction),
        fronts=_fronts(reproduction),
        ablations=[_ablation(one.name, one.sentence, one.panels) for one in reproduction.ablations],
        facts=_facts(reproduction, created),
        run_headings=RUN_HEADINGS,
        runs=[_run_row(name, log) for name, log in reproduction.logs.items()],
        absolute=ABSOLUTE,
        relative=RELATIVE,
    )


def _image(draw: Callable[[], Figure], alt: str, caption: str) -> Image:
    with in_style():
        figure, file = draw(), BytesIO()
        figure.savefig(file, format="png", dpi=DPI)
    width, height = (round(inches * CSS_DPI) for inches in figure.get_size_inches())
    return Image(b64encode(file.getvalue()).decode("ascii"), alt, caption, width, height)


def _group(reproduction: Reproduction, name: str) -> list[Finding]:
    return [finding for finding in reproduction.findings if finding.claim.group == name]


def _sections(reproduction: Reproduction) -> Iterator[Section]:
    """Give the sections on the runs: the setting, the methods, and their comparison."""
    runs = {name: load_run(log) for name, log in reproduction.logs.items()}
    yield Section("The setting", [Topic("The setting", _group(reproduction, "setting"))])
    for method in METHODS:
        title, topics = title_of(method), []
        for topic, heading in TOPICS.items():
            findings = [finding for finding in _group(reproduction, method) if finding.claim.topic == topic]
            if findings:
                image = _method_image(topic, method, runs[method])
                topics.append(Topic(f"{title}: {heading.lower()}", findings, image, heading))
        yield Section(title, topics)
    title = "The methods against each other"
    yield Section(title, [Topic(title, _group(reproduction, "order"), _schedule(runs))], list(_comparison(runs)))


def _method_image(topic: str, method: str, run: Run) -> Image:
    """Return the figure beside the claims of a method on a topic."""
    title = title_of(method)
    if topic == "times":
        ends = ", ".join(f"{span.name} at {span.end:.1f} s" for span in run.spans)
        alt = f"{title}: base pose and joint angles over time; the stages end: {ends}."
        return _image(partial(plot_states, run), alt, f"{title}: base pose and joint angles.")
    if topic == "starts":
        early = ", ".join(f"{span.name} at {span.early:.1f} s" for span in run.spans if span.early is not None)
        return _image(
            partial(plot_presence, run, load_claims().published(method, "start")),
            f"{title}: control that waiting stages add, over time, and the threshold; early starts: {early or 'none'}.",
            f"{title}: what each waiting stage adds to the control. It starts where that reaches the threshold.",
        )
    monitors = summarize(run.log).monitors
    broken = ", ".join(f"{one.name} at {one.broken_at:.1f} s" for one in monitors if isfinite(one.broken_at))
    return _image(
        partial(plot_monitors, run),
        f"{title}: the quantities of the monitors over time, with their bounds; violated: {broken or 'none'}.",
        f"{title}: the quantities that the task monitors.",
    )


def _schedule(runs: Mapping[str, Run]) -> Image:
    ends = "; ".join(f"{title_of(name)} after {run.end:.1f} s" for name, run in runs.items())
    return _image(
        partial(plot_schedule, runs, {name: load_claims().published(name, "end") for name in runs}),
        f"The stages of all methods as bars along time, with published ends; the runs end: {ends}.",
        "All methods: bars are the stages as reproduced, triangles their ends as published.",
    )


def _comparison(runs: Mapping[str, Run]) -> Iterator[Image]:
    yield _image(
        partial(plot_compared_instants, runs),
        "Planned switch times of all methods over time, stage by stage, with the actual ends of the stages.",
        "Planned switch times (Fig. 11 of the paper).",
    )
    yield _image(
        partial(plot_compared_snapshots, runs),
        "The robot and the object at the end of every stage, a row for each method.",
        "The robot at the switch times (Fig. 5 of the paper).",
    )


def _weights(reproduction: Reproduction) -> dict[str, Any]:
    """Return what the page says of the sweep over the weights."""
    cells = reproduction.weights
    images = []
    if cells.ended.any():
        found = settled(cells)
        short = f"from ratio {found.ratio:.4g} on the actual start stays at {found.start:.2f} s"
        for name, entry in figures_of("sweep", cells).items():
            caption = SWEEP_CAPTIONS[name]
            images.append(_image(partial(entry.function, cells), f"{caption} In short: {short}.", caption))
    return {
        "findings": _group(reproduction, "weights"),
        "names": cells.names,
        "cells": len(cells.ratio),
        "low": cells.omega.min(),
        "high": cells.omega.max(),
        "failed": cells.failed.sum(),
        "failed_solves": cells.count("fallbacks"),
        "solves": cells.count("solves"),
        "best": recommend(cells),
        "images": images,
    }


def _fronts(reproduction: Reproduction) -> dict[str, Any]:
    """Return what the page says of the Pareto fronts."""
    results, about = reproduction.fronts, {"caption": "The Pareto fronts", "findings": _group(reproduction, "fronts")}
    if results is None:
        return {**about, "image": None, "rows": ()}
    rows, caption = front_rows(results), "The Pareto fronts at several samples (Fig. 7 of the paper)."
    short = front_movement(results).over_ratio
    some = any(row.failed < row.points for row in rows)
    image = _image(partial(plot_fronts, results), f"{caption} In short: {short}.", caption) if some else None
    totals = {name: sum(getattr(row, name) for row in rows) for name in ("points", "failed", "dominated")}
    texts = [front_texts(row) for row in rows]
    named = {"names": results["stage"], "headings": FRONT_HEADINGS, "note": NOTE}
    return {**about, **totals, **named, "image": image, "rows": texts}


def _ablation(name: str, sentence: str, panels: Any) -> tuple[str, str, Image]:
    title = name.replace("_", " ")
    alt = f"Ablation of the {title}: {sentence}"
    draw = partial(figures_of("ablations")[f"ablation_{name}"].function, panels)
    return title, sentence, _image(draw, alt, f"With and without the {title}.")


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


def _run_row(name: str, log: Log) -> tuple[str, ...]:
    summary = summarize(log)
    return (
        title_of(name),
        "succeeded" if summary.succeeded else "; ".join(("failed", *mission_end(summary))),
        f"{summary.duration:.1f} s",
        str(len(log.time)),
        str(summary.fallbacks),
        str(summary.postponed),
        f"{summary.solves.iterations:.0f}",
    )
