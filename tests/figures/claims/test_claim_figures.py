from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from psmpc_cli.figures.claims.monitors import plot_monitors
from psmpc_cli.figures.claims.presence import SMALLEST, plot_presence
from psmpc_cli.figures.claims.schedule import plot_schedule
from psmpc_cli.figures.run import Run
from psmpc_cli.figures.style import in_style

from ..drawn import common_legend, curves, points
from ..fit_to_print import check_figure

Load = Callable[..., Run]

PUBLISHED = {"approach": 10.3, "capture": 15.1}


def waiting(run: Run) -> Run:
    """The run, in which Capture waits from 6 s to 10 s and adds ever more, at first next to nothing."""
    presence = np.full_like(run.log["window/presence"], np.nan)
    waits = (run.log.time > 6.0) & (run.log.time < 10.0)
    presence[waits, 1] = 10.0 ** (run.log.time[waits] - 9.0) * (run.log.time[waits] > 6.5)
    return replace(run, log=replace(run.log, columns={**run.log.columns, "window/presence": presence}))


def draw(plot: Callable[..., Figure], *arguments: Any) -> Figure:
    with in_style():
        figure = plot(*arguments)
        check_figure(figure)
    return figure


@pytest.fixture
def odd(load: Load) -> Run:
    """A run that was killed in its second stage, and whose object had been lost by then."""
    return load(early={1: 6.4, 3: 9.0}, last=12.0)


def test_presence_is_drawn_where_a_stage_waits(run: Run) -> None:
    figure = draw(plot_presence, waiting(run), {"capture": 8.8})
    drawn = curves(figure.axes[1])
    assert set(drawn) == {"capture"}
    assert drawn["capture"][:, 0].min() > 6.0
    assert drawn["capture"][:, 0].max() < 10.0
    assert drawn["capture"][:, 1].min() == SMALLEST
    assert "published start" in common_legend(figure)
    assert [8.8, run.task.onset.epsilon] in [points(line)[0].tolist() for line in figure.axes[1].lines]


def test_presence_of_a_run_in_which_no_stage_waits(run: Run, odd: Run) -> None:
    for one in (run, odd):
        figure = draw(plot_presence, one, {})
        assert curves(figure.axes[1]) == {}
        assert "no stage waits" in figure.axes[1].get_title(loc="left")
        assert "published start" not in common_legend(figure)


def test_monitors_are_drawn_with_their_bound_and_where_they_broke(load: Load, run: Run) -> None:
    lost = load(name="lost.h5", early={1: 6.4, 3: 19.0})
    held, broken = draw(plot_monitors, run), draw(plot_monitors, lost)
    marks = [[line for line in figure.axes[1].lines if line.get_marker() == "X"] for figure in (held, broken)]
    assert [len(found) for found in marks] == [0, 1]
    assert 19.0 < points(marks[1][0])[0, 0] < 23.0
    assert "bound" in common_legend(held)


def test_monitors_of_a_run_that_did_not_get_there_and_of_a_task_without_any(odd: Run, run: Run) -> None:
    draw(plot_monitors, odd)
    figure = draw(plot_monitors, replace(run, task=run.task.model_copy(update={"monitors": ()})))
    assert "no monitor" in figure.axes[1].get_title(loc="left")


def test_a_schedule_has_a_bar_a_stage_and_marks_what_is_published(run: Run, odd: Run) -> None:
    figure = draw(plot_schedule, {"psmpc": run, "smpc": odd}, {"smpc": PUBLISHED})
    (axes,) = figure.axes
    bars = [patch for patch in axes.patches if isinstance(patch, Rectangle)]
    widths = sorted(bar.get_width() for bar in bars)
    assert len(bars) == len(run.spans) + len(odd.spans) + sum(
        span.early is not None for span in (*run.spans, *odd.spans)
    )
    assert widths[-1] == pytest.approx(max(span.end - span.start for span in run.spans))
    marked = [points(line)[0, 0] for line in axes.lines if line.get_marker() == "v"]
    assert sorted(marked) == sorted(PUBLISHED.values())
    assert {"PSMPC", "SMPC"} <= {text.get_text() for text in axes.texts}


def test_a_schedule_reaches_to_the_last_published_end(run: Run) -> None:
    figure = draw(plot_schedule, {"psmpc": run}, {"psmpc": {"release": 50.0}})
    assert figure.axes[0].get_xlim()[1] > 50.0
