"""Claims as tables of a page."""

import re
from collections.abc import Iterable, Sequence

from psmpc_cli.report.html import Html, element, joined
from psmpc_cli.studies.claim_table import HEADINGS, cells
from psmpc_cli.studies.findings import Finding
from psmpc_cli.studies.reproduce import JudgedClaim


def claim_table(caption: str, judged: Sequence[JudgedClaim]) -> Html:
    """Return claims as a table; the cause of one that does not hold stands in a row below it."""
    rows = [row for one in judged for row in _rows(one)]
    return table(caption, ("claim", *HEADINGS[1:]), rows, "claims")


def table(caption: str, headings: Iterable[str], rows: Iterable[Html], kind: str) -> Html:
    """Return a table of a class; its roles are named, for a narrow page lays it out as blocks."""
    head = (element("th", heading, scope="col", role="columnheader") for heading in headings)
    return element(
        "table",
        element("caption", caption),
        element("thead", element("tr", *head, role="row"), role="rowgroup"),
        element("tbody", *rows, role="rowgroup"),
        role="table",
        class_=kind,
    )


def row(head: Html, texts: Iterable[tuple[str, str]], kind: str = "", anchor: str = "", last: str = "") -> Html:
    """Return a row.

    Args:
        head: Content of its first cell, which names it.
        texts: Heading and text of the other cells.
        kind: Class of the row.
        anchor: Its id.
        last: Class of its last cell.
    """
    pairs = list(texts)
    classes = [""] * (len(pairs) - 1) + [last]
    made = [
        element("td", _unbroken(text), role="cell", data_label=heading, **({"class_": name} if name else {}))
        for (heading, text), name in zip(pairs, classes, strict=True)
    ]
    given = {key: value for key, value in {"class_": kind, "id": anchor}.items() if value}
    return element("tr", element("th", head, scope="row", role="rowheader"), *made, role="row", **given)


def verdict_in_words(finding: Finding) -> str:
    """Return whether a claim holds, with a sign."""
    if finding.earlier:
        return "✓ holds, earlier"
    return "✓ holds" if finding.holds else "✗ does not hold"


def points(texts: Iterable[str], kind: str) -> Html:
    """Return texts as a list of a class."""
    return element("ul", *(element("li", text) for text in texts), class_=kind)


def _unbroken(text: str) -> str:
    """Return a text whose numbers stay with their units."""
    return re.sub(r"(\d) (s)\b", "\\1\N{NO-BREAK SPACE}\\2", text)


def _rows(judged: JudgedClaim) -> Iterable[Html]:
    claim, finding = judged.claim, judged.finding
    kind = "holds" if finding.holds else "fails"
    head = joined(claim.statement, element("small", element("code", claim.id), f", {claim.source}"))
    texts = {**cells(judged), "holds": verdict_in_words(finding)}
    pairs = [(heading, texts[heading]) for heading in HEADINGS[1:]]
    yield row(head, pairs, f"{kind} reason" if finding.cause else kind, claim.id, "verdict")
    if finding.cause:
        why = element("td", points(finding.cause, "cause"), colspan=len(HEADINGS), role="cell")
        yield element("tr", why, class_=f"{kind} why", role="row")
