"""Panels of generalized coordinates: base position, base angles, then one panel an arm."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter

from psmpc_cli.figures.run import Run
from psmpc_cli.figures.style import (
    AXIS_WIDTH,
    EDGE,
    HANDLE,
    LINE,
    TEXT,
    grow,
    legend_columns,
    line_look,
    readable,
    text_width,
)
from psmpc_cli.figures.timeline import open_timeline
from psmpc_cli.robot.model import RobotModel

HEIGHT = 0.92
"""Height of one panel [in]."""

FARTHEST = 4.0
"""Limits farther away than so many times the largest value are not drawn: nothing else could be read."""

PEAK = 5.0
"""Peaks so many times as large as 19 in 20 values dwarf the rest."""

APART = 1.5
"""Distance of two lines that can be told apart in print [pt]: more than the width of one."""

SEEN: Mapping[str, Any] = {"color": "#7A7A7A", "linewidth": 0.55}
"""How that is drawn which the controller saw."""

Kind = Literal["position", "velocity", "acceleration"]


@dataclass(frozen=True)
class Panel:
    """Rows of a vector of generalized coordinates that share a panel."""

    name: str
    rows: slice
    labels: tuple[str, ...]
    angular: bool


@dataclass(frozen=True)
class Quantity:
    """What is plotted.

    Attributes:
        words, units: For linear, then for angular coordinates.
        peaked: It may have short peaks beside which nothing else could be read; the axis is then logarithmic far out.
    """

    words: tuple[str, str]
    units: tuple[str, str]
    peaked: bool = False


def coordinate_panels(model: RobotModel) -> tuple[Panel, ...]:
    """Return the panels of Q: base position, base angles, then each arm."""
    base, d = model.parts["base"], model.dimension
    angles = ("θ",) if base.stop - base.start - d == 1 else ("yaw", "pitch", "roll")
    arms = (
        Panel(
            readable(name), rows, tuple(_joint(i, rows.stop - rows.start) for i in range(rows.stop - rows.start)), True
        )
        for name, rows in model.parts.items()
        if name != "base"
    )
    return (
        Panel("base", slice(base.start, base.start + d), ("x", "y", "z")[:d], False),
        Panel("base", slice(base.start + d, base.stop), angles, True),
        *arms,
    )


def plot_coordinates(
    run: Run,
    time: np.ndarray,
    values: np.ndarray,
    quantity: Quantity,
    limits: Kind | None = None,
    seen: np.ndarray | None = None,
) -> Figure:
    """Return a figure of values (K, n) over time (K,) [s], with the limits of that kind in force.

    Args:
        run: The run.
        time: Of each row.
        values: In the order of Q.
        quantity: What they are.
        limits: Which limits to draw.
        seen: What the controller saw of the values (K, n), drawn where it can be told apart from them.
    """
    panels = coordinate_panels(run.model)
    timeline = open_timeline(run, len(panels), HEIGHT)
    bounded = blurred = False
    for axes, panel in zip(timeline.panels, panels, strict=True):
        notes: list[str] = []
        plot_lines(axes, time, values[:, panel.rows], panel.labels)
        if limits is not None:
            within, notes = _plot_limits(axes, run, limits, panel.rows, values)
            bounded |= within
        if seen is not None:
            blurred |= _plot_seen(axes, time, values[:, panel.rows], seen[:, panel.rows])
        if quantity.peaked:
            notes += _compress(axes, values[:, panel.rows])
        axes.set_ylabel(axis_label(panel, quantity))
        panel_legend(axes, ", ".join(notes))
    limit = [Line2D([], [], color=EDGE, linewidth=0.7, label="limit")] if bounded else []
    return timeline.finish([*limit, *([Line2D([], [], label="seen by the controller", **SEEN)] if blurred else [])])


def panel_legend(axes: Axes, note: str = "", line: float = HANDLE) -> None:
    """Write a note and the legend, with lines of length `line` [em], above a panel, where they cover no curve."""
    axes.set_title(note, loc="left", pad=3.5, fontsize=TEXT)
    handles, labels = axes.get_legend_handles_labels()
    if handles:
        fitting = legend_columns(labels, AXIS_WIDTH - text_width(note), line)
        rows = -(-len(handles) // fitting)
        columns = -(-len(handles) // rows)
        grow(axes, (rows - 1) * LINE)
        axes.legend(handles=handles, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=columns, handlelength=line)


def axis_label(panel: Panel, quantity: Quantity) -> str:
    """Return name, quantity and unit on two lines, broken so that they fit the panel's height."""
    name, word, unit = panel.name.capitalize(), quantity.words[panel.angular], f"({quantity.units[panel.angular]})"
    return f"{name} {word}\n{unit}" if text_width(f"{name} {word}") < HEIGHT else f"{name}\n{word} {unit}"


def point_if_alone(time: np.ndarray) -> str:
    """Return the marker of a curve: none, but a single point where the curve is nothing else."""
    return "o" if len(np.unique(time)) == 1 else ""


def _joint(index: int, joints: int) -> str:
    return f"joint {index + 1}" if joints <= 4 else f"{index + 1}"


def plot_lines(axes: Axes, time: np.ndarray, values: np.ndarray, labels: Sequence[str]) -> None:
    """Plot values (K, len(labels)) over time (K,) [s], a line a column."""
    for i, label in enumerate(labels):
        axes.plot(time, values[:, i], label=label, marker=point_if_alone(time), **line_look(i))
    axes.margins(y=0.08)


def _plot_seen(axes: Axes, time: np.ndarray, values: np.ndarray, seen: np.ndarray) -> bool:
    """Draw what was seen (K, i) beneath those values (K, i) it can be told apart from; return whether there are any."""
    low, high = axes.get_ylim()
    apart = np.nanmax(np.abs(seen - values), axis=0, initial=0.0) * 72 * HEIGHT / (high - low) > APART
    for column in np.flatnonzero(apart):
        axes.plot(time, seen[:, column], label="_seen", zorder=1.4, **SEEN)
    return bool(apart.any())


def _compress(axes: Axes, values: np.ndarray) -> list[str]:
    """Make the axis logarithmic from a tenth of the peak's power of ten on, and say so, if peaks dwarf the rest."""
    size = np.abs(values[np.isfinite(values)])
    peak = float(np.max(size, initial=0.0))
    if peak <= PEAK * float(np.quantile(size, 0.95)) or peak == 0.0:
        return []
    threshold = 10.0 ** (np.floor(np.log10(peak)) - 1)
    axes.set_yscale("symlog", linthresh=threshold)
    axes.set_yticks(threshold * np.array([-10.0, -1.0, 0.0, 1.0, 10.0]), minor=False)
    axes.set_yticks([], minor=True)
    axes.yaxis.set_major_formatter(FuncFormatter(lambda y, _: f"{y:g}".replace("-", "\N{MINUS SIGN}")))
    return [f"log beyond ±{threshold:g}"]


def _plot_limits(axes: Axes, run: Run, kind: Kind, rows: slice, values: np.ndarray) -> tuple[bool, list[str]]:
    """Draw the limits in force; return whether any is seen, and a note where some are too far away to be drawn."""
    time, low, high = limits_in_force(run, kind)
    largest, seen, beyond = float(np.nanmax(np.abs(values[:, rows]), initial=0.0)), False, False
    bounds = np.hstack([low[:, rows], high[:, rows]])
    shared = len(np.unique(low[:, rows], axis=1).T) == 1 and len(np.unique(high[:, rows], axis=1).T) == 1
    width = low[:, rows].shape[1]
    for i in [0, width] if shared else range(2 * width):
        bound = np.where(np.isfinite(bounds[:, i]), bounds[:, i], np.nan)
        if np.all(np.isnan(bound)):
            continue
        if np.nanmin(np.abs(bound)) > FARTHEST * largest > 0:
            beyond = True
            continue
        color = EDGE if shared else line_look(i % width)["color"]
        axes.plot(time, bound, color=color, linewidth=0.7, label="_limit", zorder=1.5)
        seen = True
    return seen, ["limits beyond the axis"] if beyond else []


def limits_in_force(run: Run, kind: Kind) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return times (2 S,) [s] and the lower and upper limits (2 S, n) of the current stage between them."""
    times = np.array([edge for span in run.spans for edge in (span.start, span.end)])
    low, high = (
        np.array([getattr(run.stages[span.index].limits, f"{kind}_{side}") for span in run.spans for _ in range(2)])
        for side in ("low", "high")
    )
    return times, low, high
