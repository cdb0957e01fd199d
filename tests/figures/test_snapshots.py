from collections.abc import Callable
from typing import Any

from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from psmpc_cli.figures.run import Run
from psmpc_cli.figures.snapshots import key_instants, plot_snapshots
from psmpc_cli.figures.style import PAGE

Load = Callable[..., Run]


def titles(figure: Figure) -> list[str]:
    return [title.replace("\n", " ") for axes in figure.axes if (title := axes.get_title(loc="left"))]


def test_there_is_a_panel_for_each_key_instant(run: Run) -> None:
    assert titles(plot_snapshots(run)) == [
        "(a) 0.0 s: start",
        "(b) 6.4 s: capture starts",
        "(c) 10.0 s: approach ends",
        "(d) 13.0 s: capture ends",
        "(e) 23.0 s: transport ends",
        "(f) 29.6 s: release ends",
    ]


def test_a_killed_run_ends_with_its_last_sample(load: Load) -> None:
    run = load(last=8.0)
    assert [(key.time, key.event) for key in key_instants(run)][-1] == (run.end, "end of the run")


def test_the_loss_of_the_object_is_a_key_instant(load: Load) -> None:
    events = [key.event for key in key_instants(load(early={1: 6.4, 3: 19.0}))]
    assert events.index("release starts") < events.index("object lost") < events.index("transport ends")


def test_instants_at_the_same_time_share_a_panel(load: Load) -> None:
    keys = key_instants(load(early={1: 0.0}))
    assert keys[0].event == "start, capture starts"
    assert len({key.time for key in keys}) == len(keys)


def test_all_panels_have_one_scale(run: Run) -> None:
    shown = [axes for axes in plot_snapshots(run).axes if axes.patches]
    assert len({(axes.get_xlim(), axes.get_ylim()) for axes in shown}) == 1
    assert all(axes.get_aspect() == 1.0 for axes in shown)


def test_the_object_is_drawn_in_every_panel(run: Run) -> None:
    for axes in plot_snapshots(run).axes:
        assert len([patch for patch in axes.patches if isinstance(patch, Polygon)]) == 2


def test_the_base_alone_is_drawn_without_an_object(load: Load, one_arm: dict[str, Any]) -> None:
    figure = plot_snapshots(load(**one_arm))
    assert [len(axes.patches) for axes in figure.axes] == [1, 1]


def test_many_instants_take_the_width_of_a_page(load: Load, many_stages: dict[str, Any]) -> None:
    figure = plot_snapshots(load(**many_stages))
    assert figure.get_figwidth() == PAGE
    assert len(titles(figure)) == 15
