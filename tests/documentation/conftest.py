"""The command line for the documented commands."""

from ..cli.conftest import coarse_figures, psmpc

__all__ = ["coarse_figures", "psmpc"]
