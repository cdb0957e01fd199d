"""What figures over time show: stages, coordinates, errors, switch times, shares and solves."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.patches import Rectangle, StepPatch

from psmpc_cli.figures.coordinates import plot_controls, plot_errors, plot_forces, plot_states, plot_velocities
from psmpc_cli.figures.instants import cost_shares, plot_instants, plot_shares, plot_solve_time
from psmpc_cli.figures.style import EARLY, STAGE
from psmpc_cli.logs.run import Run
from psmpc_cli.specs.library import find

from .figure_contents import common_legend, curves, legend, long_curves, points

Load = Callable[..., Run]
Runs = Mapping[str, Run]


def bands(axes: Axes, color: str) -> list[tuple[float, float]]:
    """Left and right of the rectangles of a colour."""
    filled = [patch for patch in axes.patches if isinstance(patch, Rectangle) and patch.get_fill()]
    found = [patch for patch in filled if to_hex(patch.get_facecolor()) == color.lower()]
    return [(patch.get_x(), patch.get_x() + patch.get_width()) for patch in found]


def changed(run: Run, path: str, values: np.ndarray) -> Run:
    """The run with another column."""
    return replace(run, arrays={**run.arrays, path: values})


def test_every_other_stage_and_early_starts_are_marked_in_every_panel_and_explained(run: Run) -> None:
    figure = plot_states(run)
    for panel in figure.axes[1:]:
        assert bands(panel, STAGE) == [(10.0, 13.0), (23.0, pytest.approx(29.6))]
        assert bands(panel, EARLY) == [(6.4, 10.0)]
        assert 6.4 in [points(line)[0, 0] for line in panel.lines]
    assert bands(figure.axes[0], EARLY) == [(6.4, 10.0)]
    assert [text.get_text() for text in figure.axes[0].texts] == ["approach", "capture", "transport", "release"]
    assert {"every other stage", "next stage already acts", "early start"} <= set(common_legend(figure))


def test_states_are_drawn_to_the_end_of_the_run(run: Run) -> None:
    figure = plot_states(run)
    low, high = figure.axes[1].get_xlim()
    assert low < run.motion.time[0] and run.motion.end < high
    position, angle, arm_1, arm_2 = figure.axes[1:]
    np.testing.assert_array_equal(curves(position)["y"], np.column_stack([run.motion.time, run.motion.Q[:, 1]]))
    np.testing.assert_array_equal(curves(angle)["θ"][:, 1], run.motion.Q[:, 2])
    np.testing.assert_array_equal(curves(arm_1)["joint 3"][:, 1], run.motion.Q[:, 5])
    np.testing.assert_array_equal(curves(arm_2)["joint 1"][:, 1], run.motion.Q[:, 6])
    labels = ["Base position\n(m)", "Base angle\n(rad)", "Arm 1 angle\n(rad)", "Arm 2 angle\n(rad)"]
    assert [axes.get_ylabel() for axes in figure.axes[1:]] == labels


def limit_lines(axes: Axes) -> set[float]:
    lines = [line for line in axes.lines if line.get_label() == "_limit"]
    return {float(value) for line in lines for value in points(line)[:, 1]}


def test_velocities_have_the_limits_in_force(run: Run, load: Load, one_arm: dict[str, Any]) -> None:
    figure = plot_velocities(run)
    assert [limit_lines(axes) for axes in figure.axes[1:]] == [{-0.2, 0.2}, {-0.2, 0.2}, {-0.15, 0.15}, {-0.15, 0.15}]
    assert "limit" in common_legend(figure)
    position, angle, _ = plot_velocities(load(**one_arm)).axes[1:]
    assert limit_lines(position) == {-0.5, -0.3, 0.3, 0.5}
    assert limit_lines(angle) == set()


def test_what_the_controller_saw_is_drawn_where_it_can_be_told_apart(load: Load, run: Run) -> None:
    blurred = load(blur=0.1)
    figure = plot_velocities(blurred)
    np.testing.assert_array_equal(curves(figure.axes[1])["x"], np.column_stack([run.motion.time, run.motion.v[:, 0]]))
    seen = [points(line)[:, 1:] for axes in figure.axes[1:] for line in axes.lines if "seen" in line.get_label()]
    np.testing.assert_array_equal(np.hstack(seen), blurred.motion.v_seen)
    assert "seen by the controller" in common_legend(figure)
    assert "seen by the controller" not in common_legend(plot_states(run))


def test_controls_are_steps_held_to_the_end_of_the_run(run: Run) -> None:
    figure = plot_controls(run)
    for axes in figure.axes[1:]:
        drawn = [line for line in axes.lines if len(points(line)) > 2]
        assert drawn and all(line.get_drawstyle() == "steps-post" for line in drawn)
    time, x = curves(figure.axes[1])["x"].T
    np.testing.assert_array_equal(time, [*run.time, run.motion.end])
    np.testing.assert_array_equal(x, [*run["control/u"][:, 0], run["control/u"][-1, 0]])
    assert "limit" not in common_legend(figure)
    assert figure.axes[1].get_ylabel() == "Base control\n(m/s²)"


def test_short_peaks_make_the_axis_logarithmic_and_say_so(run: Run) -> None:
    values = np.full((len(run.time), run.problem.model.n), 0.01)
    calm, peaked = plot_controls(changed(run, "control/u", values)).axes[1], values.copy()
    assert (calm.get_yscale(), calm.get_title(loc="left")) == ("linear", "")
    peaked[5] = 3.0
    axes = plot_controls(changed(run, "control/u", peaked)).axes[1]
    assert (axes.get_yscale(), axes.get_title(loc="left")) == ("symlog", "log beyond ±0.1")
    assert [tick.get_text() for tick in axes.get_yticklabels()] == ["−1", "−0.1", "0", "0.1", "1"]


def test_forces_are_those_of_every_tick_where_logged_else_of_the_samples(run: Run, load: Load) -> None:
    figure = plot_forces(run)
    np.testing.assert_array_equal(curves(figure.axes[2])["θ"][:, 1], run["force/F"][:, 2])
    assert [axes.get_ylabel() for axes in figure.axes[1:4:2]] == ["Base force\n(N)", "Arm 1 torque\n(N m)"]
    fine = load(last=2.0, ticks=True)
    drawn = curves(plot_forces(fine).axes[1])["x"]
    np.testing.assert_array_equal(drawn, np.column_stack([fine.ticks["time"], fine.ticks["F"][:, 0]]))


def test_errors_are_the_largest_of_a_group_in_the_coordinates_the_stage_controls(run: Run) -> None:
    position, angle = plot_errors(run).axes[1:]
    found = long_curves(position)
    spans = {(curve[0, 0], curve[-1, 0]) for curve in found}
    assert spans == {(0.0, 10.0), (10.0, 13.0), (13.0, 23.0), (23.0, 29.6)}
    approach = next(curve for curve in found if curve[0, 0] == 0.0)
    np.testing.assert_allclose(approach[0, 1], 2.0)  # from 0 to (-2, 2): not the distance
    joints = [curve for curve in long_curves(angle) if curve[0, 0] == 13.0]
    target, start = run.problem.stages[2].target, run.motion.coordinates_at(13.0)
    expected = [abs(start[2] - target[2]), *(np.abs(start - target)[rows].max() for rows in (slice(3, 6), slice(6, 9)))]
    np.testing.assert_allclose([curve[0, 1] for curve in joints], expected)


def test_the_error_of_a_moving_target_is_against_its_present_value(load: Load, one_arm: dict[str, Any]) -> None:
    moving = "target: {times: [0, 6], base: [[0, 0, 0], [1, 2, 0.1]], arm: [[0, 0], [0.5, 0.5]]}"
    task = one_arm["task"].replace("target: {base: [1, 2, 0.1], arm: [0.5, 0.5]}", moving)
    figure = plot_errors(load(**{**one_arm, "task": task, "sample": 0.5}))
    found = np.vstack([curve for curve in long_curves(figure.axes[1]) if len(curve)])
    at = [found[np.isclose(found[:, 0], time), 1].max(initial=0.0) for time in (3.0, 6.0)]
    np.testing.assert_allclose(np.nan_to_num(at), 0.0, atol=1e-9)


def test_every_planned_switch_time_is_drawn_and_how_far_it_is_off(run: Run) -> None:
    figure, instants = plot_instants(run), run["window/instants"]
    drawn = curves(figure.axes[1])
    assert list(drawn) == ["approach", "capture", "transport"]
    for stage, curve in enumerate(drawn.values()):
        seen = np.isfinite(instants[:, stage])
        np.testing.assert_array_equal(curve, np.column_stack([run.time[seen], instants[seen, stage]]))
    for curve, end in zip(long_curves(figure.axes[2]), (10.0, 13.0, 23.0), strict=True):
        np.testing.assert_allclose(curve[:, 1], 20.0 * (end - curve[:, 0]), atol=1e-6)  # as made up, in ms
    assert figure.axes[2].get_ylabel() == "Planned minus\nactual (ms)"
    assert {"present time", "actual switch", "end of the horizon"} <= set(common_legend(figure))


def test_a_column_holds_its_controllers_states_on_common_axes(runs: Runs) -> None:
    found = np.array(plot_states(runs).axes).reshape(-1, len(runs)).T.tolist()
    assert [column[0].get_title() for column in found] == ["PSMPC", "SMPC", "HTMPC", "Hard switching"]
    for column, run in zip(found, runs.values(), strict=True):
        np.testing.assert_allclose(curves(column[1])["x"], np.column_stack([run.motion.time, run.motion.Q[:, 0]]))
    assert len({axes.get_xlim() for column in found for axes in column}) == 1


def stacks(axes: Axes) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Bottom and top of every stage's band, by sample."""
    found = [patch for patch in axes.patches if isinstance(patch, StepPatch)]
    data = [(str(patch.get_label()), patch.get_data()) for patch in found]
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
    assert legend(figure.axes[1]) == ["approach", "capture", "transport", "release"]
    assert set(common_legend(figure)) == {"switch", "next stage already acts", "early start"}


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
