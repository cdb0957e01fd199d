"""The runs of a Monte Carlo study: how often they succeed, when their stages end, how near limits they come."""

from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from psmpc_cli.errors import LogError
from psmpc_cli.figures.files import draw_chosen
from psmpc_cli.figures.panels import panel_legend
from psmpc_cli.figures.style import EDGE, LINE, PALETTE, TEXT, grow, line_look, new_figure, readable
from psmpc_cli.simulation.monte_carlo_runs import MonteCarloRuns

RATE_HEIGHT, INSTANTS_HEIGHT = 0.45, 1.9
"""Heights of the panels of the success rate and of the instants [in]."""

PANEL_HEIGHT, AROUND = 1.15, 0.65
"""Height of a panel over the runs, and of what is around all of them [in]."""

SIZE, RING = 3.0, 6.5
"""Sizes of the marks of runs, and of the rings around those that failed [pt]."""

WIDE = 30.0
"""Errors of which the largest is so many times the smallest have an axis of logarithms."""

MARKS = ("o", "^", "s", "D")

FAILED: Mapping[str, Any] = {
    "color": "black",
    "marker": "o",
    "markersize": RING,
    "markeredgewidth": 0.6,
    "markerfacecolor": "none",
    "linestyle": "none",
    "zorder": 1.8,
}
"""The ring around a run that failed, behind the marks."""

LOST: Mapping[str, Any] = {"color": "black", "marker": "x", "markersize": SIZE + 1, "linestyle": "none"}
"""What marks one without a value, on the lower edge of a panel."""


def draw_monte_carlo(
    runs: MonteCarloRuns,
    directory: Path,
    formats: Sequence[str] = ("png",),
    only: Collection[str] | None = None,
    force: bool = False,
) -> list[Path]:
    """Draw figures of a study, complete or not, each into a file a format, and return the files.

    Raises:
        InputError: A name or format is unknown, a file exists or cannot be written.
        LogError: All runs wait, or the file lacks what a study has.
    """
    if not runs.made.any():
        raise LogError(f"{runs.results.path}: found no run that was made, expected one at least to draw")
    return draw_chosen(FIGURES, runs, directory, formats, only, force)


def plot_success(runs: MonteCarloRuns) -> Figure:
    """Return the success rate with its interval, and the part of the runs whose stages have ended over time [s].

    The times of a stage are told from their median, which the legend names; those of the last one are the ends of the
    mission. A curve that ends below 1 belongs to a stage that not every run has ended.
    """
    figure = new_figure(RATE_HEIGHT + INSTANTS_HEIGHT + AROUND)
    rate, instants = figure.subplots(2, 1, height_ratios=(RATE_HEIGHT, INSTANTS_HEIGHT))
    _plot_rate(rate, runs)
    times = runs["switch_time"]
    for number, stage in enumerate(runs.stages):
        ended = np.sort(times[np.isfinite(times[:, number]), number])
        if len(ended):
            _plot_distribution(instants, ended, int(runs.made.sum()), readable(stage), **line_look(number))
    instants.set_xlabel("Instant that ends the stage, less its median (s)")
    instants.set_ylabel("Part of the runs (1)")
    instants.locator_params(axis="x", nbins=5)
    instants.set_ylim(-0.04, 1.04)
    panel_legend(instants)
    if (legend := instants.get_legend()) is not None:
        grow(instants, LINE)
        legend.set_title("Stage, median of its end", {"size": TEXT})
        legend.set_alignment("left")
    return figure


def _plot_rate(axes: Axes, runs: MonteCarloRuns) -> None:
    """Plot the success rate with Wilson's interval."""
    made, succeeded = int(runs.made.sum()), int(runs.succeeded.sum())
    rate, (low, high) = succeeded / made, runs.interval
    axes.errorbar(rate, 0.0, xerr=[[rate - low], [high - rate]], marker="o", color=PALETTE[0], capsize=3.0)
    axes.set_xlim(-0.02, 1.02)
    axes.set_yticks([])
    axes.set_xlabel("Success rate with its 95 % interval (1)")
    axes.set_title(f"{succeeded} of {made} runs succeeded", loc="right", pad=3.0)


def _plot_distribution(axes: Axes, ended: np.ndarray, made: int, name: str, **look: Any) -> None:
    """Plot the part of the runs (., ) [s] that have ended a stage by a time."""
    median = float(np.median(ended))
    part = np.arange(len(ended) + 1) / made
    axes.step(np.r_[ended[0], ended] - median, part, where="post", label=f"{name}, {median:.1f} s", **look)


def plot_runs(runs: MonteCarloRuns) -> Figure:
    """Return final error [tolerances], tightest margins [%] and those of the monitors [m, m/s] of every run."""
    panels: list[Callable[[Axes, MonteCarloRuns], None]] = [_plot_errors, _plot_margins]
    panels += [_plot_monitors] if runs.monitors else []
    figure = new_figure(len(panels) * PANEL_HEIGHT + AROUND)
    rows = figure.subplots(len(panels), 1, sharex=True)
    for axes, plot in zip(rows, panels, strict=True):
        plot(axes, runs)
        panel_legend(axes)
    rows[-1].set_xlabel("Seed of the run (1)")
    rows[-1].xaxis.set_major_locator(MaxNLocator(integer=True))
    figure.align_ylabels()
    return figure


def _plot_errors(axes: Axes, runs: MonteCarloRuns) -> None:
    error = runs["final_error"]
    _plot_by_run(axes, runs, {"": error})
    known = error[np.isfinite(error) & (error > 0)]
    if len(known) and known.max() > WIDE * known.min():
        axes.set_yscale("log")
    else:
        axes.set_ylim(0.0, 1.12 * max(1.0, float(np.nanmax(error, initial=0.0))))
    _draw_line(axes, 1.0, "tolerance")
    axes.set_ylabel("Final error\n(tolerances)")


def _plot_margins(axes: Axes, runs: MonteCarloRuns) -> None:
    _plot_by_run(axes, runs, {kind: 100 * runs[f"relative_{kind}_margin"] for kind in ("position", "velocity")})
    _draw_line(axes, 0.0, "limit")
    axes.set_ylabel("Tightest margin\n(% of the limit)")


def _plot_monitors(axes: Axes, runs: MonteCarloRuns) -> None:
    margins = runs["monitor_margin"].T
    _plot_by_run(axes, runs, {readable(name): margin for name, margin in zip(runs.monitors, margins, strict=True)})
    _draw_line(axes, 0.0, "bound")
    axes.set_ylabel("Margin of monitor\n(m, m/s)")


def _draw_line(axes: Axes, level: float, name: str) -> None:
    """Draw what the values of a panel should stay on one side of."""
    axes.axhline(level, color=EDGE, linewidth=0.7, zorder=1.5, label=name)


def _plot_by_run(axes: Axes, runs: MonteCarloRuns, values: Mapping[str, np.ndarray]) -> None:
    """Plot quantities (runs,) over the seed; failed runs are ringed, or crosses on the lower edge without values."""
    seed, failed = runs["seed"], runs.failed
    for number, (name, value) in enumerate(values.items()):
        look = line_look(number) | {"marker": MARKS[number % len(MARKS)], "linestyle": "none"}
        axes.plot(seed, value, markersize=SIZE, markeredgewidth=0, label=name or "_all", **look)
        axes.plot(seed[failed], value[failed], **FAILED)
    axes.margins(y=0.12)
    known = np.isfinite(list(values.values())).any(axis=0)
    if (failed & known).any():
        axes.plot([], [], label="failed", **FAILED)
    if (lost := seed[failed & ~known]).size:
        below = axes.get_xaxis_transform()
        axes.plot(lost, np.zeros(len(lost)), transform=below, label="failed, no value", clip_on=False, **LOST)


FIGURES: Mapping[str, Callable[[MonteCarloRuns], Figure]] = {"success": plot_success, "runs": plot_runs}
"""Every figure of a study by its name, which is also its file's stem."""
