"""The page as a parser sees it."""

import base64
import io
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from html.parser import HTMLParser
from itertools import pairwise

import pytest
from PIL import Image

from psmpc_cli.report.reproduction import build_report
from psmpc_cli.studies.judge import Reproduction

from .conftest import CREATED, HOSTILE

pytestmark = pytest.mark.slow

VOID = ("img", "meta")
"""Elements without content and closing tag."""


@dataclass
class Node:
    tag: str
    attributes: dict[str, str]
    children: "list[Node | str]" = field(default_factory=list)

    def all(self, *tags: str) -> "Iterator[Node]":
        """Every element of these tags below, in the order of the page."""
        for child in self.children:
            if isinstance(child, Node):
                if child.tag in tags:
                    yield child
                yield from child.all(*tags)

    @property
    def text(self) -> str:
        return "".join(child if isinstance(child, str) else child.text for child in self.children)


class Tree(HTMLParser):
    """Builds the tree of a page and refuses what is not closed as it was opened."""

    def __init__(self) -> None:
        super().__init__(convert_charrefs=True)
        self.root = Node("", {})
        self._open = [self.root]

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        assert len({key for key, _ in attrs}) == len(attrs), f"an attribute twice on {tag}"
        node = Node(tag, {key: value or "" for key, value in attrs})
        self._open[-1].children.append(node)
        if tag not in VOID:
            self._open.append(node)

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop().tag == tag

    def handle_data(self, data: str) -> None:
        self._open[-1].children.append(data)

    def close(self) -> None:
        super().close()
        assert self._open == [self.root]


def parse(text: str) -> Node:
    tree = Tree()
    tree.feed(text)
    tree.close()
    return tree.root


@pytest.fixture(scope="module")
def text(reproduction: Reproduction) -> str:
    return build_report(reproduction, CREATED)


@pytest.fixture(scope="module")
def tree(text: str) -> Node:
    return parse(text)


def test_the_page_is_whole(text: str, tree: Node) -> None:
    assert text.startswith("<!DOCTYPE html>")
    (html,) = tree.all("html")
    assert html.attributes["lang"] == "en"
    assert next(tree.all("title")).text
    assert [meta.attributes.get("charset") for meta in tree.all("meta")] == ["utf-8", None]
    assert len(list(tree.all("main"))) == len(list(tree.all("h1"))) == 1


def test_every_image_is_in_the_page_and_described(tree: Node) -> None:
    images = list(tree.all("img"))
    assert len(images) == 16
    for image in images:
        kind, _, data = image.attributes["src"].partition(",")
        assert kind == "data:image/png;base64"
        with Image.open(io.BytesIO(base64.b64decode(data, validate=True))) as picture:
            picture.load()
            assert picture.format == "PNG"
            width, height = (int(image.attributes[side]) for side in ("width", "height"))
            assert picture.width / picture.height == pytest.approx(width / height, rel=0.01)
        assert len(image.attributes["alt"]) > 20
    assert len({image.attributes["alt"] for image in images}) == len(images)


def test_every_figure_has_a_caption(tree: Node) -> None:
    assert all(
        len(list(figure.all("figcaption"))) == len(list(figure.all("img"))) == 1 for figure in tree.all("figure")
    )


def test_nothing_comes_from_outside(text: str, tree: Node) -> None:
    assert not list(tree.all("script", "link", "iframe", "object", "embed", "base"))
    (style,) = tree.all("style")
    assert not re.search(r"@import|url\(|//", style.text)
    identifiers = {node.attributes["id"] for node in everything(tree) if "id" in node.attributes}
    for node in everything(tree):
        for key, value in node.attributes.items():
            assert not key.startswith("on")
            assert not re.match(r"\s*(https?:|file:|//)", value)
            if key == "href":
                assert value.startswith("#")
                assert value[1:] in identifiers
    assert "http" not in re.sub(r"base64,[A-Za-z0-9+/=]*", "", text)


def everything(tree: Node) -> Iterator[Node]:
    for child in tree.children:
        if isinstance(child, Node):
            yield child
            yield from everything(child)


def test_headings_go_down_one_level_at_a_time(tree: Node) -> None:
    levels = [int(heading.tag[1]) for heading in tree.all("h1", "h2", "h3", "h4")]
    assert levels[0] == 1
    assert all(after - before <= 1 for before, after in pairwise(levels))
    assert all(heading.text.strip() for heading in tree.all("h1", "h2", "h3"))


def test_every_claim_stands_once_with_what_is_said_of_it(tree: Node, reproduction: Reproduction) -> None:
    rows = {row.attributes["id"]: row for row in tree.all("tr") if "id" in row.attributes}
    assert set(rows) == {finding.claim.id for finding in reproduction.findings}
    for finding in reproduction.findings:
        row = rows[finding.claim.id]
        assert finding.claim.statement in row.text
        assert ("does not hold" in row.text) == (not finding.holds)
        assert all(point in row_after(tree, row).text for point in finding.cause)


def row_after(tree: Node, row: Node) -> Node:
    rows = list(tree.all("tr"))
    return rows[rows.index(row) + 1]


def test_claims_of_every_kind_are_in_the_sample(reproduction: Reproduction) -> None:
    findings = reproduction.findings
    assert any(finding.earlier for finding in findings)
    assert any(finding.holds and not finding.earlier for finding in findings)
    assert any(not finding.holds for finding in findings)


def test_tables_name_their_rows_and_columns(tree: Node) -> None:
    tables = list(tree.all("table"))
    assert tables
    for table in tables:
        assert next(table.all("caption")).text
        (head,) = table.all("thead")
        headings = list(head.all("th"))
        assert all(heading.attributes["scope"] == "col" and heading.text for heading in headings)
        for row in next(table.all("tbody")).all("tr"):
            named, cells = list(row.all("th")), list(row.all("td"))
            assert [cell.attributes["scope"] for cell in named] == ["row"] * len(named)
            assert len(named) + sum(int(cell.attributes.get("colspan", 1)) for cell in cells) == len(headings)


def test_whether_a_claim_holds_is_not_said_by_colour_alone(tree: Node) -> None:
    for cell in tree.all("td"):
        if "verdict" in cell.attributes.get("class", ""):
            assert cell.text.startswith(("✓ holds", "✗ does not hold"))


def test_text_is_escaped(text: str, tree: Node) -> None:
    assert "alert(1)" in text
    assert "<script" not in text
    (command,) = (node for node in tree.all("code") if node.text.startswith("psmpc reproduce"))
    assert HOSTILE.split("'")[0] in command.text


def test_it_says_how_it_was_made_and_nothing_of_the_machine(tree: Node, reproduction: Reproduction) -> None:
    facts = {term.text: value.text for term, value in zip(tree.all("dt"), tree.all("dd"), strict=True)}
    assert facts["date"] == CREATED
    assert "CasADi 3.8" in facts["versions"]
    assert facts["task digest, SMPC"] == "smpc" * 8
    assert all(str(log.path.parent) not in tree.text for log in reproduction.runs.values())
