"""The frame of every figure over time: a strip that names the stages, and panels below it shaded by stage."""

from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator

from psmpc_cli.figures.run import Run, Span
from psmpc_cli.figures.style import (
    AXIS_WIDTH,
    COLUMN,
    EARLY,
    EDGE,
    LINE,
    STAGE,
    SWITCH,
    TEXT,
    grow,
    legend_columns,
    new_figure,
    readable,
    text_width,
)

STRIP, MARGINS = 0.3, 0.5
"""Height of the strip; of everything else but panels and legend [in]."""

ROOM = 0.012
"""Free space at either end of the time axis, as a part of the run: its first and last values must be seen."""

DOTTED = (0, (1, 1.5))

HALO = (withStroke(linewidth=1.5, foreground="white"),)
"""Around a stage's name, which may be wider than its bar."""


@dataclass(frozen=True, eq=False)
class Timeline:
    """A figure, its panels from top to bottom, and what its common legend says of the stages."""

    figure: Figure
    panels: Sequence[Axes]
    handles: tuple[Artist, ...]

    def finish(self, handles: Sequence[Artist] = ()) -> Figure:
        """Write the common legend, with more entries, below the panels and return the figure."""
        every = [*handles, *self.handles]
        if every:
            columns = legend_columns((str(handle.get_label()) for handle in every), COLUMN - 0.1)
            grow(self.panels[0], -(-len(every) // columns) * LINE)
            self.figure.legend(handles=every, loc="outside lower center", ncols=columns)
        return self.figure


def open_timeline(run: Run, panels: int, height: float) -> Timeline:
    """Return a figure of `panels` empty panels, each `height` [in] tall, along the time of the run."""
    figure = new_figure(STRIP + MARGINS + panels * height)
    axes = figure.subplots(panels + 1, 1, sharex=True, height_ratios=[STRIP] + [height] * panels)
    room = ROOM * (run.end - float(run.time[0])) or 0.55 * run.task.controller.sample_time
    axes[0].set_xlim(float(run.time[0]) - room, run.end + room)
    keys = draw_strip(axes[0], run)
    for panel in axes[1:]:
        shade(panel, run.spans)
    axes[-1].set_xlabel("Time (s)")
    axes[-1].xaxis.set_major_locator(MaxNLocator(nbins=7, steps=[1, 2, 5, 10]))
    figure.align_ylabels(axes[1:])
    return Timeline(figure, axes[1:], (*stage_handles(run.spans), *keys))


def shade(axes: Axes, spans: Sequence[Span]) -> None:
    """Shade every other stage, and where the next one acted early; a dotted line marks each premature start."""
    for span in spans:
        if span.index % 2:
            axes.axvspan(span.start, span.end, facecolor=STAGE, edgecolor="none", zorder=0)
        if span.index:
            axes.axvline(span.start, color=SWITCH, linewidth=0.5, zorder=0.15)
    for span in spans:
        if span.early is not None:
            axes.axvspan(span.early, span.start, facecolor=EARLY, edgecolor="none", zorder=0.1)
            axes.axvline(span.early, color="black", linestyle=DOTTED, linewidth=0.8, zorder=0.2)


def stage_handles(spans: Sequence[Span]) -> tuple[Artist, ...]:
    """Return what a legend says of the shades."""
    handles: list[Artist] = []
    if len(spans) > 1:
        handles.append(Patch(facecolor=STAGE, edgecolor=EDGE, linewidth=0.4, label="every other stage"))
    if any(span.early is not None for span in spans):
        handles.append(Patch(facecolor=EARLY, edgecolor="none", label="next stage acts already"))
        handles.append(Line2D([], [], color="black", linestyle=DOTTED, linewidth=0.8, label="premature start"))
    return tuple(handles)


def draw_strip(axes: Axes, run: Run, width: float = AXIS_WIDTH) -> tuple[Artist, ...]:
    """Draw the stages as bars, alternately on two rows; return legend entries of those whose names do not fit.

    Args:
        axes: Along the time of the run; its limits are set.
        run: The run.
        width: About the width of the axes [in].
    """
    axes.set_ylim(2, 0)
    axes.set_axis_off()
    names = _strip_names(run, axes.get_xlim(), width)
    for span in run.spans:
        row, face = span.index % 2, STAGE if span.index % 2 else "white"
        left, bottom, height = _left(span), row + 0.07, 0.86
        if span.early is not None:
            axes.add_patch(Rectangle((left, bottom), span.start - left, height, facecolor=EARLY))
        axes.add_patch(Rectangle((span.start, bottom), span.end - span.start, height, facecolor=face))
        outline = Rectangle((left, bottom), span.end - left, height, fill=False, edgecolor=EDGE, linewidth=0.5)
        outline.set_clip_on(False)
        axes.add_patch(outline)
        centre, text = names[span.index]
        axes.text(centre, row + 0.54, text, fontsize=TEXT, ha="center", va="center", path_effects=HALO)
    return tuple(
        Line2D([], [], linestyle="none", label=f"{span.index + 1}: {readable(span.name)}")
        for span in run.spans
        if names[span.index][1] != readable(span.name)
    )


def _strip_names(run: Run, limits: tuple[float, float], width: float) -> dict[int, tuple[float, str]]:
    """Return where each stage's name stands on the strip, and the name.

    In place of a name that does not fit stands the stage's number, and nothing where not even that fits.
    """
    first, last = limits
    per_inch = (last - first) / width
    names, written = {}, [first, first]  # up to where each row is written
    for span in run.spans:
        row = span.index % 2
        others = [other for other in run.spans if other is not span and other.index % 2 == row]
        for text in (readable(span.name), str(span.index + 1), ""):
            half = (text_width(text) + 0.06) * per_inch / 2
            centre = min(max(_middle(span), first + half), max(last - half, first + half))
            left, right = centre - half, centre + half
            clear = all(right <= _left(other) or other.end <= left for other in others)
            if (clear and right - left <= last - first and written[row] <= left) or not text:
                break
        names[span.index] = (centre, text)
        written[row] = right if text else written[row]
    return names


def _left(span: Span) -> float:
    return span.start if span.early is None else span.early


def _middle(span: Span) -> float:
    return (_left(span) + span.end) / 2
