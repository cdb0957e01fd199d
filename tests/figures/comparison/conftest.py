from collections.abc import Mapping
from pathlib import Path

import pytest

from psmpc_cli.figures.run import Run, load_run
from psmpc_cli.logs.read import read_log

from ..made_up import Story, write_story

STORIES = {
    "psmpc": Story(attributes={"controller": "psmpc"}),
    "smpc": Story(attributes={"controller": "smpc"}, ends=(10.2, 14.8, 24.8, 29.0), early={1: 8.0, 3: 20.0}),
    "htmpc": Story(attributes={"controller": "htmpc"}, ends=(10.4, 19.2, 29.2, 35.6), early={}),
    "hard": Story(attributes={"controller": "hard"}, ends=(10.4, 19.0, 29.0, 36.0), early={}, last=24.0),
}
"""In the second the object is lost, the last was stopped in its third stage."""


@pytest.fixture(scope="session")
def paths(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The logs of four controllers on one task."""
    directory = tmp_path_factory.mktemp("comparison")
    return {name: write_story(directory / f"{name}.h5", story) for name, story in STORIES.items()}


@pytest.fixture(scope="session")
def runs(paths: dict[str, Path]) -> Mapping[str, Run]:
    return {name: load_run(read_log(path)) for name, path in paths.items()}
