"""The command itself; what the figures hold is tested with the figures."""

import shutil
from pathlib import Path

import h5py
import pytest
import typer
from typer.testing import CliRunner

from psmpc_cli.cli.plot import plot
from psmpc_cli.errors import InputError, LogError, PsmpcError

from ..figures.made_up import Story, write_story
from ..made_up_sweep import made_up_sweep


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_story(tmp_path_factory.mktemp("logs") / "transport.h5", Story(last=4.0))


def lines(*arguments: object) -> list[str]:
    """What the command writes; raises what it raises."""
    app = typer.Typer()
    app.command()(plot)
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    if isinstance(result.exception, PsmpcError):
        raise result.exception
    assert result.exit_code == 0, result.output
    return result.output.splitlines()


def test_figures_are_written_beside_the_log_and_listed(tmp_path: Path, log: Path) -> None:
    here = tmp_path / "transport.h5"
    shutil.copy(log, here)
    written = lines(here, "--only", "states", "--only", "errors")
    assert written == [str(tmp_path / "transport" / name) for name in ("states.png", "errors.png")]
    assert all(Path(path).is_file() for path in written)


def test_directory_and_formats_are_chosen(tmp_path: Path, log: Path) -> None:
    written = lines(log, "-o", tmp_path / "out", "--only", "instants", "--format", "svg", "--format", "pdf")
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["instants.pdf", "instants.svg"]
    assert len(written) == 2


def test_beside_figures_only_the_animation_is_drawn_and_what_an_mp4_lacks_is_said(
    tmp_path: Path, log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))  # no ffmpeg
    (tmp_path / "states.png").write_text("mine")
    animation, remark = lines(log, "-o", tmp_path, "--animate")
    assert animation == str(tmp_path / "animation.gif")
    assert "MP4" in remark and "ffmpeg" in remark
    assert (tmp_path / "animation.gif").read_bytes().startswith(b"GIF89a")
    assert (tmp_path / "states.png").read_text() == "mine"


def test_nothing_is_overwritten_without_force(tmp_path: Path, log: Path) -> None:
    arguments = (log, "-o", tmp_path, "--only", "states")
    lines(*arguments)
    with pytest.raises(InputError, match=r"states\.png already.*--force"):
        lines(*arguments)
    assert lines(*arguments, "--force") == [str(tmp_path / "states.png")]


@pytest.mark.parametrize(
    ("option", "value", "choices"),
    [("--only", "stats", "states, velocities, controls, .*solve_time"), ("--format", "jpg", "png, pdf, svg")],
)
def test_an_unknown_choice_lists_the_known(tmp_path: Path, log: Path, option: str, value: str, choices: str) -> None:
    with pytest.raises(InputError, match=f"'{value}', expected one of {choices}"):
        lines(log, "-o", tmp_path / "out", option, value)
    assert not (tmp_path / "out").exists()


def test_what_is_no_log_is_refused_by_name(tmp_path: Path, log: Path) -> None:
    text, empty, cut, foreign, newer = (tmp_path / name for name in ("t.txt", "e.h5", "c.h5", "f.h5", "n.h5"))
    text.write_text("no log")
    empty.write_bytes(b"")
    cut.write_bytes(log.read_bytes()[: log.stat().st_size // 2])
    with h5py.File(foreign, "w") as file:
        file["temperature"] = [1.0, 2.0]
    shutil.copy(log, newer)
    with h5py.File(newer, "a") as file:
        file.attrs["format_version"] = 99
    expected = {
        tmp_path / "missing.h5": "no such file",
        tmp_path: "directory",
        text: "no HDF5 file",
        empty: "empty file",
        cut: "cut off",
        foreign: "another program",
        newer: "log format 99",
    }
    for path, message in expected.items():
        with pytest.raises(LogError, match=message) as raised:
            lines(path)
        assert str(path) in str(raised.value)
    assert {path.name for path in tmp_path.iterdir()} == {"t.txt", "e.h5", "c.h5", "f.h5", "n.h5"}


def test_a_log_without_samples_is_refused(tmp_path: Path) -> None:
    path = write_story(tmp_path / "killed.h5", Story(last=-1.0))
    with pytest.raises(LogError, match="holds no sample"):
        lines(path)


def test_a_sweep_is_drawn_as_what_it_is(tmp_path: Path) -> None:
    path = tmp_path / "sweep.h5"
    made_up_sweep(path, "2x2")
    names = ("surface", "heat_map", "starts", "sensitivity")
    assert lines(path) == [str(tmp_path / "sweep" / f"{name}.png") for name in names]
    with pytest.raises(InputError, match="a sweep is not animated"):
        lines(path, "--animate")
