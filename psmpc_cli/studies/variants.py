"""Runs variants of a task in parallel processes, one thread each."""

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from joblib import Parallel, delayed

from psmpc_cli.experiment.run import run
from psmpc_cli.specs.load import LoadedTask


@dataclass(frozen=True)
class Variant:
    """One run of a study: its name, its task, and where its log goes."""

    name: str
    task: LoadedTask
    path: Path


def run_variants(
    variants: Mapping[str, LoadedTask],
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
    """
    chosen = [Variant(name, task, directory / f"{number}.h5") for number, (name, task) in enumerate(variants.items())]
    workers = Parallel(n_jobs=jobs or os.cpu_count() or 1, backend="loky", return_as="generator_unordered")
    for name in workers(delayed(_run)(variant) for variant in chosen):
        done(name)
    return {variant.name: variant.path for variant in chosen}


def _run(variant: Variant) -> str:
    run(variant.task, variant.path, force=True)
    return variant.name
