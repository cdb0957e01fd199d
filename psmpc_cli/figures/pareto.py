"""Pareto fronts between the costs of two stages at several samples of a run. Paper Fig. 7."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from psmpc_cli.figures import style
from psmpc_cli.logs.results import Results
from psmpc_cli.studies.fronts import CONSTRAINED, WEIGHTED, front_points

WIDEST_LINEAR_RATIO = 30.0
"""A linear panel shows numbers that differ by so many times at most."""

FRONT_LOOK: Any = {"linewidth": 0.9, "markersize": 2.2}
"""Look of a front, besides its colour and marker."""


def fronts_by_sample(results: Results) -> list[list[tuple[np.ndarray, np.ndarray]]]:
    """List the points of the fronts whose switch time is held at the run's optimum, by sample and then by method.

    Returns:
        For each sample and each method that the study used a pair: J_1 and J_2 of its points (P, 2), and which of them
        another point dominates (P,).
    """
    methods = [name for name in (WEIGHTED, CONSTRAINED) if f"{name}_J_1" in results.quantities]
    fronts = [front_points(results, method) for method in methods]
    return [[(J[i, 0], dominated[i, 0]) for J, dominated in fronts] for i in range(len(results["instant"]))]


def has_points(results: Results) -> bool:
    """Return whether a study has a point that could be solved for."""
    return any(np.isfinite(J).any() for points in fronts_by_sample(results) for J, _ in points)


def has_instant_criterion(results: Results) -> bool:
    """Return whether the instant is a criterion of a study."""
    return "later" in results.quantities


def plot_fronts(results: Results) -> Figure:
    """Plot the Pareto fronts in the plane of both stages' costs [s], J_2 to the right and J_1 upwards.

    There is a curve for each sample of the run at which a front was computed. If the costs differ so much that linear
    axes cannot show them all, a second panel has logarithmic axes. Costs as printed in the paper's eq. (12) may be
    negative; if some are, the second panel is linear and leaves out the large fronts instead.
    """
    samples = fronts_by_sample(results)
    all_costs = np.concatenate([J for points in samples for J, _ in points])
    smallest = np.nanmin(all_costs, axis=0)
    largest = np.nanmax(all_costs, axis=0)
    is_positive = bool(np.all(smallest > 0))
    is_large = np.zeros(len(samples), bool) if is_positive else _large_fronts(samples)
    panels = 2 if is_large.any() or (is_positive and np.any(largest > WIDEST_LINEAR_RATIO * smallest)) else 1
    figure, rows = style.stack([""] * panels, [1.9] * panels, "", sharex=False)
    first, second = map(style.readable, results["stage"].tolist())  # names of the two stages
    three_criteria = has_instant_criterion(results)
    rows[0].xaxis.set_major_locator(MaxNLocator(nbins=6))
    if panels > 1 and is_positive:
        for axis, has_many_decades in zip("yx", largest > 100.0 * smallest, strict=True):
            style.make_logarithmic(rows[1], axis, subs=(1.0,) if has_many_decades else (1.0, 2.0, 5.0))
    for axes in rows:
        shown = np.flatnonzero(~is_large) if axes is not rows[0] else np.arange(len(samples))
        for sample in shown.tolist():
            label = f"{results['instant'][sample]:.1f} s"
            label += "" if three_criteria else f": {results['hypervolume'][sample]:.3g} s$^2$"
            _plot_fronts_of_sample(axes, samples[sample], sample, label)
        axes.plot(results["chosen_J_2"][shown], results["chosen_J_1"][shown], **_look_of_run_weights(results))
        axes.set(xlabel=f"Cost of {second}, $J_2$ (s)", ylabel=f"Cost of {first}, $J_1$ (s)")
        axes.margins(0.04)
    # entries of the common legend, which draw nothing
    rows[0].plot([], [], "k>-", markersize=4, linewidth=0.9, label=style.shared_label("growing $ω_2/ω_1$"))
    if len(samples[0]) > 1:
        rows[0].plot([], [], "k+", label=style.shared_label("$J_2$ bounded"))
    title = "Time of the sample, $T_0$" + ("" if three_criteria else ": hypervolume")
    better = style.better_side("down and left")
    left_out = ", ".join(f"{instant:.1f} s" for instant in results["instant"][is_large])
    second_note = f"  without {left_out}" if left_out else ""
    titles = (f"(a)  {better}", f"(b)  {better}{second_note}") if panels > 1 else (better,)
    style.panel_legend(rows[0], titles[0], title)
    for axes, panel_title in zip(rows[1:], titles[1:], strict=True):
        axes.set_title(panel_title)  # the legend of the first panel holds here too
    return style.finish(figure)


def _large_fronts(samples: Sequence[Sequence[tuple[np.ndarray, np.ndarray]]]) -> np.ndarray:
    """Tell which fronts have costs so large that the typical one is not seen beside them (samples,); never all."""
    sizes = [np.abs(np.concatenate([J for J, _ in points])) for points in samples]
    extents = np.array([np.nanmax(each, axis=0, initial=0.0) for each in sizes])
    is_large = np.any(extents > WIDEST_LINEAR_RATIO * np.median(extents, axis=0), axis=1)
    return np.zeros_like(is_large) if is_large.all() else np.asarray(is_large)


def _plot_fronts_of_sample(
    axes: Axes, points_by_method: Sequence[tuple[np.ndarray, np.ndarray]], index: int, label: str
) -> None:
    """Plot the front of one sample in the plane of both costs, J_2 to the right and J_1 upwards.

    The points of the first method are joined by a line, with arrows towards larger ratios of weights omega_2 / omega_1.
    Those of a second method are crosses without a line. Dominated points (another point is better) are crossed out and
    not on the line.

    Args:
        axes: The panel.
        points_by_method: For each method the costs J_1, J_2 of its points (P, 2), in the order of rising ratios, and
            which of them are dominated (P,).
        index: Number of the sample, for its colour.
        label: Its name in the legend.
    """
    look = style.mark_look(index)
    for method, (J, dominated) in enumerate(points_by_method):
        efficient = J[~dominated].T[::-1]  # rows J_2 and J_1, for the horizontal and the vertical axis
        if method == 0:
            axes.plot(*efficient, label=label, **FRONT_LOOK, **look)
        else:
            axes.plot(*efficient, "+", color=look["color"], markersize=3.5, markeredgewidth=0.6)
        if dominated.any():
            axes.plot(*J[dominated].T[::-1], **style.look("dominated", markersize=4.5, markeredgewidth=0.9))
    first_costs, _ = points_by_method[0]
    curve = first_costs[np.isfinite(first_costs).all(axis=1)][:, ::-1]
    if len(curve) < 2:
        return
    # arrows at 30 % and 75 % of the curve's length, in which both costs count by their ranges as they do in the panel
    arc_length = np.cumsum(np.linalg.norm(np.diff(curve, axis=0) / np.maximum(np.ptp(curve, axis=0), 1e-12), axis=1))
    for segment in np.searchsorted(arc_length, [0.3 * arc_length[-1], 0.75 * arc_length[-1]]):
        axes.annotate(
            "",
            xy=curve[segment + 1],
            xytext=curve[segment],
            arrowprops={**style.ARROW, "facecolor": look["color"]},
            zorder=4,
        )


def _look_of_run_weights(results: Results) -> dict[str, Any]:
    """Return the look of the optimum with the run's own weights, with a label that says of what it is the optimum.

    Pending cost is the same all over the front on which it lies, since the instant is held there.
    """
    ratio = results["chosen_ratio"]
    same = np.ptp(ratio) <= 1e-9 * ratio[0]
    weights = f"$ω_2/ω_1$ = {ratio[0]:g}" if same else "the weights of the run"
    return style.look("weights of the run", label=style.shared_label(f"least $J_1 + (ω_2/ω_1) J_2$ with {weights}"))


def plot_fronts_over_instant(results: Results) -> Figure:
    """Plot in one panel for each sample the Pareto fronts of the costs of two stages, for a series of switch times.

    Each front is of windows whose switch time between the stages is held. This time is the third axis; the others are
    both costs, normalized integrals over time [s]. On the floor of each panel are the projections of the fronts: where
    two of them cross, which of the two switch times is the better choice depends on the weights of the costs.
    """
    samples = len(results["instant"])
    rows = -(-samples // 3)  # rounded up
    figure = style.new_figure(style.PAGE)
    grid: Any = figure.subplots(rows, 3, subplot_kw={"projection": "3d"}, squeeze=False, height_ratios=[2.1] * rows)
    for i, axes in enumerate(grid.flat):
        if i < samples:
            _plot_fronts_of_sample_over_instant(axes, results, i)
        else:
            axes.remove()
    return style.finish(figure)


def _plot_fronts_of_sample_over_instant(axes: Any, results: Results, sample: int) -> None:
    """Plot the fronts of one sample in three dimensions: both costs, and the switch time t_s less the present time T0.

    There is a front for each switch time that was held, one with the switch time free, and the point that the run
    itself chose. Grey projections of the fronts are on the floor of the panel.

    Args:
        axes: Three-dimensional axes, for which Matplotlib has no types.
        results: The Pareto study.
        sample: Number of the sample.
    """
    method = WEIGHTED if f"{WEIGHTED}_J_1" in results.quantities else CONSTRAINED
    J, is_dominated = front_points(results, method)
    waits = results[f"{method}_wait"][sample]  # t_s - T0 of each point of each front [s]; NaN without an optimum
    floor = float(np.nanmin(waits))
    span = float(np.nanmax(waits)) - floor
    floor -= 0.15 * span
    for held, waits_of_front in enumerate(waits):
        if not np.isfinite(waits_of_front).any():
            continue
        wait = float(np.nanmax(waits_of_front))  # the same for all points of a front
        y, x = J[sample, held].T
        dominated = is_dominated[sample, held]
        efficient = np.flatnonzero(~dominated).tolist()
        look = {**FRONT_LOOK, **style.mark_look(0), "label": style.shared_label("switch time held")}
        axes.plot(x, y, wait, markevery=efficient, **look)
        axes.plot(
            x, y, floor, color="#D5D5D5", linewidth=0.9, label=style.shared_label("in the plane of $J_1$ and $J_2$")
        )
        if dominated.any():
            axes.plot(x[dominated], y[dominated], wait, **style.look("dominated", markersize=3.5, markeredgewidth=0.8))
    free_front = [results[f"free_{name}"][sample] for name in ("J_2", "J_1", "wait")]
    axes.plot(*free_front, label=style.shared_label("switch time free"), **FRONT_LOOK, **style.mark_look(1))
    point_of_run = (
        results["chosen_J_2"][sample],
        results["chosen_J_1"][sample],
        results["t_s"][sample] - results["instant"][sample],
    )
    axes.plot(*([value] for value in point_of_run), **_look_of_run_weights(results))
    first, second = map(style.readable, results["stage"].tolist())
    axes.set_xlabel(f"{second}, $J_2$ (s)", labelpad=-3)
    axes.set_ylabel(f"{first}, $J_1$ (s)", labelpad=-4)
    axes.set_zlabel("$t_s - T_0$ (s)", labelpad=-2)
    axes.set_zlim(floor, floor + 1.2 * span)
    axes.set_title(f"$T_0$ = {results['instant'][sample]:.1f} s", loc="center", y=0.95)
    axes.tick_params(pad=-3)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_major_locator(MaxNLocator(nbins=4))
    axes.view_init(elev=24.0, azim=-52.0)
    axes.set_box_aspect(None, zoom=0.77)
