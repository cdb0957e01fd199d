from collections.abc import Callable

import numpy as np

from psmpc_cli.figures.instants import plot_instants
from psmpc_cli.figures.run import Run

from .drawn import curves, legend, long_curves

Load = Callable[..., Run]


def test_every_optimized_instant_is_drawn(run: Run) -> None:
    drawn, instants = curves(plot_instants(run).axes[1]), run.log["window/instants"]
    assert list(drawn) == ["approach", "capture", "transport"]
    for stage, points in enumerate(drawn.values()):
        seen = np.isfinite(instants[:, stage])
        np.testing.assert_array_equal(points, np.column_stack([run.log.time[seen], instants[seen, stage]]))


def test_the_panel_below_is_the_difference_to_what_came_true(run: Run) -> None:
    drawn = long_curves(plot_instants(run).axes[2])
    for curve, end in zip(drawn, (10.0, 13.0, 23.0), strict=True):
        np.testing.assert_allclose(curve[:, 1], 0.02 * (end - curve[:, 0]), atol=1e-9)  # as made up


def test_an_instant_that_never_came_true_has_no_difference(load: Load) -> None:
    _, *panels = plot_instants(load(last=8.0)).axes
    assert [legend(axes) for axes in panels] == [["approach"]]


def test_a_run_without_optimized_instants_says_so(load: Load) -> None:
    figure = plot_instants(load(last=5.0))
    assert figure.axes[1].get_title(loc="left") == "no instant was optimized"
