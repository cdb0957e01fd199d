"""The page of a reproduction as a parser sees it: it is well-formed XML as well."""

import base64
import io
import re
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import pytest
from PIL import Image

from psmpc_cli.paper.judge import Reproduction
from psmpc_cli.paper.page import report_reproduction

from .conftest import CREATED, HOSTILE

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def text(reproduction: Reproduction) -> str:
    return report_reproduction(reproduction, CREATED).html


@pytest.fixture(scope="module")
def page(text: str) -> Element:
    return ElementTree.fromstring(text)


def said(element: Element) -> str:
    """All text of an element."""
    return "".join(element.itertext())


def test_every_image_is_in_the_page_described_and_has_a_caption(page: Element) -> None:
    figures = list(page.iter("figure"))
    assert len(figures) == len(list(page.iter("img"))) == 18
    for figure in figures:
        (image,), (caption,) = figure.iter("img"), figure.iter("figcaption")
        kind, _, data = image.attrib["src"].partition(",")
        assert kind == "data:image/png;base64"
        with Image.open(io.BytesIO(base64.b64decode(data, validate=True))) as picture:
            picture.load()
            width, height = (int(image.attrib[side]) for side in ("width", "height"))
            assert picture.width / picture.height == pytest.approx(width / height, rel=0.01)
        assert image.attrib["alt"] == said(caption)
    assert len({said(figure).strip() for figure in figures}) == len(figures)


def test_nothing_comes_from_outside(text: str, page: Element) -> None:
    assert text.startswith("<!DOCTYPE html>")
    assert not [one.tag for one in page.iter() if one.tag in ("script", "link", "iframe", "object", "embed", "base")]
    identifiers = {one.attrib["id"] for one in page.iter() if "id" in one.attrib}
    assert all(one.attrib["href"].removeprefix("#") in identifiers for one in page.iter("a"))
    assert not any(key.startswith("on") for one in page.iter() for key in one.attrib)
    assert not re.search(r"http|@import|url\(", re.sub(r"base64,[A-Za-z0-9+/=]*", "", text))


def test_every_claim_stands_once_with_what_is_said_of_it(page: Element, reproduction: Reproduction) -> None:
    findings = reproduction.findings
    assert {(finding.holds, finding.earlier) for finding in findings} == {(True, True), (True, False), (False, False)}
    rows = list(page.iter("tr"))
    claims = {row.attrib["id"]: row for row in rows if "id" in row.attrib}
    assert set(claims) == {finding.claim.id for finding in findings}
    for finding in findings:
        row = claims[finding.claim.id]
        assert finding.claim.statement in said(row)
        assert ("searched settings" in said(row)) == (finding.claim.searched is not None)
        assert ("✗ does not hold" in said(row)) == (not finding.holds)
        assert ("✓ holds" in said(row)) == finding.holds
        after = said(rows[rows.index(row) + 1]) if finding.cause else ""
        assert all(point in after for point in finding.cause)


def test_text_is_escaped(text: str, page: Element) -> None:
    assert "alert(1)" in text
    assert "<script" not in text
    (command,) = (one for one in page.iter("code") if said(one).startswith("psmpc reproduce"))
    assert HOSTILE.split("'")[0] in said(command)


def test_it_says_how_it_was_made_and_nothing_of_the_machine(page: Element, reproduction: Reproduction) -> None:
    facts = {said(term): said(value) for term, value in zip(page.iter("dt"), page.iter("dd"), strict=True)}
    assert facts["date"] == CREATED
    assert "CasADi 3.8" in facts["versions"]
    assert facts["task digest, SMPC"] == reproduction.runs["smpc"].task.digest
    assert all(str(run.path.parent) not in said(page) for run in reproduction.runs.values())
