"""Priority-based switching model predictive control for space robots: docs/python.md shows this module by example."""

from importlib import import_module

from psmpc_cli.errors import InputError, LogError, PsmpcError, RunError, SpecError

_MODULES = {
    "Command": "control",
    "Controller": "control",
    "State": "control",
    "plot": "figures.registry",
    "load_task": "ocp.feasibility.checks",
    "Ticks": "plant",
    "Run": "logs.run",
    "read_run": "logs.run",
    "view": "report.view",
    "load_robot": "robot.model",
    "Recorder": "simulation.recorder",
    "simulate": "simulation.run",
    "compare": "studies.compare",
    "monte_carlo": "studies.monte_carlo",
    "sweep": "studies.sweep",
}
"""The modules from which public names are imported when they are first used: CasADi is not until then."""

__all__ = ["InputError", "LogError", "PsmpcError", "RunError", "SpecError", *_MODULES]


def __getattr__(name: str) -> object:
    """Import a public name, or look up `__version__`.

    Raises:
        AttributeError: There is none.
    """
    if name == "__version__":
        from importlib.metadata import PackageNotFoundError, version

        try:
            return version("psmpc")
        except PackageNotFoundError:  # run from a source tree that was never installed
            return "0+unknown"
    if name not in _MODULES:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}', expected one of {', '.join(__all__)}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
