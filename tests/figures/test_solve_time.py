import numpy as np

from psmpc_cli.figures.run import Run
from psmpc_cli.figures.solve_time import plot_solve_time


def test_every_solve_is_drawn_once_by_the_stages_in_its_window(run: Run) -> None:
    above, below = plot_solve_time(run).axes[1:]
    for axes, column, unit in ((above, "solver/wall_time", 1e3), (below, "solver/iterations", 1.0)):
        points = np.vstack([line.get_xydata() for line in axes.get_legend_handles_labels()[0]])
        points = points[np.argsort(points[:, 0])]
        np.testing.assert_allclose(points, np.column_stack([run.log.time, run.log[column] * unit]))


def test_the_legend_counts_the_stages(run: Run) -> None:
    legend = plot_solve_time(run).axes[1].get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == ["1 stage", "2 stages", "3 stages in the window"]


def test_the_sample_time_is_a_line(run: Run) -> None:
    figure = plot_solve_time(run)
    milliseconds = run.task.controller.sample_time * 1e3
    assert any(np.all(np.asarray(line.get_ydata()) == milliseconds) for line in figure.axes[1].lines)
    assert f"sample time, {milliseconds:g} ms" in [text.get_text() for text in figure.legends[0].get_texts()]


def test_failed_solves_are_marked(run: Run) -> None:
    figure = plot_solve_time(run)
    failed = run.log.time[run.log["events/fallback"].astype(bool)]
    assert len(failed) == 1
    for axes in figure.axes[1:]:
        (crosses,) = [line for line in axes.lines if line.get_marker() == "x"]
        np.testing.assert_array_equal(crosses.get_xdata(), failed)
    assert "failed solve" in [text.get_text() for text in figure.legends[0].get_texts()]
