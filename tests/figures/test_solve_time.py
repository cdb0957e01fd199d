import numpy as np

from psmpc_cli.figures.run import Run
from psmpc_cli.figures.solve_time import plot_solve_time

from .drawn import common_legend, curves, legend, points


def test_every_solve_is_drawn_once_by_the_stages_in_its_window(run: Run) -> None:
    above, below = plot_solve_time(run).axes[1:]
    for axes, column, unit in ((above, "solver/wall_time", 1e3), (below, "solver/iterations", 1.0)):
        drawn = np.vstack(list(curves(axes).values()))
        drawn = drawn[np.argsort(drawn[:, 0])]
        np.testing.assert_allclose(drawn, np.column_stack([run.log.time, run.log[column] * unit]))


def test_the_legend_counts_the_stages(run: Run) -> None:
    assert legend(plot_solve_time(run).axes[1]) == ["1 stage", "2 stages", "3 stages in the window"]


def test_the_sample_time_is_a_line(run: Run) -> None:
    figure = plot_solve_time(run)
    milliseconds = run.task.controller.sample_time * 1e3
    assert any(np.all(points(line)[:, 1] == milliseconds) for line in figure.axes[1].lines)
    assert f"sample time, {milliseconds:g} ms" in common_legend(figure)


def test_failed_solves_are_marked(run: Run) -> None:
    figure = plot_solve_time(run)
    failed = run.log.time[run.log["events/solve_failed"].astype(bool)]
    assert len(failed) == 1
    for axes in figure.axes[1:]:
        (crosses,) = [line for line in axes.lines if line.get_marker() == "x"]
        np.testing.assert_array_equal(points(crosses)[:, 0], failed)
    assert "failed solve" in common_legend(figure)
