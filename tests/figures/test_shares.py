from collections.abc import Callable

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.patches import StepPatch

from psmpc_cli.figures.run import Run
from psmpc_cli.figures.shares import cost_shares, plot_shares
from psmpc_cli.specs.library import find

from .drawn import common_legend, legend

Load = Callable[..., Run]


def stacks(axes: Axes) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Bottom and top of every stage's band, by sample."""
    found = [patch.get_data() for patch in axes.patches if isinstance(patch, StepPatch)]
    names = [str(patch.get_label()) for patch in axes.patches if isinstance(patch, StepPatch)]
    return {name: (np.asarray(data.baseline), data.values) for name, data in zip(names, found, strict=True)}


def test_the_cost_is_weighted_by_the_priorities(run: Run) -> None:
    k = int(np.argmin(np.abs(run.log.time - 8.0)))  # approach and capture, priorities 1 and 100, cost 1 and 1/2
    np.testing.assert_allclose(cost_shares(run)[k], [1 / 51, 50 / 51, np.nan, np.nan])


def test_smpc_weighs_all_alike(load: Load) -> None:
    task = find("task", "transport").read_text().replace("kind: psmpc", "kind: smpc")
    run = load(task=task)
    assert run.task.controller.kind == "smpc"
    k = int(np.argmin(np.abs(run.log.time - 8.0)))
    np.testing.assert_allclose(cost_shares(run)[k][:2], [2 / 3, 1 / 3])


def test_the_bands_fill_the_panels_and_follow_each_other(run: Run) -> None:
    for axes in plot_shares(run).axes[1:]:
        bands = stacks(axes)
        assert list(bands) == ["approach", "capture", "transport", "release"]
        bottom = np.zeros(len(run.log.time))
        for low, top in bands.values():
            np.testing.assert_allclose(low, bottom)
            bottom = top
        np.testing.assert_allclose(bottom, 100.0)


def test_the_control_is_handed_over_before_the_switch(run: Run) -> None:
    _, top = stacks(plot_shares(run).axes[2])["approach"]
    time = run.log.time
    assert np.all(top[time < 5.9] == 100.0)
    assert np.all(np.diff(top[(time > 6.1) & (time < 9.9)]) < 0)
    assert np.all(top[time > 10.1] == 0.0)


def test_stages_are_named_and_instants_marked(run: Run) -> None:
    figure = plot_shares(run)
    assert legend(figure.axes[1]) == ["approach", "capture", "transport", "release"]
    marked = [line.get_xdata()[0] for line in figure.axes[1].lines if line.get_zorder() >= 2]
    assert set(marked) >= {10.0, 13.0, 23.0, 6.4}


def test_shares_in_the_control_that_were_not_logged_have_no_panel(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    nothing = np.full_like(run.log["window/share"], np.nan)
    monkeypatch.setitem(run.log.columns, "window/share", nothing)
    figure = plot_shares(run)
    assert [axes.get_ylabel() for axes in figure.axes[1:]] == ["Share in the\nweighted cost (%)"]
    assert not any(entry.startswith("no share") for entry in common_legend(figure))


def test_samples_without_shares_are_explained(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    some = run.log["window/share"].copy()
    some[3] = np.nan
    monkeypatch.setitem(run.log.columns, "window/share", some)
    assert any(entry.startswith("no share") for entry in common_legend(plot_shares(run)))
