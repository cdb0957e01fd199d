"""The section on the Pareto fronts of two stages: the claims of Fig. 7 of the paper with the figure of the study."""

from collections.abc import Iterator
from functools import partial

from psmpc_cli.figures.pareto import plot_fronts
from psmpc_cli.logs.results import Results
from psmpc_cli.report.claims import claim_table, row, table
from psmpc_cli.report.html import Html, element
from psmpc_cli.report.images import NARROW, Picture, embed
from psmpc_cli.studies.front_claims import FRONTS
from psmpc_cli.studies.front_movement import front_movement
from psmpc_cli.studies.front_table import HEADINGS, NOTE, FrontRow, front_rows, front_texts
from psmpc_cli.studies.reproduce import Reproduction

TITLE = "The Pareto fronts"


def fronts_section(reproduction: Reproduction) -> Iterator[Html]:
    """Give the section, if the claims were judged: they, what was found at every sample, and the figure."""
    judged = [one for one in reproduction.judged if one.claim.group == FRONTS]
    if not judged:
        return
    yield element("h2", TITLE)
    claims, results = claim_table(TITLE, judged), reproduction.fronts
    if results is None:
        yield claims
        return
    rows = front_rows(results)
    shown = [embed(_picture(results), NARROW)] if any(one.failed < one.points for one in rows) else []
    yield element("div", claims, *shown, class_="topic beside")
    yield element("p", _came_to(results, rows))
    yield table("What was found at every sample", HEADINGS, map(_row, rows), "runs")
    yield element("p", f"{NOTE}.")


def _came_to(results: Results, rows: tuple[FrontRow, ...]) -> str:
    first, second = results["stage"]
    count, failed, dominated = (sum(getattr(one, name) for one in rows) for name in ("points", "failed", "dominated"))
    return (
        f"The weights of {first} and {second} were varied in {len(rows)} windows of the PSMPC run that hold both "
        f"alone, the instant held where the run has it: {count} points, of which {failed} could not be solved for and "
        f"{dominated} are dominated."
    )


def _row(one: FrontRow) -> Html:
    head, *texts = front_texts(one)
    return row(Html(head), zip(HEADINGS[1:], texts, strict=True))


def _picture(results: Results) -> Picture:
    caption = "The Pareto fronts at several samples (Fig. 7 of the paper)."
    return Picture(
        partial(plot_fronts, results), f"{caption} In short: {front_movement(results).said_of_ratio}.", caption
    )
