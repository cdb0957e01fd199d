"""How published values are marked."""

from typing import Any


def published_mark() -> dict[str, Any]:
    """Return the look of a mark at a published value."""
    return {"marker": "v", "color": "black", "markerfacecolor": "white", "markersize": 5.0, "linestyle": "none"}
