"""Priority-based switching model predictive control for space robots: docs/python.md shows this module by example."""

from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from psmpc_cli.errors import InputError, LogError, PsmpcError, RunError, SpecError

try:
    __version__ = version("psmpc")
except PackageNotFoundError:  # run from a source tree that was never installed
    __version__ = "0+unknown"

__all__ = [
    "Command",
    "Controller",
    "InputError",
    "LogError",
    "PsmpcError",
    "Run",
    "RunError",
    "SpecError",
    "State",
    "compare",
    "load_robot",
    "load_task",
    "monte_carlo",
    "plot",
    "read_run",
    "simulate",
    "sweep",
    "view",
]

_MODULES = {
    "Command": "control",
    "Controller": "control",
    "State": "control",
    "plot": "figures.registry",
    "Run": "logs.run",
    "read_run": "logs.run",
    "view": "report.view",
    "load_robot": "robot.model",
    "simulate": "simulation.run",
    "load_task": "specs.load",
    "compare": "studies.compare",
    "monte_carlo": "studies.monte_carlo",
    "sweep": "studies.sweep",
}
"""The modules from which public names are imported when they are first used: CasADi is not until then."""


def __getattr__(name: str) -> Any:
    """Import a public name.

    Raises:
        AttributeError: There is none.
    """
    if name not in _MODULES:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}', expected one of {', '.join(__all__)}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
