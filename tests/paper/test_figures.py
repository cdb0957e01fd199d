"""What is shown beside the paper's claims, and of the ablations."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from psmpc_cli.logs.run import Run
from psmpc_cli.paper.figures import ABLATIONS, SMALLEST, has_waiting_stage, plot_monitors, plot_presence, plot_schedule
from psmpc_cli.specs.library import find

from ..figures.figure_contents import check_figure, common_legend, curves, points

Load = Callable[..., Run]

PUBLISHED = {"approach": 10.3, "capture": 15.1}


def waiting(run: Run) -> Run:
    """The run, in which Capture waits from 6 s to 10 s and adds ever more, at first next to nothing."""
    presence = np.full_like(run["window/presence"], np.nan)
    waits = (run.time > 6.0) & (run.time < 10.0)
    presence[waits, 1] = 10.0 ** (run.time[waits] - 9.0) * (run.time[waits] > 6.5)
    return replace(run, arrays={**run.arrays, "window/presence": presence})


def draw(plot: Callable[..., Figure], *arguments: Any) -> Figure:
    figure = plot(*arguments)
    check_figure(figure)
    return figure


@pytest.mark.parametrize(("kind", "scale", "least"), [("control", "log", SMALLEST), ("closeness", "linear", 0.0)])
def test_presence_is_drawn_where_a_stage_waits(load: Load, kind: str, scale: str, least: float) -> None:
    run = load(task=find("task", "transport").read_text().replace("kind: closeness", f"kind: {kind}"))
    figure = draw(plot_presence, waiting(run), {"capture": 8.8})
    drawn = {str(line.get_gid()): points(line) for line in figure.axes[1].lines if line.get_gid()}
    assert set(drawn) == {"capture"}
    assert drawn["capture"][:, 0].min() > 6.0
    assert drawn["capture"][:, 0].max() < 10.0
    assert drawn["capture"][:, 1].min() == least
    assert figure.axes[1].get_yscale() == scale
    assert "published start" in common_legend(figure)
    assert [8.8, run.task.spec.onset.epsilon] in [points(line)[0].tolist() for line in figure.axes[1].lines]


def test_only_a_run_in_which_a_stage_waits_has_a_figure_of_presence(run: Run) -> None:
    assert has_waiting_stage(waiting(run))
    assert not has_waiting_stage(run)


def test_monitors_are_drawn_with_their_bound_and_where_they_broke(load: Load, run: Run) -> None:
    lost = load(early={1: 6.4, 3: 19.0})
    held, broken = draw(plot_monitors, run), draw(plot_monitors, lost)
    marks = [[line for line in figure.axes[1].lines if line.get_marker() == "X"] for figure in (held, broken)]
    assert [len(found) for found in marks] == [0, 1]
    assert 19.0 < points(marks[1][0])[0, 0] < 23.0
    assert "bound" in common_legend(held)


def test_a_schedule_has_a_bar_a_stage_and_marks_what_is_published(run: Run, load: Load) -> None:
    odd = load(early={1: 6.4, 3: 9.0}, last=12.0)  # it was killed in its second stage
    figure = draw(plot_schedule, {"psmpc": run, "smpc": odd}, {"smpc": PUBLISHED})
    (axes,) = figure.axes
    bars = [patch for patch in axes.patches if isinstance(patch, Rectangle) and patch.get_fill()]
    widths = sorted(bar.get_width() for bar in bars)
    assert len(bars) == len(run.spans) + len(odd.spans) + sum(
        span.early is not None for span in (*run.spans, *odd.spans)
    )
    assert widths[-1] == pytest.approx(max(span.end - span.start for span in run.spans))
    marked = [points(line)[0, 0] for line in axes.lines if line.get_marker() == "v"]
    assert sorted(marked) == sorted(PUBLISHED.values())
    assert [label.get_text() for label in axes.get_yticklabels()] == ["PSMPC", "SMPC"]


TIME = np.linspace(0.0, 20.0, 41)
INSTANTS = np.linspace(1.2, 4.0, 15)
HORIZON = {"T_f": (np.array([0.0, 20.0]), np.full(2, 4.0))}
AHEAD = np.where(TIME > 5, 4.0 - (TIME - 5) % 4.0, np.nan)
MESH = np.array([10.0, 100.0])

MADE_UP = {
    "pending_cost": {
        "instant": {"printed": (TIME, np.full(41, 4.0)), "ours": (TIME, AHEAD), **HORIZON},
        "variation": {"printed": (TIME, TIME**2), "ours": (TIME, TIME)},
        "J, printed": {"1 : 1": (INSTANTS, 2.0 - INSTANTS / 4), "1 : 100": (INSTANTS, 1.0 / INSTANTS)},
        "J, ours": {"1 : 1": (INSTANTS, INSTANTS), "1 : 100": (INSTANTS, 2 * INSTANTS)},
        "minima, printed": {"1 : 1": (np.array([4.0]), np.ones(1)), "1 : 100": (np.array([4.0]), np.full(1, 0.25))},
        "minima, ours": {"1 : 1": (np.array([1.2]), np.full(1, 1.2)), "1 : 100": (np.array([1.2]), np.full(1, 2.4))},
        "found, printed": {"1 : 1": (np.full(3, 4.0), np.full(3, 1.0)), "1 : 100": (np.full(3, 4.0), np.full(3, 0.25))},
        "found, ours": {"1 : 1": (np.full(3, 1.2), np.full(3, 1.2)), "1 : 100": (np.full(3, 1.2), np.full(3, 2.4))},
    },
    "normalization": {
        "stages": {
            "ours": (np.array([0.0, 6.0, 14.0]), np.array([10.0, 14.0, 18.0])),
            "none": (np.array([0.0, 10.0, np.nan]), np.array([10.0, np.nan, np.nan])),
        },
        "instant": {"ours": (TIME, AHEAD), "none": (TIME, np.full(41, np.nan)), **HORIZON},
        "variation": {"ours": (TIME, TIME), "none": (TIME, 100 * TIME)},
    },
    "discretization": {
        "error": {"exact": (MESH, np.full(2, 1e-15)), "euler": (MESH, 1 / MESH)},
        "missed": {"exact": (MESH, np.ones(2)), "euler": (MESH, 1 + 10 / MESH)},
        "end": {"exact": (MESH, np.array([30.0, 29.0])), "euler": (MESH, np.array([np.nan, 29.1]))},
    },
}


def figure(name: str) -> Figure:
    return draw(ABLATIONS[name], MADE_UP[name])


def test_every_curve_is_drawn_as_given() -> None:
    ahead, variation, printed, ours = figure("pending_cost").axes
    np.testing.assert_array_equal(curves(ahead)["ours"], np.column_stack([TIME, AHEAD]))
    np.testing.assert_array_equal(curves(variation)["as printed, δ = 0"], np.column_stack([TIME, TIME**2]))
    for axes, panel in ((printed, "J, printed"), (ours, "J, ours")):
        for label, curve in MADE_UP["pending_cost"][panel].items():
            np.testing.assert_array_equal(curves(axes)[label], np.column_stack(curve))


@pytest.mark.parametrize("name", ABLATIONS)
def test_the_figure_of_an_ablation_is_fit_to_print(name: str) -> None:
    assert len(figure(name).axes) >= 3


def test_a_schedule_of_four_controllers_is_fit_to_print(runs: Mapping[str, Run]) -> None:
    assert len(draw(plot_schedule, runs).axes[0].get_yticklabels()) == len(runs)
