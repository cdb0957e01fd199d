from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from psmpc_cli.figures.controls import plot_controls
from psmpc_cli.figures.forces import plot_forces
from psmpc_cli.figures.panels import Quantity, coordinate_panels, limits_in_force, plot_coordinates
from psmpc_cli.figures.run import Run
from psmpc_cli.figures.states import plot_states
from psmpc_cli.figures.style import in_style
from psmpc_cli.figures.velocities import plot_velocities

from .drawn import common_legend, curves, points
from .fit_to_print import check_figure

Load = Callable[..., Run]


def seen_lines(figure: Figure) -> list[list[np.ndarray]]:
    """What the controller saw, by panel."""
    return [[points(line) for line in axes.lines if line.get_label() == "_seen"] for axes in figure.axes[1:]]


def limit_lines(axes: Axes) -> set[float]:
    lines = [line for line in axes.lines if line.get_label() == "_limit"]
    return {float(value) for line in lines for value in points(line)[:, 1]}


def test_the_panels_hold_every_coordinate_once(run: Run) -> None:
    rows = [row for panel in coordinate_panels(run.model) for row in range(run.model.n)[panel.rows]]
    assert rows == list(range(run.model.n))


def test_states_are_drawn_to_the_end_of_the_run(run: Run) -> None:
    position, angle, arm_1, arm_2 = plot_states(run).axes[1:]
    np.testing.assert_array_equal(curves(position)["y"], np.column_stack([run.time, run.Q[:, 1]]))
    np.testing.assert_array_equal(curves(angle)["θ"][:, 1], run.Q[:, 2])
    np.testing.assert_array_equal(curves(arm_1)["joint 3"][:, 1], run.Q[:, 5])
    np.testing.assert_array_equal(curves(arm_2)["joint 1"][:, 1], run.Q[:, 6])


def test_velocities_are_drawn_with_their_limits(run: Run) -> None:
    figure = plot_velocities(run)
    assert [limit_lines(axes) for axes in figure.axes[1:]] == [{-0.2, 0.2}, {-0.2, 0.2}, {-0.15, 0.15}, {-0.15, 0.15}]
    assert "limit" in common_legend(figure)


def test_what_the_controller_saw_lies_beneath_the_true_state(load: Load, run: Run) -> None:
    blurred = load(blur=0.1)
    figure = plot_velocities(blurred)
    np.testing.assert_array_equal(curves(figure.axes[1])["x"], np.column_stack([run.time, run.Qdot[:, 0]]))
    seen = np.hstack([line[:, 1:] for lines in seen_lines(figure) for line in lines])
    np.testing.assert_array_equal(seen, blurred.Qdot_seen)
    assert "seen by the controller" in common_legend(figure)
    with in_style():
        check_figure(plot_velocities(blurred))


def test_what_can_not_be_told_apart_in_print_is_not_drawn(load: Load) -> None:
    figure = plot_states(load(blur=1e-4))
    assert not any(seen_lines(figure))
    assert "seen by the controller" not in common_legend(figure)


def test_controls_without_limits_have_none_in_the_legend(run: Run) -> None:
    figure = plot_controls(run)
    assert not any(limit_lines(axes) for axes in figure.axes[1:])
    assert "limit" not in common_legend(figure)


def test_limits_are_those_of_the_current_stage(load: Load, one_arm: dict[str, Any]) -> None:
    run = load(**one_arm)
    times, low, high = limits_in_force(run, "velocity")
    np.testing.assert_array_equal(times, [0.0, 6.0])
    np.testing.assert_array_equal(high[:, :3], [[0.3, 0.5, 8.0]] * 2)
    np.testing.assert_array_equal(low, -high)


def test_limits_far_away_are_mentioned_instead_of_drawn(load: Load, one_arm: dict[str, Any]) -> None:
    position, angle, _ = plot_velocities(load(**one_arm)).axes[1:]
    assert limit_lines(position) == {-0.5, -0.3, 0.3, 0.5}
    assert limit_lines(angle) == set()
    assert angle.get_title(loc="left") == "limits beyond the axis"


def test_short_peaks_make_the_axis_logarithmic_and_say_so(run: Run) -> None:
    values = np.full((len(run.time), run.model.n), 0.01)
    values[5] = 3.0
    quantity = Quantity(("force", "torque"), ("N", "N m"), peaked=True)
    axes = plot_coordinates(run, run.time, values, quantity).axes[1]
    assert axes.get_yscale() == "symlog"
    assert axes.get_title(loc="left") == "log beyond ±0.1"
    assert [tick.get_text() for tick in axes.get_yticklabels()] == ["−1", "−0.1", "0", "0.1", "1"]


@pytest.mark.parametrize("size", [0.0, 1.0])
def test_values_without_peaks_keep_the_axis_linear(run: Run, size: float) -> None:
    values = size * np.sin(run.time)[:, None] * np.ones(run.model.n)
    quantity = Quantity(("force", "torque"), ("N", "N m"), peaked=True)
    axes = plot_coordinates(run, run.time, values, quantity).axes[1]
    assert (axes.get_yscale(), axes.get_title(loc="left")) == ("linear", "")


def test_forces_are_those_of_the_samples(run: Run) -> None:
    figure = plot_forces(run)
    np.testing.assert_array_equal(curves(figure.axes[2])["θ"][:, 1], run.log["force/F"][:, 2])
    assert figure.axes[1].get_ylabel() == "Base force\n(N)"
    assert figure.axes[3].get_ylabel() == "Arm 1 torque\n(N m)"


def test_forces_are_those_of_every_tick_where_logged(load: Load) -> None:
    run = load(last=2.0, ticks=True)
    drawn = curves(plot_forces(run).axes[1])["x"]
    np.testing.assert_array_equal(drawn, np.column_stack([run.log.ticks["time"], run.log.ticks["F"][:, 0]]))
    assert len(drawn) > len(run.log.time)
