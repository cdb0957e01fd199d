"""Runs variants of a task in parallel processes, one thread each."""

import logging
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from psmpc_cli.logs.schema import Sample
from psmpc_cli.simulation.run import simulate
from psmpc_cli.specs.load import Task
from psmpc_cli.studies.parallel import LocalCalls


@dataclass(frozen=True)
class Variant:
    """One run of a study: its name, its task, and where its log goes."""

    name: str
    task: Task
    path: Path


def run_variants(
    variants: Mapping[str, Task],
    directory: Path,
    jobs: int | None = None,
    done: Callable[[str], None] = lambda name: None,
) -> dict[str, Path]:
    """Run every variant into a log of its own below `directory` and return the logs by name.

    Args:
        variants: Tasks by name.
        directory: Where the logs go; existing ones of the same name are overwritten.
        jobs: Processes at once; default as many as there are cores.
        done: Told the name of each variant as it ends.

    Raises:
        RunError: A log could not be written, or processes are ended from outside again and again.
    """
    paths = log_paths(variants, directory.absolute())  # processes kept from before may stand elsewhere
    chosen = [Variant(name, task, paths[name]) for name, task in variants.items()]
    for _, name in LocalCalls(jobs).each(_run, chosen):
        done(name)
    return paths


def log_paths(names: Iterable[str], directory: Path) -> dict[str, Path]:
    """Return by name where the logs of variants go."""
    return {name: directory / f"{number}.h5" for number, name in enumerate(names)}


def simulated_times(paths: Mapping[str, Path]) -> dict[str, float]:
    """Return how far each run has come [s]; those that have not begun are left out."""
    notes = {name: _note(path) for name, path in paths.items()}
    return {name: float(text) for name, note in notes.items() if note.exists() and (text := note.read_text())}


def _run(variant: Variant) -> str:
    """Run one variant, in a process of its own as a rule; its warnings are counted in its log, and said there."""
    package, note = logging.getLogger("psmpc_cli"), _note(variant.path)
    level = package.level

    def watch(sample: Sample) -> None:
        note.write_text(f"{sample.command.time:.3f}")

    package.setLevel(logging.ERROR)
    try:
        simulate(variant.task, variant.path, watch, force=True)
    finally:
        package.setLevel(level)
    return variant.name


def _note(path: Path) -> Path:
    """Return where a run notes how far it has come, beside its log."""
    return path.with_suffix(".time")
