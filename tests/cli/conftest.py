"""The command line, a small task and logs of it, for every command's tests."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from psmpc_cli.figures import style
from psmpc_cli.report import pages

from ..short_runs import TASK, there_and_back
from .command import Psmpc, command_line


@pytest.fixture(scope="module", autouse=True)
def coarse_figures() -> Iterator[None]:
    """Draw figures with few dots: what they show is for the tests of figures."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pages, "DPI", 20)
        patch.setitem(style.STYLE, "savefig.dpi", 20)
        yield


@pytest.fixture
def psmpc(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Psmpc:
    """The command line in this process, in a folder of the test's own that holds task.yaml."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "task.yaml").write_text(TASK)
    return command_line(monkeypatch, capsys)


@pytest.fixture(scope="session")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the logs of a run that ended and of one that was interrupted after six samples."""
    folder = tmp_path_factory.mktemp("logs")
    there_and_back(folder, name="ended")
    there_and_back(folder, samples=6, name="part")
    return folder


@pytest.fixture
def ended(logs: Path, tmp_path: Path) -> Path:
    """The log of a run, in the folder of the test."""
    return Path(shutil.copy(logs / "ended.h5", tmp_path))


@pytest.fixture
def part(logs: Path, tmp_path: Path) -> Path:
    """The log of a run that was interrupted after six samples, in the folder of the test."""
    return Path(shutil.copy(logs / "part.h5", tmp_path))
