"""The runs of a Monte Carlo study: how often they succeed, when their stages end, how near to limits they come."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from psmpc_cli.figures import style
from psmpc_cli.studies.monte_carlo import MonteCarloRuns, wilson_interval

INTERVAL = "95 % interval of the fraction"
"""What a band about a curve of fractions is."""


def plot_success(runs: MonteCarloRuns) -> Figure:
    """Plot how surely and how evenly random runs end their stages: the fraction of runs that have, over time [s].

    There is a curve for each stage, over the time less the median of the stage's ends, which the legend names. The ends
    of the last stage are those of the mission. A curve that ends below 1 belongs to a stage that not every run has
    ended. Bands are Wilson's 95 % score intervals of the fraction at each time. The success rate is above the figure.
    """
    xlabel = "Switch time that ends the stage, less its median (s)"
    figure, (axes,) = style.stack(["Fraction of runs (1)"], [2.2], xlabel)
    times = runs["switch_time"]  # at which each run ended each stage (runs, stages) [s]; NaN where it did not
    n_runs = int(runs.made.sum())
    for number, stage in enumerate(runs.stages):
        ended = np.sort(times[np.isfinite(times[:, number]), number])
        if len(ended):
            median = float(np.median(ended))
            fraction = np.arange(len(ended) + 1) / n_runs  # it begins at 0, at the time of the first end
            label = f"{style.readable(stage)}, {median:.1f} s"
            time_after_median = np.r_[ended[0], ended] - median
            axes.step(time_after_median, fraction, where="post", label=label, **style.line_look(number))
            low, high = np.array([wilson_interval(count, n_runs) for count in range(len(ended) + 1)]).T
            band = {"color": style.line_look(number)["color"], "alpha": 0.15, "linewidth": 0}
            axes.fill_between(time_after_median, low, high, step="post", label=style.shared_label(INTERVAL), **band)
    axes.locator_params(axis="x", nbins=5)
    axes.set_ylim(-0.04, 1.04)
    style.panel_legend(axes, style.better_side("left", "sooner"), title="Stage, median of its end")
    low, high = (100 * bound for bound in runs.interval)
    rate = f"{runs.succeeded.sum()} of {n_runs} runs succeeded; 95 % interval of the rate: {low:.0f} to {high:.0f} %"
    figure.suptitle(rate)
    return style.finish(figure)


@dataclass(frozen=True, eq=False)
class MeasuredQuantity:
    """A quantity that is measured of every run and has a panel of its own.

    Attributes:
        label: The label of its axis.
        values: For each curve's name the values (runs,), NaN where they are not known.
        level: The level that values are judged by, such as a limit.
        level_label: What the level is, for the legend.
        better: Where values are better, up or down, in an arrow and a word.
    """

    label: str
    values: Mapping[str, np.ndarray]
    level: float
    level_label: str
    better: str

    @property
    def all_values(self) -> np.ndarray:
        """All values (names, runs)."""
        return np.array(list(self.values.values()))


def measured_quantities(runs: MonteCarloRuns) -> list[MeasuredQuantity]:
    """List the quantities that have a panel in the figure of random runs: those of which some run has a value.

    They are the final error [tolerances], the margins to position and velocity limits [%], and the margins of the
    task's monitors (signals that are to stay within bounds), one panel for each unit.
    """
    margins = {kind: 100 * runs[f"relative_{kind}_margin"] for kind in ("position", "velocity")}
    safer = style.better_side("up", "safer")
    quantities = [
        MeasuredQuantity(
            "Final error\n(tolerances)",
            {"": runs["final_error"]},
            1.0,
            "tolerance",
            style.better_side("down", "closer"),
        ),
        MeasuredQuantity("Tightest margin\n(% of the limit)", margins, 0.0, "limit", safer),
    ]
    margin_of_monitor = dict(zip(runs.monitors, runs["monitor_margin"].T, strict=True)) if runs.monitors else {}
    for unit in dict.fromkeys(runs.monitors.values()):
        monitored = {
            style.readable(name): margin_of_monitor[name]
            for name, unit_of_monitor in runs.monitors.items()
            if unit_of_monitor == unit
        }
        quantities.append(MeasuredQuantity(f"Margin of monitor\n({unit})", monitored, 0.0, "bound", safer))
    return [quantity for quantity in quantities if np.isfinite(quantity.all_values).any()]


def has_measured_quantities(runs: MonteCarloRuns) -> bool:
    """Tell whether anything is measured of any run."""
    return len(measured_quantities(runs)) > 0


def plot_runs(runs: MonteCarloRuns) -> Figure:
    """Plot errors and margins of every random run over its seed, to find the runs that failed or nearly did.

    There is a panel for each quantity and unit. Failed runs are ringed; those without a value are crosses on the lower
    edge of the panel.
    """
    panels = measured_quantities(runs)
    figure, all_axes = style.stack([panel.label for panel in panels], [1.1] * len(panels), "Seed of the run (1)")
    seed = runs["seed"]
    failed = runs.failed
    for axes, panel in zip(all_axes, panels, strict=True):
        for number, (name, value) in enumerate(panel.values.items()):
            look = {"linestyle": "none", "markersize": 3.0, "markeredgewidth": 0, **style.mark_look(number)}
            axes.plot(seed, value, label=name or style.NO_LABEL, **look)
            axes.plot(seed[failed], value[failed], **style.look("ring around a failed run", label=style.NO_LABEL))
        axes.axhline(panel.level, label=style.NO_LABEL, **style.LEVEL)
        axes.margins(y=0.12)
        note = style.use_symlog_if_peaks_hide_rest(axes, panel.all_values)
        if not note and (panel.all_values >= 0).all():
            axes.set_ylim(bottom=0.0)
        has_value = np.isfinite(panel.all_values).any(axis=0)
        if (failed & has_value).any():
            # an entry of the legend that draws nothing, as in the plots below
            axes.plot([], [], **style.look("ring around a failed run", label="failed"))
        if (without_value := seed[failed & ~has_value]).size:
            # with this transform 0 is the lower edge of the panel
            look = style.look("failed", label="failed, no value", transform=axes.get_xaxis_transform(), clip_on=False)
            axes.plot(without_value, np.zeros(len(without_value)), **look)
        axes.plot([], [], label=panel.level_label, **style.LEVEL)
        style.panel_legend(axes, style.join_notes(panel.better, note))
    all_axes[-1].xaxis.set_major_locator(MaxNLocator(integer=True))
    return style.finish(figure)
