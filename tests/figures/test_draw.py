from collections.abc import Callable
from pathlib import Path

import pytest
from PIL import Image

from psmpc_cli.errors import InputError, LogError
from psmpc_cli.figures.draw import default_directory, draw
from psmpc_cli.figures.registry import FIGURES
from psmpc_cli.logs.read import Log, read_log

BEGINNINGS = {"png": b"\x89PNG", "pdf": b"%PDF", "svg": b"<?xml"}


def test_every_figure_is_written_by_name(tmp_path: Path, log: Log) -> None:
    files = draw(log, tmp_path / "new" / "folder")
    assert [path.name for path in files] == [f"{name}.png" for name in FIGURES]
    for path in files:
        with Image.open(path) as image:
            assert image.width == (2148 if image.width > 1050 else 1050)


@pytest.mark.parametrize("ending", BEGINNINGS)
def test_a_format_is_what_it_says(tmp_path: Path, log: Log, ending: str) -> None:
    (path,) = draw(log, tmp_path, [ending], ["states"])
    assert path.name == f"states.{ending}"
    assert path.read_bytes().startswith(BEGINNINGS[ending])


def test_chosen_figures_come_once_and_in_order(tmp_path: Path, log: Log) -> None:
    files = draw(log, tmp_path, ["svg", "png", "svg"], ["errors", "states", "errors"])
    assert [path.name for path in files] == ["states.png", "states.svg", "errors.png", "errors.svg"]


@pytest.mark.parametrize("ending", BEGINNINGS)
def test_the_same_log_gives_the_same_file(tmp_path: Path, log: Log, ending: str) -> None:
    (first,) = draw(log, tmp_path / "1", [ending], ["solve_time"])
    (second,) = draw(log, tmp_path / "2", [ending], ["solve_time"])
    assert first.read_bytes() == second.read_bytes()


def test_an_unknown_figure_lists_the_known_ones(tmp_path: Path, log: Log) -> None:
    with pytest.raises(InputError, match=r"no figure 'state', expected one of states, velocities, .*solve_time"):
        draw(log, tmp_path, only=["states", "state"])
    assert not any(tmp_path.iterdir())


def test_an_unknown_format_lists_the_known_ones(tmp_path: Path, log: Log) -> None:
    with pytest.raises(InputError, match="no format 'jpg', expected one of png, pdf, svg"):
        draw(log, tmp_path, ["png", "jpg"])


def test_nothing_is_overwritten_unasked(tmp_path: Path, log: Log) -> None:
    (tmp_path / "errors.png").write_text("mine")
    with pytest.raises(InputError, match=r"holds errors\.png already.*--force"):
        draw(log, tmp_path, only=["states", "errors"])
    assert [path.name for path in tmp_path.iterdir()] == ["errors.png"]
    assert (tmp_path / "errors.png").read_text() == "mine"


def test_force_overwrites(tmp_path: Path, log: Log) -> None:
    (tmp_path / "errors.png").write_text("mine")
    draw(log, tmp_path, only=["errors"], force=True)
    assert (tmp_path / "errors.png").read_bytes().startswith(BEGINNINGS["png"])


def test_an_existing_animation_stops_the_figures_as_well(tmp_path: Path, log: Log) -> None:
    (tmp_path / "animation.gif").write_text("mine")
    with pytest.raises(InputError, match=r"animation\.gif already"):
        draw(log, tmp_path, only=["states"], animate=True)
    assert [path.name for path in tmp_path.iterdir()] == ["animation.gif"]


def test_a_file_in_place_of_the_directory_is_refused(tmp_path: Path, log: Log) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be made"):
        draw(log, tmp_path / "file")


def test_a_directory_in_place_of_a_file_is_refused(tmp_path: Path, log: Log) -> None:
    (tmp_path / "states.png").mkdir()
    with pytest.raises(InputError, match="cannot be written"):
        draw(log, tmp_path, only=["states"], force=True)


def test_nothing_is_made_for_a_log_without_samples(tmp_path: Path, write_log: Callable[..., Path]) -> None:
    log = read_log(write_log(tmp_path / "run.h5", last=-1.0))
    with pytest.raises(LogError, match="holds no sample"):
        draw(log, tmp_path / "figures")
    assert not (tmp_path / "figures").exists()


@pytest.mark.parametrize(
    ("log", "figures"), [("runs/transport.h5", "runs/transport"), ("runs/log", "runs/log_figures")]
)
def test_figures_go_beside_the_log_by_default(log: str, figures: str) -> None:
    assert default_directory(Path(log)) == Path(figures)
