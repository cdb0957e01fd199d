"""What every figure keeps to, so that a reader needs no second look: rows, panels, outliers, colours, names, marks."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_hex
from matplotlib.text import Text

from psmpc_cli.figures.coordinates import plot_errors, plot_forces, plot_states, plot_velocities
from psmpc_cli.figures.instants import plot_grasps, plot_instants, plot_solve_time
from psmpc_cli.figures.monte_carlo import INTERVAL, plot_runs, plot_success
from psmpc_cli.figures.registry import FIGURES, figures_of
from psmpc_cli.figures.scene import CAMERAS, base_half_edges, box_corners, in_inertial_frame
from psmpc_cli.figures.snapshots import plot_robot
from psmpc_cli.figures.style import label_ends, stack
from psmpc_cli.figures.sweep import plot_heat_map, plot_sensitivity, plot_starts
from psmpc_cli.figures.timeline import place_bars
from psmpc_cli.logs.run import Run, Span
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.library import find
from psmpc_cli.specs.load import load_robot
from psmpc_cli.specs.robots.robot import resolve_limits
from psmpc_cli.studies.monte_carlo import wilson_interval
from psmpc_cli.studies.sweep import SweepCells

from ..synthetic_monte_carlo import synthetic_monte_carlo
from ..synthetic_sweep import numbers, synthetic_sweep
from .figure_contents import check_figure, common_legend, curves, legend, names_at_ends, points

Load = Callable[..., Run]
Runs = Mapping[str, Run]


def with_column(run: Run, path: str, values: np.ndarray) -> Run:
    """The run with another column."""
    return replace(run, arrays={**run.arrays, path: values})


def without_plans(run: Run) -> Run:
    """The run as if it had never planned when a stage ends."""
    return with_column(run, "window/instants", np.full_like(run["window/instants"], np.nan))


def note(axes: Axes) -> str:
    """What is written above a panel at its left."""
    return axes.get_title(loc="left")


def test_a_stage_is_in_one_row_in_every_column_of_a_comparison(runs: Runs) -> None:
    """Hard switching has its last two stages so close that they need three rows: then all have three."""
    figure = plot_states(runs)
    strips = [axes for axes in figure.axes if not axes.axison]
    rows = [{text.get_text(): text.get_position()[1] for text in strip.texts} for strip in strips]
    assert len(rows) == len(runs)
    for of_run in rows[1:]:
        assert of_run == {name: rows[0][name] for name in of_run}
    wide = [Span(0, "one", 0.0, 4.0, None), Span(1, "two", 4.0, 8.0, None), Span(2, "three", 8.0, 12.0, None)]
    narrow = [replace(wide[0], end=0.1), replace(wide[1], start=0.1, end=0.2), replace(wide[2], start=0.2)]
    together = place_bars([wide, narrow], (0.0, 12.0), width=1.0)
    assert [bar.row for bar in place_bars([wide], (0.0, 12.0), width=1.0)[0]] == [0, 1, 0]
    assert [[bar.row for bar in bars] for bars in together] == [[0, 1, 2]] * 2


def test_there_is_no_panel_for_what_is_not_there(run: Run, runs: Runs) -> None:
    hard = without_plans(run)
    assert "instants" in figures_of("run", run)
    assert "instants" not in figures_of("run", hard)
    figure = plot_instants({"hard": hard, "psmpc": runs["psmpc"]})
    check_figure(figure)
    _, _, planned, _, off_of_hard, off = figure.axes
    assert [off_of_hard.get_visible(), off.get_visible()] == [False, True]
    assert planned.get_xlabel() == off.get_xlabel() == "Time (s)"
    assert off.get_ylabel() == "Planned minus\nactual (ms)"


def test_a_base_without_thrusters_has_no_panels_of_its_forces(load: Load) -> None:
    folded = np.r_[0, 0, 0, 0.3, 0.3, 0.3, -0.3, -0.3, -0.3]
    task = find("task", "float_and_reach").read_text()
    run = load(task=task, ends=(4.0, 10.0), points=(folded, folded + 0.1, folded), early={})
    forces = run["force/F"].copy()
    forces[:, :3] = 0.0
    labels = [axes.get_ylabel() for axes in plot_forces(with_column(run, "force/F", forces)).axes[1:]]
    assert labels == ["Arm 1 torque\n(N m)", "Arm 2 torque\n(N m)"]
    assert plot_states(run).axes[1].get_ylabel() == "Base position\n(m)"


def test_studies_without_values_have_no_figures_of_them(tmp_path: Path) -> None:
    failed = SweepCells(synthetic_sweep(tmp_path / "sweep.h5", "3x3", failed=tuple(range(9))))
    assert "sensitivity" not in figures_of("sweep", failed)
    crashed = synthetic_monte_carlo(tmp_path / "study.h5", 2, crashed=(0, 1))
    assert list(figures_of("monte-carlo", crashed)) == ["success"]


def test_one_planned_time_that_is_far_off_does_not_flatten_the_others(run: Run) -> None:
    switch_times = run["window/instants"].copy()
    planned = np.argwhere(np.isfinite(switch_times))
    off = np.array(run.stages["switch_time"])[planned[:, 1]]
    switch_times[tuple(planned.T)] = off + 1e-3
    switch_times[tuple(planned[0])] += 5.0
    axes = plot_instants(with_column(run, "window/instants", switch_times)).axes[2]
    assert (axes.get_yscale(), note(axes)) == ("symlog", "log beyond 0.1"), "in seconds"
    low, high = axes.get_ylim()
    assert low > -0.1 and high > 5


def test_one_run_far_off_does_not_flatten_the_others(tmp_path: Path) -> None:
    runs = synthetic_monte_carlo(tmp_path / "study.h5", 30)
    runs.results["relative_velocity_margin"][4] = -90.0
    assert [axes.get_yscale() for axes in plot_runs(runs).axes[:2]] == ["linear", "symlog"]
    far = [0.8] * 6 + [400.0]
    cells = SweepCells(
        synthetic_sweep(
            tmp_path / "sweep.h5", "7", of=lambda ratio: {**numbers(ratio), "end_error": [far[int(ratio > 1e5) * 6]]}
        )
    )
    error = plot_sensitivity(cells).axes[3]
    assert error.get_ylabel().startswith("End error")
    assert error.get_yscale() == "log"


def test_a_strength_far_above_the_loads_is_named_and_does_not_flatten_them(load: Load) -> None:
    run = load(task=find("task", "transport_grasp").read_text())
    shape = (len(run.time), 2)
    grasps = {
        "grasp/closed": np.ones(shape),
        "grasp/lost": np.zeros(2),
        "grasp/opened_at": np.full(2, np.nan),
        **{f"grasp/{load_kind}": np.full(shape, 1e-3) for load_kind in ("pull", "shear", "moment")},
    }
    held = replace(run, arrays={**run.arrays, **grasps, "gripper": np.array(["arm_1", "arm_2"])})
    panels = plot_grasps(held).axes[1:]
    assert note(panels[0]) == "strength 12 N, out of view; ↓ better"
    assert max(axes.get_ylim()[1] for axes in panels) < 0.01


def test_no_panel_has_more_joints_than_can_be_told_apart(load: Load, many_stages: dict[str, Any]) -> None:
    figure = plot_states(load(**many_stages))
    shown = [list(curves(axes)) for axes in figure.axes[1:]]
    assert shown[:2] == [["x", "y"], ["θ"]]
    assert shown[2:4] == [["joint 1", "joint 2", "joint 3", "joint 4"], ["joint 5", "joint 6", "joint 7"]]
    assert len(shown) == 2 + 4 * 2
    assert len({axes.get_xlim() for axes in figure.axes}) == 1


def test_limits_have_the_colours_of_the_lines_that_they_bound(run: Run, load: Load, one_arm: dict[str, Any]) -> None:
    position, angle, *_ = plot_velocities(load(**one_arm)).axes[1:]
    colors = {name: line.get_color() for line in position.lines if (name := str(line.get_label())) in ("x", "y")}
    limits = [line for line in position.lines if line.get_label() == "_limit" and len(points(line))]
    found = {abs(float(points(line)[0, 1])): line.get_color() for line in limits}
    assert found == {0.3: colors["x"], 0.5: colors["y"]}  # of x, and of y
    assert not [line for line in angle.lines if line.get_label() == "_limit" and len(points(line))]
    shared = [line for line in plot_velocities(run).axes[1].lines if line.get_label() == "_limit" and len(points(line))]
    assert {line.get_color() for line in shared} == set(colors.values())
    tolerances = [line for line in plot_errors(run).axes[1].lines if line.get_label() == "_tolerance"]
    of_parts = {
        line.get_color() for line in plot_errors(run).axes[1].lines if not str(line.get_label()).startswith("_")
    }
    assert {line.get_color() for line in tolerances if len(points(line))} <= of_parts


def test_names_stand_beside_the_ends_of_their_lines_and_apart() -> None:
    _, (axes,) = stack(["y (1)"], [1.0], "x (1)")
    ends = {"low": 0.0, "middle": 5.0, "above": 5.1, "high": 10.0}
    for name, end in ends.items():
        axes.plot([0.0, 1.0], [3.0, end], label=name)
    axes.set(ylim=(0.0, 10.0), xlim=(0.0, 1.0))
    label_ends(axes)
    names = {text.get_text(): text for text in axes.texts}
    assert list(names) == ["low", "middle", "above", "high"]
    heights = [text.xyann[1] for text in axes.texts]
    assert np.diff(heights).min() > 0.12
    assert abs(heights[1] - 0.5) < 0.1 and abs(heights[2] - 0.51) < 0.1
    for line in axes.lines:
        assert to_hex(names[str(line.get_label())].get_color()) == to_hex(line.get_color())
    assert axes.get_legend() is None


def test_lines_over_time_have_their_names_beside_them_and_stages_theirs_in_the_strip(run: Run) -> None:
    for axes in plot_states(run).axes[1:]:
        assert set(names_at_ends(axes)) == set(curves(axes)) != set()
        assert axes.get_legend() is None
    strip, above, _ = plot_instants(run).axes
    drawn = {str(line.get_gid()): line.get_color() for line in above.lines if line.get_gid()}
    keys = {to_hex(patch.get_facecolor()) for patch in strip.patches if patch.get_fill()}
    assert {to_hex(color) for color in drawn.values()} <= keys
    assert legend(above) == ["present time", "end of horizon"]


def test_fractions_of_runs_have_their_interval(tmp_path: Path) -> None:
    runs = synthetic_monte_carlo(tmp_path / "study.h5", 10)
    figure = plot_success(runs)
    bands = [each for each in figure.axes[0].collections if isinstance(each, PolyCollection)]
    assert len(bands) == len(runs.stages)
    for band in bands:
        corners = band.get_paths()[0].vertices
        assert corners[:, 1].min() == 0.0
        assert corners[:, 1].max() == 1.0
        assert wilson_interval(10, 10)[0] in corners[:, 1]
    assert INTERVAL in common_legend(figure)


def test_the_better_side_is_marked(run: Run, tmp_path: Path) -> None:
    cells = SweepCells(synthetic_sweep(tmp_path / "sweep.h5", "7x7"))
    marks = [note(axes) for axes in plot_sensitivity(cells).axes]
    assert marks == ["↓ sooner", "↓ less effort", "↓ gentler", "↓ closer"]
    assert note(plot_starts(cells).axes[0]) == "↓ sooner"
    assert note(plot_heat_map(cells).axes[0]) == "darker: sooner"
    assert note(plot_solve_time(run).axes[1]) == "↓ sooner"
    assert [note(axes).partition("; ")[2] for axes in plot_errors(run).axes[1:]] == ["↓ better"] * 2
    study = synthetic_monte_carlo(tmp_path / "study.h5")
    assert [note(axes) for axes in plot_runs(study).axes] == ["↓ closer", "↑ safer", "↑ safer"]
    assert note(plot_success(study).axes[0]) == "← sooner"


@pytest.mark.parametrize("kind", FIGURES)
def test_a_figure_has_a_sentence_that_says_what_it_shows(kind: str) -> None:
    for name, figure in FIGURES[kind].items():
        assert figure.caption.endswith(".") and figure.caption[0].isupper(), name
        assert len(figure.caption.split()) > 5, name
        assert "_" not in figure.caption, name


@pytest.mark.parametrize("name", ["dual_arm_servicer", "planar_dual_arm"])
def test_numbers_of_joints_cover_nothing_of_the_robot(name: str) -> None:
    spec = load_robot(name)
    model = RobotModel(spec)
    figure = plot_robot(spec)
    figure.draw_without_rendering()
    axes = figure.axes[0]
    camera = CAMERAS[model.dimension]
    limits = resolve_limits(spec)
    rest = np.clip(0.0, limits.position_low, limits.position_high)[model.parts["base"].stop :]
    Q = np.r_[model.neutral[: model.nq - len(rest)], rest]
    frames = model.body_frames(Q)
    ends = [
        in_inertial_frame(frame, each)
        for frame, all_ends in zip(frames, model.shape.capsules, strict=True)
        for each in all_ends
    ]
    on_links = np.vstack([first + np.linspace(0, 1, 30)[:, None] * (second - first) for first, second in ends])
    box = box_corners(frames[0] @ model.shape.box_frame, base_half_edges(model))
    on_base = np.random.default_rng(0).dirichlet(np.ones(8), 2000) @ box
    seen = axes.transData.transform(camera.project(np.vstack([on_links, on_base])))
    numbers = [text for text in axes.texts if text.get_text()[:1].isdigit()]
    assert len(numbers) >= 6
    for number in numbers:
        around = Text.get_window_extent(number)
        inside = (np.abs(seen - around.get_points().mean(axis=0)) < np.array(around.size) / 2 - 1).all(axis=1)
        assert not inside.any(), number.get_text()
