"""What figures of decisions show: planned switch times, shares and solves."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.patches import StepPatch

from psmpc_cli.figures.instants import (
    BAR_HEIGHT,
    cost_shares,
    plot_clearance,
    plot_instants,
    plot_shares,
    plot_solve_time,
    plot_thrusters,
)
from psmpc_cli.logs.run import Run
from psmpc_cli.simulation.run import simulate
from psmpc_cli.specs.library import find
from psmpc_cli.specs.load import load_task

from .figure_contents import check_figure, common_legend, curves, legend, long_curves, points

Load = Callable[..., Run]


def test_every_planned_switch_time_is_drawn_and_how_far_it_is_off(run: Run) -> None:
    figure, switch_times = plot_instants(run), run["window/instants"]
    drawn = {str(line.get_gid()): points(line) for line in figure.axes[1].lines if line.get_gid()}
    assert list(drawn) == ["approach", "capture", "transport"]
    for stage, curve in enumerate(drawn.values()):
        seen = np.isfinite(switch_times[:, stage])
        np.testing.assert_array_equal(curve, np.column_stack([run.time[seen], switch_times[seen, stage]]))
    for curve, end in zip(long_curves(figure.axes[2]), (10.0, 13.0, 23.0), strict=True):
        np.testing.assert_allclose(curve[:, 1], 20.0 * (end - curve[:, 0]), atol=1e-6)  # as made up, in ms
    assert figure.axes[2].get_ylabel() == "Planned minus\nactual (ms)"
    assert legend(figure.axes[1]) == ["present time", "end of horizon"]
    assert "actual switch" in common_legend(figure)


def test_all_runs_of_a_figure_have_all_their_planned_switch_times_in_view(runs: Mapping[str, Run]) -> None:
    """Also those of runs that last longer than the first."""
    figure = plot_instants({name: runs[name] for name in ("psmpc", "htmpc")})
    panels = [axes for axes in figure.axes if any(line.get_gid() for line in axes.lines)]
    assert len(panels) == 2
    for axes, run in zip(panels, (runs["psmpc"], runs["htmpc"]), strict=True):
        low, high = axes.get_ylim()
        assert low == 0
        assert high >= max(np.nanmax(run["window/instants"]), run.time[-1])
        planned = [line for line in axes.lines if line.get_gid()]
        assert {line.get_linestyle() for line in planned} == {"None"}  # a point a sample: plans may jump


def test_plans_that_are_off_by_seconds_are_drawn_in_seconds(load: Load) -> None:
    run = load()
    run.arrays["window/instants"][:] += 5.0
    assert plot_instants(run).axes[2].get_ylabel() == "Planned minus\nactual (s)"


def stacks(axes: Axes) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Bottom and top of every stage's band, by sample."""
    found = [patch for patch in axes.patches if isinstance(patch, StepPatch)]
    data = [(str(patch.get_gid()), patch.get_data()) for patch in found]
    return {name: (np.asarray(one.baseline), one.values) for name, one in data}


def test_cost_shares_are_weighted_by_the_priorities_but_under_smpc(run: Run, load: Load) -> None:
    k = int(np.argmin(np.abs(run.time - 8.0)))  # approach and capture, priorities 1 and 100, cost 1 and 1/2
    np.testing.assert_allclose(cost_shares(run)[k], [1 / 51, 50 / 51, np.nan, np.nan])
    smpc = load(task=find("task", "transport").read_text().replace("kind: psmpc", "kind: smpc"))
    np.testing.assert_allclose(cost_shares(smpc)[k][:2], [2 / 3, 1 / 3])


def test_the_bands_of_the_shares_fill_the_panels_and_switches_are_marked(run: Run) -> None:
    figure = plot_shares(run)
    for axes in figure.axes[1:]:
        bottom, found = np.zeros(len(run.time)), stacks(axes)
        assert list(found) == ["approach", "capture", "transport", "release"]
        for low, top in found.values():
            np.testing.assert_allclose(low, bottom)
            bottom = top
        np.testing.assert_allclose(bottom, 100.0)
        assert {line.get_xdata()[0] for line in axes.lines} == {10.0, 13.0, 23.0, 6.4}
    _, top = stacks(figure.axes[2])["approach"]  # handed over before the switch
    assert np.all(top[run.time < 5.9] == 100.0) and np.all(top[run.time > 10.1] == 0.0)
    assert legend(figure.axes[1]) == []  # the strip above has the names in the colours of the bands
    assert set(common_legend(figure)) == {"switch", "next stage already acts", "early start"}


@pytest.mark.slow
def test_a_figure_without_shares_in_the_control_says_why() -> None:
    off = ("controller.nodes=5", "plant.kind=ideal", "time_limit=0.5", "log.shares=false")
    figure = plot_shares(simulate(load_task("transport", off)))
    assert len(figure.axes) == 2
    assert "log.shares is off" in figure.get_suptitle()


def test_every_solve_is_drawn_once_by_the_stages_in_its_window(run: Run) -> None:
    figure = plot_solve_time(run)
    for axes, column, unit in zip(figure.axes[1:], ("solver/wall_time", "solver/iterations"), (1e3, 1.0), strict=True):
        drawn = np.vstack(list(curves(axes).values()))
        drawn = drawn[np.argsort(drawn[:, 0])]
        np.testing.assert_allclose(drawn, np.column_stack([run.time, run[column] * unit]))
        (crosses,) = [line for line in axes.lines if line.get_marker() == "x"]
        np.testing.assert_array_equal(points(crosses)[:, 0], [20.0])
    assert legend(figure.axes[1]) == ["1 stage", "2 stages", "3 stages in the window"]
    assert {"sample time, 100 ms", "failed solve"} <= set(common_legend(figure))
    assert any(np.all(points(line)[:, 1] == 100.0) for line in figure.axes[1].lines)


def test_distances_of_the_nearest_parts_are_drawn_with_the_margin_and_where_they_touch(
    load: Load, keeping_clear: dict[str, Any]
) -> None:
    run = load(**keeping_clear)
    figure = plot_clearance(run)
    check_figure(figure)
    names = common_legend(figure)
    nearest = ["base \N{EN DASH} wall", "arm 1.3 \N{EN DASH} object"]
    assert names[3:5] == nearest
    assert {"margin, 30 mm", "touch", "nearest of 2 others"} <= set(names)
    drawn = {str(line.get_label())[1:]: points(line) for line in figure.axes[1].lines}
    wall = drawn["base \N{EN DASH} wall"]
    np.testing.assert_allclose(wall[:-1], np.column_stack([run.time, 1e3 * run["clearance/distance"][:, 8]]))
    assert wall[-1, 0] == run.motion.end
    held = drawn["arm 1.3 \N{EN DASH} object"]  # before and after it is taken
    assert np.nanmax(held[:, 1]) == pytest.approx(400.0) and np.nanmin(held[:, 1]) < 60.0
    assert drawn["touch"][0, 1] == pytest.approx(-50.0)
    np.testing.assert_allclose(drawn["margin, 30 mm"][:, 1], 30.0)
    low, high = figure.axes[1].get_ylim()
    assert low < -50.0 and high == 300.0
    assert figure.axes[1].get_title(loc="left") == "6 of 8 pairs; the others stay above 250 mm; ↑ safer"


def test_a_margin_is_drawn_where_a_stage_keeps_it(load: Load, keeping_clear: dict[str, Any]) -> None:
    task = keeping_clear["task"].replace("  - name: capture\n", "  - name: capture\n    clearance: {margin: 0.01}\n")
    assert task != keeping_clear["task"]
    run = load(**{**keeping_clear, "task": task})
    (margin,) = [line for line in plot_clearance(run).axes[1].lines if "margin" in str(line.get_label())]
    assert margin.get_label() == "_margin, 10 mm, 30 mm"
    during = run["window/first"] == 1
    np.testing.assert_allclose(points(margin)[:-1, 1], np.where(during, 10.0, 30.0))


def test_thrusters_have_a_row_each_and_a_bar_for_each_sample() -> None:
    """As high as the impulse over the largest one; rows count downwards."""
    changes = {"time_limit": 0.5, "controller": {"horizon": 4, "nodes": 20}}
    run = simulate(load_task("thrust_and_reach", changes))
    figure = plot_thrusters(run)
    axes = figure.axes[-1]
    bars = [each for container in axes.containers for each in container]
    assert len(axes.containers) == 8
    assert len(bars) == 8 * len(run.time)
    heights = np.array([abs(bar.get_height()) for bar in bars]).reshape(8, -1)
    np.testing.assert_allclose(heights.T / BAR_HEIGHT, run["thrusters/impulse"] / (10 * 0.1))
    assert axes.yaxis_inverted()
