"""What figures over time show: stages, coordinates, errors, switch times, shares and solves."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes

from psmpc_cli.figures.coordinates import plot_controls, plot_errors, plot_forces, plot_states, plot_velocities
from psmpc_cli.logs.run import Run

from ..short_runs import CUT, there_and_back
from .figure_contents import check_figure, common_legend, curves, long_curves, points

Load = Callable[..., Run]


Runs = Mapping[str, Run]


def changed(run: Run, path: str, values: np.ndarray) -> Run:
    """The run with another column."""
    return replace(run, arrays={**run.arrays, path: values})


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
    assert (axes.get_yscale(), axes.get_title(loc="left")) == ("symlog", "log beyond 0.1")
    assert [tick.get_text() for tick in axes.get_yticklabels()] == ["−1", "−0.1", "0", "0.1", "1"]


def test_forces_are_those_of_every_tick_where_logged_else_of_the_samples(run: Run, load: Load) -> None:
    figure = plot_forces(run)
    np.testing.assert_array_equal(curves(figure.axes[2])["θ"][:, 1], run["force/F"][:, 2])
    assert [axes.get_ylabel() for axes in figure.axes[1:4:2]] == ["Base force\n(N)", "Arm 1 torque\n(N m)"]
    fine = load(last=2.0, ticks=True)
    drawn = curves(plot_forces(fine).axes[1])["x"]
    np.testing.assert_array_equal(drawn, np.column_stack([fine.ticks["time"], fine.ticks["F"][:, 0]]))


@pytest.mark.slow
def test_forces_have_their_limits_and_what_was_commanded_where_they_are_cut(tmp_path: Path) -> None:
    """The base's are along its own axes; limits that are far off are not drawn."""
    cut = there_and_back(tmp_path, *CUT, name="cut")
    figure = plot_forces(cut)
    base, torque, *_ = figure.axes[1:]
    assert base.get_ylabel() == "Base force\n(N, own axes)"
    assert (limit_lines(base), limit_lines(torque)) == ({-6.0, 6.0}, set())
    theta = cut.ticks["Q"][:, 2]
    along_x = {name: np.cos(theta) * F[:, 0] + np.sin(theta) * F[:, 1] for name, F in cut.ticks.items() if F.ndim > 1}
    np.testing.assert_allclose(curves(base)["x"][:, 1], along_x["F"], atol=1e-12)
    (commanded, _) = (points(line)[:, 1] for line in base.lines if line.get_label() == "_commanded, cut")
    is_cut = np.isfinite(commanded)
    np.testing.assert_allclose(commanded[is_cut], along_x["commanded"][is_cut], atol=1e-12)
    assert is_cut.any() and (np.abs(along_x["F"][is_cut]) <= 4.8 + 1e-9).all()
    assert "commanded, cut" in common_legend(figure)
    largest = cut.time[np.argmax(cut["force/utilization"][:, 0])]
    share = 100 * cut["force/saturated"].mean()
    beyond = 100 * (cut["force/utilization"] > 1.05).any(axis=1).mean()
    assert figure.get_suptitle().splitlines() == [
        f"base.x commanded up to 125.0 % of what is there, at {largest:.1f} s",
        f"forces cut {share:.1f} % of the time, beyond 105 % of a limit {beyond:.1f} %",
    ]
    check_figure(figure)


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


def test_a_column_holds_its_controllers_states_on_common_axes(runs: Runs) -> None:
    found = np.array(plot_states(runs).axes).reshape(-1, len(runs)).T.tolist()
    assert [column[0].get_title() for column in found] == ["PSMPC", "SMPC", "HTMPC", "Hard switching"]
    for column, run in zip(found, runs.values(), strict=True):
        np.testing.assert_allclose(curves(column[1])["x"], np.column_stack([run.motion.time, run.motion.Q[:, 0]]))
    assert len({axes.get_xlim() for column in found for axes in column}) == 1
