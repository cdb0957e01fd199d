"""The section on how a reproduction was made: command, versions, tasks, runs and rules; nothing of the machine."""

import platform
import shlex
from collections.abc import Iterator

from psmpc_cli.figures.comparison.names import title_of
from psmpc_cli.logs.read import Log
from psmpc_cli.report.claims import points, row, table
from psmpc_cli.report.html import Html, element, joined
from psmpc_cli.simulation.summary import summarize
from psmpc_cli.studies.causes import of_mission
from psmpc_cli.studies.findings import ABSOLUTE, RELATIVE
from psmpc_cli.studies.reproduce import Reproduction

RULES = (
    f"A published time holds within {ABSOLUTE:g} s or {RELATIVE:.0%} of it, whichever is larger.",
    "A time earlier than published holds as well if the mission succeeded; such a time is marked.",
    "A start that coincides with an instant does so to one sample, for it is known no better.",
    "Orders, settings and how missions end hold exactly as stated or not at all.",
    "An actual start that falls with the weights does so to one sample, for every threshold that is followed.",
    "A front moves as the mean of its points does, in costs normalized by (12), from every sample to the next.",
    "The rules stood before the runs and no claim has one of its own.",
)

HEADINGS = ("run", "mission", "ended at", "samples", "fall-backs", "postponed", "median of iterations")


def how_made(reproduction: Reproduction, created: str) -> Iterator[Html]:
    """Give the section, made at a time as ISO 8601 has it."""
    options = [word for change in reproduction.changes for word in ("--set", change)]
    digests = {title_of(name): str(log.attributes["digest"]) for name, log in reproduction.logs.items()}
    if reproduction.weights is not None:
        attributes = reproduction.weights.results.attributes
        options += ["--weights", str(attributes["sampling"])]
        digests["weights"] = str(attributes["digest"])
    if reproduction.fronts is not None:
        options += ["--fronts", str(len(reproduction.fronts["ratio"]))]
    first = next(iter(reproduction.logs.values()))
    facts = {
        "command": shlex.join(["psmpc", "reproduce", *options]),
        "date": created,
        "versions": _versions(first),
        "plant": str(first.attributes["plant"]),
        **{f"task digest, {name}": digest for name, digest in digests.items()},
    }
    pairs = ((element("dt", key), element("dd", element("code", value))) for key, value in facts.items())
    yield element("h2", "How this was made")
    yield element("dl", *(part for pair in pairs for part in pair), class_="facts")
    rows = (_run(name, log) for name, log in reproduction.logs.items())
    yield element("h3", "The runs")
    yield table("What each run came to", HEADINGS, rows, "runs")
    yield element("h3", "The rules")
    yield points(RULES, "rules")


def _versions(log: Log) -> str:
    found = {"psmpc": "psmpc_version", "CasADi": "casadi_version", "NumPy": "numpy_version"}
    named = [f"{name} {log.attributes[key]}" for name, key in found.items()]
    return ", ".join([*named, f"Python {platform.python_version()}"])


def _run(name: str, log: Log) -> Html:
    summary = summarize(log)
    texts = (
        "succeeded" if summary.succeeded else "; ".join(("failed", *of_mission(summary))),
        f"{summary.duration:.1f} s",
        str(len(log.time)),
        str(summary.fallbacks),
        str(summary.postponed),
        f"{summary.solves.iterations:.0f}",
    )
    return row(joined(title_of(name)), zip(HEADINGS[1:], texts, strict=True))
