"""The actual start of a stage over the priorities of two stages, and what their ratio does. Paper Fig. 6."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import LogLocator, MaxNLocator, NullLocator

from psmpc_cli.figures import style
from psmpc_cli.studies.sweep import ALLOWED_ERROR, QuantityByRatio, SweepCells, recommend

EARLIEST_START = "$t_s - T_h$"

RANGE = "lowest to highest of one ratio"
"""What a band about a line over the ratio is."""

FAILED_MISSION: Mapping[str, Any] = {
    "name": "ring around a failed run",
    "label": style.shared_label("mission failed"),
    "zorder": 4,
    "path_effects": [withStroke(linewidth=1.8, foreground="white")],
}
"""Look of a cell that ended the second stage, but not the mission with success; visible on every colour."""


def plot_heat_map(cells: SweepCells) -> Figure:
    """Plot when the second stage actually starts to act [s] over both stages' priorities, as colours of a grid.

    A cell of the grid is the run with a pair of priorities omega_1, omega_2. A contour surrounds the cells in which the
    start is the earliest possible, t_s - T_h: there the stage acts as soon as it enters the window, a horizon T_h
    before the switch time t_s. Starts are known to one sample, so "earliest" is the first sample after t_s - T_h.
    """
    figure, (axes,) = style.stack([""], [2.4], "")
    starts, scale, label = _starts_of_threshold(cells)
    x, y = (np.log10(cells.results[name]) for name in ("omega_1", "omega_2"))
    start, earliest = (values.reshape(len(y), len(x)) for values in (starts, cells.earliest_start))
    axes.pcolormesh(x, y, np.ma.masked_invalid(start), norm=scale, shading="nearest")
    _plot_contour(axes, x, y, start - earliest, cells.task.spec.controller.sample_time)
    if cells.waiting.any():
        # a bar of no height: the entry of white cells in the legend
        axes.bar(x[0], 0, color="white", label=[style.shared_label("waiting")])
    _mark_cells(axes, cells, {"failed": cells.failed})
    return _finish_priority_plane(figure, axes, cells, scale, label)


def plot_draws(cells: SweepCells) -> Figure:
    """Plot the actual start [s] over omega_1 and omega_2 as the colour of a point for every draw."""
    figure, (axes,) = style.stack([""], [2.4], "")
    starts, scale, label = _starts_of_threshold(cells)
    edge: dict[str, Any] = {"edgecolors": style.EDGE, "linewidths": 0.3}
    x, y = np.log10(cells.omega)[cells.ended].T
    axes.scatter(x, y, 16, starts[cells.ended], norm=scale, zorder=3, **edge)  # above the marks of failed ones
    _mark_cells(axes, cells, {"failed": cells.failed, "waiting": cells.waiting})
    return _finish_priority_plane(figure, axes, cells, scale, label)


def _mark_cells(axes: Axes, cells: SweepCells, marks: Mapping[str, np.ndarray]) -> None:
    """Mark cells in the plane of both priorities by what became of them (cells,), and the recommended run."""
    for name, which in marks.items():
        if which.any():
            axes.plot(*np.log10(cells.omega)[which].T, **style.look(name))
    if (failed := cells.ended & ~cells.succeeded).any():
        axes.plot(*np.log10(cells.omega)[failed].T, **style.look(**FAILED_MISSION))
    best = recommend(cells).omega
    if best is not None:
        label = style.shared_label(f"recommended, ω₂/ω₁ = {best[1] / best[0]:.4g}")
        axes.plot(*np.log10(best), **style.look("recommended", label=label, clip_on=False))


def _finish_priority_plane(figure: Figure, axes: Axes, cells: SweepCells, scale: Normalize, label: str) -> Figure:
    """Label the plane of both priorities, and add the bar of its colours if there are any."""
    first, second = (style.readable(name) for name in cells.names)
    _tick_decades(axes, 7)
    axes.set(xlabel=f"Priority of {first}, ω₁ (1)", ylabel=f"Priority of {second}, ω₂ (1)")
    if cells.ended.any():
        bar = figure.colorbar(ScalarMappable(scale), cax=axes.inset_axes((1.05, 0.0, 0.045, 1.0)))
        bar.set_label(label)
        axes.set_title("darker: sooner")
        bar.ax.set_title("$t_s$", loc="center")
        bar.ax.set_xlabel(EARLIEST_START, fontsize=style.TEXT, labelpad=4, loc="left")
    return style.finish(figure, above=True)


def plot_surface(cells: SweepCells) -> Figure:
    """Plot when the second stage actually starts to act [s] over both stages' priorities, as a surface.

    The surface lies between a frame at the latest switch time t_s and one at the earliest t_s - T_h: before that, a
    horizon T_h ahead of the switch, the second stage is in no window. Cells (runs with a pair of priorities) that
    failed and the recommended one are marked.
    """
    figure = style.new_figure()
    figure.set_figheight(3.0)
    axes: Any = figure.add_axes((0.09, 0.0, 0.91, 1.0), projection="3d", proj_type="ortho", computed_zorder=False)
    starts, scale, label = _starts_of_threshold(cells)
    shape = cells.results["status"].shape  # of the grid; arrays of cells are flat
    failed = cells.failed
    x, y = (omega.reshape(shape) for omega in np.log10(cells.omega.T))
    frame = [x.min(), x.max(), x.max(), x.min(), x.min()], [y.min(), y.min(), y.max(), y.max(), y.min()]
    if failed.any():
        axes.plot(x.flat[failed], y.flat[failed], np.full(failed.sum(), scale.vmin), **style.look("failed"))
    if cells.ended.any():  # drawn from the lowest to the highest, since each covers what is drawn before
        axes.plot(
            *frame, [scale.vmin] * 5, linestyle=style.DASHED, label=style.shared_label(EARLIEST_START), **style.LEVEL
        )
        colors = ScalarMappable(scale).to_rgba(starts.reshape(shape))
        look = {"rstride": 1, "cstride": 1, "shade": False, "edgecolor": style.EDGE, "linewidth": 0.2}
        axes.plot_surface(x, y, starts.reshape(shape), facecolors=colors, **look)
        axes.plot(*frame, [scale.vmax] * 5, label=style.shared_label("$t_s$"), **style.LEVEL)
    if (mission_failed := cells.ended & ~cells.succeeded).any():
        places = x.flat[mission_failed], y.flat[mission_failed], starts[mission_failed]
        axes.plot(*places, **style.look(**FAILED_MISSION))
    best = recommend(cells).omega
    # no cell is close to NaN, which stands for no recommendation
    is_recommended = cells.ended & (best is not None) & np.isclose(cells.omega, best or np.nan).all(axis=1)
    if is_recommended.any():
        legend_label = style.shared_label(f"recommended, ω₂/ω₁ = {cells.ratio[is_recommended][0]:.4g}")
        place = x.flat[is_recommended], y.flat[is_recommended], starts[is_recommended]
        axes.plot(*place, **style.look("recommended", label=legend_label))
    if cells.waiting.any():
        axes.plot([], [], linestyle="none", label=style.shared_label("blank: waiting"))  # an entry of the legend alone
    axes.view_init(24.0, -128.0)
    axes.set_box_aspect((1.0, 1.0, 0.78), zoom=1.03)
    axes.set_xlabel("ω₁ (1)", labelpad=-6)
    axes.set_ylabel("ω₂ (1)", labelpad=-6)
    axes.set_zlabel(label.replace(", ", "\n"), labelpad=-4)
    axes.grid(visible=False)
    axes.set_zlim(scale.vmin, scale.vmax)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_tick_params(pad=-3)
        axis.pane.set_facecolor("white")
    _tick_decades(axes, 4)
    if not cells.ended.any():
        axes.set_zticks([])
    return style.finish(figure, above=True)


def _starts_of_threshold(cells: SweepCells) -> tuple[np.ndarray, Normalize, str]:
    """Return what a figure shows of all cells: the actual starts of the second stage by the threshold that is chosen.

    A stage has actually started once its effect on the control is above a threshold epsilon; a sweep knows the starts
    for several thresholds.

    Returns:
        The starts (cells,) [s], NaN of cells that have not ended the stage; the scale of their colours, from the
        earliest t_s - T_h to the latest t_s; and the label of the axis.
    """
    starts = np.where(cells.ended, cells.quantity("actual_start")[:, cells.shown_threshold], np.nan)
    label = f"Actual start of {style.readable(cells.names[1])}, ε = {cells.epsilons[cells.shown_threshold]:g} (s)"
    if not cells.ended.any():
        return starts, Normalize(0.0, 1.0), label
    return starts, Normalize(cells.earliest_start[cells.ended].min(), cells.first_switch[cells.ended].max()), label


def _tick_decades(axes: Axes, most: int) -> None:
    """Put the ticks of axes that show logarithms at whole powers of ten, so many at most."""
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(nbins=most, integer=True))
        axis.set_major_formatter("$10^{{{x:.0f}}}$")


def _plot_contour(axes: Axes, x: np.ndarray, y: np.ndarray, delay: np.ndarray, sample_time: float) -> None:
    """Draw the contour around the cells in which the second stage starts as early as the horizon allows.

    Args:
        axes: The panel.
        x: log10 omega_1 of the columns of the grid.
        y: log10 omega_2 of its rows.
        delay: How long after t_s - T_h the stage starts in each cell (rows, columns) [s]; NaN where it is not known.
        sample_time: Cells whose delay is at most this are inside [s].
    """
    known = np.isfinite(delay)
    is_earliest = delay < sample_time + 1e-6
    if is_earliest[known].all() or not is_earliest[known].any():
        return
    values = np.ma.masked_where(~known, is_earliest.astype(float))  # 1 inside, 0 outside
    for color, width in (("white", 2.0), ("black", 1.0)):  # visible on every colour
        axes.contour(x, y, values, levels=[0.5], colors=color, linewidths=width)
    axes.plot([], [], color="black", linewidth=1.0, label=style.shared_label(f"{EARLIEST_START}, to one sample"))


def plot_starts(cells: SweepCells) -> Figure:
    """Plot when the second stage actually starts to act [s] over the ratio of priorities omega_2 / omega_1.

    There is a line for each threshold epsilon, above which the stage's effect on the control counts as its start. The
    start lies between the switch time t_s and t_s - T_h, the earliest possible start. Times before that are shaded.
    """
    figure, (axes,) = _panels_over_ratio(
        cells, [f"Actual start of {style.readable(cells.names[1])} (s)"], 2.3, cells.failed
    )
    if cells.ended.any():
        switch = QuantityByRatio(cells, cells.first_switch)
        earliest = QuantityByRatio(cells, cells.earliest_start)
        margin = 0.06 * cells.task.spec.controller.horizon
        low = float(earliest.lowest.min()) - margin
        high = float(switch.highest.max()) + margin
        axes.plot(switch.ratio, switch.middle, label="$t_s$", **style.LEVEL)
        axes.plot(earliest.ratio, earliest.middle, linestyle=style.DOTTED, label=EARLIEST_START, **style.LEVEL)
        axes.fill_between(earliest.ratio, low, earliest.middle, color=style.STAGE, linewidth=0, zorder=0.5)
        axes.set_ylim(low, high)
        if (best := recommend(cells).ratio) is not None:
            axes.axvline(best, color="black", linewidth=0.9, label=f"recommended {best:.4g}", zorder=1.8)
        starts = cells.quantity("actual_start")
        for threshold in map(int, np.argsort(cells.epsilons)):
            label = f"ε = {cells.epsilons[threshold]:g}"
            _plot_over_ratio(
                axes, QuantityByRatio(cells, starts[:, threshold]), label=label, **style.line_look(threshold)
            )
    style.panel_legend(axes, style.better_side("down", "sooner"))
    return style.finish(figure)


@dataclass(frozen=True, eq=False)
class ComparedQuantity:
    """A quantity of every cell that a recommendation compares; less of it is better.

    Attributes:
        label: The label of its axis.
        better: A word for smaller values, such as sooner.
        values: Its value in every cell (cells,); NaN where it is not known.
        level: A level to compare with; NaN without one.
        level_label: What this level is, for the legend.
        from_zero: Whether its axis begins at 0 where it is linear, as that of a ratio does.
    """

    label: str
    better: str
    values: np.ndarray
    level: float = np.nan
    level_label: str = ""
    from_zero: bool = False


def _compared_quantities(cells: SweepCells) -> list[ComparedQuantity]:
    """List the quantities by which a ratio of priorities is recommended, for the figure that shows why.

    Each comes with the level that it is compared with: its value with the task's own priorities, or what is allowed.
    Quantities are left out of which no cell that has ended the second stage has a value.
    """

    def beside_reference(label: str, better: str, name: str) -> ComparedQuantity:
        """Compare a quantity of the cells, by its name in the results, with that of the task's own priorities."""
        return ComparedQuantity(label, better, cells.quantity(name), float(cells.reference(name)), "task's own")

    mission_end = np.where(cells.succeeded, cells.mission_end, np.nan)
    quantities = (
        ComparedQuantity("Mission ends\n(s)", "sooner", mission_end),
        beside_reference("Control effort\n(m²/s³, rad²/s³)", "less effort", "control_effort"),
        beside_reference("Peak base force\n(N)", "gentler", "peak_base_force"),
        ComparedQuantity(
            "End error\n(tolerances)", "closer", cells.end_error, ALLOWED_ERROR, "allowed", from_zero=True
        ),
    )
    return [quantity for quantity in quantities if np.isfinite(quantity.values[cells.ended]).any()]


def has_compared_quantities(cells: SweepCells) -> bool:
    """Tell whether any quantity that a recommendation compares is known of a cell."""
    return len(_compared_quantities(cells)) > 0


def plot_sensitivity(cells: SweepCells) -> Figure:
    """Plot over the ratio of priorities the quantities by which a ratio is recommended, to show why it is this one.

    The panels are the end of the mission [s]; the control effort [m^2/s^3, rad^2/s^3] and the peak force on the base
    [N], both with their level with the task's own priorities; and the largest end error [tolerances]. Vertical lines
    are at the task's own ratio and at the recommended one. Runs whose mission failed are marked at the lower edge, and
    have no end of the mission.
    """
    quantities = _compared_quantities(cells)
    labels = [quantity.label for quantity in quantities]
    figure, all_axes = _panels_over_ratio(cells, labels, 0.95, cells.failed | (cells.ended & ~cells.succeeded))
    best = recommend(cells).ratio
    for axes, compared in zip(all_axes, quantities, strict=True):
        if cells.ratio.min() <= cells.own_ratio <= cells.ratio.max():
            # the first panel explains the vertical lines of all
            label = f"task's {cells.own_ratio:.4g}" if axes is all_axes[0] else style.NO_LABEL
            axes.axvline(cells.own_ratio, linestyle=style.DOTTED, label=label, **style.LEVEL)
        if best is not None:
            label = f"recommended {best:.4g}" if axes is all_axes[0] else style.NO_LABEL
            axes.axvline(best, color=style.PALETTE[1], linewidth=1.1, label=label, zorder=1.8)
        if np.isfinite(compared.level):
            axes.axhline(compared.level, linestyle=style.DASHED, label=compared.level_label, **style.LEVEL)
        _plot_over_ratio(axes, QuantityByRatio(cells, compared.values), **style.line_look(0))
        _choose_scale(axes, np.append(compared.values[cells.ended], compared.level))
        if compared.from_zero and axes.get_yscale() == "linear":
            axes.set_ylim(0.0, 1.15 * float(np.nanmax(np.append(compared.values[cells.ended], compared.level))))
            axes.yaxis.set_major_locator(MaxNLocator(nbins=5, prune="lower"))
        style.panel_legend(axes, style.better_side("down", compared.better))
    return style.finish(figure)


def _choose_scale(axes: Axes, values: np.ndarray) -> None:
    """Make an axis logarithmic if its values differ so much that a linear one cannot show them all."""
    known = values[np.isfinite(values)]
    low = float(known.min(initial=np.inf))
    high = float(known.max(initial=0.0))
    axes.margins(y=0.12)
    if high > 5.0 * low > 0:
        style.make_logarithmic(axes, subs=(1.0, 2.0, 5.0) if high < 300.0 * low else (1.0,))


def _panels_over_ratio(
    cells: SweepCells, labels: Sequence[str], height: float, failed: np.ndarray
) -> tuple[Figure, list[Axes]]:
    """Make a figure of panels below each other over the ratio of priorities omega_2 / omega_1, on a logarithmic axis.

    Cells that failed are marked along the lower edge of the first panel; the panels are empty besides.

    Args:
        cells: The sweep. The axis has the range of its ratios, also of cells that have not been run.
        labels: Labels of the panels' vertical axes.
        height: Height of each panel [in].
        failed: Which cells are marked as failed (cells,).

    Returns:
        The figure and its panels.
    """
    figure, rows = style.stack(labels, [height] * len(labels), "Ratio of the priorities, ω₂/ω₁ (1)")
    low = float(cells.ratio.min())
    high = float(cells.ratio.max())
    margin_factor = (high / low) ** 0.02 if high > low else 2.0
    rows[0].set(xscale="log", xlim=(low / margin_factor, high * margin_factor))
    rows[0].xaxis.set_major_locator(LogLocator(numticks=8))
    rows[0].xaxis.set_minor_locator(NullLocator())
    if failed.any():
        ratio = np.unique(cells.ratio[failed])
        # x is a ratio, y a fraction of the panel's height, just above its lower edge
        at_lower_edge = rows[0].get_xaxis_transform()
        rows[0].plot(ratio, np.full(len(ratio), 0.045), transform=at_lower_edge, **style.look("failed", label="failed"))
    return figure, rows


def _plot_over_ratio(axes: Axes, values: QuantityByRatio, **look: Any) -> None:
    """Plot a quantity over the ratio, and how far the cells of one ratio lie apart, where they do."""
    axes.plot(values.ratio, values.middle, marker="o", markersize=2.2, **look)
    if np.any(values.highest > values.lowest):
        band = {"color": look["color"], "alpha": 0.2, "linewidth": 0}
        axes.fill_between(values.ratio, values.lowest, values.highest, label=style.shared_label(RANGE), **band)
