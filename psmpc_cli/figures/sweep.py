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
from psmpc_cli.studies.sweep import ALLOWED_ERROR, AlongRatio, SweepCells, recommend

EARLIEST_START = "$t_s - T_h$"

RANGE = "lowest to highest of one ratio"
"""What a band about a line over the ratio is."""

FAILED_MISSION: Mapping[str, Any] = {
    "name": "ring around a failed run",
    "label": "_mission failed",
    "zorder": 4,
    "path_effects": [withStroke(linewidth=1.8, foreground="white")],
}
"""Look of a cell that ended the second stage, but not the mission with success; visible on every colour."""


def plot_heat_map(cells: SweepCells) -> Figure:
    """Plot the actual start of the second stage [s] over both priorities, as colours of the cells of a grid.

    A contour parts the cells in which the start is t_s - T_h, the earliest possible: then the stage acts as soon as it
    is in the window. Starts are known to one sample: within the contour the start is the first sample after t_s - T_h.
    """
    figure, (axes,) = style.stack([""], [2.4], "")
    starts, scale, label = _starts_of_threshold(cells)
    x, y = (np.log10(cells.results[name]) for name in ("omega_1", "omega_2"))
    start, earliest = (values.reshape(len(y), len(x)) for values in (starts, cells.earliest_start))
    axes.pcolormesh(x, y, np.ma.masked_invalid(start), norm=scale, shading="nearest")
    _plot_contour(axes, x, y, start - earliest, cells.task.spec.controller.sample_time)
    if cells.waiting.any():
        axes.bar(x[0], 0, color="white", label=["_waiting"])
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
        label = f"_recommended, ω₂/ω₁ = {best[1] / best[0]:.4g}"
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
    """Plot the actual start of the second stage [s] over both priorities, as a surface.

    It lies between frames at the switch time t_s and at t_s - T_h, the earliest possible start, since the stage is in
    no window before. Failed cells and the recommended one are marked.
    """
    figure = style.new_figure()
    figure.set_figheight(3.0)
    axes: Any = figure.add_axes((0.09, 0.0, 0.91, 1.0), projection="3d", proj_type="ortho", computed_zorder=False)
    starts, scale, label = _starts_of_threshold(cells)
    shape = cells.results["status"].shape
    failed = cells.failed
    x, y = (omega.reshape(shape) for omega in np.log10(cells.omega.T))
    corners = [x.min(), x.max(), x.max(), x.min(), x.min()], [y.min(), y.min(), y.max(), y.max(), y.min()]
    if failed.any():
        axes.plot(x.flat[failed], y.flat[failed], np.full(failed.sum(), scale.vmin), **style.look("failed"))
    if cells.ended.any():  # from the lowest to the highest, as they cover each other
        axes.plot(*corners, [scale.vmin] * 5, linestyle=style.DASHED, label=f"_{EARLIEST_START}", **style.LEVEL)
        colors = ScalarMappable(scale).to_rgba(starts.reshape(shape))
        look = {"rstride": 1, "cstride": 1, "shade": False, "edgecolor": style.EDGE, "linewidth": 0.2}
        axes.plot_surface(x, y, starts.reshape(shape), facecolors=colors, **look)
        axes.plot(*corners, [scale.vmax] * 5, label="_$t_s$", **style.LEVEL)
    if (mission_failed := cells.ended & ~cells.succeeded).any():
        axes.plot(
            x.flat[mission_failed], y.flat[mission_failed], starts[mission_failed], **style.look(**FAILED_MISSION)
        )
    best = recommend(cells).omega
    is_recommended = cells.ended & (best is not None) & np.isclose(cells.omega, best or np.nan).all(axis=1)
    if is_recommended.any():
        name = f"_recommended, ω₂/ω₁ = {cells.ratio[is_recommended][0]:.4g}"
        axes.plot(
            x.flat[is_recommended],
            y.flat[is_recommended],
            starts[is_recommended],
            **style.look("recommended", label=name),
        )
    if cells.waiting.any():
        axes.plot([], [], linestyle="none", label="_blank: waiting")
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
    """Take the actual starts for the one threshold that is shown, with their scale and their label.

    They are NaN where no cell has ended (cells,) [s]; the scale is from the earliest t_s - T_h to the latest t_s.
    """
    starts = np.where(cells.ended, cells.quantity("actual_start")[:, cells.chosen], np.nan)
    label = f"Actual start of {style.readable(cells.names[1])}, ε = {cells.epsilons[cells.chosen]:g} (s)"
    if not cells.ended.any():
        return starts, Normalize(0.0, 1.0), label
    return starts, Normalize(cells.earliest_start[cells.ended].min(), cells.first_switch[cells.ended].max()), label


def _tick_decades(axes: Axes, most: int) -> None:
    """Put the ticks of axes that show logarithms at whole powers of ten, so many at most."""
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(nbins=most, integer=True))
        axis.set_major_formatter("$10^{{{x:.0f}}}$")


def _plot_contour(axes: Axes, x: np.ndarray, y: np.ndarray, above: np.ndarray, sample: float) -> None:
    """Draw the contour between the cells that start less than a sample after t_s - T_h and the others."""
    known = np.isfinite(above)
    near = above < sample + 1e-6
    if near[known].all() or not near[known].any():
        return
    for color, width in (("white", 2.0), ("black", 1.0)):  # visible on every colour
        axes.contour(x, y, np.ma.masked_where(~known, near.astype(float)), levels=[0.5], colors=color, linewidths=width)
    axes.plot([], [], color="black", linewidth=1.0, label=f"_{EARLIEST_START}, to one sample")


def plot_starts(cells: SweepCells) -> Figure:
    """Plot the actual start of the second stage [s] over the ratio of priorities, a line for each threshold.

    It lies between the switch time t_s and t_s - T_h, the earliest possible start; what is below that is shaded.
    """
    figure, (axes,) = _panels_over_ratio(
        cells, [f"Actual start of {style.readable(cells.names[1])} (s)"], 2.3, cells.failed
    )
    if cells.ended.any():
        switch = AlongRatio(cells, cells.first_switch)
        earliest = AlongRatio(cells, cells.earliest_start)
        room = 0.06 * cells.task.spec.controller.horizon
        low = float(earliest.lowest.min()) - room
        high = float(switch.highest.max()) + room
        axes.plot(switch.ratio, switch.middle, label="$t_s$", **style.LEVEL)
        axes.plot(earliest.ratio, earliest.middle, linestyle=style.DOTTED, label=EARLIEST_START, **style.LEVEL)
        axes.fill_between(earliest.ratio, low, earliest.middle, color=style.STAGE, linewidth=0, zorder=0.5)
        axes.set_ylim(low, high)
        if (best := recommend(cells).ratio) is not None:
            axes.axvline(best, color="black", linewidth=0.9, label=f"recommended {best:.4g}", zorder=1.8)
        starts = cells.quantity("actual_start")
        for threshold in map(int, np.argsort(cells.epsilons)):
            label = f"ε = {cells.epsilons[threshold]:g}"
            _plot_over_ratio(axes, AlongRatio(cells, starts[:, threshold]), label=label, **style.line_look(threshold))
    style.panel_legend(axes, style.better_side("down", "sooner"))
    return style.finish(figure)


@dataclass(frozen=True, eq=False)
class ComparedQuantity:
    """A quantity of every cell that a recommendation compares; less of it is better.

    Attributes:
        label: The label of its axis.
        less: What less of it is.
        values: Its value in every cell (cells,); NaN where it is not known.
        level: A level to compare with; NaN without one.
        level_label: What this level is.
        from_zero: Whether its axis begins at 0 where it is linear, as that of a ratio does.
    """

    label: str
    less: str
    values: np.ndarray
    level: float = np.nan
    level_label: str = ""
    from_zero: bool = False


def _compared_quantities(cells: SweepCells) -> list[ComparedQuantity]:
    """List the quantities by which a ratio of priorities is recommended, of those that some ended cell has.

    Each comes with the level that it is compared with: the value with the task's own priorities, or what is allowed.
    """

    def beside_reference(label: str, less: str, name: str) -> ComparedQuantity:
        """Compare a quantity of the cells, by name, with that of the task's own priorities."""
        return ComparedQuantity(label, less, cells.quantity(name), float(cells.reference(name)), "task's own")

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
    """Plot what a recommended ratio of priorities is chosen by, over the ratio, with the recommended one.

    Panels: the end of the mission [s], the control effort [m^2/s^3, rad^2/s^3] and the peak force on the base [N], both
    with the level of the task's own priorities, and the largest end error [tolerances]. Runs whose mission failed are
    marked at the lower edge, and their end is left out.
    """
    quantities = _compared_quantities(cells)
    labels = [quantity.label for quantity in quantities]
    figure, all_axes = _panels_over_ratio(cells, labels, 0.95, cells.failed | (cells.ended & ~cells.succeeded))
    best = recommend(cells).ratio
    for axes, compared in zip(all_axes, quantities, strict=True):
        if cells.ratio.min() <= cells.own_ratio <= cells.ratio.max():
            label = f"task's {cells.own_ratio:.4g}" if axes is all_axes[0] else "_"
            axes.axvline(cells.own_ratio, linestyle=style.DOTTED, label=label, **style.LEVEL)
        if best is not None:
            label = f"recommended {best:.4g}" if axes is all_axes[0] else "_"
            axes.axvline(best, color=style.PALETTE[1], linewidth=1.1, label=label, zorder=1.8)
        if np.isfinite(compared.level):
            axes.axhline(compared.level, linestyle=style.DASHED, label=compared.level_label, **style.LEVEL)
        _plot_over_ratio(axes, AlongRatio(cells, compared.values), **style.line_look(0))
        _choose_scale(axes, np.append(compared.values[cells.ended], compared.level))
        if compared.from_zero and axes.get_yscale() == "linear":
            axes.set_ylim(0.0, 1.15 * float(np.nanmax(np.append(compared.values[cells.ended], compared.level))))
            axes.yaxis.set_major_locator(MaxNLocator(nbins=5, prune="lower"))
        style.panel_legend(axes, style.better_side("down", compared.less))
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
    """Make a figure of panels over the ratio of priorities, with failed cells along the first one's lower edge.

    Args:
        cells: The sweep, whose ratios give the range, run or not.
        labels: Labels of the panels.
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
        below = rows[0].get_xaxis_transform()
        rows[0].plot(ratio, 0.045 + 0 * ratio, transform=below, **style.look("failed", label="failed"))
    return figure, rows


def _plot_over_ratio(axes: Axes, values: AlongRatio, **look: Any) -> None:
    """Plot a quantity over the ratio, and how far the cells of one ratio lie apart, where they do."""
    axes.plot(values.ratio, values.middle, marker="o", markersize=2.2, **look)
    if np.any(values.highest > values.lowest):
        band = {"color": look["color"], "alpha": 0.2, "linewidth": 0}
        axes.fill_between(values.ratio, values.lowest, values.highest, label=f"_{RANGE}", **band)
