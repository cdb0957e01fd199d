"""Priority-based switching model predictive control for space robots."""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("psmpc")
except PackageNotFoundError:  # run from a source tree that was never installed
    __version__ = "0+unknown"
