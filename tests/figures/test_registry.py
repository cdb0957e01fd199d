"""Every figure of every kind: its file, and what a referee would ask of it."""

import re
from collections.abc import Callable, Mapping
from pathlib import Path

import matplotlib as mpl
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text

import psmpc_cli as psmpc
from psmpc_cli.errors import InputError
from psmpc_cli.figures.registry import default_directory, draw, draw_file, figures_of, plot
from psmpc_cli.logs.run import Run, read_run
from psmpc_cli.specs.library import find
from psmpc_cli.specs.load import Task

from ..limited_disk import files_of_at_most
from ..synthetic_logs import Story, story_among_obstacles, write_story

Load = Callable[..., Run]


BEGINNINGS = {"png": b"\x89PNG", "pdf": b"%PDF", "svg": b"<?xml"}


def test_a_figure_is_plotted_by_name_in_its_own_style_whatever_the_user_s(
    run: Run, runs: Mapping[str, Run], tmp_path: Path
) -> None:
    with mpl.rc_context({"font.size": 30.0, "xtick.labelsize": 30.0}):
        figure = psmpc.plot(run, "states")
        figure.savefig(tmp_path / "states.png")
    assert isinstance(figure, Figure)
    assert max(label.get_fontsize() for axes in figure.axes for label in axes.get_xticklabels()) < 10
    assert psmpc.plot({"smpc": runs["smpc"]}, "instants").axes[0].get_title() == "SMPC"
    with pytest.raises(InputError, match=r"no figure 'state', expected one of snapshots, instants, .*solve_time"):
        psmpc.plot(run, "state")


@pytest.mark.parametrize("ending", BEGINNINGS)
def test_a_format_is_what_it_says_and_the_same_each_time(tmp_path: Path, run: Run, ending: str) -> None:
    first, second = (draw("run", run, tmp_path / name, [ending], ["solve_time"]) for name in "ab")
    assert [path.name for path in first] == [f"solve_time.{ending}"]
    assert first[0].read_bytes() == second[0].read_bytes()
    assert first[0].read_bytes().startswith(BEGINNINGS[ending])


def test_an_unknown_figure_or_format_lists_the_known_ones(tmp_path: Path, run: Run) -> None:
    with pytest.raises(InputError, match=r"no figure 'state', expected one of snapshots, instants, .*solve_time"):
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
    with pytest.raises(InputError, match="found a text file, expected a PNG image"):
        draw("run", run, tmp_path, only=["errors"], force=True)
    (tmp_path / "errors.png").write_bytes(b"\x89PNG\r\n\x1a\n of an earlier command")
    draw("run", run, tmp_path, only=["errors"], force=True)
    assert (tmp_path / "errors.png").read_bytes().startswith(BEGINNINGS["png"])


def test_a_place_that_cannot_be_written_is_named(tmp_path: Path, run: Run) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="file is no directory"):
        draw("run", run, tmp_path / "file")
    (tmp_path / "states.png").mkdir()
    with pytest.raises(InputError, match=r"states\.png is a directory"):
        draw("run", run, tmp_path, only=["states"], force=True)


def test_a_figure_is_written_whole_or_not_at_all(tmp_path: Path, run: Run) -> None:
    with files_of_at_most(1000), pytest.raises(InputError, match=r"states\.svg cannot be written: File too large"):
        draw("run", run, tmp_path / "figures", ["svg"], only=["states"])
    assert list((tmp_path / "figures").iterdir()) == []


def test_a_scenario_is_drawn_into_the_file_that_is_named(transport: Task, tmp_path: Path) -> None:
    path = draw_file("scenario", transport, tmp_path / "new" / "mine.svg")
    assert path.read_bytes().startswith(BEGINNINGS["svg"])
    with pytest.raises(InputError, match="overwrite it with --force"):
        draw_file("scenario", transport, path)


@pytest.mark.parametrize(
    ("log", "figures"), [("runs/transport.h5", "runs/transport"), ("runs/log", "runs/log_figures")]
)
def test_figures_go_beside_the_log_by_default(log: str, figures: str) -> None:
    assert default_directory(Path(log)) == Path(figures)


def strange_story() -> Story:
    """A run past obstacles whose names of task, stages, arms and obstacles Matplotlib cannot read as formulas."""
    story = story_among_obstacles()
    names = {"approach": "$a_1^$", "arm_1": "$b_2^$", "ball": "$c_3^$"}

    def renamed(text: str) -> str:
        for old, new in names.items():
            text = re.sub(rf"\b{old}\b", new, text)
        return text

    distances = {renamed(name): values for name, values in story["distances"].items()}
    robot = renamed(find("robot", "planar_dual_arm").read_text())
    task = f"name: $t_4^$\n{renamed(story['task'])}"
    return Story(task=task, robot=robot, distances=distances)


@pytest.mark.slow
def test_names_are_no_formulas_in_any_figure(tmp_path: Path) -> None:
    run = read_run(write_story(tmp_path / "log.h5", strange_story()))
    assert "$b_2^$" in run.task.robot.parts
    for kind, subject in (("run", run), ("comparison", {"psmpc": run, "$d^$": run}), ("scenario", run.task)):
        paths = draw(kind, subject, tmp_path / kind, formats=("svg",))
        assert len(paths) == len(figures_of(kind, subject))
    draw("robot", run.task.robot, tmp_path / "robot")


def test_a_name_is_no_formula_in_a_figure(tmp_path: Path) -> None:
    run = read_run(write_story(tmp_path / "log.h5", strange_story()))
    legend = plot(run, "clearance")
    texts = [text.get_text() for text in legend.findobj(Text)]
    assert any(r"\$c 3^\$" in text for text in texts)
