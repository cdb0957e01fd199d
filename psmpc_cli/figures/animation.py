"""The robot moving, as an animated GIF, and as MP4 where ffmpeg is there."""

from pathlib import Path

import numpy as np
from matplotlib.animation import AbstractMovieWriter, FFMpegWriter, PillowWriter
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from psmpc_cli.figures.draw import prepare
from psmpc_cli.figures.object_motion import held_between
from psmpc_cli.figures.robot_drawing import View, draw_scene, show, view_of
from psmpc_cli.figures.run import Run, load_run
from psmpc_cli.figures.style import in_style, readable
from psmpc_cli.logs.read import Log

RATE, LONGEST, HOLD = 15, 150, 15
"""Frames a second; most frames of motion; frames the end is held."""

WIDTH, DPI = 4.0, 120


def animate(log: Log, directory: Path, force: bool = False) -> list[Path]:
    """Write animation.gif, and animation.mp4 where ffmpeg is there, and return the files.

    Args:
        log: The log.
        directory: Where the files go; made where it does not exist.
        force: Overwrite files that exist.

    Raises:
        InputError: A file exists or cannot be written.
        LogError: There is nothing to draw, or the log does not say what ran.
    """
    writers: dict[Path, AbstractMovieWriter] = {directory / "animation.gif": PillowWriter(fps=RATE)}
    if FFMpegWriter.isAvailable():
        writers[directory / "animation.mp4"] = FFMpegWriter(fps=RATE)
    run = load_run(log)
    prepare(directory, writers, force)
    with in_style():
        for path, writer in writers.items():
            _write(run, path, writer)
    return list(writers)


def frame_times(run: Run) -> np.ndarray:
    """Return the time of each frame [s]: evenly spread, no more than there are samples."""
    return np.linspace(run.time[0], run.end, min(LONGEST, len(run.time)))


def _write(run: Run, path: Path, writer: AbstractMovieWriter) -> None:
    times = frame_times(run)
    view = view_of(run, times)
    figure = _even_sized(view)
    axes = figure.add_subplot()
    _draw_frame(axes, run, run.end, view)
    figure.canvas.draw()
    figure.set_layout_engine("none")  # as it is now: laid out anew, the axes would jitter from frame to frame
    with writer.saving(figure, str(path), DPI):
        for time in np.r_[times, np.full(HOLD, times[-1])]:
            axes.clear()
            _draw_frame(axes, run, float(time), view)
            writer.grab_frame()


def _draw_frame(axes: Axes, run: Run, time: float, view: View) -> None:
    draw_scene(axes, run, time, width=1.6)
    show(axes, view)
    current = [span for span in run.spans if span.start <= time] or run.spans[:1]
    early = [span for span in run.spans if span.early is not None and span.early <= time < span.start]
    hold = held_between(run)
    events = [readable(current[-1].name), *(f"{readable(span.name)} acts already" for span in early)]
    events += ["object lost"] * (hold.lost and time >= hold.end)
    axes.set_title(f"t = {time:.1f} s: {', '.join(events)}", loc="left")
    axes.set_xlabel("x (m)")
    axes.set_ylabel("y (m)")


def _even_sized(view: View) -> Figure:
    """Return a figure whose pixels are even in number both ways, as video encoders want."""
    height = round((WIDTH * view.aspect + 0.6) * DPI / 2) * 2 / DPI
    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure
