"""The report of a reproduction: every claim with the figures beside it, in one page that needs nothing from outside."""

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from math import isfinite

from psmpc_cli.figures.ablations import plot_ablation
from psmpc_cli.figures.claims.monitors import plot_monitors
from psmpc_cli.figures.claims.presence import plot_presence
from psmpc_cli.figures.claims.schedule import plot_schedule
from psmpc_cli.figures.comparison.instants import plot_instants
from psmpc_cli.figures.comparison.names import title_of
from psmpc_cli.figures.comparison.snapshots import plot_snapshots
from psmpc_cli.figures.run import Run, load_run
from psmpc_cli.figures.states import plot_states
from psmpc_cli.report.claims import claim_table
from psmpc_cli.report.fronts import fronts_section
from psmpc_cli.report.html import Html, element, page
from psmpc_cli.report.images import NARROW, WIDE, Picture, embed
from psmpc_cli.report.making import how_made
from psmpc_cli.report.weights import weights_section
from psmpc_cli.simulation.summary import summarize
from psmpc_cli.studies.ablation import Ablation
from psmpc_cli.studies.claims import TimeClaim
from psmpc_cli.studies.reproduce import METHODS, JudgedClaim, Reproduction

PAPER = "Priority-Based Switching Model Predictive Control for Sequential Manipulation of Space Robot"

TITLE = "The paper's claims, published against reproduced"

HEADINGS = {"times": "When the stages end", "starts": "When the stages start", "mission": "How the mission ends"}


def build_report(reproduction: Reproduction, created: str) -> Html:
    """Return the report, made at a time as ISO 8601 has it."""
    runs = {name: load_run(log) for name, log in reproduction.logs.items()}
    return page(
        TITLE,
        element(
            "main",
            *_opening(reproduction),
            *_plain_section("The setting", "setting", reproduction),
            *(part for method in METHODS for part in _method(method, reproduction, runs[method])),
            *_plain_section("The methods against each other", "order", reproduction, _schedule(reproduction, runs)),
            *(embed(picture, WIDE) for picture in _comparison(runs)),
            *weights_section(reproduction),
            *fronts_section(reproduction),
            *_ablations(reproduction.ablations),
            *how_made(reproduction, created),
        ),
    )


def _opening(reproduction: Reproduction) -> Iterator[Html]:
    held, count = len(reproduction.judged) - len(reproduction.failing), len(reproduction.judged)
    earlier = sum(judged.finding.earlier for judged in reproduction.judged)
    excused = f", {earlier} of them with an earlier time than published and the mission accomplished" if earlier else ""
    yield element("h1", TITLE)
    yield element("p", f"The paper: {PAPER}. Its simulations, sections IV-B and IV-C, run again by psmpc.")
    yield element("p", element("strong", f"{held} of {count} claims hold{excused}."), class_="count")
    if reproduction.failing:
        yield element("p", "These do not; the cause stands with each below:")
        links = (
            element("li", element("a", judged.claim.id, href=f"#{judged.claim.id}"), f": {judged.claim.statement}")
            for judged in reproduction.failing
        )
        yield element("ul", *links)


def _plain_section(
    title: str, group: str, reproduction: Reproduction, picture: Picture | None = None
) -> Iterator[Html]:
    """Give a section of one topic."""
    yield element("h2", title)
    yield _topic(title, _of(reproduction, group), picture)


def _method(method: str, reproduction: Reproduction, run: Run) -> Iterator[Html]:
    """Give the section of a method: its topics, each with a figure beside it."""
    title = title_of(method)
    yield element("h2", title)
    claims = _of(reproduction, method)
    for topic, heading in HEADINGS.items():
        chosen = [judged for judged in claims if judged.claim.topic == topic]
        if chosen:
            yield element("h3", heading)
            yield _topic(f"{title}: {heading.lower()}", chosen, _picture(topic, title, run, chosen))


def _topic(caption: str, judged: Sequence[JudgedClaim], picture: Picture | None) -> Html:
    parts = [claim_table(caption, judged)] + ([] if picture is None else [embed(picture, NARROW)])
    return element("div", *parts, class_="topic" if picture is None else "topic beside")


def _of(reproduction: Reproduction, group: str) -> list[JudgedClaim]:
    return [judged for judged in reproduction.judged if judged.claim.group == group]


def _picture(topic: str, title: str, run: Run, judged: Sequence[JudgedClaim]) -> Picture:
    """Return the figure that stands beside the claims of a method on a topic."""
    if topic == "times":
        ends = ", ".join(f"{span.name} at {span.end:.1f} s" for span in run.spans)
        return Picture(
            partial(plot_states, run),
            f"{title}: base pose and joint angles over time; the stages end: {ends}.",
            f"{title}: base pose and joint angles.",
        )
    if topic == "starts":
        starts = {claim.moment.stage: claim.published for claim in _times(judged)}
        early = ", ".join(f"{span.name} at {span.early:.1f} s" for span in run.spans if span.early is not None)
        return Picture(
            partial(plot_presence, run, starts),
            f"{title}: control that waiting stages add, over time, and the threshold; early starts: {early or 'none'}.",
            f"{title}: what each waiting stage adds to the control. It starts where that reaches the threshold.",
        )
    monitors = summarize(run.log).monitors
    broken = ", ".join(f"{one.name} broke at {one.broken_at:.1f} s" for one in monitors if isfinite(one.broken_at))
    return Picture(
        partial(plot_monitors, run),
        f"{title}: what the monitors watch, over time, with their bounds; {broken or 'none broke'}.",
        f"{title}: what the monitors of the task watch.",
    )


def _times(judged: Sequence[JudgedClaim]) -> Iterator[TimeClaim]:
    for one in judged:
        if isinstance(one.claim, TimeClaim):
            yield one.claim


def _schedule(reproduction: Reproduction, runs: Mapping[str, Run]) -> Picture:
    published: dict[str, dict[str, float]] = {}
    for claim in _times(reproduction.judged):
        if claim.moment.event == "end":
            published.setdefault(claim.moment.run, {})[claim.moment.stage] = claim.published
    ends = "; ".join(f"{title_of(name)} after {run.end:.1f} s" for name, run in runs.items())
    return Picture(
        partial(plot_schedule, runs, published),
        f"The stages of all methods as bars along time, with published ends; the runs end: {ends}.",
        "All methods: bars are the stages as reproduced, triangles their ends as published.",
    )


def _comparison(runs: Mapping[str, Run]) -> Iterator[Picture]:
    yield Picture(
        partial(plot_instants, runs),
        "Optimized switching instants of all methods over time, stage by stage against the end that came true.",
        "Optimized switching instants (Fig. 11 of the paper).",
    )
    yield Picture(
        partial(plot_snapshots, runs),
        "The robot and the object at the end of every stage, a row for each method.",
        "The robot at the switching instants (Fig. 5 of the paper).",
    )


def _ablations(ablations: Sequence[Ablation]) -> Iterator[Html]:
    """Give the section on what becomes of the task without each departure from the paper, if that was asked for."""
    if not ablations:
        return
    yield element("h2", "What the departures from the paper are good for")
    for ablation in ablations:
        name = ablation.name.replace("_", " ")
        draw = partial(plot_ablation, ablation.name, ablation.panels)
        picture = Picture(draw, f"Ablation of the {name}: {ablation.sentence}", f"With and without the {name}.")
        yield element("h3", name.capitalize())
        said = element("p", ablation.sentence)
        yield element("div", said, embed(picture, NARROW), class_="topic beside")
