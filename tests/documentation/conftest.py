"""The command line for the documented commands."""

from ..cli.conftest import psmpc

__all__ = ["psmpc"]
