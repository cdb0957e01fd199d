from collections.abc import Callable

import numpy as np

from psmpc_cli.figures.instants import plot_instants
from psmpc_cli.figures.run import Run

Load = Callable[..., Run]


def test_every_optimized_instant_is_drawn(run: Run) -> None:
    above = plot_instants(run).axes[1]
    instants = run.log["window/instants"]
    drawn = {str(line.get_label()): line.get_xydata() for line in above.get_legend_handles_labels()[0]}
    assert list(drawn) == ["approach", "capture", "transport"]
    for stage, points in enumerate(drawn.values()):
        seen = np.isfinite(instants[:, stage])
        np.testing.assert_array_equal(points, np.column_stack([run.log.time[seen], instants[seen, stage]]))


def test_the_panel_below_is_the_difference_to_what_came_true(run: Run) -> None:
    below = plot_instants(run).axes[2]
    last = [line.get_ydata()[-1] for line in below.lines if len(line.get_xdata()) > 2]
    first = [line.get_ydata()[0] for line in below.lines if len(line.get_xdata()) > 2]
    assert len(last) == 3
    assert np.all(np.abs(last) < np.abs(first))


def test_an_instant_that_never_came_true_has_no_difference(load: Load) -> None:
    figure = plot_instants(load(last=8.0))
    assert any(line.get_label() == "approach" for line in figure.axes[1].lines)
    assert not [line for line in figure.axes[2].lines if line.get_label() == "approach"]


def test_a_run_without_optimized_instants_says_so(load: Load) -> None:
    figure = plot_instants(load(last=5.0))
    assert figure.axes[1].get_title(loc="left").startswith("no instant optimized")
