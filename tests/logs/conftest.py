"""Logs of made-up runs, and a comparison of them."""

import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from psmpc_cli.logs.comparison import save_comparison
from psmpc_cli.logs.conditions import LEVELS
from psmpc_cli.logs.write import LogWriter

from .synthetic_samples import FINAL, HEADER, LEAN, read_all, record


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A log with everything in it, a lean one, and one with levels; not in the order of the alphabet."""
    folder = tmp_path_factory.mktemp("logs")
    paths = {name: folder / f"{name}.h5" for name in ("smpc", "hard", "htmpc")}
    for path, header in zip(paths.values(), (HEADER, LEAN, replace(LEAN, has=LEAN.has | {LEVELS})), strict=True):
        with LogWriter(path, header) as log:
            for k in range(3):
                log.write(record(k))
            log.finish(True, "done", FINAL)
    return paths


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, logs: dict[str, Path]) -> Path:
    path = tmp_path_factory.mktemp("merged") / "runs" / "comparison.h5"
    save_comparison(read_all(logs), path)
    return path


@pytest.fixture
def merged(tmp_path: Path, made: Path) -> Path:
    (tmp_path / "runs").mkdir()
    return Path(shutil.copy(made, tmp_path / "runs"))
