"""Priority-based switching model predictive control for space robots."""

from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import Any

try:
    __version__ = version("psmpc")
except PackageNotFoundError:  # run from a source tree that was never installed
    __version__ = "0+unknown"

PUBLIC = {
    "compare": "psmpc_cli.studies.compare",
    "monte_carlo": "psmpc_cli.studies.monte_carlo",
    "plot": "psmpc_cli.figures.registry",
    "sweep": "psmpc_cli.studies.sweep",
}
"""The public names and the modules they are imported from, when they are first used."""


def __getattr__(name: str) -> Any:
    """Import a public name.

    Raises:
        AttributeError: There is none.
    """
    if name not in PUBLIC:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}', expected one of {', '.join(PUBLIC)}")
    return getattr(import_module(PUBLIC[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *PUBLIC})
