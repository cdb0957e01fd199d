"""The log of a run of the small task, with its plans."""

from pathlib import Path

from psmpc_cli.simulation.run import simulate
from psmpc_cli.specs.load import load_task

from ..there_and_back import TASK


def run_there_and_back(directory: Path, *changes: str) -> Path:
    """Run the task and return its log."""
    (directory / "task.yaml").write_text(TASK)
    loaded = load_task(directory / "task.yaml", ["log.plans=true", "log.shares=false", *changes])
    simulate(loaded, directory / "run.h5")
    return directory / "run.h5"
