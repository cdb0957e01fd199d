"""Logs of short runs, for tests of what starts from a log."""

from pathlib import Path

from psmpc_cli.logs.run import Run, read_run
from psmpc_cli.logs.schema import Sample
from psmpc_cli.simulation.run import simulate
from psmpc_cli.specs.load import load_task

from ..there_and_back import TASK


def there_and_back(folder: Path, *changes: str, samples: int | None = None, name: str = "log", text: str = TASK) -> Run:
    """Return the log of a run there and back, or of another text, interrupted after so many samples."""
    task, path, told = folder / "task.yaml", folder / f"{name}.h5", []
    task.write_text(text)

    def watch(progress: Sample) -> None:
        told.append(progress)
        if len(told) == samples:
            raise KeyboardInterrupt

    simulate(load_task(task, changes), path, watch=watch)
    return read_run(path)
