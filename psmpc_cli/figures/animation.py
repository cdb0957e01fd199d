"""The robot moving, as an animated GIF, and as MP4 where ffmpeg is there."""

from collections.abc import Callable, Sequence
from pathlib import Path
from subprocess import CalledProcessError

import numpy as np
from matplotlib.animation import FFMpegWriter, PillowWriter
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from psmpc_cli.errors import RunError
from psmpc_cli.figures.object_motion import held_between
from psmpc_cli.figures.robot_drawing import View, draw_scene, show, view_of
from psmpc_cli.figures.run import Run
from psmpc_cli.figures.style import readable

RATE, LONGEST, HOLD = 15, 150, 15
"""Frames a second; most frames of motion; frames the end is held."""

WIDTH, DPI = 4.0, 120
"""Width [in] and resolution of a frame."""


def animation_files(directory: Path, name: str = "animation") -> list[Path]:
    """Return the files of an animation: animation.gif, and animation.mp4 where ffmpeg is there."""
    return [directory / f"{name}.{ending}" for ending in ("gif", "mp4")[: 1 + FFMpegWriter.isAvailable()]]


def write_animation(run: Run, path: Path) -> None:
    """Write the robot's motion as an animation, GIF or MP4 by the file's ending.

    Raises:
        RunError: It could not be encoded or written.
    """
    times = frame_times(run)
    view = view_of(run, times)
    figure = _even_sized(view)
    axes = figure.add_subplot()
    _draw_frame(axes, run, run.end, view)
    figure.canvas.draw()
    figure.set_layout_engine("none")  # as it is now: laid out anew, the axes would jitter from frame to frame

    def draw_frame(time: float) -> None:
        axes.clear()
        _draw_frame(axes, run, time, view)

    encode(figure, path, times.tolist(), draw_frame)


def encode(figure: Figure, path: Path, times: Sequence[float], draw_frame: Callable[[float], None]) -> None:
    """Write a figure as it is drawn at each of these times [s], the last one held, GIF or MP4 by the file's ending.

    Raises:
        RunError: It could not be encoded or written.
    """
    writer = PillowWriter(fps=RATE) if path.suffix == ".gif" else FFMpegWriter(fps=RATE)
    try:
        with writer.saving(figure, str(path), DPI):
            for time in [*times, *[times[-1]] * HOLD]:
                draw_frame(time)
                writer.grab_frame()
    except (OSError, CalledProcessError) as error:
        raise RunError(f"{path} could not be written: {error}") from None


def frame_times(run: Run) -> np.ndarray:
    """Return the time of each frame [s]: evenly spread, no more than there are samples."""
    return np.linspace(run.time[0], run.end, min(LONGEST, len(run.time)))


def _draw_frame(axes: Axes, run: Run, time: float, view: View) -> None:
    draw_scene(axes, run, time, width=1.6)
    show(axes, view)
    axes.set_title(f"t = {time:.1f} s: {', '.join(events_at(run, time))}", loc="left")
    axes.set_xlabel("x (m)")
    axes.set_ylabel("y (m)")


def events_at(run: Run, time: float) -> list[str]:
    """Return what goes on at a time [s]: the current stage, those acting early, whether the object is lost."""
    current = [span for span in run.spans if span.start <= time]
    early = [span for span in run.spans if span.early is not None and span.early <= time < span.start]
    hold = held_between(run)
    events = [readable(current[-1].name), *(f"{readable(span.name)} acts already" for span in early)]
    return events + ["object lost"] * (hold.lost and time >= hold.end)


def _even_sized(view: View) -> Figure:
    """Return a figure whose pixels are even in number both ways, as video encoders want."""
    height = round((WIDTH * view.aspect + 0.6) * DPI / 2) * 2 / DPI
    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure
