from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from psmpc_cli.errors import InputError
from psmpc_cli.figures.comparison.draw import draw_comparison
from psmpc_cli.figures.comparison.instants import plot_instants
from psmpc_cli.figures.comparison.registry import FIGURES
from psmpc_cli.figures.comparison.shares import plot_shares
from psmpc_cli.figures.comparison.snapshots import plot_snapshots
from psmpc_cli.figures.comparison.states import plot_states
from psmpc_cli.figures.run import Run
from psmpc_cli.figures.style import in_style
from psmpc_cli.logs.read import Log, read_log

from ..drawn import common_legend, points
from ..fit_to_print import check_figure

Runs = Mapping[str, Run]


@pytest.fixture(scope="module")
def logs(paths: dict[str, Path]) -> dict[str, Log]:
    return {name: read_log(path) for name, path in paths.items()}


@pytest.mark.parametrize("name", FIGURES)
@pytest.mark.parametrize("compared", [("psmpc", "smpc", "htmpc", "hard"), ("psmpc", "hard"), ("smpc",)])
def test_a_figure_is_fit_to_print(name: str, compared: tuple[str, ...], runs: Runs) -> None:
    with in_style():
        check_figure(FIGURES[name]({controller: runs[controller] for controller in compared}))


@pytest.mark.parametrize("name", ["instants", "snapshots"])
def test_a_figure_of_many_long_names_is_fit_to_print(
    name: str, load: Callable[..., Run], many_stages: dict[str, Any]
) -> None:
    runs = {controller: load(f"{controller}.h5", **many_stages) for controller in ("psmpc", "smpc")}
    with in_style():
        check_figure(FIGURES[name](runs))


def columns(figure: Figure, runs: Runs) -> list[list[Axes]]:
    """The panels below each other, by controller, the strip first."""
    axes = np.array(figure.axes).reshape(-1, len(runs))
    return axes.T.tolist()


def test_shares_in_the_control_have_a_row_only_where_they_were_logged(
    runs: Runs, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = len(columns(plot_shares(runs), runs)[0])
    for run in runs.values():
        monkeypatch.setitem(run.log.columns, "window/share", np.full_like(run.log["window/share"], np.nan))
    assert len(columns(plot_shares(runs), runs)[0]) == rows - 1


def test_a_column_holds_its_controllers_states(runs: Runs) -> None:
    figure = plot_states(runs)
    found = columns(figure, runs)
    assert [column[0].get_title() for column in found] == ["PSMPC", "SMPC", "HTMPC", "Hard switching"]
    for column, run in zip(found, runs.values(), strict=True):
        drawn = [points(line) for axes in column[1:] for line in axes.lines if len(points(line)) > 2]
        assert len(drawn) == run.Q.shape[1]
        for line, Q in zip(drawn, run.Q.T, strict=True):
            np.testing.assert_allclose(line, np.column_stack([run.time, Q]))


def test_all_columns_share_their_axes(runs: Runs) -> None:
    found = columns(plot_states(runs), runs)
    assert len({axes.get_xlim() for column in found for axes in column}) == 1
    for row in zip(*found, strict=True):
        assert len({axes.get_ylim() for axes in row}) == 1
    end = max(run.end for run in runs.values())
    assert found[0][0].get_xlim()[1] > end


def test_the_common_legend_names_a_shade_once(runs: Runs) -> None:
    entries = common_legend(plot_states(runs))
    assert len(entries) == len(set(entries))
    assert "next stage acts already" in entries


def test_instants_are_drawn_over_time_and_against_the_end_that_came_true(runs: Runs) -> None:
    overview, *details = plot_instants(runs).axes
    assert [axes.get_title() for axes in details] == [f"end of {name}" for name in ("approach", "capture", "transport")]
    run = runs["psmpc"]
    seen = np.isfinite(run.log["window/instants"][:, 0])
    time, instants = run.log.time[seen], run.log["window/instants"][seen, 0]
    assert any(np.array_equal(points(line), np.column_stack([time, instants])) for line in overview.lines)
    expected = np.column_stack([time - 10.0, 1e3 * (instants - 10.0)])
    assert any(np.array_equal(points(line), expected) for line in details[0].lines)


def test_actual_ends_are_marked_for_every_controller(runs: Runs) -> None:
    overview = plot_instants(runs).axes[0]
    marked = [points(line)[:, 0] for line in overview.lines if line.get_marker() not in ("", "None", None)]
    for found, run in zip(marked, runs.values(), strict=True):
        np.testing.assert_array_equal(found, run.log.stages["switch_time"])


def titles(figure: Figure) -> list[str]:
    found = (axes.get_title(loc="left").replace("\N{NO-BREAK SPACE}", " ") for axes in figure.axes)
    return [title.rstrip() for title in found if title]


def test_snapshots_say_when_a_stage_ends_and_when_the_next_starts(runs: Runs) -> None:
    found = titles(plot_snapshots(runs))
    assert found[:4] == [
        "(a) approach ends at 10.0 s\ncapture starts at 6.4 s",
        "(b) capture ends at 13.0 s\ntransport starts then",
        "(c) transport ends at 23.0 s\nrelease starts then",
        "(d) release ends at 29.6 s",
    ]
    assert found[6] == "(g) transport ends at 24.8 s\nrelease starts at 20.0 s"
    assert found[14:] == ["(o) transport did not end", "(p) release did not end"]


def test_snapshots_show_the_object_all_to_one_scale(runs: Runs) -> None:
    cells = plot_snapshots(runs).axes
    assert len({(axes.get_xlim(), axes.get_ylim()) for axes in cells}) == 1
    drawn = [sum(isinstance(patch, Polygon) for patch in axes.patches) for axes in cells]
    assert drawn == [3, 2, 2, 2, 3, 2, 3, 2, 2, 2, 2, 2, 2, 2, 0, 0]  # base and object, and the base at an early start
    assert "object, lost" in common_legend(plot_snapshots(runs))


def test_figures_are_drawn_into_files_and_not_over_them(tmp_path: Path, logs: dict[str, Log]) -> None:
    drawn = draw_comparison(logs, tmp_path, ["pdf"], ["instants", "states"])
    assert drawn == [tmp_path / "states.pdf", tmp_path / "instants.pdf"]
    assert all(path.read_bytes().startswith(b"%PDF") for path in drawn)
    with pytest.raises(InputError, match=r"states\.pdf already"):
        draw_comparison(logs, tmp_path, ["pdf"], ["states"])
    with pytest.raises(InputError, match="expected one of states, instants, shares, snapshots"):
        draw_comparison(logs, tmp_path, only=["forces"])
