"""Every figure of every kind: its file, and what a referee would ask of it."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import matplotlib as mpl
import pytest
from matplotlib.figure import Figure
from PIL import Image

import psmpc_cli as psmpc
from psmpc_cli.errors import InputError
from psmpc_cli.figures.registry import default_directory, draw, draw_file, figures_of
from psmpc_cli.figures.style import in_style
from psmpc_cli.logs.run import Run
from psmpc_cli.specs.load import Task

from .drawn import check_figure, common_legend

Load = Callable[..., Run]

BEGINNINGS = {"png": b"\x89PNG", "pdf": b"%PDF", "svg": b"<?xml"}

STORIES: dict[str, dict[str, Any]] = {
    "as usual": {},
    "object lost": {"early": {1: 6.4, 3: 19.0}},
    "three at once": {"early": {1: 4.0, 2: 7.0, 3: 19.0}},
    "killed": {"last": 8.0},
    "killed at once": {"last": 0.2},
    "noisy": {"blur": 0.1},
}


@pytest.mark.slow
@pytest.mark.parametrize("story", STORIES)
def test_every_figure_of_a_run_is_fit_to_print(story: str, load: Load) -> None:
    run = load(**STORIES[story])
    for figure in figures_of("run").values():
        with in_style():
            check_figure(figure.function(run))


@pytest.mark.slow
def test_figures_of_many_long_names_are_fit_to_print(load: Load, many_stages: dict[str, Any]) -> None:
    run = load(**many_stages)
    for kind, subject, names in (("run", run, ("controls", "instants")), ("comparison", {"a": run}, ("snapshots",))):
        for name in names:
            with in_style():
                check_figure(figures_of(kind)[name].function(subject))


@pytest.mark.slow
@pytest.mark.parametrize("compared", [("smpc", "hard"), ("psmpc", "smpc", "htmpc", "hard")])
def test_every_figure_of_a_comparison_is_fit_to_print(compared: tuple[str, ...], runs: Mapping[str, Run]) -> None:
    for figure in figures_of("comparison").values():
        with in_style():
            check_figure(figure.function({name: runs[name] for name in compared}))


def test_a_figure_is_plotted_by_name_in_its_own_style_whatever_the_user_s(
    run: Run, runs: Mapping[str, Run], tmp_path: Path
) -> None:
    with mpl.rc_context({"font.size": 30.0, "xtick.labelsize": 30.0}):
        figure = psmpc.plot(run, "states")
        figure.savefig(tmp_path / "states.png")
    assert isinstance(figure, Figure)
    assert max(label.get_fontsize() for axes in figure.axes for label in axes.get_xticklabels()) < 10
    assert "SMPC" in common_legend(psmpc.plot({"smpc": runs["smpc"]}, "instants"))
    with pytest.raises(InputError, match=r"no figure 'state', expected one of states, velocities, .*solve_time"):
        psmpc.plot(run, "state")


@pytest.mark.slow
def test_every_figure_of_a_run_is_written_by_name(tmp_path: Path, run: Run) -> None:
    files = draw("run", run, tmp_path / "new" / "folder")
    assert [path.name for path in files] == [f"{name}.png" for name in figures_of("run")]
    for path in files:
        with Image.open(path) as image:
            assert image.width == 1050


@pytest.mark.parametrize("ending", BEGINNINGS)
def test_a_format_is_what_it_says_and_the_same_each_time(tmp_path: Path, run: Run, ending: str) -> None:
    first, second = (draw("run", run, tmp_path / name, [ending], ["solve_time"]) for name in "ab")
    assert [path.name for path in first] == [f"solve_time.{ending}"]
    assert first[0].read_bytes() == second[0].read_bytes()
    assert first[0].read_bytes().startswith(BEGINNINGS[ending])


@pytest.mark.slow
def test_chosen_figures_come_once_and_in_order(tmp_path: Path, runs: Mapping[str, Run]) -> None:
    one = {"smpc": runs["smpc"]}
    files = draw("comparison", one, tmp_path, ["svg", "pdf", "svg"], ["instants", "states", "instants"])
    assert [path.name for path in files] == ["states.pdf", "states.svg", "instants.pdf", "instants.svg"]


def test_an_unknown_figure_or_format_lists_the_known_ones(tmp_path: Path, run: Run) -> None:
    with pytest.raises(InputError, match=r"no figure 'state', expected one of states, velocities, .*solve_time"):
        draw("run", run, tmp_path / "new", only=["states", "state"])
    with pytest.raises(InputError, match="no format 'jpg', expected one of png, pdf, svg"):
        draw("run", run, tmp_path / "new", ["png", "jpg"])
    assert not (tmp_path / "new").exists()


def test_nothing_is_overwritten_without_force(tmp_path: Path, run: Run) -> None:
    (tmp_path / "errors.png").write_text("mine")
    with pytest.raises(InputError, match=r"errors\.png exists already.*--force"):
        draw("run", run, tmp_path, only=["states", "errors"])
    assert [path.name for path in tmp_path.iterdir()] == ["errors.png"]
    assert (tmp_path / "errors.png").read_text() == "mine"
    draw("run", run, tmp_path, only=["errors"], force=True)
    assert (tmp_path / "errors.png").read_bytes().startswith(BEGINNINGS["png"])


def test_a_place_that_cannot_be_written_is_named(tmp_path: Path, run: Run) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="file cannot be made"):
        draw("run", run, tmp_path / "file")
    (tmp_path / "states.png").mkdir()
    with pytest.raises(InputError, match=r"states\.png cannot be written"):
        draw("run", run, tmp_path, only=["states"], force=True)


def test_a_scenario_is_drawn_into_the_file_that_is_named(transport: Task, tmp_path: Path) -> None:
    path = draw_file("scenario", transport, tmp_path / "new" / "mine.svg")
    assert path.read_bytes().startswith(BEGINNINGS["svg"])
    with pytest.raises(InputError, match="overwrite with --force"):
        draw_file("scenario", transport, path)


@pytest.mark.parametrize(
    ("log", "figures"), [("runs/transport.h5", "runs/transport"), ("runs/log", "runs/log_figures")]
)
def test_figures_go_beside_the_log_by_default(log: str, figures: str) -> None:
    assert default_directory(Path(log)) == Path(figures)
