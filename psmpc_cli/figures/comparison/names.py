"""How figures name controllers."""

from psmpc_cli.figures.style import readable

TITLES = {"psmpc": "PSMPC", "smpc": "SMPC", "htmpc": "HTMPC", "hard": "Hard switching"}


def title_of(controller: str) -> str:
    """Return the name of a controller as figures write it."""
    return TITLES.get(controller, readable(controller))
