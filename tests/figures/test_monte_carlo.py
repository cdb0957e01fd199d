from pathlib import Path

import numpy as np
import pytest

from psmpc_cli.errors import LogError
from psmpc_cli.figures.monte_carlo import plot_runs, plot_success
from psmpc_cli.figures.registry import draw

from ..synthetic_monte_carlo import synthetic_monte_carlo
from .figure_contents import curves, legend, points


def test_a_curve_ends_at_the_fraction_of_runs_that_ended_the_stage(tmp_path: Path) -> None:
    runs = synthetic_monte_carlo(tmp_path / "study.h5", 10, waiting=(9,), crashed=(1,), late=(2, 3))
    figure = plot_success(runs)
    drawn = curves(figure.axes[0])
    assert figure.get_suptitle() == "6 of 9 runs succeeded; 95 % interval of the rate: 35 to 88 %"
    assert figure.axes[0].get_ylabel() == "Fraction of runs (1)"
    assert list(drawn) == ["approach, 7.0 s", "capture, 14.0 s", "transport, 21.0 s", "release, 28.1 s"]
    for name, curve in drawn.items():
        assert curve[-1, 1] == pytest.approx(6 / 9 if name.startswith("release") else 8 / 9)
        assert np.all(np.diff(curve, axis=0) >= 0)
        assert curve[0, 1] == 0


def test_failed_runs_are_ringed_behind_their_marks_even_those_without_values(tmp_path: Path) -> None:
    figure = plot_runs(synthetic_monte_carlo(tmp_path / "study.h5", crashed=(2,), late=(5,)))
    for axes in figure.axes:
        assert legend(axes)[-3:-1] == ["failed", "failed, no value"]
        assert [points(line).tolist() for line in axes.lines if line.get_label() == "failed, no value"] == [[[12, 0]]]
        rings = [line for line in axes.lines if line.get_marker() == "o" and line.get_markerfacecolor() == "none"]
        ringed = np.vstack([points(line) for line in rings if len(points(line))])
        assert set(ringed[np.isfinite(ringed[:, 1]), 0]) == {15.0}
        marks = [line for line in axes.lines if line.get_markeredgewidth() == 0]
        assert max(ring.get_zorder() for ring in rings) < min(mark.get_zorder() for mark in marks)


def test_a_study_that_has_not_begun_has_nothing_to_draw(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="no run that was made"):
        draw("monte-carlo", synthetic_monte_carlo(tmp_path / "study.h5", 2, waiting=(0, 1)), tmp_path / "figures")
