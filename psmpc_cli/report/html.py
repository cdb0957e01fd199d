"""HTML from elements: everything is escaped that is not an element already."""

from base64 import b64encode
from html import escape
from importlib.resources import files

VOID = frozenset({"br", "hr", "img", "meta"})
"""Elements without content and closing tag."""

Attribute = str | int


class Html(str):
    """Text that is HTML already."""

    __slots__ = ()


def element(name: str, /, *content: str, **attributes: Attribute) -> Html:
    """Return an element.

    Args:
        name: Its tag.
        content: Elements, and texts, which are escaped.
        attributes: Its attributes; `_` in a name stands for `-`, and one at its end is dropped, as in `class_`.
    """
    written = "".join(
        f' {key.removesuffix("_").replace("_", "-")}="{escape(str(value))}"' for key, value in attributes.items()
    )
    opening = f"<{name}{written}>"
    return Html(opening) if name in VOID else Html(f"{opening}{joined(*content)}</{name}>")


def joined(*content: str) -> Html:
    """Return elements and escaped texts one after another."""
    return Html("".join(part if isinstance(part, Html) else escape(part) for part in content))


def image(png: bytes, alt: str, width: int, height: int) -> Html:
    """Return a PNG image inside the page, of a size [px] that keeps its room while the page loads."""
    source = f"data:image/png;base64,{b64encode(png).decode('ascii')}"
    return element("img", src=source, alt=alt, width=width, height=height)


def page(title: str, *content: str) -> Html:
    """Return a whole page in the house's style, which needs nothing from outside."""
    style = files("psmpc_cli.report").joinpath("page.css").read_text(encoding="utf-8")
    head = element(
        "head",
        element("meta", charset="utf-8"),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("title", title),
        element("style", Html(style)),
    )
    return joined(Html("<!DOCTYPE html>\n"), element("html", head, element("body", *content), lang="en"), "\n")
